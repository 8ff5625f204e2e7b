"""What a scene's errors are before a run: measured on one frame, at a quarter of its resolution.

A pilot frame is stylized with the coarsest octave alone, which costs a small part of a frame, and
its own error estimates are kept with what pictures, files and iterations of other settings would
lose. ``error_choice`` chooses from these.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from usdsmoke.config import Config, GridsConfig
from usdsmoke.core.picture_errors import Painted, fit_blocks, resolution_error
from usdsmoke.core.scene import Scene, frame_views, measure_scene
from usdsmoke.core.smoke import ActiveSmoke
from usdsmoke.core.stylize import StylizedFrame, make_job, open_frame, stylize_window
from usdsmoke.storage_error import storage_errors
from usdsmoke.volume import VolumeFrame

__all__ = ["calibrate"]

MOST_VOXELS = 8  # a pixel's side
SHARES = (1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1)  # of the mass, to be pruned
LEAST_SHARE = 1e-4  # of a fall that a pilot's tail can tell


def calibrate(
    frame: VolumeFrame, styles: Sequence[np.ndarray], config: Config, up_axis: str
) -> dict[str, Any]:
    """The errors of one frame with other settings, as JSON values.

    Args:
        frame: one with smoke.
        styles: display-encoded images [H W 3] in [0, 1].
        config: the run's settings.
        up_axis: "Y" or "Z".

    Returns:
        ``image_sizes``: pairs of a picture's size and its resolution error, the smallest first;
        ``transport``: error by scheme; ``quadrature``; ``half``: of 16-bit floats; ``prune``: pairs
        of the mass that is lost and the density at or below which it lies; ``steps``: by name
        ``octave`` (iterations of the pilot) and ``remaining`` (share of the fall left after them);
        ``view_deviation``: of one view's loss, relative; ``seconds``. A frame in which nothing is
        done gives an empty mapping.

    Raises:
        NonFiniteError, FeatureError: see ``stylize.stylize_window``.
    """
    started = time.perf_counter()
    scene = measure_scene([frame], config, up_axis)
    link = open_frame(frame, make_job(styles, scene, config, None, 24.0, None, 1))
    if link.left_out:
        return {}
    (pilot,) = stylize_window([frame], styles, scene, _pilot_config(config))
    shape, errors = pilot.report.get("shape", {}), pilot.report["errors"]
    return {
        "time_code": frame.time_code,
        "image_sizes": _image_sizes(link.source, scene, config),
        "transport": {
            "linear": shape.get("cheap scheme differs", 0.0),
            "cubic": shape.get("transport error", {}).get("value", 0.0),
        },
        "quadrature": errors.get("quadrature", {}).get("value", 0.0),
        "half": max(entry["value"] for entry in _half(pilot).values()),
        "prune": _prune_levels(pilot.density.values),
        "steps": _steps(pilot.report, config),
        "view_deviation": _view_deviation(pilot.report, config),
        "seconds": time.perf_counter() - started,
    }


def _pilot_config(config: Config) -> Config:
    """One octave, of a quarter of the resolution, and what tells most about it."""
    shape = replace(
        config.shape, iterations=_pilot_iterations(config.shape.iterations), interpolation="cubic"
    )
    colour = replace(config.colour, iterations=_pilot_iterations(config.colour.iterations))
    optimize = replace(
        config.optimize, iterations=None, tolerance=0.0, strength=1.0, error_budget=True
    )
    stage = replace(config.stage, motion="velocity")
    return replace(config, shape=shape, colour=colour, optimize=optimize, stage=stage)


def _pilot_iterations(per_octave: Sequence[int]) -> list[int]:
    return [max(per_octave), *[0] * max(len(per_octave) - 1, 2)]


def _image_sizes(smoke: ActiveSmoke, scene: Scene, config: Config) -> list[list[float]]:
    """Pictures of the source with pixels of 8, 4, 2 and 1 voxels."""
    colour = "colour" in config.optimize.steps
    gamma_w = scene.gamma_w if colour else scene.gamma_w_shape
    longest, found = scene.image_size * scene.pixel_size, []
    views = replace(config, views=replace(config.views, pool=1))
    per_voxel = MOST_VOXELS
    while per_voxel >= 1:
        pixel = per_voxel * smoke.voxel_size
        size = math.ceil(longest / pixel - 1e-6)
        if 16 <= size <= 2048:
            near = replace(scene, pixel_size=pixel)
            view = fit_blocks(frame_views(smoke, views, near, config.optimize.seed)[0])
            with torch.no_grad():
                found.append([size, resolution_error(Painted(smoke, None), view, gamma_w).value])
        per_voxel //= 2
    return found


def _half(pilot: StylizedFrame) -> dict[str, dict[str, float]]:
    fields = [field for field in (pilot.density, pilot.emission) if field is not None]
    return storage_errors(fields, GridsConfig(half=True))


def _prune_levels(density: np.ndarray) -> list[list[float]]:
    """For each share of the mass the density at or below which no more than it lies."""
    values = np.sort(density[density > 0], axis=None).astype(np.float64)
    if len(values) == 0:
        return []
    mass = np.cumsum(values)
    places = np.searchsorted(mass, np.asarray(SHARES) * mass[-1], side="right")
    return [
        [share, float(values[place - 1])]
        for share, place in zip(SHARES, places, strict=True)
        if place > 0
    ]


def _steps(report: dict[str, Any], config: Config) -> dict[str, dict[str, float]]:
    steps = {}
    for name, part in (("shape", config.shape), ("colour", config.colour)):
        found = report.get(name, {})
        fallen, remaining = found.get("fallen", 0.0), found.get("remaining", 0.0)
        if name in report and fallen + remaining > 0:
            share = max(remaining / (fallen + remaining), LEAST_SHARE)
            steps[name] = {"octave": float(max(part.iterations)), "remaining": share}
    return steps


def _view_deviation(report: dict[str, Any], config: Config) -> float:
    last = report.get("colour") or report.get("shape") or {}
    return float(last.get("view spread", 0.0)) * math.sqrt(config.views.pool)

"""What a scene's errors are before a run: measured on one frame, stylized in short.

The pilot is the run's own pipeline at full resolution, with some of its iterations: a small part of
a shot's time, and a displacement, strokes and losses such as a run has them. ``runs.budget.choice``
chooses from these figures.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.frame_report import LEAST_MOVE, FrameReport, StepReport
from usdsmoke.base.sections import GridsConfig
from usdsmoke.base.settings import Config
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.fields.richardson import warp_error
from usdsmoke.core.fields.transport import Scheme, warp
from usdsmoke.core.sequence.error_estimates import painted_frame
from usdsmoke.core.sequence.frame_loop import run_frames
from usdsmoke.core.sequence.frame_state import PaintedFrame, make_context
from usdsmoke.core.sequence.picture_errors import fit_blocks, resolution_error
from usdsmoke.core.sequence.storage_error import storage_errors
from usdsmoke.core.sequence.stylize import stylized_frame
from usdsmoke.core.smoke.schedule import pool_size
from usdsmoke.core.steps.loss_tail import LONGER
from usdsmoke.core.views.scene import Scene, frame_views, measure_scene

MOST_VOXELS = 8  # a pixel's side
SHARES = (1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1)  # of the mass, to be pruned
FINEST_ITERATIONS = 32  # of the pilot's last octave: fewer tell little of a tail
COARSE_ITERATIONS = 20  # at most, of those before
LEAST_SHARE = 1e-3  # of a fall that a pilot's tail can tell


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
        ``transport``: see ``_transport``, None without a shape step; ``quadrature``; ``half``: of
        16-bit floats; ``prune``: pairs of the mass that is lost and the density at or below which
        it lies; ``steps``: by name ``iterations`` (of the pilot's last octave), ``remaining``
        (share of that octave's fall left after them) and ``fallen`` (how far it fell, relative to
        its end), or ``why`` there is none;
        ``view_deviation``: of one view's loss, relative; ``unseen_views``: their error, and the
        pool's size it was found with, None for one view; ``seconds``. A frame in which nothing is
        done gives an empty mapping.

    Raises:
        NonFiniteError, FeatureError: see ``stylize.stylize_window``.
    """
    started = time.perf_counter()
    pilot = _pilot_config(config)
    scene = measure_scene([frame], pilot.views, pilot.optics, up_axis, pilot.grids.refine)
    context = make_context(styles, scene, pilot, None, 24.0, None, 1)
    (finished,) = run_frames([frame], context)
    if finished.left_out:
        return {}
    done = stylized_frame(finished, context)
    n_views = pool_size(pilot.views, finished.source.thin_axis is not None)
    quadrature, unseen = done.report.errors.quadrature, done.report.errors.unseen_views
    fields = [field for field in (done.density, done.emission) if field is not None]
    return {
        "time_code": frame.time_code,
        "image_sizes": _image_sizes(finished, scene, pilot),
        "transport": _transport(finished),
        "quadrature": 0.0 if quadrature is None else quadrature.value,
        "half": _half(fields),
        "prune": _prune_levels(done.density.values),
        "steps": {name: _step(step) for name, step in done.report.steps.items()},
        "view_deviation": _view_deviation(done.report, n_views),
        "unseen_views": None if unseen is None else [n_views, unseen.value],
        "seconds": time.perf_counter() - started,
    }


def _pilot_config(config: Config) -> Config:
    """All octaves with some of the iterations, and what tells most about them."""
    shape = config.shape.replace(
        iterations=_pilot_iterations(config.shape.iterations), interpolation="cubic"
    )
    colour = config.colour.replace(iterations=_pilot_iterations(config.colour.iterations))
    optimize = config.optimize.replace(
        iterations=None, tolerance=0.0, strength=1.0, error_budget=True
    )
    stage = config.stage.replace(motion="velocity")
    return config.replace(shape=shape, colour=colour, optimize=optimize, stage=stage)


def _pilot_iterations(per_octave: Sequence[int]) -> list[int]:
    finest = max((place for place, n in enumerate(per_octave) if n), default=None)
    return [
        FINEST_ITERATIONS if place == finest else min(n, COARSE_ITERATIONS)
        for place, n in enumerate(per_octave)
    ]


def _image_sizes(frame: PaintedFrame, scene: Scene, config: Config) -> list[list[float]]:
    """Pictures of the stylized frame with pixels of 8, 4, 2 and 1 voxels."""
    painted, smoke = painted_frame(frame), frame.smoke
    gamma_w = frame.scene.gamma_w_shape if painted.colours is None else frame.scene.gamma_w
    longest, found = scene.image_size * scene.pixel_size, []
    views = config.views.replace(pool=1)
    per_voxel = MOST_VOXELS
    while per_voxel >= 1:
        pixel = per_voxel * smoke.voxel_size
        size = math.ceil(longest / pixel - 1e-6)
        if 16 <= size <= 2048:
            near = replace(frame.scene, pixel_size=pixel)
            view = fit_blocks(frame_views(smoke, views, near, config.optimize.seed)[0])
            with torch.no_grad():
                found.append([size, resolution_error(painted, view, gamma_w).value])
        per_voxel //= 2
    return found


def _transport(frame: PaintedFrame) -> dict[str, float] | None:
    """``linear`` and ``cubic``: errors of the density moved by the pilot's displacement.

    Two displacements are tried, and the larger error counts: the pilot's own, and its pattern
    scaled to the length that no displacement exceeds. A pilot that hardly moved its smoke
    (``moved`` is its longest way, voxels) has no pattern, and a shift by half a voxel along each
    axis, which is where interpolation is worst, takes its place.
    """
    if frame.displacement is None:
        return None
    lattice = frame.displacement.lattice
    box = lattice.fill(frame.source)
    u = lattice.from_stage(frame.displacement.values) / box.new_tensor(lattice.spacing)
    longest = float(u.norm(dim=-1).max())
    pairs = []
    if longest < LEAST_MOVE:
        u.fill_(0.5)
    else:
        pairs.append(_warp_errors(box, u))
        assert frame.report.transport is not None  # there is a displacement
        u.mul_(frame.report.transport.cap / max(lattice.spacing) / longest)
    pairs.append(_warp_errors(box, u))
    linear, cubic = (max(pair[place] for pair in pairs) for place in (0, 1))
    return {"linear": linear, "cubic": cubic, "moved": longest}


def _warp_errors(box: Tensor, u: Tensor) -> tuple[float, float]:
    """Of the linear and the cubic scheme, as a run's report has them."""
    schemes: tuple[Scheme, Scheme] = ("linear", "cubic")
    cheap, accurate = (warp(box, u, scheme=scheme).clamp_min(0) for scheme in schemes)
    differs = float((cheap - accurate).abs().sum() / accurate.sum().clamp_min(1e-30))
    linear = warp_error(box, u, cheap, "linear").value
    return max(linear, differs), min(warp_error(box, u, accurate, "cubic").value, differs)


def _half(fields: Sequence[DenseField]) -> float:
    errors = storage_errors(fields, GridsConfig(half=True))
    found = (errors.storage_density, errors.storage_emission)
    return max(estimate.value for estimate in found if estimate is not None)


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


def _step(report: StepReport) -> dict[str, Any]:
    """What the losses of a step's last octave show, or why they show nothing."""
    fallen, left = report.fallen_in_last_octave, report.remaining
    if fallen is None or left is None:
        return {"why": "the pilot ran too few iterations to judge"}
    loss, spread = report.loss[-1], report.view_spread or 0.0
    if fallen <= 3 * spread * loss or fallen <= 0:
        return {"why": "the pilot's loss fell by less than the spread between views"}
    left /= (
        1 - 1 / LONGER
    )  # four times as many leave a quarter of what is left after a tail's start
    share = max(left / (fallen + left), LEAST_SHARE)
    return {
        "iterations": float(report.iterations[-1]),
        "remaining": share,
        "fallen": fallen / loss,
    }


def _view_deviation(report: FrameReport, n_views: int) -> float:
    spread = report.last_step.view_spread if report.last_step is not None else None
    return (spread or 0.0) * math.sqrt(n_views)

"""Quadrature rule and step along the rays of the frame."""

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.discretisation.quadrature_rules import RULES, integrate
from usdsmoke.base.volume import DenseField
from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.engine import Sweep
from usdsmoke.work_precision.records import Plan, Task

if TYPE_CHECKING:
    from torch import Tensor

    from usdsmoke.core.views.cameras import View

__all__ = ["SWEEP"]

_STEPS = (1.0, 0.5, 2.0, 0.25, 0.125)  # voxels, the most useful first
_REFERENCE_STEP = 1 / 48
_MOST_RAYS = 1500  # and about as few: fewer would be timed in milliseconds


@dataclass(frozen=True)
class _Rays:
    """Rays through the smoke in its own index space, and what they meet."""

    values: "Tensor"  # [I J K 2]: extinction and emission, per stage unit
    start: "Tensor"  # [R 3], where the box begins
    direction: "Tensor"  # [3], index units per stage unit
    length: float  # stage units
    voxel: float

    def light(self, rule: str, per_voxel: float) -> "Tensor":
        """Light of every ray with segments of about ``per_voxel`` voxels, [R]."""
        import torch

        from usdsmoke.core.fields.sample import sample_linear

        n_steps = max(1, round(self.length / (per_voxel * self.voxel)))
        step = self.length / n_steps
        middles = (torch.arange(n_steps, dtype=torch.float64) + 0.5) * step
        places = self.start[None] + middles[:, None, None] * self.direction
        found = sample_linear(self.values, places.reshape(-1, 3)).view(n_steps, -1, 2)
        return integrate(rule, found[..., 1], found[..., 0], step)


def _applies(case: Case) -> str:
    if "colour" not in case.steps:
        return "optimize.steps has no colour: grey pictures need column sums only, not light along \
the rays"
    return ""


def _plan(case: Case) -> Plan:
    import torch

    view = _middle_view(case)
    rays, pixels = _rays(case, view)
    if 0 < len(pixels) < _MOST_RAYS:
        view = _finer(view, math.ceil(math.sqrt(_MOST_RAYS / len(pixels))))
        rays, pixels = _rays(case, view)
    exact = rays.light("segments", _REFERENCE_STEP)
    marched = torch.from_numpy(_marched(case, view)).double().reshape(-1)[pixels]
    apart = _relative(marched, exact)

    def error(found: "Tensor") -> float:
        return _relative(found, exact)

    finest = 1.0 / case.config.grids.parts
    tasks = [
        Task(
            RULES[rule],
            f"{step:g} voxel a segment" if step == 1 else f"{step:g} voxels a segment",
            partial(lambda rule, step, run: rays.light(rule, step), rule, step),
            error,
            rule == "segments" and step == finest,
            1 / step,
        )
        for step in _steps(finest)
        for rule in RULES
    ]
    return Plan(
        tasks,
        "relative error of the light (rms over the rays)",
        f"{len(pixels)} rays of the middle view through the frame's extinction, with a colour that "
        "changes smoothly in space, because the source has none yet. Time is that of looking the "
        "smoke up and adding the light up, in double precision.",
        f"exponential segments of 1/{1 / _REFERENCE_STEP:.0f} voxel. The ray marcher of previews, "
        f"which cuts rays at the planes of voxels and shares no rule with this, differs from it by "
        f"{apart:.1e} (in single precision).",
        uncertain=apart,
        n_runs=5,
        warm_up=True,
    )


def _steps(finest: float) -> list[float]:
    return sorted({*_STEPS, finest}, key=lambda step: (step != finest, -min(step, 1 / step)))


def _middle_view(case: Case) -> "View":
    from usdsmoke.core.views.scene import frame_views

    views = case.config.views.replace(pool=1, sampling="fixed")
    config = case.config.replace(views=views)
    (view,) = frame_views(case.small_smoke, config.views, case.small_scene, 0)
    return view


def _finer(view: "View", factor: int) -> "View":
    """The same picture with several rays a pixel."""
    return replace(
        view,
        height=view.height * factor,
        width=view.width * factor,
        pixel_size=view.pixel_size / factor,
        focal=None if view.focal is None else view.focal * factor,
        shift=(view.shift[0] * factor, view.shift[1] * factor),
    )


def _fields(case: Case) -> tuple[DenseField, DenseField]:
    """The small frame's density, and an emission C sigma with a colour of waves in space."""
    density = case.small.density
    shape = density.values.shape
    axes = np.meshgrid(*(np.linspace(0, 7, n) for n in shape), indexing="ij")
    colour = 0.55 + 0.45 * np.sin(axes[0] + 1.3 * axes[1] + 0.7 * axes[2] + 0.3)
    light = colour * case.small_scene.gamma_w * np.clip(density.values, 0, None)
    values = np.repeat(light[..., None], 3, axis=-1).astype(np.float32)
    return density, DenseField(
        "emission", values, density.ijk_min, density.index_to_world, (0.0, 0.0, 0.0)
    )


def _rays(case: Case, view: "View") -> tuple[_Rays, np.ndarray]:
    """Rays of pixels that see smoke, and which pixels these are."""
    import torch

    from usdsmoke.core.views.cameras import view_rays

    density, emission = _fields(case)
    sigma = case.small_scene.gamma_w * np.clip(density.values, 0, None)
    to_index = np.linalg.inv(density.index_to_world)
    y, x = np.divmod(np.arange(view.height * view.width), view.width)
    origin, direction = view_rays(view, x, y)
    corners = np.array(list(np.ndindex(2, 2, 2))) * np.array(sigma.shape) * 1.0
    corners = np.where(corners > 0, corners, -1.0) + np.array(density.ijk_min)
    depths = (corners @ density.index_to_world[:3, :3] + density.index_to_world[3, :3]
              - view.centre) @ view.forward  # fmt: skip
    low, high = float(depths.min()), float(depths.max())
    start = (origin + low * direction) @ to_index[:3, :3] + to_index[3, :3] - density.ijk_min
    values = np.stack([sigma, emission.values[..., 0]], axis=-1)
    made = _Rays(
        torch.from_numpy(values).double(),
        torch.from_numpy(start),
        torch.from_numpy(view.forward @ to_index[:3, :3]),
        high - low,
        case.small_smoke.voxel_size,
    )
    bright = made.light("segments", 1.0)
    seen = np.flatnonzero((bright > 1e-3 * bright.max()).numpy())
    pixels = seen[:: -(-len(seen) // _MOST_RAYS)]
    return replace(made, start=made.start[torch.from_numpy(pixels)]), pixels


def _marched(case: Case, view: "View") -> np.ndarray:
    from usdsmoke.core.rays.march import march
    from usdsmoke.core.rays.media import make_media

    density, emission = _fields(case)
    place = np.eye(4)
    media = make_media(density, emission, place, place, case.small_scene.gamma_w, 0.0)
    found: np.ndarray = march(media, view, rays=1).emission[..., 0]
    return found


def _relative(found: "Tensor", exact: "Tensor") -> float:
    return float((found - exact).square().mean().sqrt() / exact.square().mean().sqrt())


SWEEP = Sweep("quadrature", "Quadrature rule and step along a ray", _applies, _plan)

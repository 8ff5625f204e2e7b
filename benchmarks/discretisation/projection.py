"""Splatting voxels on pixels against marching rays: the grey picture of the frame."""

import time
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from usdsmoke.base.volume import DenseField
from usdsmoke.work_precision import Plan, Sweep, Task
from usdsmoke.work_precision.case import Case

if TYPE_CHECKING:
    from usdsmoke.core.views.cameras import View

__all__ = ["SWEEP", "tent_mean"]

_SECOND_RAYS = (4, 8)  # along each side of a pixel; extrapolated, they are the second reference
_QUICK_RAYS = (2, 4)  # where those would take too long
_SPLAT, _MARCH = "voxels splatted (ours)", "rays marched (as previews are)"
_REFINEMENTS, _RAYS = (1, 2, 3), (1, 2, 3, 4)
_FEW = 100_000  # voxels up to which there is a finer refinement still


def _plan(case: Case) -> Plan:
    view, gamma_w = _view(case), case.small_scene.gamma_w_shape
    factors = {*_REFINEMENTS, *([4] if len(case.small_smoke.ijk) < _FEW else [])}
    fields = {factor: _refined(case, factor) for factor in factors}
    exact = _exact(case, view)
    scale = float(np.sqrt(np.mean(exact**2)))

    def error(found: np.ndarray) -> float:
        return float(np.sqrt(np.mean((found - exact) ** 2))) / scale

    second, n_rays = _second(case, view)
    apart = error(second)
    configured = case.config.grids.parts
    splats = [
        Task(
            _SPLAT,
            f"grids.refine={factor}",
            partial(lambda factor, run: _splatted(case, view, fields[factor]), factor),
            error,
            factor == configured,
            factor**3,
        )
        for factor in sorted(fields)
    ]
    rays = [
        Task(
            _MARCH,
            f"{n} x {n} rays a pixel",
            partial(lambda n, run: _marched(case, view, n), n),
            error,
            effort=20.0 * n**2,
        )
        for n in _RAYS
    ]
    return Plan(
        [*splats, *rays],
        "relative error of the grey picture (rms)",
        "The grey picture of the most oblique view that a run draws: it looks "
        f"{_askew(view):.0f} degrees past the voxels' axes and has {view.width} x {view.height} "
        f"pixels, with an extinction of {gamma_w:.3g} per density and stage unit. Both methods "
        "average optical depth over a pixel and its neighbours in the same way (a tent two pixels "
        "wide).",
        "the exact footprints of trilinear voxels, from their Fourier transforms, which share "
        f"nothing with either method. {n_rays[0]} x {n_rays[0]} and {n_rays[1]} x {n_rays[1]} rays "
        f"a pixel, extrapolated, differ from it by {apart:.1e}.",
        uncertain=apart,
        n_runs=3,
        warm_up=True,
    )


def _exact(case: Case, view: "View") -> np.ndarray:
    import torch

    from benchmarks.discretisation.footprint import column_depths
    from usdsmoke.core.smoke.active import activate

    density = case.small.density
    smoke = activate(density, np.eye(4), torch.device("cpu"))
    depth = column_depths(
        smoke.positions.numpy(),
        smoke.density.double().numpy(),
        density.index_to_world[:3, :3],
        view,
    )
    found: np.ndarray = -np.expm1(-case.small_scene.gamma_w_shape * depth)
    return found


def _second(case: Case, view: "View") -> tuple[np.ndarray, tuple[int, int]]:
    """The picture of ray marching, extrapolated by its order of 2; and how many rays it took."""
    started = time.perf_counter()
    _marched(case, view, 1)
    seconds = (time.perf_counter() - started) * sum(n**2 for n in _SECOND_RAYS)
    few, many = _SECOND_RAYS if seconds < case.allowed / 4 else _QUICK_RAYS
    rough, fine = (_marched(case, view, n) for n in (few, many))
    return fine + (fine - rough) / ((many / few) ** 2 - 1), (few, many)


def _askew(view: "View") -> float:
    """Degrees between the view and the nearest axis of the voxels."""
    return float(np.degrees(np.arccos(min(np.abs(view.forward).max(), 1.0))))


def _view(case: Case) -> "View":
    """The most oblique view that a run draws; a parallel one also where there is a camera."""
    from usdsmoke.core.views.scene import frame_views

    scene = replace(case.small_scene, camera=None)
    pool = frame_views(case.small_smoke, case.config.views, scene, case.config.optimize.seed)
    view = max(pool, key=_askew)
    # pixels of room, or light of voxels beside the picture would be missing in one of the two
    return replace(view, height=view.height + 6, width=view.width + 6)


def _refined(case: Case, factor: int) -> DenseField:
    from usdsmoke.core.fields.resample import refine_field

    return refine_field(case.small.density, factor)


def _splatted(case: Case, view: "View", field: DenseField) -> np.ndarray:
    """The map is made anew, as it is for every view of an octave."""
    from usdsmoke.core.smoke.active import activate
    from usdsmoke.core.views.project import column_map

    smoke = activate(field, np.eye(4), case.device)
    image = column_map(smoke.positions, smoke.edges, view)
    depth = image.apply(smoke.density[:, None])[..., 0].cpu().numpy()
    found: np.ndarray = -np.expm1(-case.small_scene.gamma_w_shape * depth)
    return found


def _marched(case: Case, view: "View", n: int) -> np.ndarray:
    from usdsmoke.core.rays.march import march
    from usdsmoke.core.rays.media import make_media

    gamma_w = case.small_scene.gamma_w_shape
    media = make_media(case.small.density, None, np.eye(4), None, gamma_w, 1.0)
    fine = replace(
        view, height=view.height * n, width=view.width * n, pixel_size=view.pixel_size / n
    )
    found: np.ndarray = -np.expm1(-tent_mean(march(media, fine, rays=1).depth, n))
    return found


def tent_mean(fine: np.ndarray, n: int) -> np.ndarray:
    """Means over pixels of [H*n W*n] samples, [H W], weighted by 1 - distance in pixels.

    That is how much of a point a bilinear splat leaves on a pixel. Beyond the picture there is
    nothing.

    >>> tent_mean(np.ones((4, 4)), 1).sum()
    16.0
    """
    for axis in (0, 1):
        size = fine.shape[axis] // n
        middles = (np.arange(fine.shape[axis]) + 0.5) / n - 0.5
        weights = np.clip(1 - np.abs(middles[None] - np.arange(size)[:, None]), 0, None) / n
        fine = np.moveaxis(np.tensordot(weights, fine, axes=([1], [axis])), 0, axis)
    return fine


def _applies(case: Case) -> str:
    if case.small_smoke.thin_axis is not None:
        return "the smoke is one voxel thick: every voxel is a pixel"
    return ""


SWEEP = Sweep("projection", "Projection: splatting against ray marching", _applies, _plan)

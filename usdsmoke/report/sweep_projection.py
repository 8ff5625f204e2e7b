"""Splatting voxels on pixels against marching rays: the grey picture of the frame."""

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from usdsmoke.report.case import Case
from usdsmoke.report.engine import Sweep
from usdsmoke.report.records import Plan, Task
from usdsmoke.volume import DenseField

if TYPE_CHECKING:
    from usdsmoke.core.views import View

__all__ = ["SWEEP", "tent_mean"]

_REFERENCE_RAYS = 8  # along each side of a pixel
_SPLAT, _MARCH = "voxels splatted (ours)", "rays marched (as previews are)"
_REFINEMENTS, _RAYS = (1, 2, 3), (1, 2, 3, 4)


def _plan(case: Case) -> Plan:
    view, gamma_w = _view(case), case.small_scene.gamma_w_shape
    fields = {factor: _refined(case, factor) for factor in (*_REFINEMENTS, _second(case))}
    exact = _marched(case, view, _REFERENCE_RAYS)
    scale = float(np.sqrt(np.mean(exact**2)))

    def error(found: np.ndarray) -> float:
        return float(np.sqrt(np.mean((found - exact) ** 2))) / scale

    configured = case.config.grids.refine
    apart = error(_splatted(case, view, fields[_second(case)]))
    splats = [
        Task(
            _SPLAT,
            f"grids.refine={factor}",
            partial(lambda factor, run: _splatted(case, view, fields[factor]), factor),
            error,
            1 / factor,
            factor == configured,
            factor**3,
        )
        for factor in sorted({*_REFINEMENTS, configured} & fields.keys())
    ]
    rays = [
        Task(
            _MARCH,
            f"{n} x {n} rays a pixel",
            partial(lambda n, run: _marched(case, view, n), n),
            error,
            1 / n,
            effort=20.0 * n**2,
        )
        for n in _RAYS
    ]
    return Plan(
        [*splats, *rays],
        "relative error of the grey picture (rms)",
        f"The grey picture of the middle view, {view.width} x {view.height} pixels, with an "
        f"extinction of {gamma_w:.3g} per density and stage unit. Both methods average optical "
        "depth over a pixel and its neighbours in the same way (a tent two pixels wide).",
        f"{_REFERENCE_RAYS} x {_REFERENCE_RAYS} rays a pixel. Splatting on voxels "
        f"{_second(case)} times finer, the other method, differs from it by {apart:.1e}.",
        setting="the distance of samples",
        n_runs=3,
        warm_up=True,
    )


def _second(case: Case) -> int:
    return 4 if len(case.small_smoke.ijk) < 100_000 else 3


def _view(case: Case) -> "View":
    from usdsmoke.core.scene import frame_views

    views = replace(case.config.views, pool=1, sampling="fixed")
    (view,) = frame_views(case.small_smoke, replace(case.config, views=views), case.small_scene, 0)
    # a pixel of room, or light of voxels beside the picture would be missing in one of the two
    return replace(view, height=view.height + 4, width=view.width + 4)


def _refined(case: Case, factor: int) -> DenseField:
    from usdsmoke.core.refine import refine_field

    return refine_field(case.small.density, factor)


def _splatted(case: Case, view: "View", field: DenseField) -> np.ndarray:
    """The map is made anew, as it is for every view of an octave."""
    from usdsmoke.core.project import column_map
    from usdsmoke.core.smoke import activate

    smoke = activate(field, np.eye(4), case.device)
    image = column_map(smoke.positions, smoke.voxel_volume, view)
    depth = image.apply(smoke.density[:, None])[..., 0].cpu().numpy()
    found: np.ndarray = -np.expm1(-case.small_scene.gamma_w_shape * depth)
    return found


def _marched(case: Case, view: "View", n: int) -> np.ndarray:
    from usdsmoke.core.march import march
    from usdsmoke.core.media import make_media

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


SWEEP = Sweep("projection", "Projection: splatting against ray marching", 1.0, _applies, _plan)

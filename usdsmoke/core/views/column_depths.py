"""Columns of smoke along the pixels of a view: what the thick ones have, and what keeps it."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from usdsmoke.base.sections import OpticsConfig
from usdsmoke.core.smoke.levels import bounded, ranked
from usdsmoke.core.smoke.thicken import Thickening, find_thickening
from usdsmoke.core.smoke.voxels import Voxels
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.footprint import splat

DENSE_COLUMNS = 0.95  # rank of the columns that are dense
FRINGE = 1e-3  # of those: columns below are not counted as smoke
MUCH = 8.0  # times the thick columns
_SEVERAL = 10  # columns; fewer are an outlier
THIN = 25.0  # percentile of the columns that are thin
# Of what the thick columns have. The simulated plume of the examples has 0.25, and shows strokes
# everywhere; the real one has 0.03, and its upper half is fog. With ten times it has 0.13.
THIN_SHARE = 0.13
MOST_TIMES = 10.0  # of smoke that is not asked to be thickened by more
_HALVINGS = 4  # of the range of times: to a seventh


def dense_columns(smoke: Voxels, view: View) -> tuple[np.ndarray, int]:
    """Column integrals of density where there is smoke, [P], density x stage unit; and how many
    there are with those that are left out.

    Pixels that only the smoke's fringe reaches are left out, by what the dense columns have: the
    densest one may be that of one voxel.

    Args:
        view: from ``fit_view``.
    """
    columns = splat(bounded(smoke), view)
    some = columns[columns > 0]
    return some[some > FRINGE * ranked(some, DENSE_COLUMNS)], len(some)


def thick_columns(
    seen: Sequence[tuple[Voxels, View]], percentile: float
) -> tuple[list[np.ndarray], float, float]:
    """The columns of each frame, what thick ones have, and the share of all that is as thick.

    Frames count by their number of voxels: a wisp before or after the smoke hardly does, and one
    frame with another unit has no larger weight.
    """
    found = [dense_columns(*pair) for pair in seen]
    columns, sizes = [dense for dense, _ in found], frame_sizes(seen)
    thick = weighted_median([float(np.percentile(c, percentile)) for c in columns], sizes)
    return columns, thick, weighted_median([float((c >= thick).sum() / n) for c, n in found], sizes)


def find_curve(seen: Sequence[tuple[Voxels, View]], optics: OpticsConfig) -> Thickening | None:
    """The curve of ``optics.thicken``; None where density stays as it is.

    An unset knee is the one with which thick columns keep what they have. Unset times are what
    gives the thin columns ``THIN_SHARE`` of that, between 1 and ``MOST_TIMES``.
    """
    if optics.thicken is not None:
        return _curve(seen, optics, optics.thicken) if optics.thicken > 1 else None
    if _thin_share(seen, optics) >= THIN_SHARE:
        return None
    low, high, found = 0.0, math.log(MOST_TIMES), _curve(seen, optics, MOST_TIMES)
    if _thin_share(_all_thickened(seen, found), optics) < THIN_SHARE:
        return found
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        curve = _curve(seen, optics, math.exp(middle))
        if _thin_share(_all_thickened(seen, curve), optics) < THIN_SHARE:
            low = middle
        else:
            high, found = middle, curve
    return found


def _curve(
    seen: Sequence[tuple[Voxels, View]], optics: OpticsConfig, times: float
) -> Thickening | None:
    if optics.knee is not None:
        return Thickening(times, optics.knee)
    dense = [ranked(smoke.density, DENSE_COLUMNS) for smoke, _ in seen]
    usual = weighted_median(dense, frame_sizes(seen))

    def thickness(curve: Thickening) -> float:
        return thick_columns(_all_thickened(seen, curve), optics.percentile)[1]

    wanted = thick_columns(seen, optics.percentile)[1]
    return find_thickening(times, usual, thickness, wanted)


def _thin_share(seen: Sequence[tuple[Voxels, View]], optics: OpticsConfig) -> float:
    """What the thin columns have of what the thick ones have; 1 without smoke."""
    columns, thick, _ = thick_columns(seen, optics.percentile)
    thin = weighted_median([float(np.percentile(c, THIN)) for c in columns], frame_sizes(seen))
    return thin / thick if thick > 0 else 1.0


def _all_thickened(
    seen: Sequence[tuple[Voxels, View]], curve: Thickening | None
) -> list[tuple[Voxels, View]]:
    return [(thickened(smoke, curve), view) for smoke, view in seen]


def thickened(smoke: Voxels, curve: Thickening | None) -> Voxels:
    """The smoke behind a curve."""
    return smoke if curve is None else replace(smoke, density=curve(smoke.density))


def frame_sizes(seen: Sequence[tuple[Voxels, View]]) -> list[int]:
    """What frames count by: their numbers of voxels."""
    return [len(smoke.ijk) for smoke, _ in seen]


def weighted_median(values: Sequence[float], weights: Sequence[float]) -> float:
    """The median of weighted values; the usual one where all weigh the same.

    >>> weighted_median([30.0, 1.0, 2.0], [1, 1, 9])
    2.0
    """
    order = np.argsort(values)
    weight = np.asarray(weights, float)[order]
    middles = weight.cumsum() - weight / 2
    return float(np.interp(weight.sum() / 2, middles, np.asarray(values)[order]))


def hidden_mass(smoke: Voxels, view: View, thick: float) -> float:
    """The share of the mass in columns ``MUCH`` times as thick; 0 where those are few."""
    columns = splat(smoke, view)
    dense = columns[columns > MUCH * thick]
    return float(dense.sum() / columns.sum()) if len(dense) >= _SEVERAL else 0.0

"""Columns of smoke along the pixels of a view: what the thick ones have, and what keeps it."""

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
    """The curve of ``optics.thicken``: an unset knee is the one with which thick columns have what
    they had. None where density stays as it is.
    """
    if optics.thicken == 1:
        return None
    if optics.knee is not None:
        return Thickening(optics.thicken, optics.knee)
    wanted = thick_columns(seen, optics.percentile)[1]
    dense = [ranked(smoke.density, DENSE_COLUMNS) for smoke, _ in seen]
    usual = weighted_median(dense, frame_sizes(seen))

    def thickness(curve: Thickening) -> float:
        curved = [(thickened(smoke, curve), view) for smoke, view in seen]
        return thick_columns(curved, optics.percentile)[1]

    return find_thickening(optics.thicken, usual, thickness, wanted)


def thickened(smoke: Voxels, curve: Thickening) -> Voxels:
    """The smoke behind a curve."""
    return replace(smoke, density=curve(smoke.density))


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

"""Columns of smoke along the pixels of a view: what the thick ones have, and what keeps it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

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


@dataclass(frozen=True)
class SeenSmoke:
    """The smoke of a frame as one view sees it.

    The columns that count are those of the source, behind any curve. Pixels that only the smoke's
    fringe reaches are left out, by what the dense columns have: the densest one may be that of one
    voxel.
    """

    smoke: Voxels  # of the source, without a floor
    view: View  # from ``fit_view``
    floor: float = 0.0  # density of the smoke's floor; it is not thickened

    def behind(self, curve: Thickening | None) -> Voxels:
        """The smoke behind a curve."""
        if curve is None:
            return self.smoke
        return replace(self.smoke, density=curve(self.smoke.density, self.floor))

    def columns(self, curve: Thickening | None = None) -> np.ndarray:
        """Integrals of density where there is smoke, [P], density x stage unit."""
        if curve is None:
            return self._source[self._counts]
        return splat(bounded(self.behind(curve)), self.view)[self._counts]

    @property
    def n_columns(self) -> int:
        """How many columns there are, with those that are left out."""
        return int((self._source > 0).sum())

    @cached_property
    def _source(self) -> np.ndarray:
        return splat(bounded(self.smoke), self.view)

    @cached_property
    def _counts(self) -> np.ndarray:
        dense = ranked(self._source[self._source > 0], DENSE_COLUMNS)
        return self._source > FRINGE * dense


def column_percentile(
    columns: Sequence[np.ndarray], seen: Sequence[SeenSmoke], percentile: float
) -> float:
    """A percentile of each frame's columns, and the median of these.

    Frames count by their number of voxels: a wisp before or after the smoke hardly does, and one
    frame with another unit has no larger weight.
    """
    return weighted_median([float(np.percentile(c, percentile)) for c in columns], seen)


def find_curve(seen: Sequence[SeenSmoke], optics: OpticsConfig) -> Thickening | None:
    """The curve of ``optics.thicken``; None where density stays as it is.

    An unset knee is the one with which thick columns keep what they have. Unset times are what
    gives the thin columns ``THIN_SHARE`` of that, between 1 and ``MOST_TIMES``.
    """
    if optics.thicken is not None:
        return _curve(seen, optics, optics.thicken) if optics.thicken > 1 else None
    if _thin_share(seen, optics, None) >= THIN_SHARE:
        return None
    low, high, found = 0.0, math.log(MOST_TIMES), _curve(seen, optics, MOST_TIMES)
    if _thin_share(seen, optics, found) < THIN_SHARE:
        return found
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        curve = _curve(seen, optics, math.exp(middle))
        if _thin_share(seen, optics, curve) < THIN_SHARE:
            low = middle
        else:
            high, found = middle, curve
    return found


def _curve(seen: Sequence[SeenSmoke], optics: OpticsConfig, times: float) -> Thickening | None:
    if optics.knee is not None:
        return Thickening(times, optics.knee)
    dense = [ranked(one.smoke.density, DENSE_COLUMNS) for one in seen]

    def thickness(curve: Thickening | None) -> float:
        return column_percentile([one.columns(curve) for one in seen], seen, optics.percentile)

    return find_thickening(times, weighted_median(dense, seen), thickness, thickness(None))


def _thin_share(seen: Sequence[SeenSmoke], optics: OpticsConfig, curve: Thickening | None) -> float:
    """What the thin columns have of what the thick ones have; 1 without smoke."""
    columns = [one.columns(curve) for one in seen]
    thin, thick = (column_percentile(columns, seen, rank) for rank in (THIN, optics.percentile))
    return thin / thick if thick > 0 else 1.0


def weighted_median(values: Sequence[float], seen: Sequence[SeenSmoke]) -> float:
    """The median of a value of each frame, which counts by its number of voxels."""
    order = np.argsort(values)
    weight = np.array([len(one.smoke.ijk) for one in seen], float)[order]
    middles = weight.cumsum() - weight / 2
    return float(np.interp(weight.sum() / 2, middles, np.asarray(values)[order]))


def hidden_mass(seen: SeenSmoke, curve: Thickening | None, thick: float) -> float:
    """The share of the mass in columns ``MUCH`` times as thick; 0 where those are few."""
    columns = splat(seen.behind(curve), seen.view)
    dense = columns[columns > MUCH * thick]
    return float(dense.sum() / columns.sum()) if len(dense) >= _SEVERAL else 0.0

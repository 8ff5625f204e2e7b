"""Columns of smoke along the pixels of a view: what the thick ones have, and what keeps it."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from usdsmoke.base.errors import ConfigError
from usdsmoke.config.look_sections import OpticsConfig
from usdsmoke.core.smoke.levels import bounded, ranked
from usdsmoke.core.smoke.thicken import Thickening, find_thickening
from usdsmoke.core.smoke.voxels import Voxels
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.footprint import ColumnSums

MOST_EXTINCTION = 3e38  # per density, 1/stage unit
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
_ROUGH = 1e-2  # of thick columns, while the times are looked for
_PRECISE = 1e-4
_USUAL = 0.03  # of the density of dense smoke: a usual knee
_FALL = 1.7  # power of the times by which a knee usually falls


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
        return self._sums(bounded(self.behind(curve)).density)[self._counts]

    def hidden_mass(self, curve: Thickening | None, thick: float) -> float:
        """The share of the mass in columns ``MUCH`` times as thick; 0 where those are few."""
        columns = self._sums(self.behind(curve).density)
        dense = columns[columns > MUCH * thick]
        return float(dense.sum() / columns.sum()) if len(dense) >= _SEVERAL else 0.0

    @property
    def n_columns(self) -> int:
        """How many columns there are, with those that are left out."""
        return int((self._source > 0).sum())

    @cached_property
    def _source(self) -> np.ndarray:
        return self._sums(bounded(self.smoke).density)

    @cached_property
    def _sums(self) -> ColumnSums:
        return ColumnSums(self.smoke, self.view)

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
    search = _Search(seen, optics)
    if optics.thicken is not None:
        return search.curve(optics.thicken) if optics.thicken > 1 else None
    if search.thin_share(None) >= THIN_SHARE:
        return None
    low, high = 0.0, math.log(MOST_TIMES)
    if search.thin_share(search.curve(MOST_TIMES, _ROUGH)) >= THIN_SHARE:
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            if search.thin_share(search.curve(math.exp(middle), _ROUGH)) < THIN_SHARE:
                low = middle
            else:
                high = middle
    return search.curve(math.exp(high))


class _Search:
    """Curves of some smoke; each is looked for near the one before."""

    def __init__(self, seen: Sequence[SeenSmoke], optics: OpticsConfig) -> None:
        self._seen, self._optics = seen, optics
        self._last: Thickening | None = None
        self._behind: tuple[Thickening | None, list[np.ndarray]] | None = None  # the last one asked
        self._wanted = self._thick(None)

    def curve(self, times: float, precision: float = _PRECISE) -> Thickening | None:
        """The curve with so many times; None without smoke.

        Args:
            precision: up to which thick columns keep what they have, relative.
        """
        if self._optics.knee is not None:
            return Thickening(times, self._optics.knee)
        near = self._near(times)
        self._last = find_thickening(times, near, self._thick, self._wanted, precision)
        return self._last

    def thin_share(self, curve: Thickening | None) -> float:
        """What the thin columns have of what the thick ones have; 1 without smoke."""
        thick = self._thick(curve)
        return self._percentile(curve, THIN) / thick if thick > 0 else 1.0

    def _near(self, times: float) -> float:
        """A density that the knee is near."""
        if self._last is not None:
            return self._last.knee * (self._last.times / times) ** _FALL
        dense = [ranked(one.smoke.density, DENSE_COLUMNS) for one in self._seen]
        return _USUAL * weighted_median(dense, self._seen)

    def _thick(self, curve: Thickening | None) -> float:
        return self._percentile(curve, self._optics.percentile)

    def _percentile(self, curve: Thickening | None, percentile: float) -> float:
        if self._behind is None or self._behind[0] != curve:
            self._behind = curve, [one.columns(curve) for one in self._seen]
        return column_percentile(self._behind[1], self._seen, percentile)


def weighted_median(values: Sequence[float], seen: Sequence[SeenSmoke]) -> float:
    """The median of a value of each frame, which counts by its number of voxels."""
    order = np.argsort(values)
    weight = np.array([len(one.smoke.ijk) for one in seen], float)[order]
    middles = weight.cumsum() - weight / 2
    return float(np.interp(weight.sum() / 2, middles, np.asarray(values)[order]))


def checked_extinctions(extinctions: Iterable[float]) -> list[float]:
    """The same, refused where 32-bit floats cannot hold them: they would be NaN in a picture.

    Args:
        extinctions: per density, 1/stage unit.

    Raises:
        ConfigError: one is ``MOST_EXTINCTION`` or more.
    """
    found = list(extinctions)
    if not max(found) < MOST_EXTINCTION:
        raise ConfigError(
            f"the extinction per density is {max(found):.3g} per stage unit, more than 32-bit "
            "floats can hold: the smoke is too thin for voxels of this size, or optics.gamma or "
            "optics.knee is too extreme. Scale the density or the Volume, or unset these."
        )
    return found

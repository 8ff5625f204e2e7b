"""Rays of any direction through lattices: cut at every plane of voxel centres.

A segment lies in one cell of each lattice. Extinction is a cubic polynomial along it there, and two
Gauss points give its optical depth exactly. ``rays.segments`` takes the line through the values at
these points for the light; segments of much optical depth are cut once more.
"""

from collections.abc import Sequence

import numpy as np

from usdsmoke.core.rays.media import Medium
from usdsmoke.core.rays.segments import (
    GAUSS,
    OPAQUE,
    PARALLEL,
    cut_more,
    depth_before,
    n_parts,
    segment_weights,
)

_TINY = 1e-30  # keeps 0 / 0 away
_THICK = 0.2  # optical depth above which a segment is cut: its fields are no lines
_EXTINCTION, _EMISSION, _GREY = 0, 1, 4  # channels
_CORNERS = list(np.ndindex(2, 2, 2))


class Cells:
    """Lattices of any number, and the rays of one picture through all of them.

    Args:
        media: in stage space; may overlap.
        forward: [3], the view's axis.
        clip: nearest and farthest depth along it from where rays start, stage units.
        with_light: else only optical depths are found.
    """

    def __init__(
        self,
        media: Sequence[Medium],
        forward: np.ndarray,
        clip: tuple[float, float],
        with_light: bool,
    ) -> None:
        self._tables = [_Table(medium, with_light) for medium in media]
        self._forward, self._clip, self._with_light = forward, clip, with_light
        self._light = sorted({n for table in self._tables for n in table.channels} - {_EXTINCTION})
        self.numbers_per_ray = sum(sum(medium.extinction.shape) for medium in media)

    def trace(self, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Optical depths of rays [R 3], and their light, emission and grey, [R 4]; float64."""
        lattices = [_Lattice(table, *table.rays(origin, direction)) for table in self._tables]
        ray, low, high = self._cut(lattices, direction)
        values = _sampled(lattices, ray, low, high, [_EXTINCTION, *self._light])
        thickness = values[0].mean(axis=0, dtype=np.float64) * (high - low)
        depth = np.bincount(ray, thickness, minlength=len(origin))
        light = np.zeros((len(origin), 4))
        if not self._with_light or not len(ray):
            return depth, light
        before = depth_before(ray, thickness)
        parts = n_parts(thickness, before, _THICK)
        whole = (before < OPAQUE) & (parts == 1)
        self._add(light, ray[whole], (high - low)[whole], before[whole], values[..., whole])
        thick = np.flatnonzero((before < OPAQUE) & (parts > 1))
        if len(thick):
            index, first, last = cut_more(parts[thick])
            index, length = thick[index], (high - low)[thick[index]]
            begin, end = low[index] + first * length, low[index] + last * length
            values = _sampled(lattices, ray[index], begin, end, [_EXTINCTION, *self._light])
            own = values[0].mean(axis=0, dtype=np.float64) * (end - begin)
            self._add(
                light, ray[index], end - begin, before[index] + depth_before(index, own), values
            )
        return depth, light

    def _cut(
        self, lattices: Sequence["_Lattice"], direction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The segments that hold anything: ray, and distances at which they begin and end, [M]."""
        spans = [lattice.span() for lattice in lattices]
        hit = np.flatnonzero(np.any([enter < leave for enter, leave in spans], axis=0))
        cuts = np.concatenate(
            [
                lattice.cuts(hit, enter[hit], leave[hit])
                for lattice, (enter, leave) in zip(lattices, spans, strict=True)
            ],
            axis=1,
        )
        if np.isfinite(self._clip).any():
            slope = (direction[hit] @ self._forward)[:, None]  # depth along the axis by distance
            near, far = self._clip
            np.clip(cuts, near / slope, far / slope, out=cuts)
        cuts.sort(axis=1)
        holds = np.zeros((len(hit), cuts.shape[1] - 1), bool)
        middle = (cuts[:, 1:] + cuts[:, :-1]) / 2
        for lattice in lattices:
            holds |= lattice.holds(hit, middle)
        holds &= cuts[:, 1:] > cuts[:, :-1]
        place, number = np.nonzero(holds)
        return hit[place], cuts[place, number], cuts[place, number + 1]

    def _add(
        self,
        light: np.ndarray,
        ray: np.ndarray,
        length: np.ndarray,
        before: np.ndarray,
        values: np.ndarray,
    ) -> None:
        """Add what segments [M] send to the light of their rays, [R 4].

        Args:
            length: stage units.
            before: optical depth in front.
            values: extinction and light at both Gauss points, [C 2 M].
        """
        extinction, *shining = values
        total = extinction.sum(axis=0, dtype=np.float64)
        slope = 3**0.5 * (extinction[1] - extinction[0]) / (total + _TINY)
        mean, rest = segment_weights(total * (length / 2), slope)
        rest *= 3**0.5
        arriving = np.exp(-before) * (length / 2)
        near, far = (mean + rest) * arriving, (mean - rest) * arriving
        for channel, (first, second) in zip(self._light, shining, strict=True):
            sent = first * near + second * far
            light[:, channel - _EMISSION] += np.bincount(ray, sent, minlength=len(light))


class _Table:
    """A medium ready to be looked up; cell (a, b, c) lies between its voxel of that index and the
    next along every axis."""

    def __init__(self, medium: Medium, with_light: bool) -> None:
        shape = medium.extinction.shape
        self.last = np.array(shape) - 2  # cell along each axis
        self.channels = {_EXTINCTION: medium.extinction.reshape(-1)}
        filled = medium.extinction != 0
        if with_light and medium.grey:
            self.channels[_GREY] = np.float32(medium.grey) * self.channels[_EXTINCTION]
        if with_light and medium.emission is not None:
            for channel, values in enumerate(medium.emission, start=_EMISSION):
                self.channels[channel] = values.reshape(-1)
                filled |= values != 0
        # one layer more on each side, of cells outside
        cells = np.zeros(self.last + 3, bool)
        inner = cells[1:-1, 1:-1, 1:-1]
        for a, b, c in _CORNERS:
            inner |= filled[a : a + inner.shape[0], b : b + inner.shape[1], c : c + inner.shape[2]]
        self._inner, self.cells = inner, cells.reshape(-1)
        self.cell_strides = (cells.shape[1] * cells.shape[2], cells.shape[2], 1)
        self.strides = (shape[1] * shape[2], shape[2], 1)
        self.to_index = np.linalg.inv(medium.index_to_stage)

    def filled_box(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the cells between two cells that hold anything begin and end, [3] each."""
        i, j, k = (slice(a, b + 1) for a, b in zip(low, high, strict=True))
        cells, found = self._inner[i, j, k], []
        for others in ((1, 2), (0, 2), (0, 1)):
            there = np.flatnonzero(cells.any(axis=others))
            found.append((there[0], there[-1] + 1) if len(there) else (0, 0))
        first, last = np.array(found, float).T
        return low + first, low + last

    def rays(self, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same rays [R 3] in the array's indices, [3 R]; distances along them stay."""
        moved = origin @ self.to_index[:3, :3] + self.to_index[3, :3]
        turned = direction @ self.to_index[:3, :3]
        return np.ascontiguousarray(moved.T), np.ascontiguousarray(turned.T)


class _Lattice:
    """A medium's table, and rays in its indices."""

    def __init__(self, table: _Table, start: np.ndarray, step: np.ndarray) -> None:
        self.table, self._start, self._step = table, start, step  # [3 R]
        # axes along which a ray does not move
        self._slow = np.abs(step) <= PARALLEL * np.abs(step).max(axis=0)

    def span(self) -> tuple[np.ndarray, np.ndarray]:
        """Distances [R] between which rays meet all that holds anything; a ray that misses leaves
        before it enters."""
        low, high = np.zeros(3), self.table.last + 1.0
        enter, leave = self._between(low, high)
        hit = enter < leave
        if not hit.any():
            return enter, leave
        start, step = self._start[:, hit], self._step[:, hit]
        ends = np.stack([start + enter[hit] * step, start + leave[hit] * step])
        low = np.clip(np.floor(ends.min(axis=(0, 2))), 0, self.table.last)
        high = np.clip(np.floor(ends.max(axis=(0, 2))), 0, self.table.last)
        return self._between(*self.table.filled_box(low.astype(int), high.astype(int)))

    def _between(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances [R] at which rays enter and leave the box from one place to the other [3]."""
        first, last = low[:, None], high[:, None]
        safe = np.where(self._slow, 1.0, self._step)
        one, other = (first - self._start) / safe, (last - self._start) / safe
        inside = (self._start >= first) & (self._start <= last)
        enter = np.where(self._slow, np.where(inside, -np.inf, np.inf), np.minimum(one, other))
        leave = np.where(self._slow, np.inf, np.maximum(one, other))
        return enter.max(axis=0), leave.min(axis=0)

    def cuts(self, rays: np.ndarray, enter: np.ndarray, leave: np.ndarray) -> np.ndarray:
        """Distances [m K] at which rays meet planes of voxel centres; the same one for a miss.

        Args:
            rays: [m], which.
            enter, leave: [m], from ``span``.
        """
        miss = enter >= leave
        enter, leave = np.where(miss, 0.0, enter), np.where(miss, 0.0, leave)
        crossings = [enter[:, None], leave[:, None]]
        for axis in range(3):
            still = miss | self._slow[axis, rays]
            start = np.where(still, 0.0, self._start[axis, rays])
            step = np.where(still, 1.0, self._step[axis, rays])
            ends = start + enter * step, start + leave * step
            first = np.ceil(np.minimum(*ends))
            most = int(np.max(np.maximum(*ends) - first, where=~still, initial=-1.0)) + 2
            met = first[:, None] + np.arange(most) - start[:, None]
            met *= (1 / step)[:, None]
            met[still] = enter[still, None]
            crossings.append(np.clip(met, enter[:, None], leave[:, None], out=met))
        return np.concatenate(crossings, axis=1)

    def holds(self, rays: np.ndarray, middle: np.ndarray) -> np.ndarray:
        """Which segments [m K] lie in a cell that holds anything.

        Args:
            rays: [m], which.
            middle: [m K], the distances of the segments' middles.
        """
        number = np.zeros(middle.shape, np.int32)
        for axis, stride in enumerate(self.table.cell_strides):
            cell = middle * self._step[axis, rays, None]
            cell += self._start[axis, rays, None] + 1.0
            np.clip(cell, 0.0, self.table.last[axis] + 2.0, out=cell)
            number += cell.astype(np.int32) * np.int32(stride)
        return self.table.cells[number]

    def corners(
        self, ray: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """The first corner [M] of the cells of segments, and the eight corners' weights [2 M] at
        both Gauss points.

        Args:
            ray: [M].
            low, high: [M], where the segments begin and end.
        """
        middle, half = (low + high) / 2, (high - low) * GAUSS
        base = np.zeros(len(ray), np.int64)
        sides: list[tuple[np.ndarray, np.ndarray]] = []
        for axis, stride in enumerate(self.table.strides):
            step = self._step[axis][ray]
            place = self._start[axis][ray] + middle * step
            step *= half
            cell = np.clip(np.floor(place), 0, self.table.last[axis])
            place -= cell
            base += cell.astype(np.int64) * stride
            part = np.empty((2, len(ray)), np.float32)
            part[0], part[1] = place - step, place + step
            np.clip(part, 0.0, 1.0, out=part)
            sides.append((1 - part, part))
        faces = [[near * across for across in sides[1]] for near in sides[0]]
        return base, [faces[a][b] * sides[2][c] for a, b, c in _CORNERS]


def _sampled(
    lattices: Sequence[_Lattice],
    ray: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    channels: Sequence[int],
) -> np.ndarray:
    """Values at the Gauss points of segments that lie in one cell each, summed over lattices.

    Args:
        ray: [M].
        low, high: [M], where the segments begin and end.

    Returns:
        [C 2 M] float32.
    """
    found = np.zeros((len(channels), 2, len(ray)), np.float32)
    for lattice in lattices:
        base, weights = lattice.corners(ray, low, high)
        for (a, b, c), weight in zip(_CORNERS, weights, strict=True):
            first = int(np.dot((a, b, c), lattice.table.strides))
            for own, channel in zip(found, channels, strict=True):
                if channel in lattice.table.channels:
                    own += weight * lattice.table.channels[channel][first:].take(base)
    return found

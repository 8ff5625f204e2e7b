"""Rays of any direction through lattices: cut at every plane of voxel centres."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.views.media import EXTINCTION, Medium
from usdsmoke.core.views.segments import GAUSS, OPAQUE, PARALLEL, Segments, depth_before

_Rays = tuple[np.ndarray, np.ndarray]  # starts and steps [3 R] in a lattice's indices


class Cells:
    """Lattices of any number, and the rays of one picture through all of them.

    Args:
        media: in stage space; may overlap.
        forward: [3], the view's axis.
        clip: nearest and farthest depth along it from where rays start, stage units.
    """

    def __init__(
        self, media: Sequence[Medium], forward: np.ndarray, clip: tuple[float, float]
    ) -> None:
        self._tables = [_Table(medium) for medium in media]
        self._forward, self._clip = forward, clip
        self.numbers_per_ray = sum(sum(medium.values.shape[:3]) for medium in media)

    def cut(
        self, origin: np.ndarray, direction: np.ndarray, with_light: bool
    ) -> tuple[np.ndarray, Segments | None]:
        """Optical depths of rays [R 3], and with their light the segments that can be seen."""
        rays = [table.rays(origin, direction) for table in self._tables]
        spans = [table.span(*own) for table, own in zip(self._tables, rays, strict=True)]
        hit = np.flatnonzero(np.any([enter < leave for enter, leave in spans], axis=0))
        found = [
            table.cuts(start[:, hit], step[:, hit], enter[hit], leave[hit])
            for table, (start, step), (enter, leave) in zip(self._tables, rays, spans, strict=True)
        ]
        cuts = np.concatenate(found, axis=1)
        if np.isfinite(self._clip).any():
            slope = (direction[hit] @ self._forward)[:, None]  # depth along the axis by distance
            near, far = self._clip
            np.clip(cuts, near / slope, far / slope, out=cuts)
        cuts.sort(axis=1)
        place, number = np.nonzero(cuts[:, 1:] > cuts[:, :-1])
        ray, low, high = hit[place], cuts[place, number], cuts[place, number + 1]
        middle, filled = (low + high) / 2, np.zeros(len(ray), bool)
        for table, own in zip(self._tables, rays, strict=True):
            filled |= table.filled(*own, ray, middle)
        ray, low, high = ray[filled], low[filled], high[filled]
        lattices = list(zip(self._tables, rays, strict=True))
        extinction = _sampled(lattices, ray, low, high, extinction_alone=True)
        thickness = extinction[..., EXTINCTION].mean(dim=1).double().numpy() * (high - low)
        depth = np.bincount(ray, thickness, minlength=len(origin))
        if not with_light:
            return depth, None
        seen = depth_before(ray, thickness) < OPAQUE
        ray, low, high, thickness = ray[seen], low[seen], high[seen], thickness[seen]
        return depth, _CellSegments(ray, high - low, thickness, low, lattices)


@dataclass
class _CellSegments:
    """See ``Segments``."""

    ray: np.ndarray
    length: np.ndarray
    thickness: np.ndarray
    low: np.ndarray  # [M] where they begin
    lattices: Sequence[tuple["_Table", _Rays]]

    def sample(self, index: np.ndarray, low: np.ndarray, high: np.ndarray) -> Tensor:
        start, length = self.low[index], self.length[index]
        return _sampled(self.lattices, self.ray[index], start + low * length, start + high * length)


class _Table:
    """A medium ready to be looked up; cell (a, b, c) lies between its voxel of that index and the
    next along every axis."""

    def __init__(self, medium: Medium) -> None:
        values = medium.values
        self.last = np.array(values.shape[:3]) - 2  # cell along each axis
        self.values = torch.from_numpy(values.reshape(-1, values.shape[3]))
        self.extinction = self.values[:, EXTINCTION : EXTINCTION + 1].contiguous()
        filled = (values != 0).any(axis=-1)
        # one layer more on each side, of cells outside
        cells = np.zeros(self.last + 3, bool)
        inner = cells[1:-1, 1:-1, 1:-1]
        for a, b, c in np.ndindex(2, 2, 2):
            inner |= filled[a : a + inner.shape[0], b : b + inner.shape[1], c : c + inner.shape[2]]
        self.cells = cells.reshape(-1)
        self.cell_strides = (cells.shape[1] * cells.shape[2], cells.shape[2], 1)
        self.strides = (values.shape[1] * values.shape[2], values.shape[2], 1)
        self.to_index = np.linalg.inv(medium.index_to_stage)

    def rays(self, origin: np.ndarray, direction: np.ndarray) -> _Rays:
        """The same rays [R 3] in the array's indices, [3 R]; distances along them stay."""
        moved = origin @ self.to_index[:3, :3] + self.to_index[3, :3]
        turned = direction @ self.to_index[:3, :3]
        return np.ascontiguousarray(moved.T), np.ascontiguousarray(turned.T)

    def span(self, start: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances [R] at which rays [3 R] enter and leave; a ray that misses leaves before."""
        ends = (self.last + 1.0)[:, None]
        slow = self._slow(step)
        safe = np.where(slow, 1.0, step)
        one, other = -start / safe, (ends - start) / safe
        inside = (start >= 0.0) & (start <= ends)
        enter = np.where(slow, np.where(inside, -np.inf, np.inf), np.minimum(one, other))
        leave = np.where(slow, np.inf, np.maximum(one, other))
        return enter.max(axis=0), leave.min(axis=0)

    def cuts(
        self, start: np.ndarray, step: np.ndarray, enter: np.ndarray, leave: np.ndarray
    ) -> np.ndarray:
        """Distances [R K] at which rays meet planes of voxel centres; the same one for a miss.

        Args:
            start, step: [3 R], indices.
            enter, leave: [R], from ``span``.
        """
        miss = enter >= leave
        enter, leave = np.where(miss, 0.0, enter), np.where(miss, 0.0, leave)
        crossings = []
        for axis, slow in enumerate(self._slow(step)):
            first, pace = np.where(slow, 0.0, start[axis]), np.where(slow, 1.0, step[axis])
            met = np.arange(self.last[axis] + 2) - first[:, None]
            met *= (1 / pace)[:, None]
            met[slow] = enter[slow, None]
            crossings.append(np.clip(met, enter[:, None], leave[:, None], out=met))
        return np.concatenate(crossings, axis=1)

    @staticmethod
    def _slow(step: np.ndarray) -> np.ndarray:
        """Along which axes rays [3 R] do not move."""
        slow: np.ndarray = np.abs(step) <= PARALLEL * np.abs(step).max(axis=0)
        return slow

    def filled(
        self, start: np.ndarray, step: np.ndarray, ray: np.ndarray, middle: np.ndarray
    ) -> np.ndarray:
        """Which segments [M] lie in a cell that holds anything.

        Args:
            start, step: [3 R], indices.
            ray, middle: [M], the segments' rays and the distances of their middles.
        """
        number = np.zeros(len(ray), np.int64)
        for axis, stride in enumerate(self.cell_strides):
            cell = np.floor(start[axis][ray] + middle * step[axis][ray])
            number += (np.clip(cell, -1, self.last[axis] + 1).astype(np.int64) + 1) * stride
        return self.cells[number]

    def sample(
        self,
        start: np.ndarray,
        step: np.ndarray,
        ray: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        extinction_alone: bool,
    ) -> Tensor:
        """Values at the Gauss points of segments that lie in one cell each, [M 2 C].

        Args:
            start, step: [3 R], indices.
            ray: [M].
            low, high: [M], where the segments begin and end.
            extinction_alone: without the light, C = 1.
        """
        middle, half = (low + high) / 2, (high - low) * GAUSS
        base = np.zeros(len(ray), np.int64)
        sides: list[tuple[np.ndarray, np.ndarray]] = []
        for axis, stride in enumerate(self.strides):
            place, pace = start[axis][ray] + middle * step[axis][ray], half * step[axis][ray]
            cell = np.clip(np.floor(place), 0, self.last[axis])
            place -= cell
            base += cell.astype(np.int64) * stride
            part = np.empty((len(ray), 2), np.float32)
            part[:, 0], part[:, 1] = place - pace, place + pace
            part = np.clip(part, 0.0, 1.0, out=part).reshape(-1)
            sides.append((1 - part, part))
        taps, weights = (
            np.empty((len(ray), 2, 8), np.int64),
            np.empty((2 * len(ray), 8), np.float32),
        )
        for tap, (a, b, c) in enumerate(np.ndindex(2, 2, 2)):
            offset = a * self.strides[0] + b * self.strides[1] + c
            taps[..., tap] = (base + offset)[:, None]
            np.multiply(sides[0][a] * sides[1][b], sides[2][c], out=weights[:, tap])
        values = self.extinction if extinction_alone else self.values
        found = F.embedding_bag(
            torch.from_numpy(taps.reshape(-1, 8)),
            values,
            mode="sum",
            per_sample_weights=torch.from_numpy(weights),
        )
        return found.view(len(ray), 2, values.shape[1])


def _sampled(
    lattices: Sequence[tuple[_Table, _Rays]],
    ray: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    extinction_alone: bool = False,
) -> Tensor:
    """Sums over lattices, [M 2 C]; see ``_Table.sample``."""
    values = [
        table.sample(start, step, ray, low, high, extinction_alone)
        for table, (start, step) in lattices
    ]
    return torch.stack(values).sum(dim=0) if len(values) > 1 else values[0]

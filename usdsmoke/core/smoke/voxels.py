"""Voxels that hold smoke, as numpy arrays: what can be measured without torch."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from usdsmoke.base.volume import DenseField

LEAST_DENSITY = 1.17549435e-38  # of float32 with all its digits; what is below counts as none
NEARLY_CUBIC = 0.99  # share of the cube's edge; shorter edges of a voxel decide the pixels
FILLED = 0.95  # of the box's voxels: from there on there may be a floor
ABOVE = 20.0  # times the floor: denser voxels are smoke
FEWEST_ABOVE = 40  # such voxels; fewer are an outlier of smoke that fills its box
FLOOR_TIMES = 4.0  # its density: what counts as the floor
OUTER = 0.05  # of the smoke, at both ends of an axis: what may lie far from the rest
MOST_LENGTH = 2.5  # times the length of what lies between: a real plume has 2, puffs 1.2 to 2.3
FAR = 5.0  # times: from there on what lies far away has no effect on the length
LEAST_LENGTH = 1.4  # times: what a puff without remains has
MOST_REMAINS = 0.1  # of the mass: ``FEWEST_ABOVE`` voxels or more with more of it are no remains
_BLOCKS = 8  # along the longest side: lumps are told apart by these
CORE = 0.9  # rank of the voxels above which a denser one weighs no more


class Placed:
    """Lengths of voxels on the stage, whatever holds their numbers."""

    index_to_stage: np.ndarray  # [4 4]

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest active index, [3] each; there is one voxel or more."""
        raise NotImplementedError

    @property
    def is_empty(self) -> bool:
        """Whether there is no voxel."""
        raise NotImplementedError

    @property
    def edges(self) -> np.ndarray:
        """Of a voxel, [3 3] rows, stage units."""
        return self.index_to_stage[:3, :3]

    @property
    def longest_edge(self) -> float:
        """Of a voxel, stage units."""
        return float(np.linalg.norm(self.edges, axis=1).max())

    @property
    def voxel_volume(self) -> float:
        """Stage unit^3."""
        return float(abs(np.linalg.det(self.edges)))

    @property
    def thin_axis(self) -> int | None:
        """The index axis along which the smoke is one voxel thick, or None when it is not 2-D."""
        if self.is_empty:
            return None
        low, high = self.box
        thin = np.flatnonzero(high == low)
        return int(thin[0]) if len(thin) == 1 else None

    @property
    def voxel_size(self) -> float:
        """Edge of the cube of a voxel's volume (2-D: of the square of its face), stage units."""
        if self.thin_axis is None:
            return self.voxel_volume ** (1 / 3)
        across, along = (self.index_to_stage[n, :3] for n in range(3) if n != self.thin_axis)
        return float(np.linalg.norm(np.cross(across, along))) ** 0.5

    @property
    def shortest_edge(self) -> float:
        """Of a voxel, stage units; of one that is nearly a cube the edge of the cube of its volume.

        In 2-D that of its face.
        """
        edges = np.linalg.norm(self.edges, axis=1)
        if self.thin_axis is not None:
            edges = np.delete(edges, self.thin_axis)
        shortest, cube = float(edges.min()), self.voxel_size
        return shortest if shortest < NEARLY_CUBIC * cube else cube

    @property
    def longest_side(self) -> float:
        """Of the box of the active voxels, stage units."""
        low, high = self.box
        return float(max((high - low + 1) * np.linalg.norm(self.edges, axis=1)))


@dataclass(frozen=True)
class Voxels(Placed):
    """See ``core.smoke.active.ActiveSmoke``, which is the same on torch's devices."""

    ijk: np.ndarray  # [N 3] int64
    density: np.ndarray  # [N] float32, > 0
    index_to_stage: np.ndarray  # [4 4]

    @cached_property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest active index, [3] each."""
        sides = self.ijk.T  # an axis after the other takes a tenth of the time
        return np.array([n.min() for n in sides]), np.array([n.max() for n in sides])

    @property
    def is_empty(self) -> bool:
        """Whether there is no voxel."""
        return len(self.ijk) == 0

    @property
    def positions(self) -> np.ndarray:
        """Voxel centres, [N 3] float64, stage space."""
        found: np.ndarray = self.ijk @ self.edges + self.index_to_stage[3, :3]
        return found

    def take(self, chosen: np.ndarray) -> "Voxels":
        """Some of the voxels; chosen is [N] bool."""
        return Voxels(self.ijk[chosen], self.density[chosen], self.index_to_stage)

    def nearest(self, points: np.ndarray) -> np.ndarray:
        """The density of the voxels around points [P 3] of the stage, [P]; 0 outside of all."""
        low, high = self.box
        to_index = np.linalg.inv(self.index_to_stage)
        place = points @ to_index[:3, :3] + to_index[3, :3]
        place = np.rint(place.clip(low - 1.0, high + 1.0)).astype(np.int64)
        shape = high - low + 3
        keys, wanted = (np.ravel_multi_index((x - low + 1).T, shape) for x in (self.ijk, place))
        order = np.argsort(keys)
        found = order[np.searchsorted(keys, wanted, sorter=order).clip(max=len(keys) - 1)]
        return np.where(keys[found] == wanted, self.density[found], 0.0)

    @cached_property
    def floor(self) -> float:
        """The density that a simulation leaves in all of its box; 0 where there is none.

        Smoke of any shape leaves a part of its box empty. Where it does not, the box's faces tell
        the floor, if many voxels are much denser.
        """
        low, high = self.box
        filled = len(self.ijk) / np.prod((high - low + 1).astype(float))
        if filled < FILLED or len(self.ijk) < FEWEST_ABOVE:
            return 0.0
        faces = np.zeros(len(self.ijk), bool)
        for place, first, last in zip(self.ijk.T, low, high, strict=True):
            if last > first:
                faces |= (place == first) | (place == last)
        level = float(np.median(self.density[faces]))
        return level if (self.density > ABOVE * level).sum() >= FEWEST_ABOVE else 0.0

    def above_floor(self) -> "Voxels":
        """The smoke without a floor; itself where there is none."""
        return self.take(self.density > FLOOR_TIMES * self.floor) if self.floor > 0 else self

    def main_part(self) -> "Voxels":
        """The smoke without a floor, and without remains that lie far from the rest; itself where
        there are none.

        Along each axis the smoke without 5 % at both ends has a length, and voxels up to three
        quarters of that beyond it belong to the main part. Dense smoke apart from thin smoke has
        few voxels but most of the mass, and belongs to it too.
        """
        if self.floor > 0:
            return self.above_floor().main_part()
        near = np.ones(len(self.ijk), bool)
        for place, (begin, end), first, last in zip(
            self.ijk.T, self.inner_box, *self.box, strict=True
        ):
            around = (MOST_LENGTH - 1) / 2 * (end - begin + 1)
            if first < begin - around or last > end + around:
                near &= (place >= begin - around) & (place <= end + around)
        away = self.density[~near]
        if len(away) >= FEWEST_ABOVE and away.sum() > MOST_REMAINS * self.density.sum():
            return self
        return self if near.all() else self.take(near)

    @cached_property
    def inner_box(self) -> np.ndarray:
        """Lowest and highest index along each axis without 5 % of the smoke at both ends, [3 2].

        The densest tenth of the voxels weighs no more than the thinnest of these: a dense core does
        not make its surroundings remains.
        """
        weights = np.minimum(self.density, np.quantile(self.density, CORE, method="lower"))
        found = []
        for place, first in zip(self.ijk.T, self.box[0], strict=True):
            rank = np.cumsum(np.bincount(place - first, weights))
            ends = np.searchsorted(rank, [OUTER * rank[-1], (1 - OUTER) * rank[-1]])
            found.append(first + ends)
        return np.array(found)

    @property
    def usual_length(self) -> float:
        """The longest side, stage units, on which remains far away have no effect.

        Where voxels move away from the rest, a side grows with them to ``MOST_LENGTH`` times the
        length that the smoke has without its ends, and then falls to ``LEAST_LENGTH`` times: it
        never jumps. A floor does not count.
        """
        if self.floor > 0:
            return self.above_floor().usual_length
        low, high = self.box
        inner = self.inner_box[:, 1] - self.inner_box[:, 0] + 1
        times = (high - low + 1) / inner
        remains = np.interp(times, [MOST_LENGTH, FAR], [MOST_LENGTH, LEAST_LENGTH])
        sides = np.where(times > MOST_LENGTH, remains * inner, high - low + 1)
        return float(max(sides * np.linalg.norm(self.edges, axis=1)))

    def largest_lump(self) -> "Voxels":
        """The part with the most voxels, where parts lie a quarter of the longest side apart."""
        low, high = self.box
        edges = np.linalg.norm(self.edges, axis=1)
        block = np.maximum(self.longest_side / _BLOCKS // edges, 1).astype(np.int64)
        shape = (high - low) // block + 1
        member = np.ravel_multi_index(((self.ijk - low) // block).T, shape)
        counts = np.bincount(member)
        filled = np.flatnonzero(counts)
        lump = _lumps(list(zip(*np.unravel_index(filled, shape), strict=True)))
        if lump.max() == 0:
            return self
        largest = np.bincount(lump, counts[filled]).argmax()
        return self.take(lump[np.searchsorted(filled, member)] == largest)


def _lumps(blocks: list[tuple[int, ...]]) -> np.ndarray:
    """The number of each block's lump: of those that touch, if only at a corner; [B]."""
    number = {block: n for n, block in enumerate(blocks)}
    lump, n_lumps = np.full(len(blocks), -1), 0
    for start in range(len(blocks)):
        if lump[start] >= 0:
            continue
        lump[start], todo = n_lumps, [blocks[start]]
        while todo:
            block = todo.pop()
            for step in np.ndindex(3, 3, 3):
                beside = number.get(tuple(b + s - 1 for b, s in zip(block, step, strict=True)))
                if beside is not None and lump[beside] < 0:
                    lump[beside] = n_lumps
                    todo.append(blocks[beside])
        n_lumps += 1
    return lump


def occupied(density: DenseField, to_stage: np.ndarray) -> Voxels:
    """The voxels of a dense field that hold smoke.

    Voxels with a negative density, or one below ``LEAST_DENSITY``, are taken as empty.

    Args:
        density: [i j k].
        to_stage: [4 4], the field's grid world to stage space.
    """
    chosen = np.argwhere(density.values > LEAST_DENSITY)
    values = density.values[tuple(chosen.T)] if len(chosen) else np.zeros(0, np.float32)
    matrix = np.asarray(density.index_to_world, float) @ np.asarray(to_stage, float)
    ijk = chosen + np.asarray(density.ijk_min, np.int64)
    return Voxels(ijk, values.astype(np.float32, copy=False), matrix)

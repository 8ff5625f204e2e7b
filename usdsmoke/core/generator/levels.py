"""The octaves that the generator works on: their voxels, who is next to whom, and what is coarser.

An octave's voxels are blocks of the next finer one's, aligned to even absolute indices, so nothing
depends on how a frame was cropped. Only voxels that hold smoke exist: a neighbour without smoke
counts as zeros. [Graham2018, submanifold convolutions]

A finer octave takes a coarser one's values by trilinear interpolation between the blocks that hold
smoke. Where all voxels of a block have its value, the network leaves a pattern of blocks in the
picture. [Odena2016]
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product

import torch
from torch import Tensor

from usdsmoke.core.fields.sparse_map import SparseMap, SparseSums
from usdsmoke.core.generator.definition import N_CONVOLUTIONS, N_NEIGHBOURS
from usdsmoke.core.smoke.active import ActiveSmoke, block_of, divisor_of, flat_key, make_octaves
from usdsmoke.core.smoke.levels import bounded
from usdsmoke.core.smoke.memory import CHUNK_ROWS, share_rows

THINNEST = 32  # planes of voxels in a slab, about
NEAR, FAR = 0.75, 0.25  # weights of the two blocks around a voxel along an axis
CORNERS = tuple(product((0, 1), repeat=3))  # of the eight blocks around a voxel; 1: farther


@dataclass(frozen=True)
class Level:
    """One octave of a frame, or of a part of it."""

    smoke: ActiveSmoke
    edge: float  # of a voxel of the frame's finest octave, stage units
    neighbours: Tensor  # [N 27] int32, rows of the 3 x 3 x 3 voxels around each; N where is none
    blocks: SparseSums | None = None  # of the next coarser octave, around each; None: coarsest
    n_blocks: int = 0  # of that octave

    def finer(self, coarse: Tensor) -> Tensor:
        """Values [n C] of the next coarser octave at this one's voxels, [N C].

        Gradients: through ``coarse``, exact adjoint.
        """
        assert self.blocks is not None
        if coarse.requires_grad:
            return self._both_ways.apply(coarse)
        return self.blocks(coarse)

    @cached_property
    def _both_ways(self) -> SparseMap:
        assert self.blocks is not None
        return SparseMap(self.blocks, self.blocks.transposed(self.n_blocks))


@dataclass(frozen=True)
class Octaves:
    """The voxels of a frame, fine to coarse, and for each the row of the block that it lies in."""

    smokes: Sequence[ActiveSmoke]
    parents: Sequence[Tensor]
    divisor: Tensor  # [3], see ``divisor_of``

    @classmethod
    def of(cls, smoke: ActiveSmoke, n: int) -> "Octaves":
        """``n`` octaves.

        All halve the same axes, also where the smoke is one block wide: else blocks, whose indices
        their noise belongs to, would depend on the size of the box.

        Args:
            smoke: at full resolution, not empty, in the order of ``activate``.
        """
        divisor = divisor_of(smoke)
        smokes = make_octaves(bounded(smoke), n, divisor)[::-1]
        parents = [block_of(fine, coarse, divisor) for fine, coarse in pairwise(smokes)]
        return cls(smokes, parents, divisor)

    def levels(self, part: Tensor | None = None) -> Sequence[Level]:
        """What the network works on, coarse to fine.

        Args:
            part: [N] bool, voxels whose colours are wanted; the levels then hold what these depend
                on, and their voxels have the same colours as without. None: all.
        """
        smokes, parents, edge = self.smokes, self.parents, self.smokes[0].voxel_size
        if part is not None:
            kept = _needed(smokes, part, self.divisor)
            rows = [chosen.cumsum(0) - 1 for chosen in kept]
            parents = [rows[n + 1][parent[kept[n]]] for n, parent in enumerate(parents)]
            smokes = [smoke.take(chosen) for smoke, chosen in zip(smokes, kept, strict=True)]
            del kept, rows
        levels = [Level(smokes[-1], edge, _neighbours(smokes[-1].ijk))]
        for smoke, parent in zip(reversed(smokes[:-1]), reversed(parents), strict=True):
            blocks = _blocks_around(smoke, parent, levels[-1])
            n_blocks = len(levels[-1].neighbours)
            levels.append(Level(smoke, edge, _neighbours(smoke.ijk), blocks, n_blocks))
        return levels


def make_levels(smoke: ActiveSmoke, n: int, part: Tensor | None = None) -> Sequence[Level]:
    """``n`` octaves of a frame, coarse to fine; see ``Octaves.of`` and ``Octaves.levels``."""
    return Octaves.of(smoke, n).levels(part)


@dataclass(frozen=True)
class Slab:
    """Planes of voxels next to each other."""

    axis: int
    first: int
    last: int

    def holds(self, ijk: Tensor) -> Tensor:
        """Which voxels [N 3] lie in it, [N] bool."""
        along = ijk[:, self.axis]
        return (along >= self.first) & (along <= self.last)


def slabs(ijk: Tensor, most: int) -> list[Slab]:
    """Slabs across the longest side that hold all voxels [N 3], about ``most`` in each.

    Thin slabs would mostly hold what others depend on, so more voxels are in each where fewer than
    ``THINNEST`` planes have so many.
    """
    low, high = ijk.amin(0), ijk.amax(0)
    axis = int((high - low).argmax())
    begin = int(low[axis])
    upto = torch.bincount(ijk[:, axis] - begin).cumsum(0)
    n = max(1, min(-(-len(ijk) // most), len(upto) // THINNEST))
    wanted = torch.arange(1, n + 1, device=ijk.device) * len(ijk) // n
    lasts = sorted(set((torch.searchsorted(upto, wanted) + begin).tolist()))
    firsts = [begin, *(last + 1 for last in lasts[:-1])]
    return [Slab(axis, *ends) for ends in zip(firsts, lasts, strict=True)]


def _needed(octaves: Sequence[ActiveSmoke], part: Tensor, divisor: Tensor) -> list[Tensor]:
    """Which voxels of each octave, fine to coarse, a part of the finest one's depends on."""
    low, high = (end(octaves[0].ijk[part], 0) for end in (torch.amin, torch.amax))
    needed = []
    for octave in octaves:
        low, high = low - N_CONVOLUTIONS, high + N_CONVOLUTIONS
        needed.append(((octave.ijk >= low) & (octave.ijk <= high)).all(1))
        low, high = (torch.div(end, divisor, rounding_mode="floor") for end in (low, high))
        low, high = low - 1, high + 1  # blocks between which values are interpolated
    return needed


def _blocks_around(fine: ActiveSmoke, parent: Tensor, coarse: Level) -> SparseSums:
    """Trilinear weights of the eight blocks around each voxel; those without smoke weigh 0.

    Args:
        parent: [N], row of the block that each voxel lies in.
    """
    n, n_blocks, device = len(fine.ijk), len(coarse.neighbours), fine.ijk.device
    around = coarse.neighbours.view(-1)
    corners = torch.tensor(CORNERS, device=device)
    weights = torch.tensor([NEAR, FAR], device=device)[corners].prod(1)
    # where a voxel of each of the eight places in a block finds them among its block's neighbours
    places = (2 * corners[:, None] - 1) * corners + 1
    places = (places * torch.tensor([9, 3, 1], device=device)).sum(2)
    halves = torch.tensor([4, 2, 1], device=device)
    kind = torch.int32 if len(CORNERS) * n < 2**31 else torch.int64
    index = torch.empty(n, len(CORNERS), dtype=kind, device=device)
    weight = fine.density.new_empty(n, len(CORNERS))

    def look_up(part: slice) -> None:
        place = places[(torch.remainder(fine.ijk[part], 2) * halves).sum(1)]
        own = parent[part, None]
        rows = around[N_NEIGHBOURS * own + place]
        there = rows < n_blocks
        index[part] = torch.where(there, rows, own)
        shares = weights * there
        weight[part] = shares / shares.sum(1, keepdim=True)

    share_rows(look_up, n, CHUNK_ROWS, device)
    start = torch.arange(0, index.numel(), len(CORNERS), dtype=kind, device=device)
    return SparseSums(index.view(-1), weight.view(-1), start)


def _neighbours(ijk: Tensor) -> Tensor:
    """See ``Level``; for voxels [N 3]. Their rows are looked up in the box around them."""
    low, n = ijk.amin(0) - 1, len(ijk)
    shape = ijk.amax(0) - low + 2
    keys = flat_key(ijk, low, shape)
    rows = torch.full((int(shape.prod()),), n, dtype=torch.int32, device=ijk.device)
    rows[keys] = torch.arange(n, dtype=torch.int32, device=ijk.device)
    around = torch.tensor(list(product((-1, 0, 1), repeat=3)), device=ijk.device)
    steps = (around[:, 0] * shape[1] + around[:, 1]) * shape[2] + around[:, 2]
    found = torch.empty(n, N_NEIGHBOURS, dtype=torch.int32, device=ijk.device)

    def look_up(part: slice) -> None:
        torch.index_select(rows, 0, (keys[part, None] + steps).view(-1), out=found[part].view(-1))

    share_rows(look_up, n, CHUNK_ROWS, ijk.device)
    return found

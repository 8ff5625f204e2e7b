"""The octaves that the generator works on: their voxels, who is next to whom, and whose block is.

An octave's voxels are blocks of the next finer one's, aligned to even absolute indices, so nothing
depends on how a frame was cropped. Only voxels that hold smoke exist: a neighbour without smoke
counts as zeros. [Graham2018, submanifold convolutions]
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import torch
from torch import Tensor

from usdsmoke.core.generator.definition import N_NEIGHBOURS
from usdsmoke.core.smoke.active import ActiveSmoke, block_of, coarsen, flat_key
from usdsmoke.core.smoke.levels import bounded
from usdsmoke.core.smoke.memory import CHUNK_ROWS, share_rows


@dataclass(frozen=True)
class Level:
    """One octave of a frame."""

    smoke: ActiveSmoke
    neighbours: Tensor  # [N 27] int32, rows of the 3 x 3 x 3 voxels around each; N where is none
    parent: Tensor | None  # [N] int64, row of the block of the next coarser octave; None: coarsest


def make_levels(smoke: ActiveSmoke, n: int) -> Sequence[Level]:
    """``n`` octaves of a frame, coarse to fine.

    Args:
        smoke: at full resolution, not empty, in the order of ``activate``.
    """
    octaves = [bounded(smoke)]
    for _ in range(n - 1):
        octaves.append(coarsen(octaves[-1]))
    parents = [block_of(fine, coarse) for fine, coarse in pairwise(octaves)]
    levels = [
        Level(octave, _neighbours(octave.ijk), parent)
        for octave, parent in zip(octaves, [*parents, None], strict=True)
    ]
    return levels[::-1]


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

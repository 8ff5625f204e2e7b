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
    """See ``Level``; for voxels [N 3] in C order.

    The keys ascend: the place of a voxel's column neighbour is searched, and those before and
    behind it along k are next to that place.
    """
    low = ijk.amin(0) - 1
    shape = ijk.amax(0) - low + 2
    keys, n = flat_key(ijk, low, shape), len(ijk)
    # none before the first and behind the last
    padded = torch.cat(
        [keys.new_full((1,), -2), keys, keys.new_full((2,), torch.iinfo(keys.dtype).max)]
    )
    found = torch.empty(n, N_NEIGHBOURS, dtype=torch.int32, device=ijk.device)
    for number, (i, j) in enumerate(product((-1, 0, 1), repeat=2)):
        middle = keys + (i * shape[1] + j) * shape[2]
        place = torch.searchsorted(keys, middle)
        is_there = padded[place + 1] == middle
        for k, at in ((-1, place - 1), (0, place), (1, place + is_there)):
            row = torch.where(padded[at + 1] == middle + k, at, n)
            found[:, 3 * number + k + 1] = row
    return found

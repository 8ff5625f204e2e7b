"""Colours of voxels from those around them: where too little is known, and where hues disagree."""

from collections.abc import Iterator

import torch
from torch import Tensor

from usdsmoke.core.smoke.active import (
    ActiveSmoke,
    block_of,
    coarsen,
    flat_key,
    sample_colours,
)
from usdsmoke.core.smoke.srgb import luma

KNOWN = 0.99  # trust above which a voxel keeps its colour: the rest of it would not be seen
ENOUGH = 0.5  # mean trust of a block's voxels at which it needs no larger block
OWN = 4.0  # times that a voxel's chroma counts as much as that of the next one along an axis


def spread_colours(smoke: ActiveSmoke, colours: Tensor, trust: Tensor) -> Tensor:
    """Colours [N C], each its own by its trust and its neighbourhood's by the rest.

    A pyramid of means over blocks of 2, 4, 8 ... voxels, weighted by trust: a block's colour counts
    fully where the mean trust of its voxels is one half or more, and less below; the rest is that
    of the block around it, interpolated. So voxels of trust 0 take the low-passed colours of the
    nearest smoke that is trusted.

    Args:
        smoke: the voxels.
        colours: [N C].
        trust: [N] in [0, 1]. Where all of it is 0 the colours stay.
    """
    unsure = trust < KNOWN
    if not bool(unsure.any()) or not bool((trust > 0).any()):
        return colours
    around = _around(smoke, colours * trust[:, None], trust, smoke.positions[unsure])
    part = trust[unsure, None]
    found = colours.clone()
    found[unsure] = part * colours[unsure] + (1 - part) * around
    return found


def _around(smoke: ActiveSmoke, weighted: Tensor, trust: Tensor, positions: Tensor) -> Tensor:
    """Colours at points [P 3], from the blocks of twice the size around them; [P C].

    Args:
        weighted: colours times trust, [N C].
        trust: [N], the mean over a voxel's own voxels.
    """
    coarse = coarsen(smoke)
    if len(coarse.ijk) == len(smoke.ijk):  # one block, or blocks that never meet
        mean = weighted.double().sum(0) / trust.double().sum()
        return mean.to(weighted).expand(len(positions), -1)
    block = block_of(smoke, coarse)
    n_members = torch.bincount(block, minlength=len(coarse.ijk)).to(weighted)
    summed = torch.stack(
        [
            torch.bincount(block, column, minlength=len(coarse.ijk)).to(weighted)
            for column in (*weighted.unbind(1), trust)
        ],
        dim=1,
    )
    means = summed / n_members[:, None]
    light, certain = means[:, :-1], means[:, -1:]
    part = (certain / ENOUGH).clamp_max(1)
    own = light / certain.clamp_min(torch.finfo(light.dtype).tiny)
    outer = _around(coarse, light, certain[:, 0], coarse.positions)
    return sample_colours(coarse, part * own + (1 - part) * outer, positions)[0]


def blend_chroma(smoke: ActiveSmoke, colours: Tensor, weight: Tensor) -> Tensor:
    """Colours [N 3] whose chroma is a mean over each voxel and those beside it; their luma stays.

    They may leave [0, 1]. Linear, so changes of colours are blended as colours are.

    Views mix a pixel from different voxels, whose hues cancel in the views that were optimised and
    in no others: speckle. Eyes see hues less finely than light and dark.

    Args:
        smoke: the voxels.
        colours: display-encoded [N 3].
        weight: [N] >= 0, how much a voxel counts. Where all around is 0 the colours stay.
    """
    grey = luma(colours)[:, None]
    chroma = colours - grey
    summed = torch.cat([chroma * weight[:, None], weight[:, None]], dim=1)
    for first, second in _neighbours(smoke):
        blended = OWN * summed
        blended[first] += summed[second]
        blended[second] += summed[first]
        summed = blended
    total = summed[:, -1:]
    mean = summed[:, :-1] / total.clamp_min(torch.finfo(total.dtype).tiny)
    return grey + torch.where(total > 0, mean, chroma)


def _neighbours(smoke: ActiveSmoke) -> Iterator[tuple[Tensor, Tensor]]:
    """For each axis, the rows of voxels that have one behind them, and the rows of those."""
    low = smoke.ijk.amin(0)
    shape = smoke.ijk.amax(0) - low + 2  # a voxel of margin: no row of voxels meets the next one
    known, order = flat_key(smoke.ijk, low, shape).sort()
    for stride in (shape[1] * shape[2], shape[2], 1):
        behind = known + stride
        row = torch.searchsorted(known, behind).clamp_max(len(known) - 1)
        exists = known[row] == behind
        yield order[exists], order[row[exists]]

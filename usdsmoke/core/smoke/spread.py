"""Colours of voxels and of those around them: what is unknown, mixed hues, detail."""

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
DARK = 0.3  # mean luma below which detail counts less
WIDE = 3  # times that luma is averaged over three voxels along each axis, for its detail


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
    return grey + _mean_around(smoke, colours - grey, weight, OWN, 1)


def luma_detail(smoke: ActiveSmoke, colours: Tensor, weight: Tensor) -> Tensor:
    """Luma of each voxel less its mean around, [N 1]: what strokes of few voxels are made of.

    Where the mean is below ``DARK``, as much less as it is darker: dark parts have all of their
    style's detail, and more would be grain. The mean is taken three times over three voxels along
    each axis, which is close to a Gaussian with a standard deviation of 1.4 voxels.

    Args:
        smoke, colours, weight: as of ``blend_chroma``; where all around is 0 there is no detail.
    """
    grey = luma(colours)[:, None]
    mean = _mean_around(smoke, grey, weight, 1.0, WIDE)
    return (grey - mean) * (mean / DARK).clamp(0, 1)


def _mean_around(
    smoke: ActiveSmoke, values: Tensor, weight: Tensor, own: float, times: int
) -> Tensor:
    """Means [N C] of each voxel and those beside it, ``times`` in turn; where all weights are 0,
    the values themselves.

    Args:
        values: [N C].
        weight: [N] >= 0, how much a voxel counts.
        own: how much a voxel counts more than the next one along an axis.
    """
    summed = torch.cat([values * weight[:, None], weight[:, None]], dim=1)
    neighbours = _neighbours(smoke)
    for _ in range(times):
        for before, behind in neighbours:
            padded = torch.cat([summed, torch.zeros_like(summed[:1])])
            summed = own * summed + padded.index_select(0, before)
            summed += padded.index_select(0, behind)
    total = summed[:, -1:]
    mean = summed[:, :-1] / total.clamp_min(torch.finfo(total.dtype).tiny)
    return torch.where(total > 0, mean, values)


def _neighbours(smoke: ActiveSmoke) -> list[tuple[Tensor, Tensor]]:
    """For each axis, the rows [N] of the voxels before and behind each one; N where none is."""
    n, low = len(smoke.ijk), smoke.ijk.amin(0)
    shape = smoke.ijk.amax(0) - low + 2  # a voxel of margin: no row of voxels meets the next one
    known, order = flat_key(smoke.ijk, low, shape).sort()
    found = []
    for stride in (shape[1] * shape[2], shape[2], 1):
        sought = known + stride
        row = torch.searchsorted(known, sought).clamp_max(n - 1)
        exists = known[row] == sought
        first, second = order[exists], order[row[exists]]
        before, behind = torch.full_like(order, n), torch.full_like(order, n)
        before[second], behind[first] = first, second
        found.append((before, behind))
    return found

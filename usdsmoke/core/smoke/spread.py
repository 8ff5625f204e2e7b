"""Colours of voxels and of those around them: what is unknown, mixed hues, detail, speckle."""

import itertools
import math
from functools import cached_property, partial

import torch
from torch import Tensor

from usdsmoke.core.smoke.active import (
    ActiveSmoke,
    block_of,
    coarsen,
    divisor_of,
    flat_key,
    sample_colours,
)
from usdsmoke.core.smoke.memory import SHARED_ROWS, run_on, share_rows, sums_of
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
    block = block_of(smoke, coarse, divisor_of(smoke))
    n_members = torch.bincount(block, minlength=len(coarse.ijk)).to(weighted)
    summed = torch.stack(
        [
            sums_of(block, column, len(coarse.ijk)).to(weighted)
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


class Surroundings:
    """Voxels with those beside them, whose weighted means are taken.

    Who is beside whom is looked up once, when it is first asked.

    Args:
        smoke: the voxels.
        weight: [N] >= 0, how much a voxel counts.
    """

    def __init__(self, smoke: ActiveSmoke, weight: Tensor) -> None:
        self._smoke, self._weight = smoke, weight[:, None]

    def mean(self, values: Tensor, own: float, times: int) -> Tensor:
        """Means [N C] of values [N C], ``times`` in turn; where all weights are 0, the values.

        Args:
            values: of each voxel.
            own: how much a voxel counts more than the next one along an axis.
            times: how often they are taken.
        """
        weighted = torch.cat([values * self._weight, self._weight], dim=1)
        # the last row stands for voxels that are not there
        summed = torch.cat([weighted, torch.zeros_like(weighted[:1])])
        for before, behind in self._beside * times:
            summed = _with_neighbours(summed, before, behind, own)
        total = summed[:-1, -1:]
        mean = summed[:-1, :-1] / total.clamp_min(torch.finfo(total.dtype).tiny)
        return torch.where(total > 0, mean, values)

    def outlying(self, values: Tensor, rows: Tensor) -> Tensor:
        """How far some voxels lie above or below all but one of the six beside, [M]; 0 inside.

        A voxel that is not there counts as the voxel itself, so those of a slab do not outlie.

        Args:
            values: of all voxels, [N].
            rows: of those that are asked for, [M].
        """
        found = torch.empty_like(values[: len(rows)])
        # not within ``look``, where one thread would make it
        all_beside = list(itertools.chain.from_iterable(self._beside))

        def look(part: slice) -> None:
            here = rows[part]
            own = values[here]
            least, most = torch.full_like(own, math.inf), torch.full_like(own, -math.inf)
            low, high = least, most  # the second ones
            for beside in all_beside:
                at = beside[here]
                value = torch.where(at < len(values), values[at.clamp_max(len(values) - 1)], own)
                low, high = low.minimum(least.maximum(value)), high.maximum(most.minimum(value))
                least, most = least.minimum(value), most.maximum(value)
            torch.sub(own, own.clamp(low, high), out=found[part])

        share_rows(look, len(rows), SHARED_ROWS, values.device)
        return found

    def slopes(self, values: Tensor) -> Tensor:
        """Differences [N 3] over two voxels: the next one along each axis less the one before.

        Of values [N]; a voxel that is not there has 0.
        """
        padded = torch.cat([values, values.new_zeros(1)])
        return torch.stack(
            [padded[behind] - padded[before] for before, behind in self._beside], dim=1
        )

    @cached_property
    def _beside(self) -> list[tuple[Tensor, Tensor]]:
        """For each axis, the rows [N] of the voxels before and behind each one; N where none is."""
        ijk = self._smoke.ijk
        n, low = len(ijk), ijk.amin(0)
        shape = ijk.amax(0) - low + 2  # a voxel of margin: no row of voxels meets the next one
        known, order = flat_key(ijk, low, shape).sort()
        rows = order.to(torch.int32)

        def along(stride: Tensor | int) -> tuple[Tensor, Tensor]:
            sought = known + stride
            row = torch.searchsorted(known, sought).clamp_max(n - 1)
            exists = known[row] == sought
            first, second = rows[exists], rows[row[exists]]
            before, behind = torch.full_like(rows, n), torch.full_like(rows, n)
            before[second], behind[first] = first, second
            return before, behind

        strides = (shape[1] * shape[2], shape[2], 1)
        return run_on(ijk.device, [partial(along, stride) for stride in strides])


def _with_neighbours(values: Tensor, before: Tensor, behind: Tensor, own: float) -> Tensor:
    """``own`` times each of values [N+1 C] plus those of two rows [N]; the last one stays."""
    found = torch.empty_like(values)
    found[-1] = values[-1]

    def add(part: slice) -> None:
        here = torch.mul(values[part], own, out=found[part])
        here += values.index_select(0, before[part])
        here += values.index_select(0, behind[part])

    share_rows(add, len(before), SHARED_ROWS, values.device)
    return found


def blend_chroma(around: Surroundings, colours: Tensor) -> Tensor:
    """Colours [N 3] whose chroma is a mean over each voxel and those beside it; their luma stays.

    They may leave [0, 1]. Linear, so changes of colours are blended as colours are.

    Views mix a pixel from different voxels, whose hues cancel in the views that were optimised and
    in no others: speckle. Eyes see hues less finely than light and dark.

    Args:
        around: the voxels. Where all weights around are 0 the colours stay.
        colours: display-encoded [N 3].
    """
    grey = luma(colours)[:, None]
    return grey + around.mean(colours - grey, OWN, 1)


def luma_detail(around: Surroundings, colours: Tensor) -> Tensor:
    """Luma of each voxel less its mean around, [N 1]: what strokes of few voxels are made of.

    Where the mean is below ``DARK``, as much less as it is darker: dark parts have all of their
    style's detail, and more would be grain. The mean is taken three times over three voxels along
    each axis, which is close to a Gaussian with a standard deviation of 1.4 voxels.

    Args:
        around: the voxels; where all weights around are 0 there is no detail.
        colours: display-encoded [N 3].
    """
    grey = luma(colours)[:, None]
    mean = around.mean(grey, 1.0, WIDE)
    return (grey - mean) * (mean / DARK).clamp(0, 1)

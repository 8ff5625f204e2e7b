"""Colours for voxels of which too little is known, from those around them."""

import torch
from torch import Tensor

from usdsmoke.core.smoke.active import ActiveSmoke, block_of, coarsen, sample_colours

KNOWN = 0.99  # trust above which a voxel keeps its colour: the rest of it would not be seen
ENOUGH = 0.5  # mean trust of a block's voxels at which it needs no larger block


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

"""Ambient occlusion: smoke in the grooves between lumps is darker than smoke on top of them.

Smoke that shines in its own colours shows no form, and grooves show marks from the side, as lines a
voxel wide. [Hernell2010] darkens each point by what is around it. Here, a voxel is darkened or
brightened by the share of an even sky that it sees, over that of the smoke around it: whole sides
and undersides keep their colours.
"""

import torch
from torch import Tensor

from usdsmoke.core.smoke.active import sample_colours
from usdsmoke.core.smoke.spread import Surroundings
from usdsmoke.core.views.joined import JoinedSmoke

MOST = 2.0  # relief: only what no picture shows has more, next to darker smoke
AROUND = 7  # means over three voxels along each axis, a Gaussian of 2.2 voxels


def shaded(colours: Tensor, relief: Tensor, amount: float) -> Tensor:
    """Colours [N 3] as bright as their relief tells, but none brighter than white for it.

    Args:
        colours: display-encoded [N 3], at least 0.
        relief: [N], see ``find_relief``.
        amount: share of the effect, in [0, 1].
    """
    factor = 1 - amount + amount * relief[:, None]
    return torch.minimum(colours * factor, colours.clamp_min(1.0))


def find_relief(joined: JoinedSmoke, positions: Tensor) -> Tensor:
    """How much of the sky points see, over what visible smoke around them sees, [P] in [0, MOST].

    About 1 on even smoke, more on top of lumps, less in grooves, and near 0 deep inside.

    Args:
        positions: [P 3] float64, stage space, in the smoke.
    """
    smoke, sky = joined.smoke, joined.sky[:, None]
    around = Surroundings(smoke, joined.visible).mean(sky, 1.0, AROUND)
    relief = (sky / around.clamp_min(torch.finfo(sky.dtype).tiny)).clamp_max(MOST)
    return sample_colours(smoke, relief.to(smoke.density), positions)[0][:, 0]

"""Marks on walls of grooves are smoothed: they look like hairlines (decision 087).

A mark of ten voxels is a line of one or two pixels on smoke that is seen nearly along its surface.
Where another side shows that surface face on, the mark is one there. In a groove, none does: the
other wall is in the way.
"""

import torch
from torch import Tensor

from usdsmoke.core.smoke.active import ActiveSmoke, sample_colours
from usdsmoke.core.smoke.spread import Surroundings, luma_detail
from usdsmoke.core.views.joined import JoinedSmoke
from usdsmoke.core.views.optics import opacity

HIDDEN, OPEN = 0.2, 0.5  # facing: up to the first all is smoothed, from the second on nothing
TIMES = 8  # means over three voxels along each axis, a Gaussian of 2.3 voxels
CLEARER = 0.18  # share of the detail that is added elsewhere, so that pictures keep their edges


def smooth_grazing(
    colours: Tensor, painted: ActiveSmoke, joined: JoinedSmoke, gamma_w: float, amount: float
) -> Tensor:
    """Colours [N 3], smooth where no side shows them face on, and a little clearer elsewhere.

    Voxels deep in the smoke are smoothed, too: no side shows them well.

    Args:
        colours: display-encoded [N 3], at least 0.
        painted: the smoke that has them.
        joined: the painted smoke and what else hides it.
        gamma_w: extinction per density, 1/stage unit.
        amount: share of the effect, in [0, 1].
    """
    shares = torch.stack([joined.facing, joined.clear], dim=1).to(colours)
    facing, clear = sample_colours(joined.smoke, shares, painted.positions)[0].unbind(1)
    alone = opacity(painted.density * (gamma_w * painted.voxel_size))
    around = Surroundings(painted, alone * clear)  # what no side shows does not count
    face_on = ((facing - HIDDEN) / (OPEN - HIDDEN)).clamp(0, 1)[:, None]
    found = torch.lerp(around.mean(colours, 1.0, TIMES), colours, 1 - amount * (1 - face_on))
    found += amount * CLEARER * face_on * luma_detail(around, found)
    return torch.minimum(found.clamp_min(0), colours.clamp_min(1.0))

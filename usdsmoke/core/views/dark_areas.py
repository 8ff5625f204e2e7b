"""Dark areas of the smoke are lifted, with the marks in them: they look like holes (decision 086).

The value of a colour is its brightest channel: dark red is dark to the eye, but no hole. A curve
that keeps black and white takes the mean value of the visible smoke around a voxel to a level. So
marks in dark areas are seen, and dark marks in bright areas stay.
"""

import numpy as np
import torch
from torch import Tensor

from usdsmoke.core.smoke.active import ActiveSmoke, rows_at, sample_colours
from usdsmoke.core.smoke.memory import sums_of
from usdsmoke.core.smoke.spread import Surroundings
from usdsmoke.core.views.joined import JoinedSmoke

STEEPEST = 3.0  # times as bright in a round, as more would bring up single dark voxels
ROUNDS = 2  # marks are lifted by less than an even area of their mean: a second round comes nearer
OF_STYLE = 0.9  # of the median value of a style, which the level is no brighter than
AREA = 3  # means over three voxels along each axis, a Gaussian of 1.4 joined voxels


def lift_dark_areas(
    colours: Tensor, painted: ActiveSmoke, joined: JoinedSmoke, level: float, hue: Tensor
) -> Tensor:
    """Colours [N 3], brighter where the smoke around is darker than a level.

    Args:
        colours: display-encoded [N 3], at least 0.
        painted: the smoke that has them.
        joined: the painted smoke and what else hides it.
        level: value, display-encoded, in [0, 1).
        hue: [3], of what is added, whose brightest channel is 1: those of colours near black are
            noise.
    """
    smoke, rows = joined.smoke, _joined_rows(painted, joined.smoke)
    density, n = painted.density.double(), len(smoke.ijk)
    mass = sums_of(rows, density, n)
    seen = Surroundings(smoke, torch.where(mass > 0, joined.visible, 0.0))
    near = Surroundings(smoke, torch.ones_like(mass))
    for _ in range(ROUNDS):
        value = colours.amax(1).clamp(0, 1)
        mean = sums_of(rows, density * value, n) / mass.clamp_min(torch.finfo(mass.dtype).tiny)
        around = seen.mean(mean[:, None], 1.0, AREA)
        # voxels whose mean, which lies between those of joined voxels, may be below the level
        beside = near.mean((around < level).double(), 1.0, 1)
        dark = (beside[:, 0] > 0)[rows].nonzero()[:, 0]
        around = sample_colours(smoke, around.to(colours), painted.positions[dark])[0][:, 0]
        slope = level * (1 - around) / (around * (1 - level)).clamp_min(1e-6)
        slope, value = slope.clamp(1, STEEPEST), value[dark]
        added = slope * value / (1 + (slope - 1) * value) - value
        colours = colours.index_add(0, dark, added[:, None] * hue)
    return colours


def _joined_rows(painted: ActiveSmoke, smoke: ActiveSmoke) -> Tensor:
    """The row of the joined voxel that holds each painted one, [N]."""
    to_index = torch.as_tensor(np.linalg.inv(smoke.index_to_stage), device=smoke.ijk.device)
    index = painted.positions @ to_index[:3, :3] + to_index[3, :3]
    return rows_at(smoke, index.round().to(smoke.ijk))

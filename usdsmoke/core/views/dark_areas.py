"""Dark areas of the smoke are lifted, with the marks in them: they look like holes (decision 086).

The value of a colour is its brightest channel: dark red is dark to the eye, but no hole. A curve
that keeps black and white takes the mean value of the visible smoke around a voxel to a level. So
marks in dark areas are seen, and dark marks in bright areas stay.
"""

import numpy as np
import torch
from torch import Tensor

from usdsmoke.core.smoke.active import ActiveSmoke, coarsen, flat_key, sample_colours
from usdsmoke.core.smoke.memory import sums_of
from usdsmoke.core.smoke.spread import Surroundings
from usdsmoke.core.views.occlusion import AROUND, JoinedSmoke

STEEPEST = 5.0  # times as bright: more would show noise
OF_STYLE = 2 / 3  # of the mean value of a style, which the level is no brighter than
AREA = 3  # means over three voxels along each axis, a Gaussian of 1.4 joined voxels


def lift_dark_areas(
    colours: Tensor, painted: ActiveSmoke, joined: JoinedSmoke, level: float
) -> Tensor:
    """Colours [N 3], brighter where the smoke around is darker than a level.

    What is added has the hue of the smoke far around: the hues of colours near black are noise.

    Args:
        colours: display-encoded [N 3], at least 0.
        painted: the smoke that has them.
        joined: the painted smoke and what else hides it.
        level: value, display-encoded, in [0, 1).
    """
    smoke, value = joined.smoke, colours.amax(1).clamp(0, 1)
    values = torch.cat([colours.clamp(0, 1), value[:, None]], 1)
    rows, mass = _row_of(painted, smoke), painted.density.double()
    mass, means = _means(rows, mass, values, len(smoke.ijk))
    seen = torch.where(mass > 0, joined.visible, 0.0)
    around = _at(painted, smoke, Surroundings(smoke, seen).mean(means[:, 3:], 1.0, AREA))
    slope = level * (1 - around) / (around * (1 - level)).clamp_min(1e-6)
    slope = slope.clamp(1, STEEPEST)[:, 0]
    added = slope * value / (1 + (slope - 1) * value) - value
    return colours + added[:, None] * _at(painted, *_hues(smoke, means, seen))


def _hues(smoke: ActiveSmoke, means: Tensor, seen: Tensor) -> tuple[ActiveSmoke, Tensor]:
    """Smoke in voxels four times as wide, and the colour of what is bright around them, [M 3],
    whose brightest channel is 1."""
    wide = coarsen(coarsen(smoke))
    weight = seen * means[:, 3]
    rows = _row_of(smoke, wide)
    total, mean = _means(rows, weight, means[:, :3], len(wide.ijk))
    mean = Surroundings(wide, total).mean(mean, 1.0, AROUND)
    return wide, mean / mean.amax(1, keepdim=True).clamp_min(torch.finfo(mean.dtype).tiny)


def _means(rows: Tensor, weight: Tensor, values: Tensor, n: int) -> tuple[Tensor, Tensor]:
    """The weights [N] that have the same row, added, [n], and the means of their values, [n C]."""
    total = sums_of(rows, weight, n)
    sums = torch.stack([sums_of(rows, weight * column, n) for column in values.T], 1)
    return total, sums / total.clamp_min(torch.finfo(total.dtype).tiny)[:, None]


def _row_of(smoke: ActiveSmoke, coarse: ActiveSmoke) -> Tensor:
    """The row of the coarser voxel that holds each voxel, [N]."""
    matrix = torch.as_tensor(np.linalg.inv(coarse.index_to_stage), device=smoke.ijk.device)
    index = smoke.positions @ matrix[:3, :3] + matrix[3, :3]
    first = coarse.ijk.amin(0)
    shape = coarse.ijk.amax(0) - first + 1
    known = flat_key(coarse.ijk, first, shape)  # ascending, as ``coarsen`` leaves them
    return torch.searchsorted(known, flat_key(index.round().to(first), first, shape))


def _at(painted: ActiveSmoke, smoke: ActiveSmoke, values: Tensor) -> Tensor:
    return sample_colours(smoke, values.to(painted.density), painted.positions)[0]

"""What counts as ordinary density: ranks of voxels, of which one voxel or a few change nothing.

A mean or a maximum is owned by the densest voxel: smoke around a fire a million times denser than
itself would neither move nor be seen.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from usdsmoke.core.smoke.voxels import Voxels

if TYPE_CHECKING:
    from torch import Tensor

    from usdsmoke.core.smoke.active import ActiveSmoke

Smoke = TypeVar("Smoke", "ActiveSmoke", Voxels)

DENSE_RANK = 0.99  # of the voxels
DENSE_TIMES = 10.0  # the density at that rank: denser voxels are outliers


def ranked(values: "Tensor | np.ndarray", share: float) -> float:
    """The value [N] below which a share of the values lies; 0 where there are none.

    At least one value is larger wherever there are two, so the largest never counts for ``share``
    < 1.
    """
    if not len(values):
        return 0.0
    place = int(share * (len(values) - 1))
    if isinstance(values, np.ndarray):
        return float(np.partition(values, place)[place])
    return float(values.kthvalue(place + 1).values)


def dense_level(density: "Tensor | np.ndarray") -> float:
    """The density from which voxels are outliers; 0 where there is no smoke.

    Args:
        density: any shape; voxels at 0 or below do not count.
    """
    return DENSE_TIMES * ranked(density[density > 0], DENSE_RANK)


def bounded(smoke: Smoke) -> Smoke:
    """The smoke without the excess of outliers; the smoke itself where there is none.

    Voxels of a floor do not make all smoke outliers.
    """
    voxels = smoke if isinstance(smoke, Voxels) else smoke.voxels
    level = dense_level(voxels.above_floor().density)
    if not bool((smoke.density > level).any()):
        return smoke
    return replace(smoke, density=smoke.density.clip(max=level))

"""Ambient occlusion: smoke in the grooves between lumps is darker than smoke on top of them.

Smoke that shines in its own colours shows no form, and grooves show marks from the side, as lines a
voxel wide. [Hernell2010] darkens each point by what is around it. Here, a voxel is darkened or
brightened by the share of an even sky that it sees, over that of the smoke around it: whole sides
and undersides keep their colours.
"""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from usdsmoke.core.smoke.active import ActiveSmoke, coarsen, sample_colours
from usdsmoke.core.smoke.memory import run_on
from usdsmoke.core.smoke.spread import Surroundings
from usdsmoke.core.views.optics import opacity
from usdsmoke.core.views.scene import Scene
from usdsmoke.core.views.shadows import trace_shadows

MOST_SIDE = 64  # voxels along the longer side of the pictures; smaller ones are joined
MOST_VOXELS = 2**19  # twice those of a cube of that side; smoke beyond the picture may have more
SOFT = 0.12  # of the extinction: shade lies on lumps of smoke, not on its single voxels
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


@dataclass(frozen=True)
class JoinedSmoke:
    """Smoke in voxels that are large enough to tell its lumps from its marks."""

    smoke: ActiveSmoke  # N voxels
    sky: Tensor  # [N] float64, the share of the sky above that a voxel sees
    visible: Tensor  # [N] float64, its light in the picture that shows it best


def join_smoke(smoke: ActiveSmoke, scene: Scene) -> JoinedSmoke:
    """Join voxels, and look at them from all sides.

    Args:
        smoke: all that hides the sky, one voxel or more.
        scene: its extinction, its size and its up axis.

    Gradients: none; density is fixed where smoke is painted.
    """
    longest = scene.image_size * scene.pixel_size
    n_halvings = math.ceil(math.log2(max(longest / smoke.voxel_size / MOST_SIDE, 1.0)))
    for _ in range(n_halvings):
        smoke = coarsen(smoke)
    while len(smoke.ijk) > MOST_VOXELS:
        smoke = coarsen(smoke)
    return JoinedSmoke(smoke, *_seen(smoke, scene))


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


def _seen(smoke: ActiveSmoke, scene: Scene) -> tuple[Tensor, Tensor]:
    """The share of the sky above that voxels see, and their light in the picture that shows them
    best, [N] each, in [0, 1] and in double precision: sums over many voxels leave single's range.
    """

    def seen(towards: np.ndarray) -> Tensor:
        found = trace_shadows(smoke, SOFT * scene.gamma_w, towards).at(smoke.positions)
        return found.double()

    above = _sky_above(scene.up_axis)
    found = run_on(smoke.density.device, [partial(seen, way) for way in (*above, *-above)])
    shares = torch.stack(found)
    alone = opacity(smoke.density.double() * (scene.gamma_w * smoke.voxel_size))
    return shares[: len(above)].mean(0), shares.amax(0) ** (1 / SOFT) * alone


def _sky_above(up_axis: str) -> np.ndarray:
    """Unit vectors to the sky, [6 3]: the upper corners of an icosahedron, of equal weight.

    It stands on a corner: of those of ``lighting.sky_directions``, some lie on the horizon.
    """
    angle = np.arange(5) * (2 * np.pi / 5)
    ring = np.stack([2 * np.cos(angle), np.ones(5), 2 * np.sin(angle)], axis=1) / 5**0.5
    found: np.ndarray = np.concatenate([[[0.0, 1.0, 0.0]], ring])
    return found if up_axis == "Y" else found[:, [0, 2, 1]]

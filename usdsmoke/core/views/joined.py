"""Smoke in large voxels, seen from all sides: its lumps, without the marks that are on them."""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from usdsmoke.core.smoke.active import ActiveSmoke, coarsen
from usdsmoke.core.smoke.memory import run_on
from usdsmoke.core.smoke.spread import Surroundings
from usdsmoke.core.views.optics import THICKEST, attenuation_ratio, opacity
from usdsmoke.core.views.scene import Scene
from usdsmoke.core.views.shadows import trace_shadows

MOST_SIDE = 64  # voxels along the longer side of the pictures; smaller ones are joined
MOST_VOXELS = 2**19  # twice those of a cube of that side; smoke beyond the picture may have more
SOFT = 0.12  # of the extinction: shade lies on lumps of smoke, not on its single voxels
SURFACE = 2  # means over three voxels along each axis, a Gaussian of 1.2 voxels, for normals
EVEN = 0.05  # difference of opacity at which smoke has a surface by half


@dataclass(frozen=True)
class JoinedSmoke:
    """Smoke in voxels that are large enough to tell its lumps from its marks.

    Shares are in [0, 1] and in double precision: sums over many voxels leave single's range.
    """

    smoke: ActiveSmoke  # N voxels
    sky: Tensor  # [N], the share of the sky above that a voxel sees
    clear: Tensor  # [N], the share of its light that arrives at the side that shows it best
    # [N], the most, over sides, of the light that arrives from its front times the cosine between
    # side and normal; fog has no normal and counts as face on
    facing: Tensor
    visible: Tensor  # [N], its light at the side that shows it best


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
    return _seen(smoke, scene)


def _seen(smoke: ActiveSmoke, scene: Scene) -> JoinedSmoke:
    """The voxels with what twelve sides show of them, the corners of an icosahedron."""

    def seen(towards: np.ndarray) -> Tensor:
        found = trace_shadows(smoke, SOFT * scene.gamma_w, towards).at(smoke.positions)
        return found.double()

    above = _sky_above(scene.up_axis)
    sides = np.concatenate([above, -above])
    shares = torch.stack(run_on(smoke.density.device, [partial(seen, side) for side in sides]))
    depth = smoke.density.double() * (scene.gamma_w * smoke.voxel_size)
    clear = shares.amax(0) ** (1 / SOFT)
    facing = _facing(smoke, depth, shares, torch.as_tensor(sides, device=depth.device))
    sky, visible = shares[: len(above)].mean(0), clear * opacity(depth)
    return JoinedSmoke(smoke, sky, clear, facing, visible)


def _facing(smoke: ActiveSmoke, depth: Tensor, shares: Tensor, sides: Tensor) -> Tensor:
    """How well the side that does so best shows the surface of voxels, [N] in [0, 1].

    Args:
        depth: optical depth of a voxel, [N].
        shares: of the light of each side, [S N], with ``SOFT`` of the extinction.
        sides: unit vectors, [S 3].
    """
    normals = _normals(smoke, opacity(depth))
    even = 1 - normals.norm(dim=1)
    # shares are means over a voxel; here, no voxel hides itself
    own = attenuation_ratio((SOFT * depth).clamp_max(THICKEST))
    found = torch.zeros_like(depth)
    for share, side in zip(shares, sides, strict=True):
        before = (share / own).clamp_max(1) ** (1 / SOFT)
        found = torch.maximum(found, before * ((normals @ side).clamp_min(0) + even))
    return found


def _normals(smoke: ActiveSmoke, alone: Tensor) -> Tensor:
    """Normals out of the smoke, [N 3], from opacities of voxels [N].

    They are shorter than 1 the less of a surface there is: all sides of even smoke look alike. An
    edge one voxel wide gives directions that are off by up to 30 degrees.
    """
    around = Surroundings(smoke, torch.ones_like(alone))
    along = -around.slopes(around.mean(alone[:, None], 1.0, SURFACE)[:, 0])
    to_index = torch.as_tensor(np.linalg.inv(smoke.edges) * smoke.voxel_size, device=alone.device)
    along = along @ to_index.T
    return along / (along.norm(dim=1, keepdim=True) + EVEN)


def _sky_above(up_axis: str) -> np.ndarray:
    """Unit vectors to the sky, [6 3]: the upper corners of an icosahedron, of equal weight.

    It stands on a corner: of those of ``lighting.sky_directions``, some lie on the horizon.
    """
    angle = np.arange(5) * (2 * np.pi / 5)
    ring = np.stack([2 * np.cos(angle), np.ones(5), 2 * np.sin(angle)], axis=1) / 5**0.5
    found: np.ndarray = np.concatenate([[[0.0, 1.0, 0.0]], ring])
    return found if up_axis == "Y" else found[:, [0, 2, 1]]

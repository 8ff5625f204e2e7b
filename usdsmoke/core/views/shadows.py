"""Shadow maps: how much light of a distant light arrives at points among smoke.

A map holds a transmittance for each slab and pixel along the light's way, as a deep shadow map does
[Lokovic2000]. It is traced once; a look-up costs a few per cent of that.
"""

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.memory import CHUNK_ROWS, chunks
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.project import (
    MOST_CELLS,
    THICKEST,
    add_depths,
    light_up,
    project_voxels,
    slab_cells,
    split_points,
)
from usdsmoke.core.views.scene import fit_view


@dataclass(frozen=True)
class ShadowMap:
    """The share of a light that arrives in slabs across its way."""

    view: View
    arriving: Tensor  # [S P] in [0, 1]; the first slab is empty
    nearest: float  # depth of the first slab with smoke, stage units
    step: float  # thickness of a slab, stage units
    last: float  # slab of the smoke that is farthest from the light

    def at(self, positions: Tensor) -> Tensor:
        """The share that arrives at points, [P] in [0, 1]; trilinear.

        Args:
            positions: [P 3] float64, stage space, among the smoke.
        """
        n_pixels, dtype = self.arriving.shape[1], self.arriving.dtype
        arriving, found = self.arriving.view(-1), self.arriving.new_empty(len(positions))
        for part in chunks(len(positions), CHUNK_ROWS, positions.device):
            foot = project_voxels(positions[part], self.view)
            slab = ((foot.depth - self.nearest) / self.step + 1).clamp(0, self.last)
            cell, far = slab_cells(slab, foot.pixel, n_pixels, dtype)
            here = arriving[cell] * (1 - far) + arriving[cell + n_pixels] * far
            found[part] = (foot.weight.to(dtype) * here).sum(1)
        return found


def trace_shadows(
    smoke: ActiveSmoke, gamma_w: float, towards: np.ndarray, both: bool = False
) -> ShadowMap:
    """The shadow map of a distant light.

    In slab s with optical depth t_s it is exp(-sum_{r<s} t_r) (1 - exp(-t_s)) / t_s, the mean over
    the slab. It is bounded for every optical depth, and of second order in the voxel's size where a
    voxel is optically thin.

    Args:
        smoke: what casts shadows, one voxel or more.
        gamma_w: extinction per density, 1/stage unit.
        towards: unit vector to the light, [3].
        both: the mean of this light and of as much from the opposite side, through the same slabs.

    Gradients: none; density is fixed where smoke is lit.
    """
    view = fit_view(light_view(towards, smoke.voxel_size), smoke)
    points, n_points = split_points(smoke.positions, smoke.edges, view)
    n_pixels, axis = view.height * view.width, points.new_tensor(view.forward)
    depth = (points - points.new_tensor(view.centre)) @ axis
    nearest, length = float(depth.min()), float(depth.max() - depth.min())
    step = max(smoke.voxel_size, length * n_pixels / MOST_CELLS)
    last = length / step + 1  # behind an empty slab
    density = smoke.density
    if n_points > 1:
        density = density.repeat_interleave(n_points)
    volume = smoke.voxel_volume / n_points
    n_cells = (int(last) + 2) * n_pixels
    near, far = density.new_zeros(n_cells), density.new_zeros(n_cells)
    for part in chunks(len(points), CHUNK_ROWS, points.device):
        foot = project_voxels(points[part], view)
        mass = (density[part] * (gamma_w * volume) * foot.per_area).clamp_max(THICKEST)
        mass = (foot.weight * mass[:, None]).to(density.dtype)
        slab = ((foot.depth - nearest) / step + 1).clamp(0, last)
        add_depths(near, far, slab, foot.pixel, mass, n_pixels)
    arriving = near.add_(far).view(-1, n_pixels)
    behind = arriving.flip(0) if both else None
    light_up(arriving)
    if behind is not None:
        light_up(behind)
        arriving = (arriving + behind.flip(0)) / 2
    return ShadowMap(view, arriving, nearest, step, last)


def light_view(towards: np.ndarray, pixel_size: float) -> View:
    """A view along the light's way, one pixel large.

    Args:
        towards: unit vector to the light, [3].
        pixel_size: stage units.
    """
    forward = -towards
    side = np.eye(3)[int(np.argmin(np.abs(forward)))]
    right = np.cross(forward, side)
    right = right / np.linalg.norm(right)
    return View(right, np.cross(right, forward), forward, np.zeros(3), 1, 1, pixel_size)

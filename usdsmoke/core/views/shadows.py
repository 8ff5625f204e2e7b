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
from usdsmoke.core.views.optics import THICKEST, Slabs
from usdsmoke.core.views.project import Projector, point_offsets
from usdsmoke.core.views.scene import fit_view


@dataclass(frozen=True)
class ShadowMap:
    """The share of a light that arrives in slabs across its way."""

    projector: Projector
    arriving: Slabs  # in [0, 1]; the first slab is empty

    def at(self, positions: Tensor) -> Tensor:
        """The share that arrives at points, [P] in [0, 1]; trilinear.

        Args:
            positions: [P 3] float64, stage space, among the smoke.
        """
        found = self.arriving.values.new_empty(len(positions))
        for part in chunks(len(positions), CHUNK_ROWS, positions.device):
            for foot in self.projector.footprints(positions[part]):
                place = self.arriving.place(foot.first, foot.depth)
                here = self.arriving.at(*place, self.projector.shifts)
                found[part] = (foot.weights.to(here) * here).sum(0)
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
    positions, density = smoke.positions, smoke.density
    offsets, projector = point_offsets(positions, smoke.edges, view), Projector(positions, view)
    depth_range = projector.depth_range(positions, offsets)
    slabs = Slabs(view, depth_range, smoke.voxel_size, density, margin=1)
    volume = smoke.voxel_volume / len(offsets)
    for part in chunks(len(positions), CHUNK_ROWS, positions.device):
        for foot in projector.footprints(positions[part], offsets):
            mass = (density[part] * (gamma_w * volume) * foot.per_area).clamp_max(THICKEST)
            place = slabs.place(foot.first, foot.depth)
            slabs.add(*place, projector.shifts, (foot.weights * mass).to(density))
    slabs.light_up(both)
    return ShadowMap(projector, slabs)


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

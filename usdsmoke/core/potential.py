"""From a potential on a box to the displacement of its smoke."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from usdsmoke.core.displacement import (
    cap_displacement,
    from_mixed,
    from_potential,
    from_stream,
    smooth_mask,
)
from usdsmoke.core.lattice import Lattice

__all__ = ["Potential", "border_mask", "carry_levels", "displacement_from"]

BORDER = 2.0  # voxels over which the displacement fades towards the border


@dataclass(frozen=True)
class Potential:
    """What the displacement is made from, on the voxels of a box: stage unit^2."""

    values: Tensor  # [I J K C]: 3 stream, 1 potential, 4 both
    lattice: Lattice

    def on(self, lattice: Lattice, departures: Tensor | None = None) -> Tensor:
        """The potential on another box, [I J K C], or at the points its voxels' smoke came from."""
        positions = lattice.positions() if departures is None else departures
        found = self.lattice.sample(self.values, positions.to(self.values.device))
        return found.view(*lattice.shape, -1)


def carry_levels(
    like: Sequence[Tensor], lattice: Lattice, before: Lattice, levels: Sequence[Tensor]
) -> list[Tensor]:
    """A pyramid's values on the pyramid of the next octave, whose lattice is twice as fine.

    Each level gets what the level of its own resolution had; the finest had none, and gets 0.

    Args:
        like: the new levels, coarse to fine, [i j k C] each.
        lattice, before: of the new pyramid's finest level, and of the old one's.
        levels: the old levels, coarse to fine.
    """
    carried = []
    for number, level in enumerate(like):
        above = number - len(like) + 1 + len(levels)  # the same resolution, counted from the finest
        if not 0 <= above < len(levels):
            carried.append(torch.zeros_like(level))
            continue
        old = levels[above]
        places = lattice.coarsened(level.shape).positions()
        found = before.coarsened(old.shape).sample(old, places.to(old.device))
        carried.append(found.view(level.shape))
    return carried


def border_mask(density: Tensor) -> Tensor:
    """1 inside the smoke, falling smoothly to 0 *at* its border, [I J K].

    The blurred mask is one half at the border: the upper half of its range is taken, or smoke would
    still move at the silhouette and pile up there as a bright rim.
    """
    inside = (2 * smooth_mask(density, BORDER) - 1).clamp_min(0)
    return inside * inside * (3 - 2 * inside)


def displacement_from(
    potential: Tensor, mask: Tensor, kind: str, cap: float, lattice: Lattice
) -> Tensor:
    """u on a box's voxels, [I J K 3] in *index units* along its axes; |u| < cap in stage units.

    The potential is faded before it is derived, so that a stream function's displacement stays free
    of divergence where the mask falls off; the cap alone disturbs it.
    """
    faded = potential * mask[..., None]
    if kind == "stream":
        moved = from_stream(faded, lattice.spacing)
    elif kind == "potential":
        moved = from_potential(faded[..., 0], lattice.spacing)
    else:
        moved = from_mixed(faded[..., :3], faded[..., 3], lattice.spacing, 0.5)
    return cap_displacement(moved, cap) / moved.new_tensor(lattice.spacing)

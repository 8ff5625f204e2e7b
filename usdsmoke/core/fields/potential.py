"""From a potential on a box to the velocity of its smoke."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_

import torch
from torch import Tensor

from usdsmoke.core.fields.displacement import (
    MIXED_SHARE,
    from_mixed,
    from_potential,
    from_stream,
    smooth_mask,
)
from usdsmoke.core.fields.gather import gather_sum, planar
from usdsmoke.core.fields.lattice import Lattice, largest_near
from usdsmoke.core.fields.sample import sample_linear, spline_coefficients


@dataclass(frozen=True)
class Potential:
    """The potential of a velocity, on the voxels of a box: stage unit^2."""

    values: Tensor  # [I J K C]: 3 stream, 1 potential, 4 both
    lattice: Lattice

    def on(self, lattice: Lattice) -> Tensor:
        """The potential on another box, [I J K C]."""
        values = planar(self.values)
        return lattice.on_voxels(lambda places: self.lattice.sample(values, places), values)


@dataclass(frozen=True)
class Displacement:
    """A displacement of smoke, on the voxels of a box: stage units.

    Or the velocity that gives it when it is followed for a unit of time.
    """

    values: Tensor  # [I J K 3]
    lattice: Lattice

    def to(self, device: torch.device) -> "Displacement":
        """The same on a device."""
        return Displacement(self.values.to(device), self.lattice)

    def at(self, positions: Tensor) -> Tensor:
        """The displacement at points [N 3] float64 of stage space, [N 3]; 0 beyond the box."""
        return self.lattice.sample(self.values, positions.to(self.values.device), "zero")

    def smoothly(self) -> Callable[[Tensor], Tensor]:
        """As ``at``, through a cubic spline: a look-up between voxels keeps what is small.

        Where ``at`` finds nothing, there is nothing: a spline rings into empty voxels.
        """
        values, margin = self.values, 2  # voxels that a place up to one beyond the box reads
        channels = values.unbind(-1)
        parts = [spline_coefficients(channel, margin) for channel in channels]
        coefficients = torch.stack(parts).movedim(0, -1)  # one after another in memory
        there = reduce(or_, (channel != 0 for channel in channels)).to(values)

        def at(positions: Tensor) -> Tensor:
            place = self.lattice.index_of(positions.to(values.device)).to(values.dtype)
            found = gather_sum(coefficients, place + margin, cubic=True)
            return found * (sample_linear(there, place) > 0)[:, None]

        return at

    def on(self, lattice: Lattice) -> Tensor:
        """The displacement on another box, [I J K 3], along its axes."""
        moved = Displacement(planar(self.values), self.lattice)  # laid out for many look-ups
        return lattice.on_voxels(lambda places: lattice.from_stage(moved.at(places)), self.values)


def border_mask(density: Tensor, sigma: float | Sequence[float]) -> Tensor:
    """1 inside the smoke, falling smoothly to 0 *at* the border of thick smoke, [I J K].

    The blurred mask is compared with its largest value nearby. At the border of thick smoke that is
    one half: the upper half of the range is taken, or smoke would still move at the silhouette and
    pile up there as a bright rim. A sheet or a filament thinner than the blur is as blurred inside
    as everywhere nearby, and takes part.

    Args:
        density: [I J K].
        sigma: of the blur, voxels; one number or one per axis.
    """
    sigmas = [float(sigma)] * 3 if isinstance(sigma, (int, float)) else [float(s) for s in sigma]
    blurred = smooth_mask(density, sigmas)
    reach = [
        min(math.ceil(2 * along), n - 1) for along, n in zip(sigmas, density.shape, strict=True)
    ]
    nearby = largest_near(blurred, reach)
    tiny = torch.finfo(blurred.dtype).tiny
    inside = (2 * blurred / nearby.clamp_min(tiny) - 1).clamp_min(0)
    return inside * inside * (3 - 2 * inside)


def unclamped_displacement(
    potential: Tensor, mask: Tensor, kind: str, lattice: Lattice, base: Tensor | None = None
) -> Tensor:
    """The displacement before it is clamped to a length, [I J K 3] along the axes, stage units.

    The potential is faded before it is derived, so that a stream function's velocity stays free of
    divergence where the mask falls off. The cap does disturb it.

    Args:
        potential: [I J K C], stage unit^2.
        mask: [I J K] in [0, 1], the share of the effect.
        kind: stream, potential or mixed.
        lattice: the box.
        base: what the potential's displacement is added to, such as the neighbouring
            frame's unclamped one, which is faded already.
    """
    faded = potential * mask[..., None]
    if kind == "stream":
        moved = from_stream(faded, lattice.spacing)
    elif kind == "potential":
        moved = from_potential(faded[..., 0], lattice.spacing)
    else:
        moved = from_mixed(faded[..., :3], faded[..., 3], lattice.spacing, MIXED_SHARE)
    return moved if base is None else moved + base

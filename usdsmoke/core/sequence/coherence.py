r"""How one frame's result follows another's: carried by the smoke's velocity, compared, averaged.

T carries a field from one frame to the next: T(F)(x) = F(departure point of x). A displacement is
carried component by component; a potential must not be, because the curl of a carried potential is
not the carried curl where the smoke turns (measured: 37 % off in a lively plume, each frame).

The temporal error of a sequence is |F_{t+1} - T(F_t)| / |F_{t+1}| over the smoke, weighted by
density. A sequence is aligned in one sweep forward, in which every frame starts from its
neighbour's carried result, and one backward, which averages a frame with the one that follows.
"""

import torch
from torch import Tensor

from usdsmoke.base.volume import VolumeFrame
from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.sequence.warm import departure_points, trace_back
from usdsmoke.core.smoke.active import ActiveSmoke, sample_colours

__all__ = [
    "average_colours",
    "average_displacement",
    "carry_displacement",
    "colour_error",
    "displacement_error",
]


def carry_displacement(
    before: Displacement, frame: VolumeFrame, lattice: Lattice, seconds: float
) -> Tensor:
    """A neighbouring frame's displacement on this frame's box, [I J K 3], along its axes.

    Args:
        before: the neighbour's.
        frame: this frame, for its velocity.
        lattice: of this frame.
        seconds: time since the neighbour; negative when it is later.
    """
    values = before.values
    trace, moved = trace_back(frame, seconds, values.device), before.planar()
    return lattice.on_voxels(lambda places: lattice.from_stage(moved.at(trace(places))), values)


def average_displacement(
    own: Displacement, later: Displacement, frame: VolumeFrame, seconds: float, share: float
) -> Displacement:
    """A frame's displacement, averaged with the following frame's carried back to it.

    Args:
        own, later: of the frame and of the one that follows.
        frame: for its velocity.
        seconds: until the later frame, > 0.
        share: of the later frame, in [0, 1].
    """
    carried = own.lattice.to_stage(carry_displacement(later, frame, own.lattice, -seconds))
    return Displacement(torch.lerp(own.values, carried, share), own.lattice)


def average_colours(
    smoke: ActiveSmoke,
    colours: Tensor,
    later: tuple[ActiveSmoke, Tensor],
    frame: VolumeFrame,
    seconds: float,
    share: float,
) -> Tensor:
    """A frame's colours [N 3], averaged with the following frame's carried back to it.

    Smoke that is not there any more in the later frame keeps its own.
    """
    departures = departure_points(frame, smoke.positions, -seconds)
    carried, near = sample_colours(*later, departures)
    return torch.lerp(colours, carried, share * near.clamp(0, 1))


def displacement_error(
    before: Displacement,
    own: Displacement,
    smoke: ActiveSmoke,
    frame: VolumeFrame,
    seconds: float,
) -> float:
    """Temporal error of the displacement over a frame's (source) smoke; 0 when nothing moves."""
    carried = before.at(departure_points(frame, smoke.positions, seconds))
    return _relative(own.at(smoke.positions), carried, smoke.density)


def colour_error(
    before: tuple[ActiveSmoke, Tensor],
    smoke: ActiveSmoke,
    colours: Tensor,
    frame: VolumeFrame,
    seconds: float,
) -> float:
    """Temporal error of display-encoded colours, over smoke that was there before."""
    departures = departure_points(frame, smoke.positions, seconds)
    carried, near = sample_colours(*before, departures)
    there = near[:, 0] > 1e-3
    return _relative(colours[there], carried[there], smoke.density[there])


def _relative(found: Tensor, wanted: Tensor, weight: Tensor) -> float:
    """|found - wanted| / |found|, weighted."""
    weight = weight.double()[:, None]
    energy = float((found.double().square() * weight).sum())
    missed = float(((found - wanted).double().square() * weight).sum())
    return (missed / energy) ** 0.5 if energy > 0 else 0.0

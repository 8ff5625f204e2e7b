r"""How one frame's result follows another's: carried by the smoke's velocity, averaged.

T carries a field from one frame to the next: T(F)(x) = F(departure point of x). A displacement is
carried component by component; a potential must not be, because the curl of a carried potential is
not the carried curl where the smoke turns (measured: 37 % off in a lively plume, each frame).

A sequence is aligned in one sweep forward, in which every frame starts from its
neighbour's carried result, and one backward, which averages a frame with the one that follows.
"""

import torch
from torch import Tensor

from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.sequence.transit import Transit
from usdsmoke.core.smoke.active import ActiveSmoke, coarsen, sample_colours
from usdsmoke.core.smoke.noise import white_noise

FILL_LEVELS = 4  # halvings over which new smoke takes its neighbours' colour
NEAR = 1e-3  # trilinear weight of smoke from which there is smoke


def carry_displacement(
    before: Displacement, transit: Transit, lattice: Lattice, near: Tensor | None = None
) -> Tensor:
    """A neighbouring frame's displacement on this frame's box, [I J K 3], along its axes.

    Args:
        before: the neighbour's.
        transit: from the neighbour to this frame.
        lattice: of this frame.
        near: [I J K] bool, voxels that it is carried to, see ``steps.move.near_smoke``; the others
            have none. None: all.
    """
    trace, look_up = transit.tracer(before.values.device), before.smoothly()

    def at(places: Tensor) -> Tensor:
        return lattice.from_stage(transit.turn(look_up(trace(places))))

    return lattice.on_voxels(at, before.values, near)


def carry_colours(
    before: ActiveSmoke, colours: Tensor, transit: Transit, smoke: ActiveSmoke, seed: int
) -> Tensor:
    """The neighbouring frame's colours at this frame's voxels, [N 3].

    Args:
        before, colours: the neighbour's smoke and its colours.
        transit: from the neighbour to this frame.
        smoke: this frame's smoke.
        seed: see ``fill_colours``.
    """
    return fill_colours(before, colours, smoke, transit.origins(smoke.positions), seed)


def fill_colours(
    before: ActiveSmoke, colours: Tensor, smoke: ActiveSmoke, departures: Tensor, seed: int
) -> Tensor:
    """Colours of one smoke for another one's voxels, [N 3], each with some colour.

    New smoke takes the colour of the nearest coarser voxels that had smoke,
    or white noise where those have none either.

    Args:
        before, colours: where colours are taken from.
        smoke: what they are for.
        departures: where in ``before`` each of its voxels comes from, [N 3] float64, stage space.
        seed: of the noise.
    """
    carried, near = sample_colours(before, colours, departures)
    level, level_colours = before, colours
    for _ in range(FILL_LEVELS):
        missing = torch.nonzero(near[:, 0] < NEAR).squeeze(1)
        if len(missing) == 0:
            return carried
        coarser = coarsen(level)
        level_colours, _ = sample_colours(level, level_colours, coarser.positions)
        level = coarser
        found, near_found = sample_colours(level, level_colours, departures[missing])
        carried[missing], near[missing] = found, near_found
    missing = torch.nonzero(near[:, 0] < NEAR).squeeze(1)
    carried[missing] = white_noise(smoke.ijk[missing], 3, seed).to(carried)
    return carried


def average_displacement(
    own: Displacement, later: Displacement, transit: Transit, share: float, near: Tensor
) -> Displacement:
    """A frame's displacement, averaged with the following frame's carried back to it.

    Args:
        own, later: of the frame and of the one that follows.
        transit: from the frame to the later one.
        share: of the later frame, in [0, 1].
        near: see ``carry_displacement``.
    """
    carried = own.lattice.to_stage(carry_displacement(later, transit.reverse, own.lattice, near))
    return Displacement(torch.lerp(own.values, carried, share), own.lattice)


def average_colours(
    smoke: ActiveSmoke,
    colours: Tensor,
    later: tuple[ActiveSmoke, Tensor],
    transit: Transit,
    share: float,
) -> Tensor:
    """A frame's colours [N 3], averaged with the following frame's carried back to it.

    Smoke that is gone in the later frame keeps its own.

    Args:
        smoke, colours: of the frame.
        later: of the frame that follows.
        transit: from the frame to the later one.
        share: of the later frame, in [0, 1].
    """
    departures = transit.reverse.origins(smoke.positions)
    carried, near = sample_colours(*later, departures)
    return torch.lerp(colours, carried, share * near.clamp(0, 1))

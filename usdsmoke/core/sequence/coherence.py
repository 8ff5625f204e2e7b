r"""How one frame's result follows another's: carried by the smoke's velocity, averaged.

T carries a field from one frame to the next: T(F)(x) = F(departure point of x). A displacement is
carried component by component; a potential must not be, because the curl of a carried potential is
not the carried curl where the smoke turns (measured: 37 % off in a lively plume, each frame).

A sequence is aligned in one sweep forward, in which every frame starts from its
neighbour's carried result, and one backward, which averages a frame with the one that follows.
"""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.fields.sample import sample_linear
from usdsmoke.core.fields.transport import backtrace, choose_substeps
from usdsmoke.core.smoke.active import ActiveSmoke, coarsen, sample_colours
from usdsmoke.core.smoke.levels import bounded
from usdsmoke.core.smoke.memory import CHUNK_ROWS, chunks
from usdsmoke.core.smoke.noise import white_noise

FILL_LEVELS = 4  # halvings over which new smoke takes its neighbours' colour
NEAR = 1e-3  # trilinear weight of smoke from which there is smoke
MOST_TRACED = 2**14  # voxels that tell where a frame's smoke comes from


def departure_points(frame: VolumeFrame, positions: Tensor, seconds: float) -> Tensor:
    """Where the smoke at some points was a while ago, [N 3] float64, stage space.

    Mid-point steps back along the frame's own velocity, as many as a CFL number of 1 needs.

    Args:
        frame: without a velocity the points stay where they are.
        positions: [N 3] float64, stage space.
        seconds: how long ago; negative looks ahead.
    """
    return trace_back(frame, seconds, positions.device)(positions)


def trace_back(
    frame: VolumeFrame, seconds: float, device: torch.device
) -> Callable[[Tensor], Tensor]:
    """``departure_points`` for many sets of points on one device; the velocity is prepared once.

    Raises:
        NonFiniteError: the velocity holds NaN or infinity.
        PlanError: it is too fast for its unit to be right.
    """
    velocity = frame.velocity
    if velocity is None or velocity.is_empty or frame.velocity_to_stage is None:
        return lambda positions: positions
    index_to_stage = velocity.index_to_world @ np.asarray(frame.velocity_to_stage, float)
    forth, back = (
        torch.as_tensor(matrix, device=device)
        for matrix in (index_to_stage, np.linalg.inv(index_to_stage))
    )
    rates = _voxels_per_second(velocity, device)
    low = torch.tensor(velocity.ijk_min, dtype=torch.float64, device=device)
    n_substeps = choose_substeps(rates, seconds)

    def rate_at(place: Tensor) -> Tensor:
        return sample_linear(rates, place, boundary="nearest")

    def trace(positions: Tensor) -> Tensor:
        place = positions @ back[:3, :3] + back[3, :3] - low
        place = backtrace(rate_at, place, seconds, n_substeps)
        return (place + low) @ forth[:3, :3] + forth[3, :3]

    return trace


def _voxels_per_second(velocity: DenseField, device: torch.device) -> Tensor:
    """[I J K 3] float64 from grid world units per second; planar, because it is sampled often."""
    to_index = torch.as_tensor(np.linalg.inv(velocity.index_to_world[:3, :3]))
    given = torch.from_numpy(velocity.values).view(-1, 3)
    rates = torch.empty((3, len(given)), dtype=torch.float64, device=device)
    for part in chunks(len(given), CHUNK_ROWS, given.device):
        rates[:, part] = (given[part].double() @ to_index).T.to(device)
    return rates.view(3, *velocity.values.shape[:3]).movedim(0, -1)


def carry_displacement(
    before: Displacement, mover: VolumeFrame, lattice: Lattice, seconds: float
) -> Tensor:
    """A neighbouring frame's displacement on this frame's box, [I J K 3], along its axes.

    Args:
        before: the neighbour's.
        mover: the earlier of the two frames: its velocity carries smoke to the later one.
        lattice: of this frame.
        seconds: time since the neighbour; negative when it is later.
    """
    values = before.values
    trace, moved = trace_back(mover, seconds, values.device), before.planar()
    return lattice.on_voxels(lambda places: lattice.from_stage(moved.at(trace(places))), values)


def carry_colours(
    before: ActiveSmoke,
    colours: Tensor,
    mover: VolumeFrame,
    smoke: ActiveSmoke,
    seconds: float,
    seed: int,
) -> Tensor:
    """The neighbouring frame's colours at this frame's voxels, [N 3].

    Args:
        before, colours: the neighbour's smoke and its colours.
        mover: the earlier of the two frames: its velocity carries smoke to the later one.
        smoke: this frame's smoke.
        seconds: time between the two frames; negative when the neighbour is later.
        seed: see ``fill_colours``.
    """
    departures = departure_points(mover, smoke.positions, seconds)
    return fill_colours(before, colours, smoke, departures, seed)


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
    own: Displacement, later: Displacement, mover: VolumeFrame, seconds: float, share: float
) -> Displacement:
    """A frame's displacement, averaged with the following frame's carried back to it.

    Args:
        own, later: of the frame and of the one that follows.
        mover: the earlier of the two frames: its velocity carries smoke to the later one.
        seconds: until the later frame, > 0.
        share: of the later frame, in [0, 1].
    """
    carried = own.lattice.to_stage(carry_displacement(later, mover, own.lattice, -seconds))
    return Displacement(torch.lerp(own.values, carried, share), own.lattice)


def average_colours(
    smoke: ActiveSmoke,
    colours: Tensor,
    later: tuple[ActiveSmoke, Tensor],
    mover: VolumeFrame,
    seconds: float,
    share: float,
) -> Tensor:
    """A frame's colours [N 3], averaged with the following frame's carried back to it.

    Smoke that is gone in the later frame keeps its own.
    """
    departures = departure_points(mover, smoke.positions, -seconds)
    carried, near = sample_colours(*later, departures)
    return torch.lerp(colours, carried, share * near.clamp(0, 1))


def share_from(
    before: ActiveSmoke, smoke: ActiveSmoke, mover: VolumeFrame, seconds: float
) -> float:
    """The share of a frame's smoke that comes from smoke of the frame before, by mass.

    Args:
        before: the earlier frame's.
        smoke: the frame's; some thousand of its voxels are looked at.
        mover: the earlier of the two frames: its velocity carries smoke to the later one.
        seconds: between the two.
    """
    chosen = torch.zeros(len(smoke.ijk), dtype=torch.bool, device=smoke.ijk.device)
    chosen[:: max(1, len(smoke.ijk) // MOST_TRACED)] = True
    some = bounded(smoke).take(chosen)
    departures = departure_points(mover, some.positions, seconds)
    _, near = sample_colours(before, torch.ones_like(before.density)[:, None], departures)
    mass = some.density.double()
    return float(mass[near[:, 0] > NEAR].sum() / mass.sum())

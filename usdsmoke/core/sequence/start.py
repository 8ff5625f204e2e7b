"""What a frame takes from its neighbour's result and from the shot's coarse result, to start from.

Without both, ``frame_loop`` starts it from noise or from what a network paints.

The coarse result is made once for the whole shot and fixes what windows have in common: the places
of the style. The neighbour's result has the detail.
"""

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import torch
from torch import Tensor

from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.sequence.coherence import carry_colours, carry_displacement, fill_colours
from usdsmoke.core.sequence.steadiness import Clouds
from usdsmoke.core.sequence.transit import Transit
from usdsmoke.core.smoke.active import ActiveSmoke, sample_colours
from usdsmoke.core.smoke.memory import sums_of

# Share of the difference to the coarse result by which a carried result is corrected. More keeps
# windows closer together, less follows the smoke more smoothly; benchmarks/coherence.py.
PULL = 0.5

_Movable = TypeVar("_Movable", Tensor, ActiveSmoke, Displacement, "Carried", "CoarseStart")


@dataclass(frozen=True)
class Carried:
    """What the next frame starts from: a sequence continues with it as if it had not been cut."""

    time_code: float
    unclamped: Displacement | None = None  # the velocity, neither clamped nor averaged
    colours: Tensor | None = None  # display-encoded [N 3] of the painted voxels, not averaged
    # What displacements and colours of later frames are compared with; empty: nothing is.
    clouds: tuple[tuple[Clouds, ...], ...] = ()

    def to(self, device: torch.device) -> "Carried":
        """The same on a device."""
        clouds = tuple(tuple(one.to(device) for one in kind) for kind in self.clouds)
        unclamped, colours = on_device(self.unclamped, device), on_device(self.colours, device)
        return Carried(self.time_code, unclamped, colours, clouds)


@dataclass(frozen=True)
class CoarseStart:
    """One frame's result of the shared coarse step."""

    time_code: float
    factor: int  # of its voxels over the full resolution's
    displacement: Displacement | None = None  # the velocity, not clamped
    smoke: ActiveSmoke | None = None  # painted voxels
    colours: Tensor | None = None  # display-encoded [N 3]
    carried: Carried | None = None  # where the next frame starts from this one

    def to(self, device: torch.device) -> "CoarseStart":
        """The same on a device."""
        return replace(
            self,
            displacement=on_device(self.displacement, device),
            smoke=on_device(self.smoke, device),
            colours=on_device(self.colours, device),
            carried=on_device(self.carried, device),
        )

    def n_octaves(self, n: int) -> int:
        """How many of a step's n octaves were done in the coarse step."""
        return max(0, n - (self.factor.bit_length() - 1))


def on_device(values: _Movable | None, device: torch.device) -> _Movable | None:
    """The same on a device; None stays None."""
    return None if values is None else values.to(device)


def start_displacement(
    before: Displacement | None,
    coarse: CoarseStart | None,
    transit: Transit | None,
    limit: float,
    lattice: Lattice,
    near: Tensor,
) -> Tensor:
    """The velocity to start from, [I J K 3] along the lattice's axes, stage units.

    The neighbour's is carried no longer than it counts: what is beyond the limit would grow from
    frame to frame, turn more and more sharply, and fold space (decision 026).

    Args:
        before: the neighbour's.
        coarse: this frame's.
        transit: from the neighbour to this frame; None without one.
        limit: of a displacement's length, stage units.
        lattice: of this frame, at any octave.
        near: [I J K] bool, see ``carry_displacement``.
    """
    shared = coarse.displacement if coarse is not None else None
    if before is None or transit is None:
        if shared is None:
            return torch.zeros(*lattice.shape, 3, device=near.device)
        return shared.on(lattice)
    carried = carry_displacement(before, transit, lattice, near)
    carried *= limit / carried.norm(dim=-1, keepdim=True).clamp_min(limit)
    if shared is None:
        return carried
    in_stage = Displacement(lattice.to_stage(carried), lattice)
    missing = shared.values - _block_means(in_stage, shared.lattice)
    del in_stage
    return carried + PULL * Displacement(missing, shared.lattice).on(lattice)


def start_colours(
    before: tuple[ActiveSmoke, Tensor] | None,
    coarse: CoarseStart | None,
    transit: Transit | None,
    painted: ActiveSmoke,
    seed: int,
) -> Tensor | None:
    """The display-encoded colours to start from, [N 3] >= 0; None where there is nothing.

    The colour step cuts them off above.

    Args:
        before: the neighbour's painted smoke and its colours.
        coarse: this frame's.
        transit: the way of the smoke from the neighbour; None: there is no neighbour.
        painted: this frame's painted smoke.
        seed: of the noise for new smoke.
    """
    if len(painted.ijk) == 0:
        return None
    shared = None
    if coarse is not None and coarse.smoke is not None and coarse.colours is not None:
        shared = (coarse.smoke, coarse.colours) if len(coarse.smoke.ijk) else None
    if before is None or transit is None:
        if shared is None:
            return None
        return fill_colours(*shared, painted, painted.positions, seed)
    carried = carry_colours(*before, transit, painted, seed)
    if shared is None:
        return carried
    missing = _coarse_difference(*shared, painted, carried)
    return (carried + PULL * missing).clamp_min(0)


def _block_means(fine: Displacement, coarse: Lattice) -> Tensor:
    """Means over the coarse lattice's voxels, [i j k 3]; 0 beyond the fine box."""
    voxels = fine.lattice.on_voxels(partial(_voxel_of, coarse), fine.values)
    sums, counts = _bin(voxels.view(-1), fine.values.reshape(-1, 3), coarse.shape)
    return (sums / counts.clamp_min(1.0)).view(*coarse.shape, 3).to(fine.values)


def _coarse_difference(
    smoke: ActiveSmoke, colours: Tensor, painted: ActiveSmoke, carried: Tensor
) -> Tensor:
    """Coarse colours minus the block means of the carried ones, at the painted voxels [N 3]."""
    low = smoke.ijk.amin(0)
    shape = tuple(int(n) for n in smoke.ijk.amax(0) - low + 1)
    lattice = Lattice(low.cpu().numpy(), shape, smoke.index_to_stage)  # type: ignore[arg-type]
    voxels = _voxel_of(lattice, painted.positions)
    weighted = torch.cat([carried, torch.ones_like(carried[:, :1])], 1) * painted.density[:, None]
    sums, _ = _bin(voxels, weighted, lattice.shape)
    own = (smoke.ijk - low).T
    found = sums.view(*shape, 4)[tuple(own)]
    there = found[:, 3] > 0
    means = (found[:, :3] / found[:, 3:].clamp_min(1e-300)).to(colours)
    difference = torch.where(there[:, None], colours - means, torch.zeros_like(colours))
    return sample_colours(smoke, difference, painted.positions)[0]


def _voxel_of(lattice: Lattice, positions: Tensor) -> Tensor:
    """The number of the voxel, in C order, that each place [N 3] lies in; -1 outside, [N] int64."""
    places, shape = lattice.index_of(positions).round().long(), lattice.shape
    inside = ((places >= 0) & (places < torch.tensor(shape, device=places.device))).all(dim=1)
    flat = (places[:, 0] * shape[1] + places[:, 1]) * shape[2] + places[:, 2]
    return torch.where(inside, flat, -1)


def _bin(voxels: Tensor, values: Tensor, shape: tuple[int, ...]) -> tuple[Tensor, Tensor]:
    """Sums [V C] float64 and counts [V 1] of values [N C] by voxel; outside ones are dropped."""
    n_voxels, inside = math.prod(shape), voxels >= 0
    voxels = voxels[inside]
    sums = [sums_of(voxels, channel[inside].double(), n_voxels) for channel in values.T]
    counts = torch.bincount(voxels, minlength=n_voxels)
    return torch.stack(sums, 1), counts[:, None].double()

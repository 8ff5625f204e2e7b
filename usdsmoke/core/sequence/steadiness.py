r"""The temporal error of a sequence: the share of a pattern that does not move with its smoke.

Little clouds of 27 points are laid into a frame's smoke and carried along by the velocity. In a
later frame the mean of the pattern over each cloud, with binomial weights, is compared with the
mean over the same material points before:

    e^2 = sum w |a - b|^2 / sum w (|a - m|^2 + |b - m|^2),

a and b the means before and now, m the mean of both, w the smoke's density. A pattern that keeps
to its smoke gives 0, one that is drawn anew in every frame gives 1. Both sides are looked up alike,
between voxels, and blurred alike, by a voxel of the earlier frame, so that neither sharpness nor
blur counts as unsteadiness. What a frame loses by one exact trip to other voxels and back is the
floor f, and the error that is told is sqrt((e^2 - f^2) / (1 - f^2)), or 0 below the floor.

Frames are compared over 1, 4 and 8 steps, along the whole way: what boils has changed as much after
one step as after eight, what drifts, the longer the more.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor

from usdsmoke.core.sequence.coherence import NEAR
from usdsmoke.core.sequence.transit import Transit
from usdsmoke.core.smoke.active import ActiveSmoke, sample_colours
from usdsmoke.core.smoke.levels import bounded
from usdsmoke.core.smoke.memory import run_on
from usdsmoke.core.smoke.noise import white_noise

LAGS = (1, 4, 8)  # frames
N_CLOUDS = 1024  # of a frame: the error is known within 2 %
FLOOR_EVERY = 4  # clouds: one in so many tells the floor
LEAST_INSIDE = 0.5  # of a cloud's weight: with less in the smoke it does not count
SHIFT = 0.2113  # voxels, (1 - 1 / sqrt 3) / 2: a shift by so much blurs like the mean of all shifts
MOST_FLOOR = 0.5  # squared: noise of single voxels hardly survives a trip
LEAST_PATTERN = 1e-6  # of the values' square: what varies less is no pattern


@dataclass(frozen=True)
class Clouds:
    """Points of one frame's smoke on their way, with what the pattern was at their start."""

    positions: Tensor  # [M 27 3] float64, stage space; where they are now (a slab has 9 a cloud)
    values: Tensor  # [M 27 C]
    inside: Tensor  # [M 27] bool, in smoke at the start
    mass: Tensor  # [M]
    weights: Tensor  # [27]
    floor: float = 0.0  # squared
    age: int = 0  # steps

    def to(self, device: torch.device) -> "Clouds":
        """The same on a device."""
        return replace(
            self,
            positions=self.positions.to(device),
            values=self.values.to(device),
            inside=self.inside.to(device),
            mass=self.mass.to(device),
            weights=self.weights.to(device),
        )


class Steadiness:
    """The temporal error of one pattern, frame after frame.

    ``clouds`` is all that it keeps of the frames so far: another one with the same clouds goes on
    alike.

    Args:
        seed: of the points' places within their voxels.
        is_vector: True if the pattern's values are vectors of stage space, which turn and grow with
            their Volume.
    """

    def __init__(self, seed: int = 0, is_vector: bool = False) -> None:
        self._seed, self._is_vector = seed, is_vector
        self.clouds: tuple[Clouds, ...] = ()

    def restart(self) -> None:
        """Compare the next frame with none before it."""
        self.clouds = ()

    def compare(
        self, smoke: ActiveSmoke, values: Tensor, transit: Transit | None
    ) -> Mapping[int, float]:
        """The errors of the next frame against those before it, by the number of steps.

        Args:
            smoke: the frame's.
            values: the pattern at its voxels, [N C].
            transit: from the frame before; None at the start.

        Returns:
            those of ``LAGS`` that there are frames for, with some smoke in common.
        """
        if transit is None:
            self.restart()
        else:
            trace = transit.reverse.tracer(smoke.ijk.device)
            turn = transit.turn if self._is_vector else None
            carried = [partial(_carried, clouds, trace, turn) for clouds in self.clouds]
            self.clouds = tuple(run_on(smoke.ijk.device, carried))
        found = {}
        for clouds in self.clouds:
            if clouds.age in LAGS and (error := _error(clouds, smoke, values)) is not None:
                found[clouds.age] = error
        kept = (clouds for clouds in self.clouds if clouds.age < LAGS[-1])
        self.clouds = (*kept, _start(smoke, values, self._seed))
        return dict(sorted(found.items()))


def _start(smoke: ActiveSmoke, values: Tensor, seed: int) -> Clouds:
    """Clouds around some voxels, each at a random place in its voxel."""
    some = slice(None, None, max(1, len(smoke.ijk) // N_CLOUDS))
    ijk = smoke.ijk[some]
    offsets, weights = _stencil(smoke)
    jitter = white_noise(ijk, 3, seed).double() - 0.5
    index = ijk.double()[:, None] + jitter[:, None] + offsets
    near_values, inside = _look_up(smoke, values, index)
    mass = bounded(smoke).density[some].double()
    few = slice(None, None, FLOOR_EVERY)
    here = Clouds(_to_stage(smoke, index), near_values, inside, mass, weights)
    part = replace(here, values=near_values[few], inside=inside[few], mass=mass[few])
    return replace(here, floor=_floor(smoke, values, index[few], part))


def _carried(
    clouds: Clouds, trace: Callable[[Tensor], Tensor], turn: Callable[[Tensor], Tensor] | None
) -> Clouds:
    """The clouds a frame later, and their vectors as their Volume's motion leaves them."""
    moved = trace(clouds.positions.view(-1, 3)).view(clouds.positions.shape)
    values = clouds.values if turn is None else turn(clouds.values)
    return replace(clouds, positions=moved, values=values, age=clouds.age + 1)


def _error(clouds: Clouds, smoke: ActiveSmoke, values: Tensor) -> float | None:
    """The error above the floor; None where the frames have no smoke in common."""
    shape = clouds.positions.shape
    found, near = sample_colours(smoke, values, clouds.positions.view(-1, 3))
    there = (near[:, 0] > NEAR).view(shape[:2])
    squared = _squared_error(clouds, found.view(*shape[:2], -1), there)
    if squared is None:
        return None
    return (max(squared - clouds.floor, 0.0) / (1 - clouds.floor)) ** 0.5


def _floor(smoke: ActiveSmoke, values: Tensor, index: Tensor, clouds: Clouds) -> float:
    """The squared error of a frame against itself, brought to other voxels and back.

    Args:
        index: where the clouds are, [M n 3] index positions.
    """
    place = index.reshape(-1, 3) - SHIFT
    base = torch.floor(place)
    part = (place - base).to(values)
    corners = [[n >> 2 & 1, n >> 1 & 1, n & 1] for n in range(8)]
    offsets = torch.tensor(corners, device=place.device)[:, None]  # [8 1 3]
    weights = torch.where(offsets.bool(), part, 1 - part).prod(2, keepdim=True)
    found, inside = _look_up(smoke, values, base + offsets + SHIFT)  # at once: it lays out a box
    weights = weights * inside[..., None]
    total = weights.sum(0)
    back = (weights * found).sum(0)
    there = total.view(index.shape[:2]) > NEAR
    back = (back / total.clamp_min(NEAR)).view(*index.shape[:2], -1)
    return min(_squared_error(clouds, back, there) or 0.0, MOST_FLOOR)


def _squared_error(clouds: Clouds, now: Tensor, there: Tensor) -> float | None:
    """e^2 of the values now [M n C]; None where no cloud counts.

    Args:
        there: [M n] bool, what is in smoke.
    """
    weights = clouds.weights * (clouds.inside & there)
    total = weights.sum(1)
    counts = total > LEAST_INSIDE
    if not bool(counts.any()):
        return None
    shares = (weights / total.clamp_min(1e-12)[:, None])[counts]
    a, b = ((v[counts].double() * shares[..., None]).sum(1) for v in (clouds.values, now))
    weight = (clouds.mass[counts] / clouds.mass[counts].sum())[:, None]
    middle = (weight * (a + b)).sum(0) / 2
    pattern = float((weight * ((a - middle).square() + (b - middle).square())).sum())
    size = float((weight * (a.square() + b.square())).sum())
    changed = float((weight * (a - b).square()).sum())
    if size == 0:
        return 0.0
    return changed / (pattern if pattern > LEAST_PATTERN * size else size)


def _look_up(smoke: ActiveSmoke, values: Tensor, index: Tensor) -> tuple[Tensor, Tensor]:
    """Values [M n C] at index positions [M n 3], and where there is smoke [M n] bool."""
    found, near = sample_colours(smoke, values, _to_stage(smoke, index).reshape(-1, 3))
    return found.view(*index.shape[:2], -1), (near[:, 0] > NEAR).view(index.shape[:2])


def _stencil(smoke: ActiveSmoke) -> tuple[Tensor, Tensor]:
    """Offsets [n 3] in voxels, and their binomial weights [n], which add up to 1."""
    low, high = smoke.box
    device = smoke.ijk.device
    axes = [
        (torch.tensor([-1.0, 0.0, 1.0]), torch.tensor([0.25, 0.5, 0.25]))
        if b > a
        else (torch.tensor([0.0]), torch.tensor([1.0]))
        for a, b in zip(low, high, strict=True)
    ]
    places = torch.stack(torch.meshgrid(*[a for a, _ in axes], indexing="ij"), -1).view(-1, 3)
    shares = torch.stack(torch.meshgrid(*[w for _, w in axes], indexing="ij"), -1).view(-1, 3)
    return places.double().to(device), shares.prod(1).double().to(device)


def _to_stage(smoke: ActiveSmoke, index: Tensor) -> Tensor:
    matrix = torch.as_tensor(smoke.index_to_stage, dtype=torch.float64, device=index.device)
    return index @ matrix[:3, :3] + matrix[3, :3]

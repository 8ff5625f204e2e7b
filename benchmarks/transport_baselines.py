"""Transport schemes that the product does not use: baselines for ``benchmarks.transport_orders``.

They are here so that the tables of docs/numerics_transport.md can be made again: transport along a
velocity over many steps, MacCormack's correction with its limiter [Selle2008], back-traces of order
1 and 4, boxes that repeat or continue their border value, and velocities that change with time.
Decision 006 has the figures. The look-ups themselves are the product's.
"""

import itertools
from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor

from usdsmoke.core.fields.sample import sample_cubic, sample_linear, voxel_positions
from usdsmoke.core.fields.transport import choose_substeps

__all__ = ["Boundary", "Scheme", "Velocity", "advect", "cell_bounds", "trace", "warp"]

Scheme = Literal["linear", "maccormack", "cubic"]
Boundary = Literal["zero", "nearest", "periodic"]
Velocity = Tensor | Callable[[Tensor, float], Tensor]
Sampler = Callable[[Tensor, Tensor], Tensor]
PADDING = 30  # voxels that continue a box on every side: a spline sees no farther
INVERSE_STEPS = 5  # of the fixed point that inverts a displacement; more change nothing


def advect(
    values: Tensor,
    velocity: Velocity,
    dt: float,
    scheme: Scheme,
    *,
    order: int = 2,
    limiter: bool = True,
    boundary: Boundary = "zero",
    time: float = 0.0,
) -> Tensor:
    """``values`` [I J K] after the time dt along ``velocity``.

    Args:
        velocity: [I J K 3], index units per unit of time, in sub-steps of a CFL number of 1; or a
            function of (positions [N 3], time), in one step.
        scheme: "linear", "maccormack" or "cubic".
        order: of the back-trace, 1, 2 or 4.
        limiter: keep "maccormack" within the cell of each departure point, "cubic" within the range
            of the field.
        time: at the start of the step.
    """
    n_substeps = choose_substeps(velocity, dt) if isinstance(velocity, Tensor) else 1
    arrivals = voxel_positions(values.shape, values)
    departures = trace(velocity, arrivals, dt, order, n_substeps, time)

    def destinations() -> Tensor:
        return trace(velocity, arrivals, -dt, order, n_substeps, time + dt)

    return _transport(values, departures, destinations, scheme, limiter, boundary)


def warp(values: Tensor, displacement: Tensor, scheme: Scheme, limiter: bool = True) -> Tensor:
    """``values`` [I J K] moved by a displacement [I J K 3] in one step: f(x - u(x))."""
    arrivals, u = voxel_positions(values.shape, values), displacement.reshape(-1, 3)

    def destinations() -> Tensor:
        """Where the displacement takes each voxel: y = x + u(y), by fixed point."""
        inverse = arrivals + u
        for _ in range(INVERSE_STEPS):
            inverse = arrivals + sample_linear(displacement, inverse, boundary="nearest")
        return inverse

    return _transport(values, arrivals - u, destinations, scheme, limiter, "zero")


def trace(
    velocity: Velocity,
    positions: Tensor,
    dt: float,
    order: int = 2,
    n_substeps: int = 1,
    time: float = 0.0,
) -> Tensor:
    """Where what is at ``positions`` [N 3] at ``time + dt`` was at ``time``, by Runge-Kutta steps.

    Args:
        velocity: [I J K 3], or a function of (positions [N 3], time).
        order: 1 (Euler), 2 (mid-point) or 4 (classical).
    """

    def at(place: Tensor, now: float) -> Tensor:
        if isinstance(velocity, Tensor):
            return sample_linear(velocity, place, boundary="nearest")
        return velocity(place, now)

    h = dt / n_substeps
    for step in range(n_substeps):
        now = time + dt - step * h
        k1 = at(positions, now)
        if order == 1:
            positions = positions - h * k1
            continue
        k2 = at(positions - 0.5 * h * k1, now - 0.5 * h)
        if order == 2:
            positions = positions - h * k2
            continue
        k3 = at(positions - 0.5 * h * k2, now - 0.5 * h)
        k4 = at(positions - h * k3, now - h)
        positions = positions - h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return positions


def cell_bounds(values: Tensor, positions: Tensor, boundary: Boundary = "zero") -> list[Tensor]:
    """Smallest and largest corner of the cell that holds each position, [N] each."""
    low = positions.floor()
    flat = torch.tensor([n == 1 for n in values.shape[:3]])
    corners = [
        _sample(sample_linear, values, low + torch.tensor(offset).to(low) * ~flat, boundary)
        for offset in itertools.product((0, 1), repeat=3)
    ]
    return [torch.stack(corners).amin(0), torch.stack(corners).amax(0)]


def _transport(
    values: Tensor,
    departures: Tensor,
    destinations: Callable[[], Tensor],
    scheme: Scheme,
    limiter: bool,
    boundary: Boundary,
) -> Tensor:
    """The box of values at the departure points by the scheme."""
    if scheme == "cubic":
        moved = _sample(sample_cubic, values, departures, boundary)
        bounds = [values.amin().clamp(max=0), values.amax().clamp(min=0)]
    else:
        moved = _sample(sample_linear, values, departures, boundary)
        if scheme == "linear":
            return moved.reshape(values.shape)
        bounds = cell_bounds(values, departures, boundary)
        box, back = moved.reshape(values.shape), destinations()
        error = values.reshape(-1) - _sample(sample_linear, box, back, boundary)
        # a step back from outside the box knows nothing
        last = torch.tensor(values.shape[:3]) - 1
        inside = ((back >= 0) & (back <= last) | (last == 0)).all(1) | (boundary == "periodic")
        moved = moved + 0.5 * error * inside
    if limiter:
        moved = torch.minimum(torch.maximum(moved, bounds[0]), bounds[1])
    return moved.reshape(values.shape)


def _sample(sampler: Sampler, values: Tensor, positions: Tensor, boundary: Boundary) -> Tensor:
    """Look-ups in the box, which lies in zeros, is held beyond its border, or repeats."""
    if boundary == "zero":
        return sampler(values, positions)
    columns = list(positions.unbind(1))
    for axis, length in enumerate(values.shape[:3]):
        if length == 1:
            continue
        index = torch.arange(-PADDING, length + PADDING)
        if boundary == "periodic":
            index, place = index % length, torch.remainder(columns[axis], length)
        else:  # a spline sees the mirror image
            index = (length - 1) - ((index % (2 * (length - 1))) - (length - 1)).abs()
            place = columns[axis].clamp(0, length - 1)
        values, columns[axis] = values.index_select(axis, index), place + PADDING
    return sampler(values, torch.stack(columns, 1))

"""Transport problems with known answers: each gives the error of one run.

All run on the unit square or cube with n voxels a side, voxel m centred at (m + 1/2) / n; the plane
ones as boxes one voxel thick. Velocities come in closed form, so only the interpolation and the
back-trace err.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from benchmarks.transport_baselines import Scheme, advect, trace, warp
from usdsmoke.core.fields.sample import voxel_positions

__all__ = [
    "Outcome",
    "periodic_gaussian",
    "rotation_error",
    "single_vortex",
    "sphere_reversal",
    "swirl_warp",
    "window_and_back",
    "zalesak_disk",
]


@dataclass(frozen=True)
class Outcome:
    """How a transported field differs from the exact one."""

    l1: float  # mean absolute error
    lmax: float
    relative_l1: float  # sum of the absolute error / sum of the exact field
    mass: float  # relative mass error
    low: float
    high: float
    area: float  # relative error of the volume above 1/2


def _compare(found: Tensor, exact: Tensor) -> Outcome:
    error = (found - exact).abs()
    covered = (exact > 0.5).sum()
    return Outcome(
        float(error.mean()),
        float(error.max()),
        float(error.sum() / exact.sum()),
        float(found.sum() / exact.sum() - 1),
        float(found.min()),
        float(found.max()),
        float((found > 0.5).sum() / covered - 1) if covered else 0.0,
    )


def _centres(n: int, dim: int, dtype: torch.dtype) -> Tensor:
    """Unit coordinates of the voxel centres, [n n 1 3] or [n n n 3]; a flat axis lies at 1/2."""
    shape = (n, n, n if dim == 3 else 1)
    position = voxel_positions(shape, torch.empty(0, dtype=dtype)).reshape(*shape, 3)
    return (position + 0.5) / torch.tensor(shape, dtype=dtype)


def _gaussian(offset: Tensor, sigma: float) -> Tensor:
    return torch.exp(-offset.square().sum(dim=-1) / (2 * sigma**2))


def _in_voxels(unit_velocity: Callable[[Tensor, float], Tensor], n: int, dim: int) -> Callable:
    """A velocity on unit coordinates as one on index positions."""

    def velocity(position: Tensor, time: float) -> Tensor:
        moving = position[:, :dim]
        speed = unit_velocity((moving + 0.5) / n, time) * n
        return torch.cat([speed, torch.zeros_like(position[:, dim:])], dim=1)

    return velocity


def single_vortex(
    n: int,
    scheme: Scheme,
    limiter: bool,
    *,
    cfl: float = 1.0,
    order: int = 4,
    period: float = 2.0,
    dtype: torch.dtype = torch.float64,
) -> Outcome:
    """LeVeque's vortex winds a Gaussian up and, from half time on, back to where it was."""
    centres = _centres(n, 2, dtype)
    exact = _gaussian(centres[..., :2] - torch.tensor([0.5, 0.75], dtype=dtype), 0.06)

    def vortex(p: Tensor, time: float) -> Tensor:
        x, y = math.pi * p[:, 0], math.pi * p[:, 1]
        u, v = x.sin().square() * (2 * y).sin(), -y.sin().square() * (2 * x).sin()
        return torch.stack([u, v], dim=1) * math.cos(math.pi * time / period)

    n_steps = round(period * n / cfl)
    step = period / n_steps
    field = exact
    for number in range(n_steps):
        field = advect(
            field,
            _in_voxels(vortex, n, 2),
            step,
            scheme=scheme,
            order=order,
            limiter=limiter,
            boundary="nearest",
            time=number * step,
        )
    return _compare(field, exact)


def zalesak_disk(scheme: Scheme, limiter: bool, dtype: torch.dtype = torch.float64) -> Outcome:
    """A slotted disk after one rigid turn in 628 steps on 100 x 100 voxels."""
    position = _centres(100, 2, dtype)[..., :2] * 100
    x, y = position[..., 0] - 50, position[..., 1]
    disk = x.square() + (y - 75).square() < 15**2
    exact = (disk & ~((x.abs() < 2.5) & (y < 85))).to(dtype)
    rate = 2 * math.pi / 628

    def turn(p: Tensor, _: float) -> Tensor:
        return rate * torch.stack([0.5 - p[:, 1], p[:, 0] - 0.5], dim=1)

    field = exact
    for _ in range(628):
        velocity = _in_voxels(turn, 100, 2)
        field = advect(
            field, velocity, 1.0, scheme=scheme, order=4, limiter=limiter, boundary="nearest"
        )
    return _compare(field, exact)


def periodic_gaussian(n: int, scheme: Scheme, limiter: bool = False) -> Outcome:
    """A Gaussian carried by a uniform velocity through a periodic box at CFL 2.4, n / 4 steps."""
    centres = _centres(n, 2, torch.float64)[..., :2]
    speed = torch.tensor([0.61, 0.37], dtype=torch.float64)

    def shape_at(centre: Tensor) -> Tensor:
        away = centres - centre
        return _gaussian(away - away.round(), 0.1)

    field = shape_at(torch.full((2,), 0.5, dtype=torch.float64))
    n_steps = n // 4
    for _ in range(n_steps):
        field = advect(
            field,
            _in_voxels(lambda p, _: speed.expand_as(p), n, 2),
            1.0 / n_steps,
            scheme=scheme,
            order=1,
            limiter=limiter,
            boundary="periodic",
        )
    return _compare(field, shape_at(0.5 + speed))


def sphere_reversal(n: int, scheme: Scheme, limiter: bool = False, period: float = 0.5) -> Outcome:
    """Enright's deformation of a soft sphere in 3-D and back, at CFL 2."""
    exact = _gaussian(_centres(n, 3, torch.float64) - 0.35, 0.12)

    def deformation(p: Tensor, time: float) -> Tensor:
        once, twice = (math.pi * p).sin().square(), (2 * math.pi * p).sin()
        u = 2 * once[:, 0] * twice[:, 1] * twice[:, 2]
        v = -twice[:, 0] * once[:, 1] * twice[:, 2]
        w = -twice[:, 0] * twice[:, 1] * once[:, 2]
        return torch.stack([u, v, w], dim=1) * math.cos(math.pi * time / period)

    n_steps = round(period * n)
    step = period / n_steps
    field = exact
    for number in range(n_steps):
        field = advect(
            field,
            _in_voxels(deformation, n, 3),
            step,
            scheme=scheme,
            limiter=limiter,
            time=number * step,
        )
    return _compare(field, exact)


def rotation_error(order: int, n_steps: int) -> float:
    """Largest distance from the exact departure points of a rotation that slows down, voxels."""
    rate, start, length = 2.0, 0.3, 1.0
    centre = torch.tensor([10.0, 10.0, 0.0], dtype=torch.float64)
    arrivals = torch.tensor([[14, 10, 0], [10, 17, 0], [3, 5, 0]], dtype=torch.float64)

    def velocity(p: Tensor, time: float) -> Tensor:
        away = p - centre
        turned = torch.stack([-away[:, 1], away[:, 0], torch.zeros_like(p[:, 0])], dim=1)
        return rate * math.cos(time) * turned

    angle = -rate * (math.sin(start + length) - math.sin(start))
    cos, sin = math.cos(angle), math.sin(angle)
    turn = torch.tensor([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]], dtype=torch.float64)
    exact = centre + (arrivals - centre) @ turn
    found = trace(velocity, arrivals, length, order, n_steps, start)
    return float((found - exact).norm(dim=1).max())


def swirl_warp(n: int, scheme: Scheme, limiter: bool = False) -> Outcome:
    """A Gaussian warped once by a smooth displacement of up to 5 % of the box."""
    centres = _centres(n, 2, torch.float64)[..., :2]
    x, y = (math.pi * centres).unbind(dim=-1)
    u = torch.stack(
        [0.05 * (2 * y).sin() * x.sin().square(), 0.04 * (2 * x).cos() * y.sin().square()], dim=-1
    )
    middle = torch.tensor([0.5, 0.45], dtype=torch.float64)
    displacement = torch.cat([u * n, torch.zeros_like(u[..., :1])], dim=-1)
    source = _gaussian(centres - middle, 0.08)
    moved = warp(source, displacement, scheme, limiter)
    return _compare(moved, _gaussian(centres - u - middle, 0.08))


def window_and_back(n_frames: int, scheme: Scheme) -> Outcome:
    """A Gaussian carried through n_frames frames of a vortex, CFL 1.5, and back, in float32."""
    n = 96
    centres = _centres(n, 2, torch.float32)
    x, y = (math.pi * centres[..., :2]).unbind(dim=-1)
    swirl = torch.stack(
        [x.sin().square() * (2 * y).sin(), -y.sin().square() * (2 * x).sin(), torch.zeros_like(x)],
        dim=-1,
    )
    exact = _gaussian(centres[..., :2] - torch.tensor([0.5, 0.7]), 0.08)
    field = exact
    for direction in (1.0, -1.0):
        for _ in range(n_frames):
            field = advect(field, swirl, 1.5 * direction, scheme)
    return _compare(field, exact)

"""Following a velocity backwards or forwards in time: departure points of a transport step."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from usdsmoke.base.errors import NonFiniteError, PlanError, ShapeError
from usdsmoke.core.fields.sample import Boundary, sample_linear

__all__ = ["Velocity", "backtrace", "check_finite", "choose_substeps"]

Velocity = Tensor | Callable[[Tensor, float], Tensor]


def choose_substeps(velocity: Tensor, dt: float, cfl: float = 1.0, limit: int = 1000) -> int:
    """Back-trace sub-steps in which nothing moves further than ``cfl`` voxels along an axis.

    Args:
        velocity: [I J K 3] or [N 3], index units per unit of time.
        dt: the step, any sign.
        cfl: largest CFL number of one sub-step, > 0.
        limit: more sub-steps than this are refused: the unit of such a velocity is wrong.

    Raises:
        NonFiniteError: the velocity or dt holds NaN or infinity.
        PlanError: ``limit`` sub-steps do not suffice.
    """
    check_finite(velocity, "velocity")
    if not (math.isfinite(dt) and math.isfinite(cfl) and cfl > 0):
        raise NonFiniteError(
            f"cannot choose sub-steps for dt = {dt} and cfl = {cfl}; "
            "wanted finite numbers, cfl above 0"
        )
    fastest = max(map(abs, map(float, velocity.detach().aminmax()))) if velocity.numel() else 0.0
    needed = fastest * abs(dt) / cfl
    if needed > limit:
        raise PlanError(
            f"the velocity crosses {fastest * abs(dt):.4g} voxels in one step of {dt:.4g}; that "
            f"needs {needed:.4g} sub-steps at a CFL number of {cfl:g}, wanted at most {limit}: "
            "check the velocity's unit (per second or per frame) and its grid's voxel size"
        )
    return max(1, math.ceil(needed - 1e-9))


def backtrace(
    velocity: Velocity,
    positions_ijk: Tensor,
    dt: float,
    order: int = 2,
    n_substeps: int = 1,
    time: float = 0.0,
    boundary: Boundary = "nearest",
) -> Tensor:
    """Where what is at ``positions_ijk`` at ``time + dt`` was at ``time``, [N 3], index units.

    Runge-Kutta steps of order 1 (Euler), 2 (mid-point) or 4 (classical) backwards in time; a
    negative dt traces forwards, from ``time + dt`` on to ``time``.

    Args:
        velocity: [I J K 3] in index units per unit of time, constant during dt and sampled
            trilinearly; or a function of (positions [N 3], time) that gives [N 3].
        positions_ijk: [N 3], index units.
        dt: the step, unit of time.
        order: 1, 2 or 4.
        n_substeps: equal parts into which dt is cut, see ``choose_substeps``.
        time: the time at the departure points; only a function of time sees it.
        boundary: how a dense velocity continues outside its box.

    Raises:
        NonFiniteError: the velocity holds NaN or infinity (with how many).
        ShapeError: the order or the velocity's shape is not as above.

    Gradients: through a dense velocity and the positions.
    """
    if order not in (1, 2, 4):
        raise ShapeError(f"cannot trace back with order {order}; wanted 1, 2 or 4")
    if n_substeps < 1:
        raise ShapeError(f"cannot trace back in {n_substeps} sub-steps; wanted at least 1")
    velocity_at = _velocity_function(velocity, boundary)
    h = dt / n_substeps
    positions = positions_ijk
    for step in range(n_substeps):
        now = time + dt - step * h
        k1 = velocity_at(positions, now)
        if order == 1:
            positions = positions - h * k1
            continue
        k2 = velocity_at(positions - 0.5 * h * k1, now - 0.5 * h)
        if order == 2:
            positions = positions - h * k2
            continue
        k3 = velocity_at(positions - 0.5 * h * k2, now - 0.5 * h)
        k4 = velocity_at(positions - h * k3, now - h)
        positions = positions - h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return positions


def check_finite(tensor: Tensor, name: str) -> None:
    """Raises NonFiniteError, with how many, if ``tensor`` holds NaN or infinity.

    Args:
        tensor: any shape.
        name: what the message calls it.
    """
    # A sum is four times cheaper than a test of every element, and NaN and infinity survive it.
    if tensor.numel() and not torch.isfinite(tensor.detach().sum()):
        n_bad = int((~torch.isfinite(tensor)).sum())
        if n_bad:
            raise NonFiniteError(
                f"{n_bad} of {tensor.numel()} numbers of the {name} given to transport are NaN or "
                "infinite; wanted finite numbers: repair the grid or leave the field out"
            )


def _velocity_function(velocity: Velocity, boundary: Boundary) -> Callable[[Tensor, float], Tensor]:
    if not isinstance(velocity, Tensor):
        return velocity
    if velocity.ndim != 4 or velocity.shape[3] != 3:
        raise ShapeError(f"the velocity has shape {list(velocity.shape)}; wanted [I J K 3]")
    check_finite(velocity, "velocity")
    return lambda positions, _: sample_linear(velocity, positions, boundary=boundary)

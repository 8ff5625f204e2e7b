r"""Transport of a dense field along a velocity or by a displacement, semi-Lagrangian.

Every voxel x of the result is traced back to its departure point and takes its value from there:
T(f)(x) = f(departure(x)). Velocities and displacements are in *index units* (voxels of the field,
per unit of time), so that anisotropic and rotated grids are the caller's one matrix product.

============ ==================================================================================
"linear"     one trilinear look-up; first order over many steps, keeps the range, blurs
"maccormack" adds half of what a step back fails to restore [Selle2008]; second order; first
             order where that step comes from outside the box
"cubic"      one cubic B-spline look-up; third order over many steps, costs a prefilter
============ ==================================================================================

With ``limiter`` no new extremes appear, at some cost at peaks: "maccormack" stays between the
smallest and the largest voxel of the cell in which *each departure point* lies, "cubic" between
those of the whole field (cell by cell it would lose half of its accuracy).
"""

import math
from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor

from usdsmoke.base.errors import ShapeError
from usdsmoke.core.fields.sample import (
    BOUNDARIES,
    Boundary,
    sample_bounds,
    sample_cubic,
    sample_linear,
    voxel_positions,
)
from usdsmoke.core.fields.trace import Velocity, backtrace, check_finite, choose_substeps

__all__ = ["SCHEMES", "Scheme", "advect", "correct_mass", "warp"]

Scheme = Literal["linear", "maccormack", "cubic"]
SCHEMES: tuple[Scheme, ...] = ("linear", "maccormack", "cubic")
_INVERSE_STEPS = 5  # of the fixed point that inverts a displacement; more change nothing


def advect(
    values: Tensor,
    velocity: Velocity,
    dt: float,
    *,
    active_ijk: Tensor | None = None,
    scheme: Scheme = "maccormack",
    order: int = 2,
    n_substeps: int | None = None,
    limiter: bool = True,
    boundary: Boundary = "zero",
    outside: float = 0.0,
    time: float = 0.0,
) -> Tensor:
    """``values`` after the time dt along ``velocity``, in their unit.

    Args:
        values: [I J K] or [I J K C].
        velocity: [I J K 3], index units per unit of time; or a function, see ``backtrace``.
        dt: the step; negative goes back in time.
        active_ijk: [N 3] integer voxels of the box at which the result is wanted; None means all.
            Give all that the result can reach: "maccormack" takes it as ``outside`` elsewhere.
        scheme: one of SCHEMES.
        order: of the back-trace, 1, 2 or 4.
        n_substeps: of the back-trace; None chooses them for a CFL number of 1 (a function: 1).
        limiter: hold the results of "maccormack" and "cubic" in range, see the module.
        boundary: of ``values``, see ``core.sample``; "periodic" holds for the velocity too.
        outside: the value around the box.
        time: at the start of the step; only a velocity that is a function sees it.

    Returns:
        the box, same shape as ``values``; or [N] or [N C] at ``active_ijk``.

    Raises:
        NonFiniteError: values or velocity hold NaN or infinity.
        PlanError: the velocity needs too many sub-steps.
        ShapeError: shapes or options are not as above.

    Gradients: through ``values`` and a dense velocity.
    """
    if isinstance(velocity, Tensor) and velocity.shape != (*values.shape[:3], 3):
        raise ShapeError(
            f"the velocity has shape {list(velocity.shape)} and the values {list(values.shape)}; "
            "wanted [I J K 3] on the voxels of the values: resample the velocity first"
        )
    if n_substeps is None:
        n_substeps = choose_substeps(velocity, dt) if isinstance(velocity, Tensor) else 1
    edge: Boundary = "periodic" if boundary == "periodic" else "nearest"
    arrivals = _arrivals(values, active_ijk)

    def departures() -> Tensor:
        return backtrace(velocity, arrivals, dt, order, n_substeps, time, edge)

    def destinations() -> Tensor:
        return backtrace(velocity, arrivals, -dt, order, n_substeps, time + dt, edge)

    moved = _transport(
        values, departures(), destinations, active_ijk, scheme, limiter, boundary, outside
    )
    return moved.reshape(values.shape) if active_ijk is None else moved


def warp(
    values: Tensor,
    displacement: Tensor,
    *,
    active_ijk: Tensor | None = None,
    scheme: Scheme = "linear",
    limiter: bool = True,
    boundary: Boundary = "zero",
    outside: float = 0.0,
) -> Tensor:
    """``values`` moved by a displacement in one step: T(f)(x) = f(x - u(x)), in their unit.

    Args:
        values: [I J K] or [I J K C].
        displacement: u, [I J K 3], index units; [N 3] at ``active_ijk`` where that is given and the
            scheme is not "maccormack", which must invert it and needs the whole box.
        active_ijk, scheme, limiter, boundary, outside: as for ``advect``.

    Returns:
        the box, same shape as ``values``; or [N] or [N C] at ``active_ijk``.

    Raises:
        NonFiniteError: values or displacement hold NaN or infinity.
        ShapeError: shapes or options are not as above.

    Gradients: through ``values`` and ``displacement``.
    """
    check_finite(displacement, "displacement")
    arrivals = _arrivals(values, active_ijk)
    at_arrivals = _displacement_at(displacement, values, active_ijk, scheme)

    def destinations() -> Tensor:
        return _invert_displacement(displacement, arrivals, at_arrivals, boundary)

    departures = arrivals - at_arrivals
    if scheme != "maccormack":  # which alone looks where things go
        del arrivals
    moved = _transport(
        values, departures, destinations, active_ijk, scheme, limiter, boundary, outside
    )
    return moved.reshape(values.shape) if active_ijk is None else moved


def correct_mass(moved: Tensor, source: Tensor) -> tuple[Tensor, float]:
    """``moved`` scaled to the sum of ``source``, and the relative mass error it had before.

    Semi-Lagrangian transport does not conserve mass where the flow converges or the look-up blurs.
    The scale cannot tell that loss from smoke that left the box: not for smoke that may leave.

    Args:
        moved: any shape, what transport gave.
        source: what it was given; same voxel size.

    Returns:
        (corrected, (sum moved - sum source) / sum source). Where the sums do not have the same
        sign, or one is 0, nothing can be scaled: ``moved`` comes back as it is, with its error (0
        if both are 0, infinite if only the source's is).

    Gradients: through both tensors into the corrected one; the error is a plain number.
    """
    wanted, found = source.double().sum(), moved.double().sum()
    if wanted.item() == 0.0:
        return moved, 0.0 if found.item() == 0.0 else math.inf
    error = ((found - wanted) / wanted).item()
    if error <= -1.0:
        return moved, error
    return moved * (wanted / found).to(moved.dtype), error


def _transport(
    values: Tensor,
    departures: Tensor,
    destinations: Callable[[], Tensor],
    active_ijk: Tensor | None,
    scheme: Scheme,
    limiter: bool,
    boundary: Boundary,
    outside: float,
) -> Tensor:
    """Values at the departure points by the scheme, [N] or [N C]."""
    _check_options(scheme, boundary)
    check_finite(values, "values")
    if scheme == "linear":
        return sample_linear(values, departures, outside, boundary)
    if scheme == "cubic":
        moved = sample_cubic(values, departures, outside, boundary)
    else:
        first = sample_linear(values, departures, outside, boundary)
        box, where = _fill_box(first, values, active_ijk, outside), destinations()
        error = _take_active(values, active_ijk) - sample_linear(box, where, outside, boundary)
        known = _inside(where, values, boundary).to(values.dtype)
        moved = first + 0.5 * error * (known if error.ndim == 1 else known[:, None])
    if not limiter:
        return moved
    if scheme == "cubic":
        low, high = _range(values, boundary, outside)
    else:
        low, high = sample_bounds(values, departures, outside, boundary)
    return torch.minimum(torch.maximum(moved, low), high)


def _range(values: Tensor, boundary: Boundary, outside: float) -> tuple[Tensor, Tensor]:
    """Smallest and largest value of each channel, with the background where it can be seen."""
    low, high = values.amin(dim=(0, 1, 2)), values.amax(dim=(0, 1, 2))
    if boundary == "zero":
        low, high = low.clamp(max=outside), high.clamp(min=outside)
    return low, high


def _inside(positions: Tensor, values: Tensor, boundary: Boundary) -> Tensor:
    """Whether a look-up at the positions reads nothing from outside the box, [N] bool."""
    if boundary == "periodic":
        return torch.ones_like(positions[:, 0], dtype=torch.bool)
    last = torch.tensor(values.shape[:3], device=positions.device) - 1
    return ((positions >= 0) & (positions <= last) | (last == 0)).all(dim=1)


def _arrivals(values: Tensor, active_ijk: Tensor | None) -> Tensor:
    if active_ijk is None:
        return voxel_positions(values.shape, values)
    lengths = torch.tensor(values.shape[:3], device=active_ijk.device)
    if active_ijk.ndim != 2 or active_ijk.shape[1] != 3 or active_ijk.is_floating_point():
        raise ShapeError(
            f"active voxels are {active_ijk.dtype} of shape {list(active_ijk.shape)}; "
            "wanted integers of shape [N 3]"
        )
    n_outside = int(((active_ijk < 0) | (active_ijk >= lengths)).any(dim=1).sum())
    if n_outside:
        raise ShapeError(
            f"{n_outside} of {len(active_ijk)} active voxels lie outside the box of "
            f"{list(values.shape[:3])} voxels; wanted indices from 0: pad the box first"
        )
    return active_ijk.to(values.dtype)


def _fill_box(
    at_active: Tensor, values: Tensor, active_ijk: Tensor | None, outside: float
) -> Tensor:
    """A box like ``values`` with ``at_active`` at the active voxels and ``outside`` elsewhere."""
    if active_ijk is None:
        return at_active.reshape(values.shape)
    return torch.full_like(values, outside).index_put(tuple(active_ijk.T), at_active)


def _take_active(values: Tensor, active_ijk: Tensor | None) -> Tensor:
    if active_ijk is None:
        return values.reshape(-1, *values.shape[3:])
    return values[tuple(active_ijk.T)]


def _displacement_at(
    displacement: Tensor, values: Tensor, active_ijk: Tensor | None, scheme: Scheme
) -> Tensor:
    """The displacement at the arrival voxels, [N 3]."""
    if displacement.shape == (*values.shape[:3], 3):
        return _take_active(displacement, active_ijk)
    if active_ijk is not None and displacement.shape == active_ijk.shape and scheme != "maccormack":
        return displacement
    raise ShapeError(
        f"the displacement has shape {list(displacement.shape)}; wanted "
        f"{[*values.shape[:3], 3]} for values of shape {list(values.shape)}, or one row for each "
        "active voxel with a scheme other than maccormack"
    )


def _invert_displacement(
    displacement: Tensor, arrivals: Tensor, at_arrivals: Tensor, boundary: Boundary
) -> Tensor:
    """Where the displacement takes what was at ``arrivals``: y = x + u(y), by fixed point."""
    edge: Boundary = "periodic" if boundary == "periodic" else "nearest"
    inverse = arrivals + at_arrivals
    for _ in range(_INVERSE_STEPS):
        inverse = arrivals + sample_linear(displacement, inverse, boundary=edge)
    return inverse


def _check_options(scheme: str, boundary: str) -> None:
    for name, found, known in (("scheme", scheme, SCHEMES), ("boundary", boundary, BOUNDARIES)):
        if found not in known:
            raise ShapeError(
                f"unknown transport {name} {found!r}; wanted one of {', '.join(known)}"
            )

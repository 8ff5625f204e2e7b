r"""Transport of a dense field by a displacement, and the back-trace along a velocity.

Semi-Lagrangian: every voxel x of the result takes its value from its departure point,
T(f)(x) = f(x - u(x)). Velocities and displacements are in *index units* (voxels of the field, per
unit of time), so anisotropic and rotated grids cost the caller one matrix product.

======== ========================================================================================
"linear" one trilinear look-up; second order for a single warp, keeps the range, blurs
"cubic"  one cubic B-spline look-up; fourth order for a single warp, costs a prefilter; clamped to
         the range of the whole field, and inside smoke to between half the least and twice the
         largest of the eight voxels around the place (their range itself would cost half of the
         accuracy): beside a core a hundred times denser the spline rings by more than the smoke
         there, and would empty it. It is at least a tenth of the linear look-up, also where one of
         the eight is empty
======== ========================================================================================

Schemes that were measured and not taken are in ``benchmarks/transport_baselines.py``; see decision
006.
"""

import math
from collections.abc import Callable, Sequence
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.base.errors import NonFiniteError, PlanError, ShapeError
from usdsmoke.core.fields.sample import sample_cubic, sample_linear, voxel_positions

Scheme = Literal["linear", "cubic"]
RINGING = 2.0  # factor by which a spline may leave the range of the voxels around a place
FADING = 10.0  # factor by which it may be below a linear look-up
MOST_SUBSTEPS = 1000
_ROUND_OFF = 1e-9  # of the mass that is missing
SCHEMES: tuple[Scheme, ...] = ("linear", "cubic")
Velocity = Tensor | Callable[[Tensor], Tensor]


def warp(
    values: Tensor,
    displacement: Tensor,
    *,
    active_ijk: Tensor | None = None,
    scheme: Scheme = "linear",
) -> Tensor:
    """``values`` moved by a displacement in one step: T(f)(x) = f(x - u(x)), in their unit.

    The box is surrounded by zeros: smoke that leaves it is lost.

    Args:
        values: [I J K] or [I J K C].
        displacement: u, [I J K 3], index units; or [N 3] at ``active_ijk``.
        active_ijk: [N 3] integer voxels of the box at which the result is computed; None means all.
        scheme: one of SCHEMES.

    Returns:
        the box, same shape as ``values``; or [N] or [N C] at ``active_ijk``.

    Raises:
        NonFiniteError: values or displacement hold NaN or infinity.
        ShapeError: shapes or the scheme are not as above.

    Gradients: through ``values`` and ``displacement``.
    """
    if scheme not in SCHEMES:
        raise ShapeError(f"unknown transport scheme {scheme!r}. Use one of {', '.join(SCHEMES)}.")
    check_finite(displacement, "displacement")
    arrivals = _arrivals(values, active_ijk)
    departures = arrivals - _displacement_at(displacement, values, active_ijk)
    del arrivals  # as large as all that follows
    check_finite(values, "values")
    if scheme == "linear":
        moved = sample_linear(values, departures)
    else:
        low, high = values.amin(dim=(0, 1, 2)), values.amax(dim=(0, 1, 2))
        moved = sample_cubic(values, departures)
        moved = torch.minimum(torch.maximum(moved, low.clamp(max=0.0)), high.clamp(min=0.0))
        if bool((low >= 0).all()):
            least, most = _cell_range(values, departures)
            bounded = torch.minimum(torch.maximum(moved, least / RINGING), most * RINGING)
            moved = torch.where(least > 0, bounded, moved)
            # the linear look-up, which is at most ``most``, is only needed where it may be larger
            faint = (moved < most / FADING).reshape(len(moved), -1).any(1).nonzero()[:, 0]
            kept = sample_linear(values, departures[faint]) / FADING
            moved = moved.index_copy(0, faint, torch.maximum(moved[faint], kept))
    return moved.reshape(values.shape) if active_ijk is None else moved


def _cell_range(values: Tensor, positions: Tensor) -> tuple[Tensor, Tensor]:
    """The least and the largest of the eight voxels around each position [N 3], [N] or [N C] each.

    The box is surrounded by zeros. An axis with one voxel has the same values everywhere.

    Args:
        values: [I J K] or [I J K C].
    """
    box = values.detach().reshape(*values.shape[:3], -1).permute(3, 0, 1, 2)
    lengths = torch.tensor(values.shape[:3], device=values.device)
    margins = [0 if n == 1 else 1 for n in values.shape[:3]]
    around = [margin for margin in reversed(margins) for _ in range(2)]
    box = F.pad(box, around)
    # the cell between voxels n and n + 1 is number n + 1 of those of the padded box
    cell = torch.floor(positions.detach()).long() + 1
    cell = torch.minimum(cell.clamp(min=0), lengths).masked_fill(lengths == 1, 0)
    shape = [n + margin for n, margin in zip(values.shape[:3], margins, strict=True)]
    rows = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    found = (
        _of_pairs(pick, box, margins).reshape(len(box), -1)[:, rows].T
        .reshape(len(rows), *values.shape[3:])
        for pick in (torch.minimum, torch.maximum)
    )  # fmt: skip
    return next(found), next(found)


def _of_pairs(
    pick: Callable[[Tensor, Tensor], Tensor], box: Tensor, margins: Sequence[int]
) -> Tensor:
    """The smallest or largest of neighbours along each axis with a margin, [C I J K]."""
    for axis, margin in enumerate(margins, start=1):
        if margin:
            n = box.shape[axis] - 1
            box = pick(box.narrow(axis, 0, n), box.narrow(axis, 1, n))
    return box


def correct_mass(
    moved: Tensor, source: Tensor, linear: Tensor | None = None
) -> tuple[Tensor, float]:
    """``moved`` with the sum of ``source``, and the relative mass error it had before.

    Semi-Lagrangian transport does not conserve mass where the flow converges or the look-up blurs.
    What is missing cannot be distinguished from smoke that left the box: use it only if none can
    leave.

    Mass is missing where a look-up is uncertain, at a dense core for instance, and one factor would
    take it from all other smoke. So values go towards ``linear`` where that lies on the right side,
    by the share min(1, k |linear - moved|) of the way, with the k that suits [Bermejo2002]; the
    bound of 1 is ours, and keeps values between both look-ups. Without ``linear``, and for what
    that leaves, all values are scaled by one factor.

    Args:
        moved: any shape, the result of transport.
        source: its input; same voxel size.
        linear: the result of the linear scheme, shape of ``moved``.

    Returns:
        (corrected, (sum moved - sum source) / sum source). If the sums do not have the same sign,
        or one is 0, nothing can be corrected: ``moved`` is returned unchanged, with its error (0 if
        both are 0, infinite if only the source's is).

    Gradients: through the tensors into the corrected one, at the k that was found; the error is a
    plain number.
    """
    target, found = source.double().sum(), moved.double().sum()
    if target.item() == 0.0:
        return moved, 0.0 if found.item() == 0.0 else math.inf
    error = ((found - target) / target).item()
    if error <= -1.0:
        return moved, error
    if linear is not None and error != 0.0:
        moved = _towards(linear, moved, (target - found).item())
        found = moved.double().sum()
    return moved * (target / found).to(moved.dtype), error


def _towards(linear: Tensor, moved: Tensor, missing: float) -> Tensor:
    """``moved`` with what is missing, as far as ``linear`` has it."""
    sign = math.copysign(1.0, missing)
    way = ((linear - moved) * sign).clamp_min(0.0)
    longest = float(way.max())
    if longest == 0:
        return moved
    lengths = way.detach()[way.detach() > 0].double() / longest
    share = _even_share(lengths, abs(missing) / longest)
    return moved + sign * way * (way * (share / longest)).clamp(max=1.0)


def _even_share(lengths: Tensor, wanted: float) -> float:
    """The k for which the sum of x min(1, k x) over ``lengths`` [N] is ``wanted``.

    The largest of them is 1. That k which makes all of them whole where their sum is too little.
    Newton's method stays below the answer, because the sum is concave in k.
    """
    k, most = 0.0, 1 / float(lengths.min())
    while k < most:
        is_whole = lengths * k >= 1
        slope = float(lengths[~is_whole].square().sum())
        rest = wanted - float(lengths[is_whole].sum()) - k * slope
        if slope == 0 or rest <= _ROUND_OFF * wanted:
            return k
        k += rest / slope
    return most


def choose_substeps(velocity: Tensor, dt: float, cfl: float = 1.0) -> int:
    """Back-trace sub-steps in which nothing moves further than ``cfl`` voxels along an axis.

    Args:
        velocity: [I J K 3] or [N 3], index units per unit of time.
        dt: the step, any sign.
        cfl: largest CFL number of one sub-step, > 0.

    Raises:
        NonFiniteError: the velocity or dt holds NaN or infinity.
        PlanError: ``MOST_SUBSTEPS`` do not suffice: the unit of such a velocity is wrong.
    """
    check_finite(velocity, "velocity")
    if not (math.isfinite(dt) and math.isfinite(cfl) and cfl > 0):
        raise NonFiniteError(
            f"cannot choose sub-steps for dt = {dt} and cfl = {cfl}. "
            "Pass finite numbers, cfl above 0."
        )
    fastest = max(map(abs, map(float, velocity.detach().aminmax()))) if velocity.numel() else 0.0
    needed = fastest * abs(dt) / cfl
    if needed > MOST_SUBSTEPS:
        raise PlanError(
            f"the velocity crosses {fastest * abs(dt):.4g} voxels in one step of {dt:.4g}; that "
            f"needs {needed:.4g} sub-steps at a CFL number of {cfl:g}, more than {MOST_SUBSTEPS}. "
            "Check the velocity's unit (per second or per frame) and its grid's voxel size."
        )
    return max(1, math.ceil(needed - 1e-9))


def backtrace(velocity: Velocity, positions_ijk: Tensor, dt: float, n_substeps: int = 1) -> Tensor:
    """Where what is at ``positions_ijk`` was the time dt before, [N 3], index units.

    Mid-point steps (Runge-Kutta of order 2) backwards in time; a negative dt traces forwards.

    Args:
        velocity: [I J K 3] in index units per unit of time, sampled trilinearly, its border value
            continued outwards; or a function of positions [N 3] that gives [N 3].
        positions_ijk: [N 3], index units.
        dt: the step, unit of time.
        n_substeps: equal parts into which dt is cut, see ``choose_substeps``.

    Raises:
        NonFiniteError: the velocity holds NaN or infinity (with how many).
        ShapeError: the velocity's shape or the number of sub-steps is not as above.

    Gradients: through a dense velocity and the positions.
    """
    if n_substeps < 1:
        raise ShapeError(f"cannot trace back in {n_substeps} sub-steps. Pass at least 1.")
    velocity_at = _velocity_function(velocity)
    h = dt / n_substeps
    positions = positions_ijk
    for _ in range(n_substeps):
        halfway = positions - 0.5 * h * velocity_at(positions)
        positions = positions - h * velocity_at(halfway)
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
                "infinite. Repair the grid or leave the field out."
            )


def _velocity_function(velocity: Velocity) -> Callable[[Tensor], Tensor]:
    if not isinstance(velocity, Tensor):
        return velocity
    if velocity.ndim != 4 or velocity.shape[3] != 3:
        raise ShapeError(f"the velocity has shape {list(velocity.shape)}. Pass [I J K 3].")
    check_finite(velocity, "velocity")
    return lambda positions: sample_linear(velocity, positions, boundary="nearest")


def _arrivals(values: Tensor, active_ijk: Tensor | None) -> Tensor:
    if active_ijk is None:
        return voxel_positions(values.shape, values)
    lengths = torch.tensor(values.shape[:3], device=active_ijk.device)
    if active_ijk.ndim != 2 or active_ijk.shape[1] != 3 or active_ijk.is_floating_point():
        raise ShapeError(
            f"active voxels are {active_ijk.dtype} of shape {list(active_ijk.shape)}. "
            "Pass integers of shape [N 3]."
        )
    n_outside = int(((active_ijk < 0) | (active_ijk >= lengths)).any(dim=1).sum())
    if n_outside:
        raise ShapeError(
            f"{n_outside} of {len(active_ijk)} active voxels lie outside the box of "
            f"{list(values.shape[:3])} voxels. Pad the box first."
        )
    return active_ijk.to(values.dtype)


def _displacement_at(displacement: Tensor, values: Tensor, active_ijk: Tensor | None) -> Tensor:
    """The displacement at the arrival voxels, [N 3]."""
    if displacement.shape == (*values.shape[:3], 3):
        return (
            displacement.reshape(-1, 3) if active_ijk is None else displacement[tuple(active_ijk.T)]
        )
    if active_ijk is not None and displacement.shape == active_ijk.shape:
        return displacement
    raise ShapeError(
        f"the displacement has shape {list(displacement.shape)}. Pass "
        f"{[*values.shape[:3], 3]} for values of shape {list(values.shape)}, or one row for each "
        "active voxel."
    )

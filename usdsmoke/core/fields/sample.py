r"""Interpolation of dense fields at fractional index positions, and its exact adjoint.

A field is ``values``, [I J K] or [I J K C]; a position is a row (i, j, k) in which voxel
``values[0, 0, 0]`` is centred on (0, 0, 0). Only the voxels around the given positions are read. An
axis of length 1 is taken as constant, so a one-voxel-thick box is a 2-D field and costs what a 2-D
field costs.

What lies outside the box is said by ``boundary``:

=========== ===================================================================================
"zero"      the box is embedded in the constant ``outside``: what leaves the box is gone and
            nothing is smeared in from its border
"nearest"   the border value continues outwards
"periodic"  the box repeats
=========== ===================================================================================

torch's ``grid_sample`` is not used: it wants positions scaled to [-1, 1], which moves whole-voxel
positions by round-off, walks a point list on one thread, and has no cubic mode for volumes. Here
every corner is one gather from a shifted view of the same flat array, and a position on a voxel
gives that voxel's value back bit for bit ("linear").
"""

from functools import reduce

import torch
from torch import Tensor

from usdsmoke.base.errors import NonFiniteError, ShapeError
from usdsmoke.core.fields.gather import iterate_cells, planar, sum_taps
from usdsmoke.core.fields.spline import SPLINE_REACH, Boundary, spline_coefficients
from usdsmoke.core.smoke.chunks import cut

__all__ = [
    "BOUNDARIES",
    "Boundary",
    "sample_bounds",
    "sample_cubic",
    "sample_linear",
    "voxel_positions",
]

POINTS_AT_ONCE = 2**16
BOUNDARIES: tuple[Boundary, ...] = ("zero", "nearest", "periodic")


def sample_linear(
    values: Tensor, positions_ijk: Tensor, outside: float = 0.0, boundary: Boundary = "zero"
) -> Tensor:
    r"""Trilinear interpolation, in the unit of ``values``.

    f(p) = sum_c values[c] * prod_a max(0, 1 - |p_a - c_a|), plus what the corners outside the box
    contribute.

    Args:
        values: [I J K] or [I J K C], floating point.
        positions_ijk: [N 3], index units, finite, same dtype; may lie outside the box.
        outside: the value around the box; used by boundary "zero" only.
        boundary: see the module.

    Returns:
        [N] or [N C]; within the range of the corners (and ``outside``).

    Raises:
        ShapeError: the shapes, dtypes or the boundary are not as above.
        NonFiniteError: a position is NaN or infinite.

    Gradients: through ``values`` (the exact adjoint) and ``positions_ijk`` (on a voxel: the
    derivative towards larger indices). Not twice differentiable.
    """
    _check_sampling(values, positions_ijk, boundary)
    shifted = values - outside if boundary == "zero" and outside else values
    if boundary == "periodic":
        shifted = _repeat_first(shifted)
    sampled = sum_taps(shifted, _wrap(positions_ijk, values, boundary), cubic=False)
    return sampled + outside if boundary == "zero" and outside else sampled


def sample_cubic(
    values: Tensor, positions_ijk: Tensor, outside: float = 0.0, boundary: Boundary = "zero"
) -> Tensor:
    r"""Cubic B-spline interpolation (twice continuously differentiable), in the unit of ``values``.

    The spline goes through every voxel's value, fourth order in the voxel size, and overshoots at
    steps by up to a fifth; ``sample_bounds`` limits it where that matters. The prefilter
    reads the whole box once; each position then reads 64 coefficients (16 in 2-D).

    Args:
        values: [I J K] or [I J K C], floating point.
        positions_ijk: [N 3], index units, finite, same dtype; may lie outside the box.
        outside: the value around the box; used by boundary "zero" only. The spline of the embedded
            box rings into the outside and is cut off where that has fallen to 1e-7.
        boundary: see the module; "nearest" mirrors the box for the prefilter and holds the border
            value outside.

    Returns:
        [N] or [N C].

    Raises:
        ShapeError: the shapes, dtypes or the boundary are not as above.
        NonFiniteError: a position is NaN or infinite.

    Gradients: through ``values`` (the exact adjoint) and ``positions_ijk``. Not twice
    differentiable.
    """
    _check_sampling(values, positions_ijk, boundary)
    shifted = values - outside if boundary == "zero" and outside else values
    coefficients = spline_coefficients(shifted, boundary)
    positions = _wrap(positions_ijk, values, boundary)
    first = SPLINE_REACH if boundary == "zero" else 1
    lengths = torch.tensor(values.shape[:3], device=positions.device)

    def sampled(positions: Tensor) -> Tensor:
        found = sum_taps(coefficients, positions + first, cubic=True)
        if boundary != "zero":
            return found
        inside = (positions > 1 - first) & (positions < lengths + first - 2) | (lengths == 1)
        keep = inside.all(dim=1).to(found.dtype)
        found = found * (keep if found.ndim == 1 else keep[:, None])
        return found + outside if outside else found

    if torch.is_grad_enabled() and (coefficients.requires_grad or positions.requires_grad):
        return sampled(positions)
    coefficients = coefficients if values.ndim == 3 else planar(coefficients)
    parts = cut(len(positions), POINTS_AT_ONCE, positions.device)
    nothing = values.new_empty((0, *values.shape[3:]))
    return torch.cat([nothing, *(sampled(positions[part]) for part in parts)])


def sample_bounds(
    values: Tensor, positions_ijk: Tensor, outside: float = 0.0, boundary: Boundary = "zero"
) -> tuple[Tensor, Tensor]:
    """Smallest and largest of the voxels around each position, for limiters.

    They are the corners of the cell that holds the position, those that ``sample_linear`` reads;
    corners outside the box count as ``outside`` when the boundary is "zero".

    Args:
        values: [I J K] or [I J K C], floating point.
        positions_ijk: [N 3], index units, finite, same dtype.
        outside: the value around the box; used by boundary "zero" only.
        boundary: see the module.

    Returns:
        (low, high), each [N] or [N C].

    Raises:
        ShapeError: the shapes, dtypes or the boundary are not as above.
        NonFiniteError: a position is NaN or infinite.

    Gradients: through ``values``, to the corner that was taken; none through the positions.
    """
    _check_sampling(values, positions_ijk, boundary)
    positions = _wrap(positions_ijk.detach(), values, boundary)
    padded = _repeat_first(values) if boundary == "periodic" else values
    lows, highs = [], []
    for corners in iterate_cells(padded, positions):
        seen = [
            torch.where(hit, corner, outside) if boundary == "zero" else corner
            for corner, hit in corners
        ]
        lows.append(reduce(torch.minimum, seen))
        highs.append(reduce(torch.maximum, seen))
    nothing = values.new_empty((0, *values.shape[3:]))
    return torch.cat([nothing, *lows]), torch.cat([nothing, *highs])


def voxel_positions(shape: tuple[int, ...], like: Tensor) -> Tensor:
    """Index positions of all voxels of a box in C order, [I*J*K 3].

    Args:
        shape: the box's I, J, K (further entries are ignored).
        like: a tensor whose dtype and device the positions get.
    """
    ranges = [torch.arange(n, dtype=like.dtype, device=like.device) for n in shape[:3]]
    return torch.stack(torch.meshgrid(*ranges, indexing="ij"), dim=-1).reshape(-1, 3)


def _wrap(positions: Tensor, values: Tensor, boundary: Boundary) -> Tensor:
    """Positions brought into the box as the boundary says; flat axes do not matter."""
    if boundary == "zero":
        return positions
    lengths = torch.tensor(values.shape[:3], dtype=positions.dtype, device=positions.device)
    if boundary == "periodic":
        return torch.remainder(positions, lengths)
    return torch.minimum(positions.clamp(min=0), lengths - 1)


def _repeat_first(values: Tensor) -> Tensor:
    """The box with its first layer repeated behind its last along every axis longer than 1."""
    for axis in range(3):
        if values.shape[axis] > 1:
            values = torch.cat((values, values.narrow(axis, 0, 1)), dim=axis)
    return values


def _check_sampling(values: Tensor, positions: Tensor, boundary: str) -> None:
    if boundary not in BOUNDARIES:
        raise ShapeError(
            f"cannot sample with boundary {boundary!r}; wanted one of {', '.join(BOUNDARIES)}"
        )
    if values.ndim not in (3, 4) or 0 in values.shape:
        raise ShapeError(
            f"cannot sample values of shape {list(values.shape)}; wanted [I J K] or [I J K C] with "
            "at least one voxel: leave empty volumes out"
        )
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise ShapeError(
            f"sample positions have shape {list(positions.shape)}; wanted [N 3], (i, j, k)"
        )
    if positions.dtype != values.dtype or not values.dtype.is_floating_point:
        raise ShapeError(
            f"values are {values.dtype} and sample positions {positions.dtype}; "
            "wanted the same floating-point dtype: convert the positions"
        )
    # A sum is four times cheaper than a test of every element, and NaN and infinity survive it.
    if positions.numel() and not torch.isfinite(positions.detach().sum()):
        n_bad = int((~torch.isfinite(positions)).any(dim=1).sum())
        if n_bad:
            raise NonFiniteError(
                f"{n_bad} of {len(positions)} sample positions are NaN or infinite; wanted finite "
                "index positions: look at the velocity or displacement that moved them"
            )

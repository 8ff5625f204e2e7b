r"""Interpolation of dense fields at fractional index positions, and its exact adjoint.

A field is ``values``, [I J K] or [I J K C]. A position is a row (i, j, k), and voxel (0, 0, 0) is
centred on position (0, 0, 0). Only the voxels around the given positions are read. A field is
constant along an axis of length 1, so a box one voxel thick is a 2-D field at the cost of one.

``sample_linear`` offers two boundaries:

========= =====================================================================================
"zero"    the box is embedded in the constant ``outside``: what leaves the box is gone and nothing
          is smeared in from its border
"nearest" the border value continues outwards
========= =====================================================================================

torch's ``grid_sample`` is not used: it takes positions scaled to [-1, 1], which moves whole-voxel
positions by round-off, walks a point list on one thread, and has no cubic mode for volumes. Here
every corner is one gather from a shifted view of the same flat array, and a position on a voxel
returns that voxel's value bit for bit ("linear").
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Literal

import torch
from torch import Tensor

from usdsmoke.base.errors import NonFiniteError, ShapeError
from usdsmoke.core.fields.gather import gather_sum, planar
from usdsmoke.core.smoke.memory import share_rows

Boundary = Literal["zero", "nearest"]
BOUNDARIES: tuple[Boundary, ...] = ("zero", "nearest")
CUBIC_CHUNK = 2**16  # positions that a thread samples at once
SPLINE_SUPPORT = 12  # voxels; |z|^12 is 1.4e-7, the round-off of float32
_POLE = math.sqrt(3.0) - 2.0  # z
_RESPONSE = 30  # voxels; |z|^30 is 7e-18, below the round-off of float64


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
    if boundary not in BOUNDARIES:
        raise ShapeError(f"unknown boundary {boundary!r}. Use one of {', '.join(BOUNDARIES)}.")
    _check_sampling(values, positions_ijk)
    if boundary == "nearest":
        lengths = torch.tensor(values.shape[:3]).to(positions_ijk)
        positions_ijk = torch.minimum(positions_ijk.clamp(min=0), lengths - 1)
        return gather_sum(values, positions_ijk, cubic=False)
    shifted = values - outside if outside else values
    sampled = gather_sum(shifted, positions_ijk, cubic=False)
    return sampled + outside if outside else sampled


def sample_cubic(values: Tensor, positions_ijk: Tensor) -> Tensor:
    r"""Cubic B-spline interpolation (twice continuously differentiable), in the unit of ``values``.

    The spline goes through every voxel's value, is fourth order in the voxel size, and overshoots
    at steps by up to a fifth. The box is embedded in zeros; the spline rings into them and is cut
    off where that has fallen to 1e-7. The prefilter reads the whole box once; each position then
    reads 64 coefficients (16 in 2-D).

    Args:
        values: [I J K] or [I J K C], floating point.
        positions_ijk: [N 3], index units, finite, same dtype; may lie outside the box.

    Returns:
        [N] or [N C].

    Raises:
        ShapeError: the shapes or dtypes are not as above.
        NonFiniteError: a position is NaN or infinite.

    Gradients: through ``values`` (the exact adjoint) and ``positions_ijk``. Not twice
    differentiable.
    """
    _check_sampling(values, positions_ijk)
    coefficients = spline_coefficients(values)
    lengths = torch.tensor(values.shape[:3], device=positions_ijk.device)

    def sampled(positions: Tensor) -> Tensor:
        found = gather_sum(coefficients, positions + SPLINE_SUPPORT, cubic=True)
        inside = (positions > 1 - SPLINE_SUPPORT) & (positions < lengths + SPLINE_SUPPORT - 2)
        keep = (inside | (lengths == 1)).all(dim=1).to(found.dtype)
        return found * (keep if found.ndim == 1 else keep[:, None])

    if torch.is_grad_enabled() and (coefficients.requires_grad or positions_ijk.requires_grad):
        return sampled(positions_ijk)
    coefficients = coefficients.contiguous() if values.ndim == 3 else planar(coefficients)
    found = values.new_empty((len(positions_ijk), *values.shape[3:]))

    def sample(part: slice) -> None:
        found[part] = sampled(positions_ijk[part])

    share_rows(sample, len(positions_ijk), CUBIC_CHUNK, positions_ijk.device)
    return found


def spline_coefficients(values: Tensor, margin: int = SPLINE_SUPPORT) -> Tensor:
    r"""Cubic B-spline coefficients of a box in zeros: the prefilter of ``sample_cubic``.

    A field s is interpolated by sum_k c_k * B(x - k) when (c_{k-1} + 4 c_k + c_{k+1}) / 6 = s_k.
    The solution is a filter with the impulse response sqrt(3) * z^|m|, z = sqrt(3) - 2.
    [Unser1999]

    Args:
        values: [I J K] or [I J K C].
        margin: voxels around the box for which there are coefficients too.

    Returns:
        the coefficients, same layout; each axis longer than 1 is longer by ``margin`` voxels at
        both ends.

    Gradients: through ``values``. Costs one small dense matrix product an axis.
    """
    coefficients = values
    for axis in range(3):
        length = values.shape[axis]
        if length > 1:
            matrix = _filter_matrix(length, margin).to(values)
            moved = torch.tensordot(matrix, coefficients, dims=([1], [axis]))
            coefficients = moved.movedim(0, axis)
    return coefficients


@lru_cache(maxsize=32)
def _filter_matrix(length: int, margin: int) -> Tensor:
    """[n_coefficients length] float64: from values along an axis to coefficients."""
    rows = torch.arange(-margin, length + margin)
    matrix = torch.zeros(len(rows), length, dtype=torch.float64)
    for shift in range(-_RESPONSE, _RESPONSE + 1):
        response = math.sqrt(3.0) * _POLE ** abs(shift)
        source = rows + shift
        kept = ((source >= 0) & (source < length)).nonzero()[:, 0]
        matrix.index_put_(
            (kept, source[kept]), torch.tensor(response, dtype=torch.float64), accumulate=True
        )
    return matrix


def voxel_positions(shape: tuple[int, ...], like: Tensor) -> Tensor:
    """Index positions of all voxels of a box in C order, [I*J*K 3].

    Args:
        shape: the box's I, J, K (further entries are ignored).
        like: a tensor whose dtype and device the positions get.
    """
    ranges = [torch.arange(n, dtype=like.dtype, device=like.device) for n in shape[:3]]
    return torch.stack(torch.meshgrid(*ranges, indexing="ij"), dim=-1).reshape(-1, 3)


def share_of_flat(shape: Sequence[int], positions_ijk: Tensor) -> Tensor:
    """How far positions are within a box along its axes with one voxel, [N] in [0, 1].

    ``sample_linear`` has no end along these. The share is 1 for half a voxel to both sides, so that
    a flat field holds for all of a slab of smoke that lies in it, and 0 after a whole voxel.

    Args:
        shape: the box's I, J, K (further entries are ignored).
        positions_ijk: [N 3], index units.
    """
    share = torch.ones_like(positions_ijk[:, 0])
    for axis, length in enumerate(shape[:3]):
        if length == 1:
            share = share * (2 - 2 * positions_ijk[:, axis].abs()).clamp(0, 1)
    return share


def _check_sampling(values: Tensor, positions: Tensor) -> None:
    if values.ndim not in (3, 4) or 0 in values.shape:
        raise ShapeError(
            f"cannot sample values of shape {list(values.shape)}. Pass [I J K] or [I J K C] with "
            "at least one voxel; leave empty volumes out."
        )
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise ShapeError(
            f"sample positions have shape {list(positions.shape)}. Pass [N 3], (i, j, k)."
        )
    if positions.dtype != values.dtype or not values.dtype.is_floating_point:
        raise ShapeError(
            f"values are {values.dtype} and sample positions {positions.dtype}. "
            "Convert the positions to the floating-point dtype of the values."
        )
    # A sum is four times cheaper than a test of every element, and NaN and infinity survive it.
    if positions.numel() and not torch.isfinite(positions.detach().sum()):
        n_bad = int((~torch.isfinite(positions)).any(dim=1).sum())
        if n_bad:
            raise NonFiniteError(
                f"{n_bad} of {len(positions)} sample positions are NaN or infinite. Check the "
                "velocity or displacement that moved them."
            )

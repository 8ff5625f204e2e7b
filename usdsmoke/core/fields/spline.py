r"""Cubic B-spline coefficients of a dense field: the prefilter of cubic interpolation.

A field s is interpolated by sum_k c_k * B(x - k) when (c_{k-1} + 4 c_k + c_{k+1}) / 6 = s_k. The
solution is a filter with the impulse response sqrt(3) * z^|m|, z = sqrt(3) - 2 [Unser1999].
"""

import math
from functools import lru_cache
from typing import Literal

import torch
from torch import Tensor

__all__ = ["SPLINE_REACH", "Boundary", "spline_coefficients"]

Boundary = Literal["zero", "nearest", "periodic"]
SPLINE_REACH = 12  # voxels; |z|^12 is 1.4e-7, the round-off of float32
_POLE = math.sqrt(3.0) - 2.0
_RESPONSE = 30  # |z|^30 is 7e-18, below the round-off of float64


def spline_coefficients(values: Tensor, boundary: Boundary) -> Tensor:
    """Coefficients on the box and a margin around it; axes of length 1 are left as they are.

    Args:
        values: [I J K] or [I J K C].
        boundary: what the box is embedded in: zeros, its mirror image, or itself, repeated.

    Returns:
        the coefficients, same layout; each axis longer than 1 is longer by ``SPLINE_REACH`` voxels
        at both ends ("zero"), or by one before and two after ("nearest", "periodic").

    Gradients: through ``values``. Costs one small dense matrix product an axis.
    """
    coefficients = values
    for axis in range(3):
        length = values.shape[axis]
        if length > 1:
            matrix = _filter_matrix(length, boundary).to(values)
            moved = torch.tensordot(matrix, coefficients, dims=([1], [axis]))
            coefficients = moved.movedim(0, axis)
    return coefficients


@lru_cache(maxsize=32)
def _filter_matrix(length: int, boundary: Boundary) -> Tensor:
    """[n_coefficients length] float64: from values along an axis to coefficients."""
    first, last = (
        (-SPLINE_REACH, length - 1 + SPLINE_REACH) if boundary == "zero" else (-1, length + 1)
    )
    rows = torch.arange(first, last + 1)
    matrix = torch.zeros(len(rows), length, dtype=torch.float64)
    for shift in range(-_RESPONSE, _RESPONSE + 1):
        response = math.sqrt(3.0) * _POLE ** abs(shift)
        source = rows + shift
        inside = (source >= 0) & (source < length)
        if boundary == "periodic":
            source, inside = source % length, torch.ones_like(inside)
        elif boundary == "nearest":
            source, inside = _mirror(source, length), torch.ones_like(inside)
        kept = inside.nonzero()[:, 0]
        matrix.index_put_(
            (kept, source[kept]), torch.tensor(response, dtype=torch.float64), accumulate=True
        )
    return matrix


def _mirror(index: Tensor, length: int) -> Tensor:
    """Indices reflected about the first and the last voxel."""
    return (length - 1) - ((index % (2 * (length - 1))) - (length - 1)).abs()

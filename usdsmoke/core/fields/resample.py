r"""Fields on coarser and finer lattices of the same box: upsampling, smoothing, smaller voxels.

A lattice of n voxels across a box has its voxel m centred at (m + 1/2) / n of the box's extent.
Lattices of any sizes therefore cover the same box, and two upsamplings in a row land where one
does. Everything is separable: a small matrix is applied along one axis after the other, which on a
processor costs less than gathering, and has its transpose as exact adjoint.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.errors import ShapeError
from usdsmoke.base.volume import DenseField

Method = Literal["linear", "cubic"]
_SIGMAS = 4.0  # where the Gaussian is cut off; 6e-5 of it lies beyond


def upsample(coarse: Tensor, shape: Sequence[int], method: Method = "cubic") -> Tensor:
    """A field on a finer lattice of the same box.

    Args:
        coarse: [i j k] or [i j k C], floating point.
        shape: the finer I, J, K (further entries are ignored), each at least the coarse one.
        method: "linear", or "cubic" with Keys' four-point kernel: third order, continuous
            derivative, through the coarse values, overshoots at steps [Keys1981]. Beyond the box
            the border value continues.

    Returns:
        [I J K] or [I J K C].

    Raises:
        ShapeError: a shape or the method is not as above.

    Gradients: through ``coarse``, the exact adjoint.
    """
    fine = tuple(int(n) for n in tuple(shape)[:3])
    if method not in ("linear", "cubic"):
        raise ShapeError(f"unknown upsampling method {method!r}. Use linear or cubic.")
    if (
        coarse.ndim not in (3, 4)
        or len(fine) != 3
        or any(not 1 <= n <= m for n, m in zip(coarse.shape, fine, strict=False))
    ):
        raise ShapeError(
            f"cannot upsample a field of shape {list(coarse.shape)} to {list(fine)} voxels. "
            "Pass [i j k] or [i j k C] and at least as many voxels along each axis."
        )
    return _along_axes(coarse, lambda axis, n: interpolation_matrix(fine[axis], n, method))


def smooth(values: Tensor, sigma: float | Sequence[float]) -> Tensor:
    """Gaussian blur over i, j and k of a box surrounded by zeros; channels are not mixed.

    Args:
        values: [I J K] or [I J K C], floating point.
        sigma: voxels, >= 0, one number or one per axis; axes of length 1 are not blurred.

    Raises:
        ShapeError: sigma is not as above.

    Gradients: through ``values``, the exact adjoint.
    """
    sigmas = [float(sigma)] * 3 if isinstance(sigma, (int, float)) else [float(s) for s in sigma]
    if len(sigmas) != 3 or not all(0 <= s < math.inf for s in sigmas):
        raise ShapeError(f"the blur's sigma is {sigma}. Pass one or three numbers from 0.")
    return _along_axes(values, lambda axis, n: _gaussian_matrix(n, sigmas[axis]))


def refine_field(field: DenseField, factor: int) -> DenseField:
    """The field on voxels ``factor`` times smaller along every axis with more than one voxel.

    A quadratic B-spline with the voxels' values as its coefficients [Unser1999]: its slope is
    continuous, so dense smoke has round outlines, where trilinear interpolation has steps of the
    source's voxels. It keeps the integral over space and the range of values, reproduces what is
    linear, and is a little softer: the width of a voxel (standard deviation) is 0.5 voxels instead
    of the trilinear 0.41. The box grows by one source voxel on every side that is subdivided, where
    the field falls to its background.

    Args:
        field: [i j k] or [i j k 3].
        factor: 1 gives the field back unchanged.
    """
    if factor == 1 or field.is_empty:
        return field
    shape = np.array(field.values.shape[:3])
    scale = np.where(shape > 1, factor, 1)
    pad = np.where(shape > 1, 1, 0)
    values = torch.from_numpy(np.ascontiguousarray(field.values, np.float32))
    outside = torch.from_numpy(np.asarray(field.background, np.float32).reshape(-1))
    values = values - (outside if values.ndim == 4 else outside[0])
    for axis in (2, 1, 0):  # the last step makes the largest box, whose planes lie in order
        if scale[axis] > 1:
            values = _subdivided(values, axis, int(scale[axis]))
    values += outside if values.ndim == 4 else outside[0]
    old_from_new = np.diag([*(1.0 / scale), 1.0])
    old_from_new[3, :3] = 0.5 / scale - 0.5
    return DenseField(
        field.name,
        values.numpy(),
        tuple(int(n) for n in (np.asarray(field.ijk_min) - pad) * scale),  # type: ignore[arg-type]
        old_from_new @ field.index_to_world,
        field.background,
        field.grid_class,
        field.half,
        field.metadata,
    )


def _subdivided(values: Tensor, axis: int, parts: int) -> Tensor:
    """A quadratic B-spline at the centres of the parts of each voxel and of one beyond each end.

    Args:
        values: coefficients, a box along whose ``axis`` zeros follow.
    """
    values = values.movedim(axis, 0)
    n = len(values)
    fine = values.new_zeros((n + 2, parts, *values.shape[1:]))
    for part in range(parts):
        place = (part + 0.5) / parts - 0.5  # from the voxel's centre, in voxels
        weights = (0.5 * (0.5 - place) ** 2, 0.75 - place**2, 0.5 * (0.5 + place) ** 2)
        for first, weight in zip((2, 1, 0), weights, strict=True):  # voxels before, at and behind
            fine[first : first + n, part].add_(values, alpha=weight)
    return fine.flatten(0, 1).movedim(0, axis)


def apply_along(values: Tensor, matrices: Sequence[Tensor]) -> Tensor:
    """A box [i j k] or [i j k C] after a matrix [I i] along each of its three axes."""
    return _along_axes(values, lambda axis, n: matrices[axis])


def _along_axes(values: Tensor, matrix_for: Callable[[int, int], Tensor | None]) -> Tensor:
    """Applies ``matrix_for(axis, length)``, if any, along each of the three axes."""
    for axis in range(3):
        matrix = matrix_for(axis, values.shape[axis])
        if matrix is not None:
            moved = torch.tensordot(matrix.to(values), values, dims=([1], [axis]))
            values = moved.movedim(0, axis)
    return values


@lru_cache(maxsize=64)
def interpolation_matrix(n_fine: int, n_coarse: int, method: Method) -> Tensor | None:
    """The matrix of ``upsample`` along an axis, [n_fine n_coarse] float64; None for the identity.

    The tensor is shared: do not change it.
    """
    if n_fine == n_coarse:
        return None
    place = (torch.arange(n_fine, dtype=torch.float64) + 0.5) * n_coarse / n_fine - 0.5
    below = place.floor()
    matrix = torch.zeros(n_fine, n_coarse, dtype=torch.float64)
    rows = torch.arange(n_fine)
    for step in (0, 1) if method == "linear" else (-1, 0, 1, 2):
        distance = (place - below - step).abs()
        weight = 1 - distance if method == "linear" else _keys_kernel(distance)
        column = (below + step).clamp(0, n_coarse - 1).long()
        matrix.index_put_((rows, column), weight, accumulate=True)
    return matrix


def _keys_kernel(distance: Tensor) -> Tensor:
    """Keys' cubic convolution kernel with a = -1/2 at distances in [0, 2]."""
    near = (1.5 * distance - 2.5) * distance * distance + 1
    far = ((-0.5 * distance + 2.5) * distance - 4) * distance + 2
    return torch.where(distance <= 1, near, far)


@lru_cache(maxsize=64)
def _gaussian_matrix(length: int, sigma: float) -> Tensor | None:
    """[length length] float64, rows of the unit-sum kernel; None for the identity."""
    support = math.ceil(_SIGMAS * sigma)
    if length == 1 or support == 0:
        return None
    index = torch.arange(length, dtype=torch.float64)
    distance = (index[:, None] - index).abs()
    kernel = torch.exp(-0.5 * (distance / sigma) ** 2) * (distance <= support)
    steps = torch.arange(-support, support + 1, dtype=torch.float64)
    return kernel / torch.exp(-0.5 * (steps / sigma) ** 2).sum()

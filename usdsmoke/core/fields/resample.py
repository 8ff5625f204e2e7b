r"""Fields on coarser lattices of the same box: interpolation, smoothing, coefficient pyramids.

A lattice of n voxels across a box has its voxel m centred at (m + 1/2) / n of the box's extent.
Lattices of any sizes therefore cover the same box, and two upsamplings in a row land where one
does. Everything is separable: a small matrix is applied along one axis after the other, which on a
processor costs less than gathering, and has its transpose as exact adjoint.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import torch
from torch import Tensor

from usdsmoke.base.errors import ShapeError

__all__ = ["Method", "Pyramid", "interpolation_matrix", "pyramid_shapes", "smooth", "upsample"]

Method = Literal["linear", "cubic"]
_SIGMAS = 4.0  # where the Gaussian is cut off; 6e-5 of it lies beyond


@dataclass(frozen=True)
class Pyramid:
    """A field as a sum of coefficient fields, coarse to fine.

    Optimising the levels instead of the voxels lets coarse structure form first and keeps speckle
    out. ``levels`` are the parameters: turn on their gradients, or replace them.

    Args:
        levels: coarse to fine, each [i j k C]; see ``pyramid_shapes``.
        method: of the upsampling; "cubic" for potentials, whose derivative is wanted, "linear"
            where the field must stay within the range of its coefficients.
    """

    levels: tuple[Tensor, ...]
    method: Method = "cubic"

    def expand(self) -> Tensor:
        """The field, [I J K C] on the finest level's lattice.

        Every level is added to the upsampled sum of the coarser ones, so the whole costs little
        more than one upsampling to the finest lattice.

        Gradients: through ``levels``.
        """
        total = self.levels[0]
        for level in self.levels[1:]:
            total = upsample(total, level.shape, self.method) + level
        return total


def pyramid_shapes(shape: Sequence[int], n_levels: int) -> list[tuple[int, int, int]]:
    """Lattice shapes of a pyramid, each half of the next finer one; the last is ``shape``.

    Args:
        shape: I, J, K of the finest level.
        n_levels: how many are wanted, >= 1; fewer where the box is too small for them.

    Raises:
        ShapeError: a number is out of range.
    """
    finest: tuple[int, ...] = tuple(int(n) for n in tuple(shape)[:3])
    if n_levels < 1 or len(finest) != 3 or min(finest) < 1:
        raise ShapeError(
            f"cannot make a pyramid of {n_levels} levels on {list(finest)} voxels; wanted at least "
            "1 level and at least 1 voxel along 3 axes"
        )
    shapes: list[tuple[int, ...]] = [finest]
    while len(shapes) < n_levels:
        coarser = tuple(max(min(n, 2), math.ceil(n / 2)) for n in shapes[0])
        if coarser == shapes[0]:
            break
        shapes.insert(0, coarser)
    return [(i, j, k) for i, j, k in shapes]


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
        raise ShapeError(f"unknown upsampling method {method!r}; wanted linear or cubic")
    if (
        coarse.ndim not in (3, 4)
        or len(fine) != 3
        or any(not 1 <= n <= m for n, m in zip(coarse.shape, fine, strict=False))
    ):
        raise ShapeError(
            f"cannot upsample a field of shape {list(coarse.shape)} to {list(fine)} voxels; "
            "wanted [i j k] or [i j k C] and at least as many voxels along each axis"
        )
    return _along_axes(coarse, lambda axis, n: interpolation_matrix(fine[axis], n, method))


def smooth(values: Tensor, sigma: float | Sequence[float]) -> Tensor:
    """Gaussian blur over i, j and k of a box in emptiness; channels are not mixed.

    Args:
        values: [I J K] or [I J K C], floating point.
        sigma: voxels, >= 0, one number or one per axis; axes of length 1 are left as they are.

    Raises:
        ShapeError: sigma is not as above.

    Gradients: through ``values``, the exact adjoint.
    """
    sigmas = [float(sigma)] * 3 if isinstance(sigma, (int, float)) else [float(s) for s in sigma]
    if len(sigmas) != 3 or not all(0 <= s < math.inf for s in sigmas):
        raise ShapeError(f"the blur's sigma is {sigma}; wanted one or three numbers from 0")
    return _along_axes(values, lambda axis, n: _gaussian_matrix(n, sigmas[axis]))


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
    """What ``upsample`` does along an axis, [n_fine n_coarse] float64; None where that is nothing.

    The tensor is shared: not to be changed.
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
    """[length length] float64, rows of the unit-sum kernel; None where nothing is to be done."""
    reach = math.ceil(_SIGMAS * sigma)
    if length == 1 or reach == 0:
        return None
    index = torch.arange(length, dtype=torch.float64)
    distance = (index[:, None] - index).abs()
    kernel = torch.exp(-0.5 * (distance / sigma) ** 2) * (distance <= reach)
    steps = torch.arange(-reach, reach + 1, dtype=torch.float64)
    return kernel / torch.exp(-0.5 * (steps / sigma) ** 2).sum()

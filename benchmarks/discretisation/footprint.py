r"""The picture of trilinear smoke in a parallel view, from the exact footprint of a voxel.

Between voxel centres smoke is interpolated trilinearly: each voxel is a product of three hats. Seen
along a direction, its optical depth is a box spline, and so is the mean of that over a pixel with
the weights of a tent. By the projection-slice theorem the footprint K has the Fourier transform

    K(k) = sinc(k_x / 2)^2 sinc(k_y / 2)^2  prod_i sinc(k . q_i / 2)^2,    sinc(x) = sin(x) / x,

where q_i are the voxel's edges in the picture, in pixels, and k is in radians per pixel: the first
two factors are the pixel's tent, the others the hats. K has compact support, so its Fourier series
on a large enough square is exact; it is summed up on a fine grid once, and looked up for every
voxel and pixel. Nothing of this is shared with the splatting or the ray marching that it judges.
"""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from usdsmoke.core.views.cameras import View

__all__ = ["column_depths", "footprint"]

_SAMPLES = 2048  # along each side of the square on which the footprint is tabulated


def footprint(edges: np.ndarray) -> tuple[np.ndarray, int]:
    """A voxel's footprint on a square of whole pixels around it; its integral is 1.

    Args:
        edges: [3 2], the voxel's edges in the picture, pixels.

    Returns:
        Values [S S] by rows and columns, 1/pixel^2, the middle at [0, 0] and wrapped around; and
        how many pixels the square has along a side.
    """
    reach = 1 + np.abs(edges).sum(axis=0).max()
    size = 2 ** int(np.ceil(np.log2(2 * reach + 2)))
    k = 2 * np.pi * np.fft.fftfreq(_SAMPLES, 1 / _SAMPLES) / size
    ky, kx = k[:, None], k[None, : _SAMPLES // 2 + 1]
    shape = _hat(kx) * _hat(ky)
    for x, y in edges:
        shape = shape * _hat(kx * x + ky * y)
    return np.fft.irfft2(shape, (_SAMPLES, _SAMPLES)) * (_SAMPLES / size) ** 2, size


def _hat(k: np.ndarray) -> np.ndarray:
    """Fourier transform of a hat from -1 to 1."""
    hat: np.ndarray = np.sinc(k / (2 * np.pi)) ** 2
    return hat


def column_depths(
    positions: np.ndarray, density: np.ndarray, steps: np.ndarray, view: "View"
) -> np.ndarray:
    """Integrals of the density along rays, means over pixels with a tent two pixels wide, [H W].

    Args:
        positions: of voxels, [N 3], stage space.
        density: theirs, [N].
        steps: from a voxel to the next along each axis, [3 3], stage space.
        view: parallel.
    """
    axes = np.stack([view.right, -view.up], axis=1) / view.pixel_size
    table, size = footprint(steps @ axes)
    middle = np.array([view.width, view.height]) / 2 - 0.5 + np.array(view.shift)
    places = (positions - view.centre) @ axes + middle
    low = np.floor(places).astype(np.int64)
    mass = density * abs(np.linalg.det(steps)) / view.pixel_size**2
    picture = np.zeros(view.height * view.width)
    for dy in range(-size // 2 + 1, size // 2 + 1):
        for dx in range(-size // 2 + 1, size // 2 + 1):
            x, y = low[:, 0] + dx, low[:, 1] + dy
            seen = (x >= 0) & (x < view.width) & (y >= 0) & (y < view.height)
            weights = _looked_up(table, size, x[seen] - places[seen, 0], y[seen] - places[seen, 1])
            pixels = y[seen] * view.width + x[seen]
            picture += np.bincount(pixels, weights * mass[seen], len(picture))
    return picture.reshape(view.height, view.width)


def _looked_up(table: np.ndarray, size: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The footprint at offsets from a voxel in pixels, linear between the table's entries."""
    n = len(table)
    column, row = x * (n / size), y * (n / size)
    c, r = np.floor(column).astype(np.int64), np.floor(row).astype(np.int64)
    fc, fr = column - c, row - r
    found: np.ndarray = (
        table[r % n, c % n] * (1 - fr) * (1 - fc)
        + table[r % n, (c + 1) % n] * (1 - fr) * fc
        + table[(r + 1) % n, c % n] * fr * (1 - fc)
        + table[(r + 1) % n, (c + 1) % n] * fr * fc
    )
    return found

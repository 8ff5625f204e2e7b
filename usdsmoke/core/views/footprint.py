"""The points that voxels are splatted at, so that a picture of constant smoke is constant.

A lattice of voxels, splatted with the hat of a pixel, ripples: each vector g of the reciprocal
lattice, in cycles per pixel, adds a wave of amplitude 2 sinc^2(g_x) sinc^2(g_y), where sinc(x) is
sin(pi x) / (pi x). Voxels as large as pixels, seen along an axis, have waves of amplitude 0. Seen
at 45 degrees they ripple by 9 %, and voxels longer than a pixel leave holes. Waves that change
along the ray average out over thick smoke.

A voxel that is split into equal parts along its edges has a finer lattice. The fewest parts are
taken whose ripple is small; most views need none.
"""

import math
from functools import lru_cache

import numpy as np

from usdsmoke.core.smoke.voxels import Voxels
from usdsmoke.core.views.cameras import View

RIPPLE = 0.005  # rms, of constant smoke
DEPTH = 16  # voxels of smoke along the ray, over which waves average out
MOST_EXTRA = 3  # parts of an edge beyond those that leave no hole
_STILL = 1e-9  # pixels that smoke may be moved by when it is counted
_MODES = np.array([mode for mode in np.ndindex(9, 9, 9) if mode != (4, 4, 4)]) - 4


def _ripple(
    edges: np.ndarray, axes: np.ndarray, parts: tuple[int, int, int], pixel: float
) -> float:
    """Predicted rms of the picture of constant smoke around its mean, relative.

    Args:
        edges: of a voxel, [3 3] rows, stage units.
        axes: right, up and forward, [3 3] rows.
        parts: of each edge.
        pixel: edge of a pixel at the smoke, stage units.
    """
    waves = (_MODES * np.array(parts)) @ np.linalg.inv(edges).T  # cycles per stage unit
    across, up, along = (waves @ axes.T).T
    height = np.sinc(across * pixel) ** 2 * np.sinc(up * pixel) ** 2
    depth = DEPTH * abs(float(np.linalg.det(edges))) ** (1 / 3)
    height = height / np.maximum(np.pi * np.abs(along) * depth, 1.0)
    is_layer = np.hypot(across, up) <= np.abs(along)  # the steps of a slanted surface are real
    return math.sqrt(float((height[~is_layer] ** 2).sum()))


def voxel_points(edges: np.ndarray, view: View, pixel: float) -> np.ndarray:
    """Where in a voxel it is splatted: offsets from its centre, [n 3], stage units.

    Args:
        edges: of a voxel, [3 3] rows, stage units.
        view: gives the directions.
        pixel: edge of a pixel at the smoke, stage units.
    """
    parts = _fewest_parts(_numbers(edges), _numbers(view.right), _numbers(view.up), pixel)
    places = [(np.arange(n) + 0.5) / n - 0.5 for n in parts]
    return np.stack(np.meshgrid(*places, indexing="ij"), axis=-1).reshape(-1, 3) @ edges


def _numbers(values: np.ndarray) -> tuple[float, ...]:
    return tuple(float(value) for value in values.ravel())


@lru_cache(maxsize=1024)
def _fewest_parts(
    edges: tuple[float, ...], right: tuple[float, ...], up: tuple[float, ...], pixel: float
) -> tuple[int, int, int]:
    """Numbers of parts of a voxel's edges."""
    rows, axes = np.reshape(edges, (3, 3)), np.array([right, up, np.cross(up, right)])
    sides = np.linalg.norm(rows @ axes[:2].T, axis=1) / pixel
    least = [max(1, math.ceil(side - 1e-6)) for side in sides]
    choices = [tuple(np.add(least, extra).tolist()) for extra in np.ndindex(*[MOST_EXTRA + 1] * 3)]
    choices.sort(key=math.prod)  # stable
    found: dict[tuple[int, int, int], float] = {}
    for parts in choices:
        found[parts] = _ripple(rows, axes, parts, pixel)
        if found[parts] <= RIPPLE:
            return parts
    return min(found, key=lambda parts: found[parts])


class ColumnSums:
    """Integrals of density along the pixels of a view: ``project.column_map`` for NumPy.

    Args:
        smoke: lies inside the view. Its own density is not read.
        view: orthographic.
    """

    def __init__(self, smoke: Voxels, view: View) -> None:
        self._shape = view.height, view.width
        to_pixels = np.stack([view.right, -view.up], axis=1) / view.pixel_size
        middle = [(view.width - 1) / 2 + view.shift[0], (view.height - 1) / 2 + view.shift[1]]
        start = (smoke.index_to_stage[3, :3] - view.centre) @ to_pixels + np.array(middle)
        steps = smoke.edges @ to_pixels
        ijk, self._column = _without_depth(smoke, steps)
        self._places, self._n = ijk @ steps, len(ijk)
        self._offsets = voxel_points(smoke.edges, view, view.pixel_size) @ to_pixels + start
        self._scale = smoke.voxel_volume / len(self._offsets) / view.pixel_size**2

    def __call__(self, density: np.ndarray) -> np.ndarray:
        """The integrals [P] float64 of the voxels' density [N], density x stage unit."""
        mass: np.ndarray = density.astype(np.float64)
        if self._column is not None:
            mass = np.bincount(self._column, mass, self._n)
        mass *= self._scale
        height, width = self._shape
        total = np.zeros(height * width)
        for offset in self._offsets:
            place = self._places + offset
            first = np.floor(place)
            (x, y), (column, row) = (place - first).T, first.astype(np.int64).T
            pixel = row * width + column
            for down, across in np.ndindex(2, 2):
                weight = (x if across else 1 - x) * (y if down else 1 - y) * mass
                total += np.bincount(pixel + (down * width + across), weight, len(total))
        return total


def _without_depth(smoke: Voxels, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """The places [M 3] that voxels are counted at, and which of them each voxel has, [N].

    Voxels behind one another have one place where an axis is seen from its end; else each has its
    own, and the second is None.

    Args:
        steps: of a voxel along each axis, pixels, [3 2].
    """
    lengths = np.abs(steps).sum(axis=1)
    axis, (low, high) = int(lengths.argmin()), smoke.box
    if lengths[axis] * (high - low)[axis] > _STILL:
        return smoke.ijk, None
    across = [n for n in range(3) if n != axis]
    shape = (high - low + 1)[across]
    i, j = (smoke.ijk[:, n] - low[n] for n in across)
    column, n_columns = i * shape[1] + j, int(np.prod(shape))
    is_filled = np.bincount(column, minlength=n_columns) > 0
    filled = np.flatnonzero(is_filled)
    ijk = np.tile(low, (len(filled), 1))
    ijk[:, across] += np.stack(np.divmod(filled, shape[1]), axis=1)
    return ijk, (np.cumsum(is_filled) - 1)[column]

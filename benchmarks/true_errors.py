"""Errors of a stylized frame by code that shares none with what made the frame."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage

from benchmarks.raymarch import march_rays
from benchmarks.told_true_scenes import Scene
from usdsmoke.base.volume import DenseField
from usdsmoke.core.views.cameras import View

__all__ = [
    "FOLDED",
    "READ_TWICE",
    "UNREAD",
    "difference",
    "enlarged",
    "filter_errors",
    "marched",
    "transport_error",
    "unevenness",
]

FOLDED, UNREAD, READ_TWICE = "folded smoke", "mass, unread", "mass, read twice"

_STEPS = 6.0  # segments a voxel, of the ray marcher
_FINE = 4  # samples across a pixel


def difference(found: np.ndarray, exact: np.ndarray) -> float:
    """The sum of the absolute differences, relative to the exact one's."""
    return float(np.abs(found - exact).sum() / np.abs(exact).sum())


def marched(density: DenseField, emission: DenseField, gamma_w: float, view: View) -> np.ndarray:
    """Premultiplied colour and alpha, [H W 4], of fields over one box; nothing around it."""
    to_stage = density.index_to_world.copy()
    first = np.array([*(np.asarray(density.ijk_min) - 1.0), 1.0])
    to_stage[3] = first @ density.index_to_world
    values = np.pad(np.maximum(density.values, 0), 1)
    light = np.pad(emission.values, [(1, 1)] * 3 + [(0, 0)])
    picture, alpha = march_rays(values, light, to_stage, gamma_w, view, _STEPS)
    return np.concatenate([picture, alpha[..., None]], axis=-1)


def filter_errors(picture: Callable[[View], np.ndarray], view: View) -> float:
    """How far a picture sampled at its pixels' centres is from the means over the pixels."""
    offsets = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    mean = np.mean([picture(_moved(view, x, y)) for x in offsets for y in offsets], axis=0)
    return difference(picture(view), mean)


def enlarged(picture: np.ndarray) -> np.ndarray:
    """A picture [H W C] with twice as many pixels along each side."""
    channels = [
        ndimage.zoom(picture[..., c], 2, order=3, grid_mode=True, mode="nearest")
        for c in range(picture.shape[-1])
    ]
    return np.stack(channels, -1)


def transport_error(scene: Scene, u: np.ndarray, low: Sequence[int], density: DenseField) -> float:
    """One warp against the smoke itself at the places that it comes from; NaN where not known.

    Args:
        scene: the smoke that was moved.
        u: displacement [I J K 3], voxels.
        low: index of its first voxel.
        density: the moved one.
    """
    low = np.asarray(low)
    if scene.truth is not None:
        places = np.stack(np.meshgrid(*map(np.arange, u.shape[:3]), indexing="ij"), -1) + low
        exact = scene.truth(places - u)
    elif scene.fine is not None:
        exact = _fine_values(scene.fine, scene.factor, u, low)
    else:
        return float("nan")
    found = np.zeros(u.shape[:3])
    offset = low - np.asarray(density.ijk_min)
    begin, end = np.maximum(offset, 0), np.minimum(offset + found.shape, density.values.shape)
    inner = tuple(slice(a - o, b - o) for a, b, o in zip(begin, end, offset, strict=True))
    found[inner] = density.values[tuple(map(slice, begin, end))]
    exact = exact * (found.sum() / exact.sum())  # the mass is corrected in the result
    return difference(found, exact)


def unevenness(u: np.ndarray, box: np.ndarray) -> dict[str, float]:
    """The share of the voxels where space folds, and of the mass that is unread or read twice.

    Args:
        u: displacement [I J K 3], voxels.
        box: density before it is moved [I J K].
    """
    slopes = np.stack([np.stack(np.gradient(u[..., a]), -1) for a in range(3)], -2)
    folded = (np.linalg.det(np.eye(3) - slopes) <= 0) & (box > 0)
    weight = np.zeros(np.array(box.shape) + 2)
    place = np.stack(np.meshgrid(*map(np.arange, box.shape), indexing="ij"), -1) - u + 1
    place = place.reshape(-1, 3)
    base = np.floor(place).astype(int)
    part = place - base
    for corner in np.ndindex(2, 2, 2):
        index = np.clip(base + corner, 0, np.array(weight.shape) - 1)
        share = np.prod(np.where(np.array(corner) > 0, part, 1 - part), axis=1)
        np.add.at(weight, tuple(index.T), share)
    read = weight[1:-1, 1:-1, 1:-1]
    return {
        FOLDED: float(folded.sum() / (box > 0).sum()),
        UNREAD: float(box[read < 0.05].sum() / box.sum()),
        READ_TWICE: float(box[read > 2].sum() / box.sum()),
    }


def _moved(view: View, x: float, y: float) -> View:
    """The view whose pixels' centres lie x, y pixels from its own."""
    offset = view.pixel_size * (x * view.right + y * view.up)
    return replace(view, centre=view.centre + offset)


def _fine_values(fine: np.ndarray, n: int, u: np.ndarray, low: np.ndarray) -> np.ndarray:
    """Block means of the finer smoke at the departure points of the finer voxels."""
    within = (np.arange(n) + 0.5) / n - 0.5
    shape, summed = u.shape[:3], np.zeros(u.shape[:3])
    grid = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), 0).astype(float)
    for offset in np.ndindex(n, n, n):
        shift = within[list(offset)][:, None, None, None]
        moved = [
            ndimage.map_coordinates(u[..., axis], grid + shift, order=1, mode="nearest")
            for axis in range(3)
        ]
        place = grid + shift - np.stack(moved) + low[:, None, None, None]
        summed += ndimage.map_coordinates(fine, (place + 0.5) * n - 0.5, order=1, mode="constant")
    return summed / n**3

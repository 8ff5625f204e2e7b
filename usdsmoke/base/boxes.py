"""Boxes of voxels: the one around several fields, and a field's values in another one."""

from collections.abc import Iterable, Sequence

import numpy as np

from usdsmoke.base.volume import DenseField

Ijk = tuple[int, int, int]


def union_box(fields: Iterable[DenseField]) -> tuple[Ijk, Ijk]:
    """First voxel and voxels along i, j, k of the box that holds those of all fields."""
    boxes = [field for field in fields if not field.is_empty]
    if not boxes:
        return (0, 0, 0), (0, 0, 0)
    low = np.min([field.ijk_min for field in boxes], axis=0)
    high = np.max([np.add(field.ijk_min, field.values.shape[:3]) for field in boxes], axis=0)
    (i, j, k), (n_i, n_j, n_k) = low.tolist(), (high - low).tolist()
    return (i, j, k), (n_i, n_j, n_k)


def values_in_box(
    field: DenseField, ijk_min: Sequence[int], shape: Sequence[int], dtype: type = np.float32
) -> np.ndarray:
    """A field's values in a box, its background beyond its own box.

    Args:
        ijk_min: index of the box's first voxel.
        shape: [i j k], or [i j k 3] for vectors.
        dtype: of the result; with float32 it may be the field's own array.
    """
    if tuple(field.ijk_min) == tuple(ijk_min) and field.values.shape == tuple(shape):
        return field.values.astype(dtype, copy=False)
    values: np.ndarray = np.full(shape, np.asarray(field.background, dtype), dtype)
    start = np.maximum(field.ijk_min, ijk_min)
    stop = np.minimum(
        np.add(field.ijk_min, field.values.shape[:3]), np.add(ijk_min, tuple(shape)[:3])
    )
    if np.all(start < stop):
        theirs, ours = (
            tuple(map(slice, (start - first).tolist(), (stop - first).tolist()))
            for first in (ijk_min, field.ijk_min)
        )
        values[theirs] = field.values[ours]
    return values

"""Which voxels of a dense field are active: those that differ from the background."""

import dataclasses

import numpy as np

from usdsmoke.base.volume import DenseField

Ijk = tuple[int, int, int]


def active_mask(field: DenseField) -> np.ndarray:
    """[i j k] bool: True where the value, in any component, differs from the background."""
    differs = field.values != np.asarray(field.background, np.float32)
    return differs.any(axis=-1) if field.values.ndim == 4 else differs


def active_box(field: DenseField) -> tuple[Ijk, Ijk] | None:
    """Index of the first voxel and voxels along i, j, k of the active box; None without any."""
    span = _active_span(active_mask(field))
    if span is None:
        return None
    i, j, k = (int(a) + s.start for a, s in zip(field.ijk_min, span, strict=True))
    n_i, n_j, n_k = (s.stop - s.start for s in span)
    return (i, j, k), (n_i, n_j, n_k)


def crop_to_active(field: DenseField) -> DenseField:
    """The same grid without the border that holds nothing but background; values are copied."""
    span = _active_span(active_mask(field))
    if span is None:
        values = np.zeros((0, 0, 0, *field.values.shape[3:]), np.float32)
        return dataclasses.replace(field, values=values, ijk_min=(0, 0, 0))
    i, j, k = (int(a) + s.start for a, s in zip(field.ijk_min, span, strict=True))
    return dataclasses.replace(
        field, values=np.ascontiguousarray(field.values[span]), ijk_min=(i, j, k)
    )


def _active_span(mask: np.ndarray) -> tuple[slice, slice, slice] | None:
    """Slices of the smallest box that holds every True."""
    if not mask.any():
        return None
    spans = []
    for axis in range(3):
        others = tuple(other for other in range(3) if other != axis)
        hits = np.flatnonzero(mask.any(axis=others))
        spans.append(slice(int(hits[0]), int(hits[-1]) + 1))
    return spans[0], spans[1], spans[2]

"""Boxes of voxels: which voxels of a field are active, and where a box lies in grid world.

Matrices are 4x4 in the row-vector convention, ``p @ a_to_b``.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from usdsmoke.base.boxes import Ijk, values_in_box
from usdsmoke.base.errors import GridTooLarge
from usdsmoke.base.volume import DenseField

# Volume of a voxel, in grid world units: OpenVDB takes the transform of a smaller one for singular
LEAST_VOXEL = 3e-15


def check_dense_size(found: str, shape: Sequence[int], components: int, limit: int) -> None:
    """Refuse a box of voxels that is too large as a dense array of 32-bit floats.

    Args:
        found: the grid, for the message.
        shape: voxels along i, j, k.
        components: numbers in a voxel.
        limit: bytes.

    Raises:
        GridTooLarge: with the size and the limit.
    """
    n_bytes = 4 * components * shape[0] * shape[1] * shape[2]
    if n_bytes > limit:
        raise GridTooLarge(
            f"{found} spans {' x '.join(map(str, shape))} voxels, {_size(n_bytes)} as a "
            f"dense array; {_size(limit)} are allowed. Raise grids.memory_limit_gib or "
            "cut the grid into smaller ones."
        )


def _size(n_bytes: int) -> str:
    return f"{n_bytes / 2**30:.1f} GiB" if n_bytes >= 2**30 else f"{n_bytes / 2**20:.3g} MiB"


def active_mask(field: DenseField) -> np.ndarray:
    """[i j k] bool: True where the value, in any component, differs from the background."""
    background = np.asarray(field.background, np.float32)
    if field.values.ndim < 4:
        return np.asarray(field.values != background)
    parts = zip(np.moveaxis(field.values, -1, 0), np.broadcast_to(background, 3), strict=True)
    return np.logical_or.reduce([values != outside for values, outside in parts])  # any() is slow


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


def index_to_world(points_ijk: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Positions in grid world of positions in index space.

    Args:
        points_ijk: [... 3], may be fractional.
        matrix: [4 4] index-to-world.

    Returns:
        [... 3] float64, in grid-world units.
    """
    matrix = np.asarray(matrix, np.float64)
    return np.asarray(points_ijk, np.float64) @ matrix[:3, :3] + matrix[3, :3]


def box_extent(
    ijk_min: Sequence[int], shape: Sequence[int], matrix: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner in grid world, [3] each, of a box of voxels with their full width.

    A voxel is centred on its index and reaches half a voxel to each side.
    """
    low = np.asarray(ijk_min, np.float64) - 0.5
    return corners_extent(low, low + np.asarray(shape[:3], np.float64), matrix)


def corners_extent(
    low: Sequence[float] | np.ndarray, high: Sequence[float] | np.ndarray, matrix: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner, [3] each, of a box that a [4 4] matrix takes elsewhere."""
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1)
    moved = index_to_world(corners.reshape(-1, 3), matrix)
    return moved.min(axis=0), moved.max(axis=0)


def union_extent(
    boxes: Sequence[tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner, [3] each, of one box or more."""
    low, high = zip(*boxes, strict=True)
    return np.min(low, axis=0), np.max(high, axis=0)


def field_extent(
    field: DenseField,
) -> tuple[tuple[float, float, float], tuple[float, float, float]] | None:
    """Lowest and highest corner in grid world of a field's active voxels; None when it has none."""
    box = active_box(field)
    if box is None:
        return None
    ijk_min, shape = box
    low, high = box_extent(ijk_min, shape, field.index_to_world)
    return (low[0].item(), low[1].item(), low[2].item()), (
        high[0].item(),
        high[1].item(),
        high[2].item(),
    )


def prune_fields(fields: Sequence[DenseField], prune: float) -> list[DenseField]:
    """The fields with their background wherever there is too little smoke.

    Args:
        fields: density first; the others have its transform, and may have other boxes.
        prune: density at or below which a voxel is left out; 0 gives the fields back.
    """
    if prune <= 0 or fields[0].is_empty:
        return list(fields)
    found = []
    for field in fields:
        smoke = values_in_box(fields[0], field.ijk_min, field.values.shape[:3]) > prune
        mask = smoke[..., None] if field.values.ndim == 4 else smoke
        background = np.asarray(field.background, np.float32)
        found.append(dataclasses.replace(field, values=np.where(mask, field.values, background)))
    return found

"""From index space to grid world: 4x4 matrices in the row-vector convention, ``p @ a_to_b``."""

from collections.abc import Sequence

import numpy as np

from usdsmoke.base.volume import DenseField
from usdsmoke.vdb.active_box import active_box


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

    Args:
        ijk_min: index of the box's first voxel.
        shape: voxels along i, j, k.
        matrix: [4 4] index-to-world.
    """
    low = np.asarray(ijk_min, np.float64) - 0.5
    high = low + np.asarray(shape[:3], np.float64)
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1)
    corners_xyz = index_to_world(corners.reshape(-1, 3), matrix)
    return corners_xyz.min(axis=0), corners_xyz.max(axis=0)


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

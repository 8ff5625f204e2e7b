"""Index space and grid world: 4x4 matrices in the row-vector convention, ``p @ a_to_b``."""

from collections.abc import Sequence

import numpy as np

from usdsmoke.grids.active_box import active_box
from usdsmoke.volume import DenseField

__all__ = [
    "box_extent",
    "compose",
    "field_extent",
    "index_to_world",
    "invert",
    "is_axis_aligned",
    "voxel_size",
    "voxel_volume",
    "world_to_index",
]


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


def world_to_index(points_xyz: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Positions in index space, [... 3], of positions in grid world; ``matrix`` is index-to-world.

    Raises:
        numpy.linalg.LinAlgError: the matrix has no inverse.
    """
    matrix = np.asarray(matrix, np.float64)
    shifted = np.asarray(points_xyz, np.float64) - matrix[3, :3]
    return shifted @ np.linalg.inv(matrix[:3, :3])


def compose(*matrices: np.ndarray) -> np.ndarray:
    """``a_to_b, b_to_c, ...`` as one matrix ``a_to_...``, [4 4] float64; the first acts first."""
    result = np.eye(4)
    for matrix in matrices:
        result = result @ np.asarray(matrix, np.float64)
    return result


def invert(a_to_b: np.ndarray) -> np.ndarray:
    """``b_to_a`` of an affine matrix, [4 4] float64, with a last column of exactly 0, 0, 0, 1.

    Raises:
        numpy.linalg.LinAlgError: the matrix has no inverse.
    """
    a_to_b = np.asarray(a_to_b, np.float64)
    linear = np.linalg.inv(a_to_b[:3, :3])
    b_to_a = np.eye(4)
    b_to_a[:3, :3] = linear
    b_to_a[3, :3] = -a_to_b[3, :3] @ linear
    return b_to_a


def voxel_size(matrix: np.ndarray) -> np.ndarray:
    """Lengths of a voxel's edges along i, j, k in grid-world units, [3] float64, >= 0."""
    return np.linalg.norm(np.asarray(matrix, np.float64)[:3, :3], axis=1)


def voxel_volume(matrix: np.ndarray) -> float:
    """A voxel's volume in cubed grid-world units, >= 0; a mirrored transform does not matter."""
    return float(abs(np.linalg.det(np.asarray(matrix, np.float64)[:3, :3])))


def is_axis_aligned(matrix: np.ndarray, tolerance: float = 1e-9) -> bool:
    """Whether i, j, k run along x, y, z in some order and direction, so that boxes stay boxes.

    Args:
        matrix: [4 4] index-to-world.
        tolerance: largest share of an edge's length that may point elsewhere.
    """
    linear = np.abs(np.asarray(matrix, np.float64)[:3, :3])
    along = linear > tolerance * linear.max(axis=1, keepdims=True)
    return bool((along.sum(axis=0) == 1).all() and (along.sum(axis=1) == 1).all())


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

"""Two windows' versions of one frame, blended voxel by voxel on the union of their boxes.

Linear in density and in emission, so that mass and light are the blend of both versions' mass and
light. Sums are taken in double precision; where both versions agree their bits stay.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from usdsmoke.base.boxes import union_box, values_in_box
from usdsmoke.base.errors import ShapeError
from usdsmoke.base.volume import DenseField

RISE = 1.2  # power of the place in an overlap: later than half-way through, shares are equal


def tail_weights(n_frames: int) -> list[float]:
    """Weight of the earlier window in each frame of an overlap; the later one has the rest.

    The later one's share rises smoothly: what a step adds is the change of the share times the
    difference of both versions, and the steps at both ends are the largest already (decision 009).

    >>> [round(weight, 3) for weight in tail_weights(3)]
    [0.906, 0.597, 0.206]
    """
    places = (((number + 1) / (n_frames + 1)) ** RISE for number in range(n_frames))
    return [1.0 - place**2 * (3.0 - 2.0 * place) for place in places]


def blend_frames(
    tail: Sequence[DenseField], head: Sequence[DenseField], weight: float
) -> list[DenseField]:
    """One frame from two versions of it: density first, then its emission, if any.

    Emission stays where there is smoke: it becomes 0 where the blended density is not above 0.

    Args:
        tail: fields of the earlier window, [i j k] and [i j k 3].
        head: of the later window: the same grids; gives names, classes and metadata.
        weight: of ``tail``, 0 to 1.

    Raises:
        ShapeError: the versions do not have the same grids on the same lattice.
    """
    if len(tail) != len(head):
        raise ShapeError(
            f"two versions of a frame have {len(tail)} and {len(head)} grids. Run both windows "
            "again."
        )
    density, *others = blend_fields(tail, head, weight)
    return [density, *(_where_smoke_is(density, emission) for emission in others)]


def blend_fields(
    tail: Sequence[DenseField], head: Sequence[DenseField], weight: float
) -> list[DenseField]:
    """Fields of two versions of a frame, each blended by itself; see ``blend_frames``."""
    return [_blend_field(one, other, weight) for one, other in zip(tail, head, strict=True)]


def relative_difference(tail: DenseField, head: DenseField) -> float:
    """||A - B|| over the mean of ||A|| and ||B||, from 0 (equal) to 2; 0 when both are zero.

    Raises:
        ShapeError: the fields are not on the same lattice.
    """
    one, other, _ = _on_union(tail, head)
    sizes = np.linalg.norm(one.ravel()) + np.linalg.norm(other.ravel())
    return float(2 * np.linalg.norm((one - other).ravel()) / sizes) if sizes > 0 else 0.0


def _blend_field(tail: DenseField, head: DenseField, weight: float) -> DenseField:
    one, other, ijk_min = _on_union(tail, head)
    one -= other
    one *= weight
    one += other
    # The background is a constant of the source that neither version changes.
    return dataclasses.replace(head, values=one.astype(np.float32), ijk_min=ijk_min)


def _where_smoke_is(density: DenseField, emission: DenseField) -> DenseField:
    """The emission with zeros wherever the density is not above 0."""
    if density.is_empty or emission.is_empty:
        return emission
    density = dataclasses.replace(density, background=0.0)
    smoke = values_in_box(density, emission.ijk_min, emission.values.shape[:3]) > 0
    values = np.where(smoke[..., None], emission.values, np.float32(0))
    return dataclasses.replace(emission, values=values)


def _on_union(
    tail: DenseField, head: DenseField
) -> tuple[np.ndarray, np.ndarray, tuple[int, int, int]]:
    """Both fields' values on the box that holds both, float64, and where it begins."""
    _check_alike(tail, head)
    ijk_min, shape = union_box((tail, head))
    components = (tail if head.is_empty else head).values.shape[3:]
    one, other = (
        values_in_box(field, ijk_min, (*shape, *components), np.float64) for field in (tail, head)
    )
    return one, other, ijk_min


def _check_alike(tail: DenseField, head: DenseField) -> None:
    same_shape = tail.is_empty or head.is_empty or tail.values.ndim == head.values.ndim
    same_place = np.array_equal(tail.index_to_world, head.index_to_world)
    same_background = np.array_equal(tail.background, head.background)
    if tail.name != head.name or not (same_shape and same_place and same_background):
        raise ShapeError(
            f'grid "{tail.name}" of one version of a frame and "{head.name}" of the other differ '
            "in name, components, transform or background. Run both windows again."
        )

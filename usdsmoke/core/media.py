"""A Volume's fields as rays take them: extinction and light on lattices in stage space."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdsmoke.errors import ShapeError
from usdsmoke.volume import DenseField

__all__ = ["EXTINCTION", "Medium", "make_media"]

EXTINCTION, _EMISSION, _GREY = 0, slice(1, 4), 4  # channels of a medium

# Values [i j k 5], index of the first of them, and the lattice's place on the stage.
_Box = tuple[np.ndarray, tuple[int, int, int], np.ndarray]


@dataclass(frozen=True)
class Medium:
    """Smoke on one lattice, as the rays see it."""

    # [i j k 5]: extinction in 1/stage unit, emitted RGB and the colourless light of grey smoke in
    # radiance/stage unit; float32, empty outside
    values: np.ndarray
    index_to_stage: np.ndarray  # [4 4], from the array's own indices


def make_media(
    density: DenseField,
    emission: DenseField | None,
    to_stage: np.ndarray,
    emission_to_stage: np.ndarray | None,
    gamma_w: float,
    grey: float,
) -> list[Medium]:
    """A Volume's fields as media: one where the two share their voxels, else one each.

    Args:
        density: [i j k]; negative values count as none.
        emission: [i j k 3], radiance per stage unit; None lets the smoke glow evenly in grey.
        to_stage, emission_to_stage: [4 4], grid world to stage; the second with an emission only.
        gamma_w: extinction per density, 1/stage unit.
        grey: scene-linear light of thick smoke without emission.

    Raises:
        ShapeError: a field lies on the stage flattened, so that no ray can be followed through it.
    """
    sigma = np.float32(gamma_w) * np.maximum(density.values, 0, dtype=np.float32)
    smoke = np.zeros((*sigma.shape, 5), np.float32)
    smoke[..., EXTINCTION] = sigma
    if emission is None:
        smoke[..., _GREY] = np.float32(grey) * sigma
    boxes = [(smoke, density.ijk_min, _lattice(density, to_stage))]
    if emission is not None and emission_to_stage is not None:
        light = np.zeros((*emission.values.shape[:3], 5), np.float32)
        light[..., _EMISSION] = emission.values
        boxes.append((light, emission.ijk_min, _lattice(emission, emission_to_stage)))
    boxes = [box for box in boxes if box[0].size]
    if len(boxes) == 2 and np.allclose(boxes[0][2], boxes[1][2], rtol=1e-12, atol=0):
        boxes = [_merged(boxes[0], boxes[1])]
    return [Medium(values, _moved(first) @ lattice) for values, first, lattice in boxes]


def _lattice(field: DenseField, to_stage: np.ndarray) -> np.ndarray:
    """[4 4] from the grid's indices to the stage."""
    matrix = np.asarray(field.index_to_world, float) @ np.asarray(to_stage, float)
    if not abs(np.linalg.det(matrix[:3, :3])) > 0:  # nor with NaN
        raise ShapeError(
            f'the grid "{field.name}" is flattened where it stands on the stage; wanted a '
            "transform that can be inverted: correct the scale of its field prim and its parents"
        )
    return matrix


def _moved(first: Sequence[int]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[3, :3] = first
    return matrix


def _merged(one: _Box, other: _Box) -> _Box:
    """Both on the box that holds them: they share their voxels."""
    ends = [np.add(first, values.shape[:3]) for values, first, _ in (one, other)]
    low = np.minimum(one[1], other[1])
    whole = np.zeros((*(np.maximum(*ends) - low), 5), np.float32)
    for values, first, _ in (one, other):
        i, j, k = np.subtract(first, low)
        whole[i : i + values.shape[0], j : j + values.shape[1], k : k + values.shape[2]] += values
    return whole, (int(low[0]), int(low[1]), int(low[2])), one[2]

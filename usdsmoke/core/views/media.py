"""A Volume's fields as rays take them: extinction and light on lattices in stage space."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdsmoke.base.errors import ShapeError
from usdsmoke.base.volume import DenseField

EXTINCTION, _EMISSION, _GREY = 0, slice(1, 4), 4  # channels of a medium
LIGHT = slice(1, 5)  # emission and grey

_THICKEST = 1e30  # extinction; thicker smoke hides what is behind it no better


@dataclass(frozen=True)
class Medium:
    """Smoke on one lattice, as the rays see it."""

    # [i j k 5]: extinction in 1/stage unit, emitted RGB and the colourless light of grey smoke in
    # radiance/stage unit; float32. The outermost layer is empty, and so is all outside.
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
        density: [i j k]; negative values are taken as 0.
        emission: [i j k 3], radiance per stage unit; None lets the smoke glow evenly in grey.
        to_stage, emission_to_stage: [4 4], grid world to stage; the second with an emission only.
        gamma_w: extinction per density, 1/stage unit.
        grey: scene-linear light of thick smoke without emission.

    Raises:
        ShapeError: an emission without its place, or a field that lies on the stage flattened,
            so that no ray can be followed through it.
    """
    if (emission is None) != (emission_to_stage is None):
        raise ShapeError("emission and emission_to_stage belong together. Pass both or neither.")
    fields = [density] if emission is None else [density, emission]
    places = [to_stage] if emission_to_stage is None else [to_stage, emission_to_stage]
    lattices = [_lattice(*item) for item in zip(fields, places, strict=True)]
    groups = [[field] for field in fields]
    if len(fields) == 2 and np.allclose(lattices[0], lattices[1], rtol=1e-12, atol=0):
        groups = [fields]
    media = []
    for group, lattice in zip(groups, lattices, strict=False):
        filled = [field for field in group if not field.is_empty]
        if filled:
            values, first = _filled(filled, density, gamma_w, grey if emission is None else 0.0)
            media.append(Medium(values, _moved(first) @ lattice))
    return media


def _filled(
    fields: Sequence[DenseField], density: DenseField, gamma_w: float, grey: float
) -> tuple[np.ndarray, np.ndarray]:
    """Fields of one lattice on the box that holds them and one layer more; its first index."""
    low = np.min([field.ijk_min for field in fields], axis=0)
    high = np.max([np.add(field.ijk_min, field.values.shape[:3]) for field in fields], axis=0)
    values = np.zeros((*(high - low + 2), 5), np.float32)
    for field in fields:
        start = np.subtract(field.ijk_min, low) + 1
        i, j, k = (slice(a, a + n) for a, n in zip(start, field.values.shape[:3], strict=True))
        if field is density:
            values[i, j, k, EXTINCTION] = _extinction(density, gamma_w)
            values[i, j, k, _GREY] = np.float32(grey) * values[i, j, k, EXTINCTION]
        else:
            values[i, j, k, _EMISSION] = field.values
    return values, low - 1


def _extinction(density: DenseField, gamma_w: float) -> np.ndarray:
    """[i j k] float32, 1/stage unit."""
    most = _THICKEST / max(gamma_w, 1.0)
    sigma: np.ndarray = np.float32(gamma_w) * np.clip(density.values, 0, most)
    return sigma.astype(np.float32, copy=False)


def _lattice(field: DenseField, to_stage: np.ndarray) -> np.ndarray:
    """[4 4] from the grid's indices to the stage."""
    matrix = np.asarray(field.index_to_world, float) @ np.asarray(to_stage, float)
    if not abs(np.linalg.det(matrix[:3, :3])) > 0:  # nor with NaN
        raise ShapeError(
            f'the transform of grid "{field.name}" to the stage flattens space and cannot be '
            "inverted. Correct the scale of its field prim and its parents."
        )
    return matrix


def _moved(first: np.ndarray) -> np.ndarray:
    """[4 4] that adds the index of an array's first voxel."""
    matrix = np.eye(4)
    matrix[3, :3] = first
    return matrix

"""A Volume's fields as rays take them: extinction and light on lattices in stage space."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdsmoke.base.errors import ShapeError
from usdsmoke.base.volume import DenseField, is_same_transform

_THICKEST = 1e30  # extinction; thicker smoke hides what is behind it no better


@dataclass(frozen=True)
class Medium:
    """Smoke on one lattice, as the rays see it.

    The outermost layer of voxels is empty, and so is all outside.
    """

    extinction: np.ndarray  # [i j k] float32, 1/stage unit
    emission: np.ndarray | None  # [3 i j k] float32, RGB, radiance/stage unit
    grey: float  # colourless light per extinction
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
    if len(fields) == 2 and is_same_transform(lattices[0], lattices[1]):
        groups = [fields]
    media = []
    for group, lattice in zip(groups, lattices, strict=False):
        filled = [field for field in group if not field.is_empty]
        if filled:
            look = (gamma_w, grey if emission is None else 0.0)
            media.append(_medium(filled, density, lattice, look))
    return media


def _medium(
    fields: Sequence[DenseField],
    density: DenseField,
    lattice: np.ndarray,
    look: tuple[float, float],
) -> Medium:
    """Fields of one lattice on the box that holds them and one layer more.

    Args:
        look: extinction per density and grey of the smoke.
    """
    gamma_w, grey = look
    low = np.min([field.ijk_min for field in fields], axis=0)
    high = np.max([np.add(field.ijk_min, field.values.shape[:3]) for field in fields], axis=0)
    shape = tuple((high - low + 2).tolist())
    extinction, emission = np.zeros(shape, np.float32), None
    for field in fields:
        start = np.subtract(field.ijk_min, low) + 1
        i, j, k = (slice(a, a + n) for a, n in zip(start, field.values.shape[:3], strict=True))
        if field is density:
            extinction[i, j, k] = _extinction(density, gamma_w)
        else:
            emission = np.zeros((3, *shape), np.float32)
            emission[:, i, j, k] = np.moveaxis(field.values, -1, 0)
    return Medium(extinction, emission, grey, _moved(low - 1) @ lattice)


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

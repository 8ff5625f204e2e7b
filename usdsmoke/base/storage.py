"""What a VDB file keeps of computed values: rounding to 16-bit floats, and the loss."""

import dataclasses
import time
from collections.abc import Sequence

import numpy as np

from usdsmoke.base.errors import ConfigError
from usdsmoke.base.frame_report import Estimate, FrameErrors
from usdsmoke.base.volume import DenseField

LARGEST_HALF = 65504.0  # largest finite 16-bit float
MOST_LOST = 0.01  # of a copied field; 16-bit floats lose up to 0.05 % of numbers above 6e-5


def round_to_half(values: np.ndarray) -> np.ndarray:
    """The nearest 16-bit floats as float32; beyond ``LARGEST_HALF`` infinite."""
    return values.astype(np.float16).astype(np.float32)


def clip_to_smoke(field: DenseField, density: DenseField) -> DenseField:
    """The field with its background farther than two voxels from all smoke.

    A voxel is as wide as the wider one of both grids: readers interpolate between voxels, and
    renderers sample what moves beside where it is.

    Args:
        field: on voxels of its own, in the density's place.
        density: smoke is where it differs from its background.
    """
    if field.is_empty or density.is_empty:
        return dataclasses.replace(field, values=field.values[:0, :0, :0])
    smoke = np.argwhere(density.values != density.background) + density.ijk_min
    to_field = density.index_to_world @ np.linalg.inv(field.index_to_world)
    places = smoke @ to_field[:3, :3] + to_field[3, :3] - field.ijk_min
    margin = np.ceil(2 * np.maximum(np.abs(to_field[:3, :3]).sum(axis=0), 1)).astype(int)
    shape = np.array(field.values.shape[:3])
    near = np.zeros(shape + 2 * margin, bool)
    nearest = np.round(places).astype(int) + margin
    inside = ((nearest >= 0) & (nearest < near.shape)).all(axis=1)
    near[tuple(nearest[inside].T)] = True
    for axis, reach in enumerate(margin):
        shifted = [np.roll(near, step, axis) for step in range(-reach, reach + 1)]
        near = np.logical_or.reduce(shifted)
    near = near[tuple(slice(m, m + n) for m, n in zip(margin, shape, strict=True))]
    mask = near[..., None] if field.values.ndim == 4 else near
    background = np.asarray(field.background, np.float32)
    return dataclasses.replace(field, values=np.where(mask, field.values, background))


def check_half(time_code: float, densest: float, brightest: float) -> None:
    """Refuse 16-bit floats that cannot hold what a frame will have.

    Args:
        time_code: of the frame.
        densest: the largest density.
        brightest: the largest number of the emission; 0 without one.

    Raises:
        ConfigError: with the largest number and the one that can be held.
    """
    for name, bound in {"density": densest, "emission": brightest}.items():
        if bound > LARGEST_HALF:
            raise ConfigError(
                f"16-bit floats hold numbers up to {LARGEST_HALF:g}, but the {name} at timeCode "
                f"{time_code:g} reaches up to {bound:g}. Unset grids.half (--half)."
            )


def check_half_copy(grids: Sequence[DenseField], remedy: str) -> None:
    """Refuse 16-bit floats that cannot hold a field that is copied.

    Args:
        grids: of one field: one, or three of a velocity.
        remedy: what to do.

    Raises:
        ConfigError: with the largest number and the one that can be held, or the share of small
            numbers that is lost.
    """
    if not grids:
        return
    name = " ".join(grid.name for grid in grids)
    numbers = [grid.values.ravel() for grid in grids]
    largest = max(float(np.abs(n).max(initial=0.0)) for n in numbers)
    held = max([largest, *(float(np.abs(grid.background).max()) for grid in grids)])
    if held > LARGEST_HALF:
        raise ConfigError(
            f"16-bit floats hold numbers up to {LARGEST_HALF:g}, but the copied field "
            f'"{name}" reaches {held:g}. {remedy}'
        )
    values = np.concatenate(numbers)
    lost = _difference(values, values, half=True)
    if not lost <= MOST_LOST:
        raise ConfigError(
            f'16-bit floats lose numbers below 3e-8: {lost:.0%} of the copied field "{name}", '
            f"which reaches {largest:g}. {remedy}"
        )


def storage_errors(
    fields: Sequence[DenseField],
    kept: Sequence[DenseField],
    half: bool,
    others: FrameErrors | None = None,
) -> FrameErrors:
    """How far what a file holds is from what was computed, relative to that.

    Sum of absolute differences over sum of absolute values, voxel by voxel; 0 where everything is
    kept in 32-bit floats.

    Args:
        fields: density and, after a colour step, emission, before they are pruned.
        kept: the same, pruned.
        half: whether the file holds 16-bit floats.
        others: errors of the frame that are kept; None: there are none.
    """
    found: dict[str, Estimate] = {}
    names = ("storage_density", "storage_emission")
    for name, field, stored in zip(names, fields, kept, strict=False):
        started = time.perf_counter()
        lost = 0.0
        if half or stored is not field:
            lost = _difference(field.values, stored.values, half)
        found[name] = Estimate(lost, time.perf_counter() - started)
    return dataclasses.replace(others or FrameErrors(), **found)


def _difference(values: np.ndarray, kept: np.ndarray, half: bool) -> float:
    size = float(np.abs(values).sum(dtype=np.float64))
    if size == 0:
        return 0.0
    if half:  # what is too large is refused when it is written
        kept = round_to_half(kept.clip(-LARGEST_HALF, LARGEST_HALF))
    return float(np.abs(values - kept).sum(dtype=np.float64)) / size

"""What a VDB file keeps of computed values: pruning, and rounding to 16-bit floats."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from usdsmoke.base.errors import ConfigError
from usdsmoke.base.settings import Config
from usdsmoke.base.volume import DenseField

LARGEST_HALF = 65504.0  # largest finite 16-bit float


def round_to_half(values: np.ndarray) -> np.ndarray:
    """The nearest 16-bit floats as float32; beyond ``LARGEST_HALF`` infinite."""
    return values.astype(np.float16).astype(np.float32)


def prune_fields(fields: Sequence[DenseField], prune: float) -> list[DenseField]:
    """The fields with their background wherever there is too little smoke.

    Args:
        fields: density first; the others are on the same voxels.
        prune: density at or below which a voxel is left out; 0 gives the fields back.
    """
    if prune <= 0 or fields[0].is_empty:
        return list(fields)
    smoke = fields[0].values > prune
    found = []
    for field in fields:
        mask = smoke[..., None] if field.values.ndim == 4 else smoke
        background = np.asarray(field.background, np.float32)
        found.append(dataclasses.replace(field, values=np.where(mask, field.values, background)))
    return found


def check_half(density: DenseField, time_code: float, gamma_w: float, config: Config) -> None:
    """Refuse 16-bit floats that cannot hold what a frame will have.

    Colours are at most 1, so no emission is above gamma_w times the largest density, divided by the
    exposure.

    Args:
        density: of the frame.
        time_code: of the frame.
        gamma_w: extinction per density, 1/stage unit.
        config: grids and steps.

    Raises:
        ConfigError: with the largest number and the one that can be held.
    """
    if not config.grids.half:
        return
    largest = float(density.values.max(initial=0.0))
    bounds = {"density": largest}
    if "colour" in config.optimize.steps:
        exposure = 2.0 ** (config.optics.exposure or 0.0)
        bounds["emission"] = gamma_w * largest * config.optimize.strength / exposure
    for name, bound in bounds.items():
        if bound > LARGEST_HALF:
            raise ConfigError(
                f"16-bit floats hold numbers up to {LARGEST_HALF:g}, but the {name} at timeCode "
                f"{time_code:g} reaches up to {bound:g}. Unset grids.half (--half)."
            )

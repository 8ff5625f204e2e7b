"""What pruning and 16-bit floats do to a result's values: measured, not estimated."""

import dataclasses
import time
from collections.abc import Sequence

import numpy as np

from usdsmoke.base.errors import ConfigError
from usdsmoke.base.frame_report import Estimate, FrameErrors
from usdsmoke.base.sections import GridsConfig
from usdsmoke.base.settings import Config
from usdsmoke.base.volume import DenseField

_LARGEST_HALF = 65504.0


def pruned(fields: Sequence[DenseField], prune: float) -> list[DenseField]:
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
    """Raises ConfigError if 16-bit floats cannot hold what a frame will have.

    Colours are at most 1, so no emission is above gamma_w times the largest density.

    Args:
        density: of the frame.
        time_code: of the frame.
        gamma_w: extinction per density, 1/stage unit.
        config: grids and steps.
    """
    if not config.grids.half:
        return
    largest = float(density.values.max(initial=0.0))
    bounds = {"density": largest}
    if "colour" in config.optimize.steps:
        bounds["emission"] = gamma_w * largest * config.optimize.strength
    for name, bound in bounds.items():
        if bound > _LARGEST_HALF:
            raise ConfigError(
                f"16-bit floats hold numbers up to {_LARGEST_HALF:g}, but the {name} at timeCode "
                f"{time_code:g} reaches up to {bound:g}. Unset grids.half (--half)."
            )


def storage_errors(
    fields: Sequence[DenseField],
    config: GridsConfig,
    others: FrameErrors | None = None,
    kept: Sequence[DenseField] | None = None,
) -> FrameErrors:
    """How far what a file holds is from what was computed, relative to that.

    Sum of absolute differences over sum of absolute values, voxel by voxel; 0 where everything is
    kept in 32-bit floats.

    Args:
        fields: density and, after a colour step, emission, before they are pruned.
        config: ``half`` and ``prune``.
        others: errors of the frame that are kept; None: there are none.
        kept: the fields from ``pruned``, where they are at hand.
    """
    found: dict[str, Estimate] = {}
    names = ("storage_density", "storage_emission")
    kept = pruned(fields, config.prune) if kept is None else kept
    for name, field, stored in zip(names, fields, kept, strict=False):
        started = time.perf_counter()
        lost = 0.0
        if config.prune > 0 or config.half:
            lost = _difference(field.values, stored.values, config.half)
        found[name] = Estimate(lost, time.perf_counter() - started)
    return dataclasses.replace(others or FrameErrors(), **found)


def _difference(values: np.ndarray, kept: np.ndarray, half: bool) -> float:
    size = float(np.abs(values).sum(dtype=np.float64))
    if size == 0:
        return 0.0
    if half:  # what is too large is refused when it is written
        kept = kept.clip(-_LARGEST_HALF, _LARGEST_HALF).astype(np.float16).astype(np.float32)
    return float(np.abs(values - kept).sum(dtype=np.float64)) / size

"""What pruning and 16-bit floats do to a result's values: measured, not estimated."""

import dataclasses
import time
from collections.abc import Sequence

import numpy as np

from usdsmoke.base.frame_report import Estimate, FrameErrors
from usdsmoke.base.sections import GridsConfig
from usdsmoke.base.storage import LARGEST_HALF, prune_fields, round_to_half
from usdsmoke.base.volume import DenseField


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
        kept: the fields from ``prune_fields``, where they are at hand.
    """
    found: dict[str, Estimate] = {}
    names = ("storage_density", "storage_emission")
    kept = prune_fields(fields, config.prune) if kept is None else kept
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
        kept = round_to_half(kept.clip(-LARGEST_HALF, LARGEST_HALF))
    return float(np.abs(values - kept).sum(dtype=np.float64)) / size

"""Lengths on a stage: what one unit of a Volume's own space is in stage units."""

import math
from collections.abc import Iterable

import numpy as np
from pxr import Usd, UsdGeom

from usdsmoke.usd.field_samples import field_targets, target_prim
from usdsmoke.usd.schema import STAGE_UNITS

_METRES = "metersPerUnit"
_EVEN = 1.0001  # of the largest scale, as a multiple of the smallest


def stage_units(prim: Usd.Prim, time_code: float) -> float:
    """Stage units in one unit of a prim's space, as a geometric mean; 1 for a flattened one."""
    matrix = UsdGeom.XformCache(time_code).GetLocalToWorldTransform(prim)
    return float(abs(matrix.GetDeterminant3()) ** (1 / 3)) or 1.0


def is_stretched(prim: Usd.Prim) -> bool:
    """Whether the first scale from a prim's space to the stage differs along its axes."""
    first = Usd.TimeCode.EarliestTime()
    matrix = np.array(UsdGeom.XformCache(first).GetLocalToWorldTransform(prim))[:3, :3]
    sizes = np.linalg.svd(matrix, compute_uv=False)
    return bool(sizes[0] > _EVEN * sizes[2])


def stage_units_over_time(
    prim: Usd.Prim, first: float, time_codes: Iterable[float]
) -> tuple[float, dict[float, float]]:
    """The same at ``first``, and at all of ``time_codes`` if it changes; else no others."""
    default = stage_units(prim, first)
    samples = {code: stage_units(prim, code) for code in time_codes}
    changes = any(value != default for value in samples.values())
    return default, samples if changes else {}


def units_since(volume: Usd.Prim) -> tuple[float, float]:
    """How the units that a Volume's look was made for have changed since, at its first timeCode.

    Returns:
        How many times as many stage units a length of the Volume is, and how many times as long a
        stage unit is; 1 where nothing is known. The latter is known from the look's layer, and not
        from a flattened one.
    """
    stage, attribute = volume.GetStage(), volume.GetAttribute(STAGE_UNITS)
    if not attribute or not attribute.HasAuthoredValue():
        return 1.0, 1.0
    first = _first_time(volume, attribute)
    made_for = attribute.Get(first)
    if not made_for or not (math.isfinite(made_for) and made_for > 0):
        return 1.0, 1.0
    scale = stage_units(volume, first.GetValue()) / float(made_for)
    layer = attribute.GetPropertyStack(first)[0].layer
    metres = layer.pseudoRoot.GetInfo(_METRES) if layer.pseudoRoot.HasInfo(_METRES) else 0.0
    return scale, UsdGeom.GetStageMetersPerUnit(stage) / metres if metres > 0 else 1.0


def _first_time(volume: Usd.Prim, attribute: Usd.Attribute) -> Usd.TimeCode:
    """The first sample of a look's attribute; where it has one value, that of the fields' files.

    Before it, the Volume may have had any scale.
    """
    codes = list(attribute.GetTimeSamples())
    if not codes:
        for targets in field_targets(volume).values():
            prim = target_prim(volume.GetStage(), targets)
            files = prim.GetAttribute("filePath") if prim is not None else None
            codes += files.GetTimeSamples() if files else []
    return Usd.TimeCode(min(codes)) if codes else Usd.TimeCode.EarliestTime()

"""Lengths on a stage: what one unit of a Volume's own space is in stage units."""

from collections.abc import Iterable

from pxr import Usd, UsdGeom


def stage_units(prim: Usd.Prim, time_code: float) -> float:
    """Stage units in one unit of a prim's space, as a geometric mean; 1 for a flattened one."""
    matrix = UsdGeom.XformCache(time_code).GetLocalToWorldTransform(prim)
    return float(abs(matrix.GetDeterminant3()) ** (1 / 3)) or 1.0


def stage_units_over_time(
    prim: Usd.Prim, first: float, time_codes: Iterable[float]
) -> tuple[float, dict[float, float]]:
    """The same at ``first``, and at all of ``time_codes`` if it changes; else no others."""
    default = stage_units(prim, first)
    samples = {code: stage_units(prim, code) for code in time_codes}
    changes = any(value != default for value in samples.values())
    return default, samples if changes else {}

"""What a stage's Volumes show at any timeCode, between time samples too, as a renderer sees it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pxr import Sdf, Usd, UsdGeom, UsdVol

from usdsmoke.base.errors import StageError
from usdsmoke.base.naming import EMISSION
from usdsmoke.base.time_codes import format_time_code
from usdsmoke.base.volume import FieldSource, LightSource, Scattering, StageSource
from usdsmoke.usd.field_samples import field_targets
from usdsmoke.usd.schema import (
    ALBEDO,
    ANISOTROPY,
    BOUNCES,
    EMISSION_MODE,
    EXPOSURE,
    EXTINCTION_PER_DENSITY,
    LIGHTS,
    SCATTER_FIELD,
    STAGE_UNITS,
)
from usdsmoke.usd.stage.fields import check_assets, field_source
from usdsmoke.usd.stage.lights import read_lights
from usdsmoke.usd.units import stage_units
from usdsmoke.usd.values import value_at

_SAME_SCALE = 1e-6  # relative difference that single precision leaves


@dataclass(frozen=True)
class ComposedVolume:
    """What a Volume shows at one timeCode, between time samples too."""

    prim_path: str
    density: FieldSource
    emission: FieldSource | None  # None: it has no such field, or a gap there
    extinction: float | None  # usdSmoke:extinctionPerDensity, rescaled; None if not authored
    emission_mode: str = ""  # usdSmoke:emissionMode; "" if not authored
    # Of the stage that the look was made for: its units in one stage unit. The emission is per unit
    # of that stage.
    rescale: float = 1.0
    scattering: Scattering | None = None  # where its look was made for lights
    stops: float = 0.0  # exposure that the look was made for, usdSmoke:exposure
    colour: FieldSource | None = None  # its scattering colour; None: every voxel scatters alike


def composed_volumes(
    stage: Usd.Stage, source: StageSource, time_code: float
) -> list[ComposedVolume]:
    """What the Volumes show at a timeCode; hidden ones and those in a gap are left out.

    Unlike ``find_volumes``, which lists timeCodes that are authored, this holds values between
    time samples and outside them, as a renderer would.

    Args:
        time_code: any.

    Raises:
        AssetNotResolved: a file cannot be read from disk.
        StageError: an extinction per density is negative or not finite.
    """
    xforms = UsdGeom.XformCache(time_code)
    composed = []
    for volume in source.volumes:
        prim = stage.GetPrimAtPath(volume.prim_path)
        if UsdGeom.Imageable(prim).ComputeVisibility(time_code) == UsdGeom.Tokens.invisible:
            continue
        density = _composed_field(prim, volume.density, time_code, xforms)
        if density is None:
            continue
        light = _composed_field(prim, EMISSION, time_code, xforms)
        colour = str(_authored(prim, SCATTER_FIELD, time_code) or "")
        extinction, rescale = _extinction(prim, time_code), _rescale(prim, time_code)
        composed.append(
            ComposedVolume(
                volume.prim_path,
                density,
                light,
                None if extinction is None else extinction * rescale,
                str(_authored(prim, EMISSION_MODE, time_code) or ""),
                rescale,
                _scattering(prim, time_code),
                float(_authored(prim, EXPOSURE, time_code) or 0),
                None if not colour else _composed_field(prim, colour, time_code, xforms),
            )
        )
    return composed


def _composed_field(
    volume: Usd.Prim, name: str, time_code: float, xforms: UsdGeom.XformCache
) -> FieldSource | None:
    targets: list[Sdf.Path] = field_targets(volume).get(name, [])
    prim = volume.GetStage().GetPrimAtPath(targets[0]) if len(targets) == 1 else None
    if not prim or not prim.IsA(UsdVol.OpenVDBAsset):
        return None
    found = field_source(name, prim, time_code, xforms)
    if found is not None:
        check_assets(prim, [found])
    return found


def _authored(prim: Usd.Prim, name: str, time_code: float) -> Any:
    """An attribute's value; None for the schema's fallback, which says nothing about this smoke."""
    attribute = prim.GetAttribute(name)
    return value_at(attribute, time_code) if attribute and attribute.HasAuthoredValue() else None


def _rescale(prim: Usd.Prim, time_code: float) -> float:
    """1 where the Volume's scale is the one that its look was made for, or has no look."""
    made_for = _authored(prim, STAGE_UNITS, time_code)
    if not made_for or not (math.isfinite(made_for) and made_for > 0):
        return 1.0
    ratio = float(made_for) / stage_units(prim, time_code)
    return 1.0 if abs(ratio - 1) < _SAME_SCALE else ratio


def _scattering(prim: Usd.Prim, time_code: float) -> Scattering | None:
    albedo, anisotropy = (float(_authored(prim, n, time_code) or 0) for n in (ALBEDO, ANISOTROPY))
    if not (0 <= albedo <= 1 and -1 < anisotropy < 1):
        raise StageError(
            f"<{prim.GetPath()}> has {ALBEDO} {albedo:g} and {ANISOTROPY} {anisotropy:g}. Set an "
            "albedo from 0 to 1 and an anisotropy between -1 and 1."
        )
    if not albedo:
        return None
    named = _authored(prim, LIGHTS, time_code)
    if named:
        lights = _recorded_lights(named)
    else:
        lights = read_lights(prim.GetStage(), str(prim.GetPath()), time_code)
    if _authored(prim, SCATTER_FIELD, time_code):
        albedo = 1.0  # the field's colours are the albedo
    bounces = bool(_authored(prim, BOUNCES, time_code))
    return Scattering(lights, albedo, anisotropy, bounces) if lights else None


def _recorded_lights(named: Sequence[Sequence[float]]) -> tuple[LightSource, ...]:
    """The lights that the look's settings named: direction and colour in turn."""
    found = []
    for way, colour in zip(named[::2], named[1::2], strict=False):
        (x, y, z), (red, green, blue) = (map(float, triple) for triple in (way, colour))
        towards = None if x == y == z == 0 else (x, y, z)
        found.append(LightSource(LIGHTS, (red, green, blue), towards))
    return tuple(found)


def _extinction(prim: Usd.Prim, time_code: float) -> float | None:
    value = _authored(prim, EXTINCTION_PER_DENSITY, time_code)
    if value is None:
        return None
    if not (math.isfinite(value) and value >= 0):
        raise StageError(
            f"<{prim.GetPath()}> has {EXTINCTION_PER_DENSITY} {value:g} at timeCode "
            f"{format_time_code(time_code)}. Set a number of 0 or more, or "
            "remove the attribute."
        )
    return float(value)

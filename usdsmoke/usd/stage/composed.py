"""What a stage's Volumes show at any timeCode, with their look or without it."""

import math
import os
from typing import Any

from pxr import Sdf, Usd, UsdGeom, UsdVol

from usdsmoke.base.errors import StageError
from usdsmoke.base.time_codes import format_time_code
from usdsmoke.base.volume import FieldSource, ShownVolume, StageSource
from usdsmoke.usd.relationships import field_targets
from usdsmoke.usd.schema import EMISSION_MODE, EXTINCTION_PER_DENSITY
from usdsmoke.usd.stage.assets import check_assets, field_source
from usdsmoke.usd.stage.opening import open_stage
from usdsmoke.usd.stage.originals import is_look_layer, leave_looks_out

__all__ = ["open_original", "shown_volumes"]


def shown_volumes(
    stage: Usd.Stage, source: StageSource, time_code: float, emission: str = "emission"
) -> list[ShownVolume]:
    """What the Volumes show at a timeCode; hidden ones and those in a gap are left out.

    Unlike ``find_volumes``, which lists timeCodes that are authored, this holds values between
    time samples and outside them, as a renderer would.

    Args:
        stage: from ``open_stage``.
        source: which Volumes, and what their density is called.
        time_code: any.
        emission: relationship name of the emission.

    Raises:
        AssetNotResolved: a file cannot be read from disk.
        StageError: an extinction per density is negative or not finite.
    """
    xforms = UsdGeom.XformCache(time_code)
    shown = []
    for volume in source.volumes:
        prim = stage.GetPrimAtPath(volume.prim_path)
        if UsdGeom.Imageable(prim).ComputeVisibility(time_code) == UsdGeom.Tokens.invisible:
            continue
        density = _shown_field(prim, volume.density, time_code, xforms)
        if density is None:
            continue
        light = _shown_field(prim, emission, time_code, xforms)
        shown.append(
            ShownVolume(
                volume.prim_path,
                density,
                light,
                _extinction(prim, time_code),
                str(_authored(prim, EMISSION_MODE, time_code) or ""),
            )
        )
    return shown


def open_original(file_path: str | os.PathLike[str]) -> Usd.Stage:
    """The stage as it is without usdsmoke's looks.

    Of an asset the variant without a look is selected, in the session layer; look layers that are
    in use after that are muted.

    Raises:
        StageError: the stage cannot be opened, no layer of it was made by usdsmoke, or its root
            layer was, which cannot be muted.
    """
    stage = open_stage(file_path)
    if is_look_layer(stage.GetRootLayer()):
        raise StageError(
            f"{os.fspath(file_path)} is a look layer itself, and a stage's root layer cannot be "
            "muted; wanted the root stage that was written beside it, NAME_look.usda"
        )
    if not leave_looks_out(stage).layers:
        raise StageError(
            f"no layer of the stage {os.fspath(file_path)} was made by usdsmoke, so there is no "
            "look to compare with; wanted a root stage such as NAME_look.usda: leave out --compare"
        )
    return stage


def _shown_field(
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
    return attribute.Get(time_code) if attribute and attribute.HasAuthoredValue() else None


def _extinction(prim: Usd.Prim, time_code: float) -> float | None:
    value = _authored(prim, EXTINCTION_PER_DENSITY, time_code)
    if value is None:
        return None
    if not (math.isfinite(value) and value >= 0):
        raise StageError(
            f"<{prim.GetPath()}> has {EXTINCTION_PER_DENSITY} {value:g} at timeCode "
            f"{format_time_code(time_code)}; wanted a number, 0 or more: correct or remove it"
        )
    return float(value)

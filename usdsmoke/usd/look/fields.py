"""The prims that carry the result's fields, and the opinions on them.

A prim is the source's own where that is safe, else a new one. It shows our files where the result
is, and what the source has elsewhere.

Time samples of one attribute never merge across layers: the strongest layer that has any supplies
all of them. So the look authors every timeCode of the source, and re-authors the source's own value
at those that were not stylized. Values are held in between, as USD holds them; a timeCode that only
a weaker attribute has shows what the density's timeCode before it shows.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdVol

from usdsmoke.base.errors import LayerError, StageError
from usdsmoke.base.naming import COLOUR_CHANNELS, COLOUR_VECTORS, relative_asset_path
from usdsmoke.base.volume import is_same_transform
from usdsmoke.usd.field_samples import FIELD_PREFIX, FieldSamples, field_targets
from usdsmoke.usd.look.records import StylizedVolume
from usdsmoke.usd.values import asset_value, value_at


@dataclass(frozen=True)
class FieldTarget:
    """The prim that a field of the result is authored on."""

    relationship: str  # without field:
    grid_name: str
    prim_path: Sdf.Path
    source: Usd.Prim | None  # shows the field where the result does not; None: nothing does
    is_new: bool  # defined by the look, and the relationship is pointed to it
    beside: Usd.Prim  # the density's field prim, whose xform a new prim shares


def count_field_uses(stage: Usd.Stage) -> dict[Sdf.Path, int]:
    """How many field relationships of all Volumes, instances included, lead to each prim."""
    uses: dict[Sdf.Path, int] = {}
    predicate = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
    for prim in Usd.PrimRange.Stage(stage, predicate):
        if not prim.IsA(UsdVol.Volume):
            continue
        for path in chain.from_iterable(field_targets(prim).values()):
            uses[path] = uses.get(path, 0) + 1
    return uses


def choose_field_prims(
    stage: Usd.Stage,
    volume: StylizedVolume,
    uses: Mapping[Sdf.Path, int],
    taken: set[Sdf.Path],
) -> list[FieldTarget]:
    """A prim for every field of a result, the density first.

    The source's field prim is overridden in place unless other Volumes show it too, or the Volume
    by another name than that of its grid; they must keep what they have. A new
    prim is a sibling of the density's field prim and copies its xform ops, so that the two share
    their place in space at every moment. A colour field that the source has already is kept up only
    where it lies in that same place.

    Args:
        taken: paths of prims that the look defines already; new ones are added.

    Raises:
        LayerError: the stage is not the one that was read.
    """
    prim = stage.GetPrimAtPath(volume.source.prim_path)
    density = _field_prim(prim, volume.source.density)
    if density is None:
        raise LayerError(
            f"Volume <{volume.source.prim_path}> has lost its density field since it was read. "
            "Open the stage again."
        )
    names = sorted(volume.grids, key=lambda name: (name != volume.source.density, name))
    targets = []
    for name in names:
        source = _field_prim(prim, name)
        is_colour = name in (*COLOUR_VECTORS, *COLOUR_CHANNELS) and name != volume.source.density
        if is_colour and source is not None and not _same_place(source, density, volume):
            source = None
        is_new = source is None or uses.get(source.GetPath(), 0) > _own_uses(prim, source, name)
        if source is None or is_new:
            path = _free_path(density, name, prim, taken)
            taken.add(path)
        else:
            path = source.GetPath()
        targets.append(FieldTarget(name, volume.grids[name], path, source, is_new, density))
    return targets


def _field_prim(volume: Usd.Prim, name: str) -> Usd.Prim | None:
    relationship = volume.GetRelationship(FIELD_PREFIX + name)
    targets = relationship.GetForwardedTargets() if relationship else []
    if len(targets) != 1:
        return None
    prim = volume.GetStage().GetPrimAtPath(targets[0])
    usable = prim and prim.IsA(UsdVol.OpenVDBAsset) and not prim.IsInstanceProxy()
    return prim if usable else None


def _own_uses(volume: Usd.Prim, field: Usd.Prim, name: str) -> int:
    """Relationships of a Volume that give a field under its name or that of its grid."""
    grid = FieldSamples(field).at(None).grid_name
    names = [other for other, paths in field_targets(volume).items() if paths == [field.GetPath()]]
    return len({name, *([grid] if grid in names else [])})


def _same_place(one: Usd.Prim, other: Usd.Prim, volume: StylizedVolume) -> bool:
    """Whether two field prims have equal local-to-world matrices at the Volume's timeCodes."""
    for time_code in volume.source.time_codes:
        xforms = UsdGeom.XformCache(time_code)
        first, second = (np.array(xforms.GetLocalToWorldTransform(prim)) for prim in (one, other))
        if not is_same_transform(first, second):
            return False
    return True


def _free_path(beside: Usd.Prim, name: str, volume: Usd.Prim, taken: set[Sdf.Path]) -> Sdf.Path:
    """A path next to ``beside`` where the stage has no prim: name, name_volume, name_volume_2...;
    nor one whose name differs in case alone, which people would take for the same."""
    parent = beside.GetPath().GetParentPath()
    base = name.replace(":", "_")
    longer = f"{base}_{volume.GetName()}"
    siblings = {prim.GetName().casefold() for prim in beside.GetParent().GetAllChildren()}
    candidates = [base, longer] + [f"{longer}_{n}" for n in range(2, 1000)]
    for candidate in candidates:
        path = parent.AppendChild(candidate)
        if path not in taken and candidate.casefold() not in siblings:
            return path
    raise LayerError(
        f"no free name for the field {name} below <{parent}>: {longer} to {candidates[-1]} exist. "
        "Rename some of them."
    )


_TYPES = Sdf.ValueTypeNames
_INVERT, _RESET = "!invert!", "!resetXformStack!"


def author_field(
    layer: Sdf.Layer, target: FieldTarget, result: StylizedVolume, folder: Path
) -> None:
    """All opinions of one field prim of the result.

    Args:
        folder: where the look layer will be; paths are relative to it.
    """
    spec = Sdf.CreatePrimInLayer(layer, target.prim_path)
    if target.is_new:
        spec.specifier = Sdf.SpecifierDef
        spec.typeName = "OpenVDBAsset"
        _copy_xform(spec, target.beside)
    _author_files(spec, target.source, result, folder)
    _author_held(spec, target.source, result, "fieldName", _TYPES.Token, target.grid_name)
    if target.source is not None and target.source.GetAttribute("fieldIndex").HasAuthoredValue():
        _author_held(spec, target.source, result, "fieldIndex", _TYPES.Int, 0)
    data_type, field_class, role = _tokens(target)
    if data_type:
        _author_held(spec, target.source, result, "fieldDataType", _TYPES.Token, data_type)
        _author_held(spec, target.source, result, "fieldClass", _TYPES.Token, field_class)
    if role:
        _author_held(spec, target.source, result, "vectorDataRoleHint", _TYPES.Token, role)


def retarget(volume_spec: Sdf.PrimSpec, target: FieldTarget) -> None:
    """Point the Volume's relationship to a field prim that the look defines."""
    relationship = Sdf.RelationshipSpec(
        volume_spec, FIELD_PREFIX + target.relationship, custom=True
    )
    relationship.targetPathList.explicitItems = [target.prim_path]


def close_fields(volume_spec: Sdf.PrimSpec, names: Sequence[str]) -> None:
    """Leave relationships without a target that only an earlier look has given the Volume."""
    for name in names:
        relationship = Sdf.RelationshipSpec(volume_spec, FIELD_PREFIX + name, custom=True)
        relationship.targetPathList.ClearEditsAndMakeExplicit()


def _tokens(target: FieldTarget) -> tuple[str, str, str]:
    """fieldDataType, fieldClass and vectorDataRoleHint; empty ones are left to the source."""
    if target.relationship in COLOUR_VECTORS:
        return "float3", "unknown", "Color"
    if target.relationship in COLOUR_CHANNELS:
        return "float", "unknown", ""
    if target.beside == target.source:
        return "float", "fogVolume", ""
    if target.is_new and target.source is not None:
        names = ("fieldDataType", "fieldClass", "vectorDataRoleHint")
        theirs = [target.source.GetAttribute(name) for name in names]
        kind, field_class, role = (item.Get() or "" if item else "" for item in theirs)
        return kind, field_class, role if kind == "float3" else ""
    return ("float3", "unknown", "Vector") if target.is_new else ("", "", "")


def _author_files(
    spec: Sdf.PrimSpec, source: Usd.Prim | None, result: StylizedVolume, folder: Path
) -> None:
    attribute = Sdf.AttributeSpec(spec, "filePath", _TYPES.Asset)
    attribute.default = Sdf.AssetPath(relative_asset_path(result.first_frame.file_path, folder))
    if not result.source.animated:
        return
    composed = source.GetAttribute("filePath") if source is not None else None
    codes = set(result.source.time_codes) | set(composed.GetTimeSamples() if composed else [])
    for code in sorted(codes):
        frame = result.frame_at(code)
        ours = frame.file_path if frame else "" if composed else result.empty_file
        if ours:
            value = Sdf.AssetPath(relative_asset_path(ours, folder))
        else:
            value = asset_value(composed, code, folder) if composed else Sdf.ValueBlock()
        spec.layer.SetTimeSample(attribute.path, code, value)


def _author_held(
    spec: Sdf.PrimSpec,
    source: Usd.Prim | None,
    result: StylizedVolume,
    name: str,
    type_name: Sdf.ValueTypeName,
    ours: Any,
) -> None:
    """``ours`` where our files are shown, the source's value elsewhere; a default if all agree.

    Where the source says nothing: no value of fieldName and fieldIndex, which select a grid of its
    file, but our value of the others, which describe what both files hold.
    """
    attribute = Sdf.AttributeSpec(spec, name, type_name)
    attribute.default = ours
    if source is None or not result.source.animated:
        return
    composed = source.GetAttribute(name)
    codes = sorted(set(result.source.time_codes) | set(composed.GetTimeSamples()))
    nothing = Sdf.ValueBlock() if name in ("fieldName", "fieldIndex") else ours
    values = []
    for code in codes:
        theirs = value_at(composed, code) if result.frame_at(code) is None else ours
        values.append(nothing if theirs is None else theirs)
    if all(value == ours for value in values):
        return
    for code, value in zip(codes, values, strict=True):
        spec.layer.SetTimeSample(attribute.path, code, value)


def _copy_xform(spec: Sdf.PrimSpec, prim: Usd.Prim) -> None:
    """The xform ops of ``prim``, op by op, so that they also agree between time samples."""
    order = UsdGeom.Xformable(prim).GetXformOpOrderAttr()
    tokens = order.Get() if order.HasAuthoredValue() else None
    if not tokens:
        return
    Sdf.AttributeSpec(
        spec, "xformOpOrder", _TYPES.TokenArray, Sdf.VariabilityUniform
    ).default = tokens
    for name in dict.fromkeys(token.removeprefix(_INVERT) for token in tokens if token != _RESET):
        _copy_attribute(spec, prim.GetAttribute(name))


def _copy_attribute(spec: Sdf.PrimSpec, composed: Usd.Attribute) -> None:
    copy = Sdf.AttributeSpec(spec, composed.GetName(), composed.GetTypeName())
    default = composed.Get(Usd.TimeCode.Default())
    if default is not None:
        copy.default = default
    if _copy_spline(copy, composed):
        return
    for code in composed.GetTimeSamples():
        value = value_at(composed, code)
        spec.layer.SetTimeSample(copy.path, code, Sdf.ValueBlock() if value is None else value)


def _copy_spline(copy: Sdf.AttributeSpec, composed: Usd.Attribute) -> bool:
    """Copy the spline of an attribute; False if it has none.

    Raises:
        StageError: this OpenUSD has splines, but cannot write them from Python.
    """
    if not hasattr(composed, "HasSpline") or not composed.HasSpline():  # splines came with 24.11
        return False
    if not hasattr(copy, "SetSpline"):
        _, year, month = Usd.GetVersion()
        raise StageError(
            f"<{composed.GetPath()}> has a spline, which OpenUSD {year}.{month:02} cannot copy "
            "from Python. Use OpenUSD 25.08 or newer, or bake the spline into time samples."
        )
    copy.SetSpline(composed.GetSpline())
    return True

"""Fixers for findings that can be mended without a decision, in USD's registry of validators.

A fixer authors opinions at an edit target that its caller chooses: the layer of a stage, or a new
one above it. OpenUSD has fixers since 26.11.
"""

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdVol

from usdsmoke.base.naming import relative_asset_path
from usdsmoke.usd.field_samples import FieldSamples, field_targets, usd_time
from usdsmoke.usd.field_tokens import DATA_TYPES
from usdsmoke.usd.rules.facts import FieldFacts, collect_fields, field_to_stage, sample_grid
from usdsmoke.usd.values import Box, extent_value, held_extents, union_of, value_at
from usdsmoke.vdb.boxes import corners_extent, union_extent

if TYPE_CHECKING:
    from pxr import UsdValidation

Fix = Callable[[Usd.Prim, Sdf.Layer], bool]  # edits at the stage's edit target; whether it did
_ALWAYS = Gf.Interval(-math.inf, math.inf)


def author_missing_extent(volume: Usd.Prim, _layer: Sdf.Layer) -> bool:
    """The box of all grids of a Volume, from the headers of its files, at every timeCode."""
    fields = collect_fields(volume, _ALWAYS)
    codes = {sample.time_code for field in fields for sample in field.samples}
    codes = codes - {None} or codes
    boxes = {code: box for code in codes if (box := _box_at(volume, fields, code)) is not None}
    if not boxes:
        return False
    extent = volume.GetAttribute("extent")
    extent.Set(extent_value(*union_extent(list(boxes.values()))))
    held = {code: box for code, box in boxes.items() if code is not None}
    for code, value in held_extents(held).items():
        extent.Set(value, code)
    return True


def _box_at(volume: Usd.Prim, fields: Sequence[FieldFacts], code: float | None) -> Box | None:
    """The box of all that the fields show at a time, in the Volume's space; None: of nothing."""
    place, boxes = field_to_stage(volume, code), []
    if not abs(np.linalg.det(place[:3, :3])) > 0:
        return None
    for field in fields:
        grid = sample_grid(field.at(code))
        if grid is not None and grid.extent is not None:
            to_volume = field_to_stage(field.prim, code) @ np.linalg.inv(place)
            boxes.append(corners_extent(*grid.extent, to_volume))
    return union_of(boxes)


def author_data_type(field: Usd.Prim, _layer: Sdf.Layer) -> bool:
    """``fieldDataType`` of a field that shows grids of one type."""
    samples = FieldSamples(field).inside(_ALWAYS)
    types = {grid.value_type for sample in samples if (grid := sample_grid(sample)) is not None}
    fitting = DATA_TYPES.get(types.pop(), ()) if len(types) == 1 else ()
    attribute = field.GetAttribute("fieldDataType")
    if not fitting or attribute.GetTimeSamples():
        return False
    return bool(attribute.Set(fitting[0]))


def author_relative_paths(field: Usd.Prim, layer: Sdf.Layer) -> bool:
    """File paths relative to the layer that is edited, at every timeCode."""
    if not layer.realPath:
        return False
    attribute, folder = field.GetAttribute("filePath"), Path(layer.realPath).parent
    values = {code: value_at(attribute, usd_time(code)) for code in attribute.GetTimeSamples()}
    values[None] = value_at(attribute, Usd.TimeCode.Default())
    for code, value in values.items():
        if value is None:
            value = Sdf.ValueBlock() if code is not None else None
        elif os.path.isabs(value.resolvedPath):
            value = Sdf.AssetPath(relative_asset_path(value.resolvedPath, folder))
        if value is not None:
            attribute.Set(value, usd_time(code))
    return True


def author_second_name(field: Usd.Prim, _layer: Sdf.Layer) -> bool:
    """A relationship of the grid's name beside each that leads to the field under another one."""
    samples = FieldSamples(field).inside(_ALWAYS)
    names = {sample.grid_name for sample in samples if not sample.blocked}
    name = names.pop().replace(".", "_") if len(names) == 1 else ""
    if not Sdf.Path.IsValidNamespacedIdentifier(name):
        return False
    volumes = [
        prim
        for prim in field.GetStage().Traverse()
        if prim.IsA(UsdVol.Volume)
        and [field.GetPath()] in field_targets(prim).values()
        and name not in field_targets(prim)
    ]
    for volume in volumes:
        UsdVol.Volume(volume).CreateFieldRelationship(name, field.GetPath())
    return bool(volumes)


_FIXES: dict[str, tuple[Fix, str]] = {
    "VolumeExtentMissing": (author_missing_extent, "Author the box that the files' headers name."),
    "FieldTypeMismatch": (author_data_type, "Author the type of the grid that the field shows."),
    "FieldNameMismatch": (author_second_name, "Author a relationship of the grid's name too."),
    "AbsolutePath": (author_relative_paths, "Author paths relative to the edited layer."),
}


def fixers_of(rule: str, module: Any) -> list["UsdValidation.ValidationFixer"]:
    """The fixers of a rule; none before OpenUSD 26.11.

    Args:
        module: UsdValidation.
    """
    if rule not in _FIXES or not hasattr(module, "ValidationFixer"):
        return []
    fix, description = _FIXES[rule]

    def apply(
        error: "UsdValidation.ValidationError", target: Usd.EditTarget, _time: Usd.TimeCode
    ) -> bool:
        prim = error.GetSites()[0].GetPrim()
        with Usd.EditContext(prim.GetStage(), target):
            return fix(prim, target.GetLayer())

    def can_apply(
        error: "UsdValidation.ValidationError", target: Usd.EditTarget, _time: Usd.TimeCode
    ) -> bool:
        sites = error.GetSites()
        return bool(sites and sites[0].IsPrim() and target.GetLayer().permissionToEdit)

    name = f"Fix{rule}"
    return [module.ValidationFixer(name, description, apply, can_apply, ["usdsmoke"], rule)]

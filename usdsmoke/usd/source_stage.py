"""A stage made from bare VDB files: one Volume, a field for each grid, a time sample for each file.

OpenUSD expands no frame patterns, so that a sequence of files needs a layer with time samples.
"""

import os
import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, UsdVol

from usdsmoke.base.errors import AssetNotResolved, ConfigError, LayerError
from usdsmoke.base.naming import relative_asset_path
from usdsmoke.base.publish import publish_file
from usdsmoke.usd.field_tokens import GRID_CLASSES, data_type, field_class
from usdsmoke.usd.values import FRAME_PATTERN, Box, extent_value, held_extents, union_of
from usdsmoke.vdb.header import FileHeader, GridHeader, read_header


@dataclass(frozen=True)
class SourceStage:
    """A stage that was written.

    Attributes:
        file: the stage.
        prim_path: of the Volume.
        time_codes: of the files; empty for a single file.
        fields: names of the relationships.
        left_out: grids without a field, and why.
        level_sets: names of fields that hold surfaces, which usdsmoke does not stylize.
        densities: names of fields that can be a density: float grids that hold no surface.
    """

    file: Path
    prim_path: str
    time_codes: tuple[int, ...]
    fields: tuple[str, ...]
    left_out: tuple[str, ...]
    level_sets: tuple[str, ...] = ()
    densities: tuple[str, ...] = ()


def write_source_stage(
    pattern: str,
    output: str | os.PathLike[str],
    meters_per_unit: float,
    up_axis: str = "Y",
    frames_per_second: float = 24.0,
) -> SourceStage:
    """Write a stage that shows a VDB file or a sequence of them.

    Args:
        pattern: a file, or a name such as ``plume.####.vdb``, ``plume.$F4.vdb`` or
            ``plume.%04d.vdb``; the frame numbers become timeCodes.
        output: the .usda, .usdc or .usd file; must not exist.
        meters_per_unit: length of a unit of the VDB files' world space, in metres; the files do
            not say it.
        up_axis: ``Y`` or ``Z``.
        frames_per_second: also the timeCodes per second.

    Raises:
        AssetNotResolved: no file matches.
        DamagedFile, UnsupportedGrid: a file's header cannot be read.
        ConfigError: an argument is wrong.
        LayerError: the output exists, or no grid can be a field.
        WriteFailed: the operating system refused.
    """
    target = Path(output).absolute()
    _check(target, meters_per_unit, up_axis, frames_per_second)
    files = find_sequence(pattern)
    headers = {code: read_header(file_path) for code, file_path in files.items()}
    fields, left_out = _choose_fields(headers)
    layer = Sdf.Layer.CreateAnonymous(target.suffix)
    stage = Usd.Stage.Open(layer)
    UsdGeom.SetStageUpAxis(stage, up_axis)
    UsdGeom.SetStageMetersPerUnit(stage, meters_per_unit)
    stage.SetTimeCodesPerSecond(frames_per_second)
    stage.SetFramesPerSecond(frames_per_second)
    codes = tuple(code for code in files if code is not None)
    if codes:
        stage.SetStartTimeCode(codes[0])
        stage.SetEndTimeCode(codes[-1])
    root = UsdGeom.Xform.Define(stage, f"/{_prim_name(pattern)}")
    stage.SetDefaultPrim(root.GetPrim())
    volume = UsdVol.Volume.Define(stage, root.GetPath().AppendChild("volume"))
    paths = {code: relative_asset_path(name, target.parent) for code, name in files.items()}
    for name, grid in fields.items():
        _author_field(volume, name, grid, paths)
    _author_extent(volume, headers)
    publish_file(target, partial(_write, layer))
    surfaces = tuple(
        name for name, grid in fields.items() if grid.grid_class == GRID_CLASSES["levelSet"]
    )
    densities = tuple(
        name
        for name, grid in fields.items()
        if grid.value_type in ("float", "double") and name not in surfaces
    )
    return SourceStage(
        target, str(volume.GetPath()), codes, tuple(fields), left_out, surfaces, densities
    )


def _write(layer: Sdf.Layer, path: Path) -> None:
    path.touch()  # where this may not be done, the system says why; USD would not
    layer.Export(str(path))


def find_sequence(pattern: str) -> dict[int | None, Path]:
    """The files of a pattern by frame number, ascending; a single file has the number None.

    Raises:
        AssetNotResolved: no file matches.
        ConfigError: the pattern has two frame numbers, or two files have one number.
    """
    place = Path(pattern)
    marks = FRAME_PATTERN.findall(place.name)
    if not marks:
        if not place.is_file():
            what = f"{pattern} is a folder" if place.is_dir() else f"there is no file {pattern}"
            raise AssetNotResolved(f"{what}. For a sequence write plume.####.vdb, quoted.")
        return {None: place}
    if len(marks) > 1:
        raise ConfigError(f"{place.name} has {len(marks)} frame numbers. Keep one, such as ####.")
    before, after = FRAME_PATTERN.split(place.name)
    name = re.compile(rf"{re.escape(before)}(-?\d+){re.escape(after)}")
    found: dict[int, Path] = {}
    for file_path in sorted(place.parent.glob("*")) if place.parent.is_dir() else []:
        match = name.fullmatch(file_path.name)
        if match is None:
            continue
        if (code := int(match[1])) in found:
            raise ConfigError(
                f"{file_path.name} and {found[code].name} are both frame {code}. Remove one."
            )
        found[code] = file_path
    if not found:
        raise AssetNotResolved(f"no file matches {pattern}. Check the folder and the name.")
    return {code: found[code] for code in sorted(found)}


def _check(target: Path, meters_per_unit: float, up_axis: str, fps: float) -> None:
    if target.suffix not in (".usda", ".usdc", ".usd"):
        raise ConfigError(f"{target.name} is not a USD file. Use .usda, .usdc or .usd.")
    if target.exists():
        raise LayerError(f"{target} exists already. Choose another name, or remove it.")
    if not target.parent.is_dir():
        raise ConfigError(f"there is no folder {target.parent}. Create it first.")
    if up_axis not in ("Y", "Z"):
        raise ConfigError(f"the up axis is {up_axis!r}. Give Y or Z.")
    for name, value in (("metersPerUnit", meters_per_unit), ("frame rate", fps)):
        if not (np.isfinite(value) and value > 0):
            raise ConfigError(f"the stage's {name} is {value}. Give a number above 0.")


def _choose_fields(
    headers: dict[int | None, FileHeader],
) -> tuple[dict[str, GridHeader], tuple[str, ...]]:
    """A field for each grid of any file, by its relationship's name; and what is left out."""
    fields: dict[str, GridHeader] = {}
    left_out: dict[str, None] = {}
    for header in headers.values():
        for grid in header.grids:
            name = Tf.MakeValidIdentifier(grid.label) if grid.name else ""
            if data_type(grid) is None:
                left_out[f"{grid.label}: USD has no field of type {grid.value_type}"] = None
            elif not name:
                left_out["a grid without a name"] = None
            else:
                fields.setdefault(name, grid)
    if not fields:
        header = next(iter(headers.values()))
        reasons = "; ".join(left_out) or "it has no grids"
        raise LayerError(f"{header.file_path} has no grid that can be a field: {reasons}.")
    return fields, tuple(left_out)


def _author_field(
    volume: UsdVol.Volume, name: str, grid: GridHeader, paths: dict[int | None, str]
) -> None:
    stage, path = volume.GetPrim().GetStage(), volume.GetPath().AppendChild(name)
    asset = UsdVol.OpenVDBAsset.Define(stage, path)
    file_path = asset.CreateFilePathAttr()
    for code, authored in paths.items():
        time = Usd.TimeCode.Default() if code is None else Usd.TimeCode(code)
        file_path.Set(Sdf.AssetPath(authored), time)
    asset.CreateFieldNameAttr(grid.name)
    if grid.index:
        asset.CreateFieldIndexAttr(grid.index)
    asset.CreateFieldDataTypeAttr(data_type(grid) or "")
    asset.CreateFieldClassAttr(field_class(grid))
    volume.CreateFieldRelationship(name, path)


def _author_extent(volume: UsdVol.Volume, headers: dict[int | None, FileHeader]) -> None:
    """The box of each file's grids, from the headers; a file that does not say it has none."""
    attribute, boxes = volume.CreateExtentAttr(), dict[float, Box | None]()
    for code, header in headers.items():
        box = union_of(grid.extent for grid in header.grids)
        if code is not None:
            boxes[code] = box
        elif box is not None:
            attribute.Set(extent_value(*box))
    for time_code, value in held_extents(boxes).items():
        attribute.Set(value, time_code)


def _prim_name(pattern: str) -> str:
    stem = FRAME_PATTERN.split(Path(pattern).name)[0].removesuffix(".vdb").strip("._- ")
    return Tf.MakeValidIdentifier(stem or "smoke")

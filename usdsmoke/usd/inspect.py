"""What a stage holds: Volumes, fields, files, frames, grids, sizes, settings; from headers only."""

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from os import PathLike
from typing import Any

from pxr import Usd, UsdGeom

from usdsmoke.base.errors import GridNotFound, StageError, UsdSmokeError
from usdsmoke.base.volume import FieldSource, FrameSource, StageSource, VolumeSource
from usdsmoke.config.look_sections import OpticsConfig
from usdsmoke.config.resolve import Settings, Styles
from usdsmoke.config.run_sections import StageConfig
from usdsmoke.usd.diagnostics import readable_values
from usdsmoke.usd.schema import STYLE_API, late_note
from usdsmoke.usd.stage import find_volumes, hidden_volumes, lit_by, open_stage, read_camera
from usdsmoke.usd.volume_settings import RunArguments, describe_requests
from usdsmoke.vdb.header import FileHeader, GridHeader, read_header
from usdsmoke.vdb.read import GridRequest, check_readable, find_grid
from usdsmoke.vdb.velocity import find_velocity


@readable_values()
def inspect(
    stage: str | PathLike[str] | Usd.Stage,
    prims: list[str] | None = None,
    frames: str = "",
    style: Styles = None,
    settings: Settings = None,
) -> dict[str, Any]:
    """What usdsmoke sees on a stage, as plain values; no voxel is read and torch is not loaded.

    A Volume, file or grid that cannot be used is described by a problem and stops nothing, as long
    as one Volume is left.

    Args:
        stage: a USD file, or an open stage, which is described as it is composed now, with its
            unsaved edits.
        prims: Volume prim paths; None means all.
        frames: timeCodes such as ``1-24``; empty means all.
        style, settings: as in ``stylize``; they decide the settings of each Volume.

    Raises:
        StageError: the stage cannot be opened, or the files of its Volumes cannot be found.
        ConfigError: ``frames`` cannot be read, or settings contradict each other.
    """
    stage = open_stage(stage)
    given = RunArguments.of(style, settings)
    own = given.config.stage
    own = own.replace(prims=prims or own.prims, frames=frames or own.frames)
    problems: list[str] = []
    source = _find(stage, own, not given.styles, problems)
    headers: dict[str, FileHeader | str] = {}
    requests = describe_requests(stage, source, given)
    lit = lit_by(stage, source, [OpticsConfig()] * len(source.volumes))
    return {
        "stage": _describe_stage(source) | {"not_authored": _not_authored(stage)},
        "volumes": [
            _describe_volume(volume, headers) | {"request": request}
            for volume, request in zip(lit.volumes, requests, strict=True)
        ],
        "notes": [*_notes(lit), *_beside_notes(source, headers)],
        "omitted": [{"what": path, "reason": why} for path, why in source.omitted.items()],
        "problems": [
            *(f"{sentence}." for sentence in source.dropped),
            *problems,
            *_problems(source, headers),
            *_camera_problems(stage, source, requests),
        ],
    }


def _find(
    stage: Usd.Stage, config: StageConfig, with_styles: bool, problems: list[str]
) -> StageSource:
    """The Volumes; those that are left out unless they are named where there are no others."""
    try:
        return find_volumes(stage, config, with_styles=with_styles, problems=problems)
    except StageError:
        hidden = {} if config.prims else hidden_volumes(stage)
        if not hidden:
            raise
        config = config.replace(prims=list(hidden))
        source = find_volumes(stage, config, with_styles=with_styles, problems=problems)
        problems += [f"Volume <{path}> is not used: {why}" for path, why in hidden.items()]
        return source


def _notes(source: StageSource) -> list[str]:
    """Worth knowing, and no problem."""
    ignored = [
        f"{', '.join(volume.request.ignored)} of <{volume.prim_path}> are ignored: "
        f"{STYLE_API} is not applied to the prim. Apply it."
        for volume in source.volumes
        if volume.request.ignored
    ]
    missing = [f"left out: {sentence}." for sentence in source.missing]
    places = [f"{note}." for volume in source.volumes for note in volume.notes]
    lights = [
        f"the light <{path}> is left out: {why}." for path, why in source.unused_lights.items()
    ]
    return [*filter(None, [late_note()]), *missing, *ignored, *places, *lights]


def grids_beside(volume: VolumeSource, header: FileHeader) -> list[str]:
    """The grids of a density's file, in the first frame, that no relationship leads to.

    A velocity of a usual name is not among them: it is found without one.
    """
    fields = volume.frames[0].fields.values()
    used = {"", *volume.other_fields, *(field.grid_name for field in fields)}
    for field in fields:
        if not field.grid_name and field.file_path == header.file_path:
            with suppress(GridNotFound):
                used.add(find_grid(header, GridRequest("", field.grid_index)).name)
    used |= {grid.name for grid in find_velocity(header)}
    return list(dict.fromkeys(grid.name for grid in header.grids if grid.name not in used))


def _beside_notes(source: StageSource, headers: dict[str, FileHeader | str]) -> list[str]:
    notes = []
    for volume in source.volumes:
        header = _header_of(volume.frames[0].fields[volume.density].file_path, headers)
        if names := [] if isinstance(header, str) else grids_beside(volume, header):
            notes.append(
                f"the density's file of <{volume.prim_path}> also holds {', '.join(names)}: not in "
                "the result unless layer.copy_fields names it."
            )
    return notes


def _describe_stage(source: StageSource) -> dict[str, Any]:
    return {
        "file": source.file_path,
        "up_axis": source.up_axis,
        "meters_per_unit": source.meters_per_unit,
        "time_codes_per_second": source.time_codes_per_second,
        "frames_per_second": source.frames_per_second,
        "start_time_code": source.start_time_code,
        "end_time_code": source.end_time_code,
        "default_prim": source.default_prim,
    }


def _not_authored(stage: Usd.Stage) -> list[str]:
    """Values that are USD's fallbacks: a length of smoke may be another one than was meant."""
    authored = {
        "up_axis": stage.HasAuthoredMetadata(UsdGeom.Tokens.upAxis),
        "meters_per_unit": UsdGeom.StageHasAuthoredMetersPerUnit(stage),
    }
    return [name for name, is_there in authored.items() if not is_there]


def _describe_volume(volume: VolumeSource, headers: dict[str, FileHeader | str]) -> dict[str, Any]:
    return {
        "prim_path": volume.prim_path,
        "animated": volume.animated,
        "time_codes": [frame.time_code for frame in volume.frames],
        "density": volume.density,
        "velocity": list(volume.velocity),
        "other_fields": list(volume.other_fields),
        "lights": _describe_lights(volume),
        "frames": [_describe_frame(volume, frame, headers) for frame in volume.frames],
    }


def _describe_lights(volume: VolumeSource) -> list[dict[str, Any]]:
    """The lights that light the first frame; smoke scatters them where optics.albedo is set."""
    return [
        {
            "prim_path": light.prim_path,
            "type": "dome" if light.towards is None else "distant",
            "colour": list(light.colour),
            "towards": None if light.towards is None else list(light.towards),
        }
        for light in volume.frames[0].lights
    ]


def _describe_frame(
    volume: VolumeSource, frame: FrameSource, headers: dict[str, FileHeader | str]
) -> dict[str, Any]:
    fields = {
        name: _describe_field(field, headers, _components(volume, name))
        for name, field in frame.fields.items()
    }
    return {"time_code": frame.time_code, "fields": fields}


def _describe_field(
    field: FieldSource, headers: dict[str, FileHeader | str], components: int | None
) -> dict[str, Any]:
    described: dict[str, Any] = {
        "prim_path": field.prim_path,
        "file": field.file_path,
        "authored_path": field.authored_path,
        "grid": field.grid_name,
        "grid_index": field.grid_index,
        "data_type": field.data_type,
        "field_class": field.field_class,
        "field_to_stage": field.field_to_stage.tolist(),
    }
    header = _header_of(field.file_path, headers)
    if isinstance(header, str):
        return described | {"problem": header}
    described["file_bytes"] = os.path.getsize(field.file_path)
    described["grids"] = [_describe_grid(grid) for grid in header.grids]
    described["velocity_grids"] = [grid.label for grid in find_velocity(header)]
    problem = _grid_problem(field, header, components)
    return described | ({"problem": problem} if problem else {})


def _header_of(file_path: str, headers: dict[str, FileHeader | str]) -> FileHeader | str:
    """The file's header, or what is wrong with it; each file is opened once."""
    if file_path not in headers:
        try:
            headers[file_path] = read_header(file_path)
        except UsdSmokeError as error:
            headers[file_path] = str(error)
    return headers[file_path]


def _components(volume: VolumeSource, name: str) -> int | None:
    """How many numbers a voxel of a field has; None is any."""
    return 1 if name in (volume.density, volume.mask) else None


def _grid_problem(field: FieldSource, header: FileHeader, components: int | None) -> str:
    """What keeps smoke from being read from the field's grid; "" when nothing does."""
    where = f"field <{field.prim_path}>, timeCode {field.time_code:g}"
    request = GridRequest(field.grid_name, field.grid_index, where, components)
    try:
        check_readable(header, find_grid(header, request), request)
    except UsdSmokeError as error:
        return str(error)
    return ""


def _describe_grid(grid: GridHeader) -> dict[str, Any]:
    matrix = grid.index_to_world
    return {
        "name": grid.name,
        "index": grid.index,
        "type": grid.value_type,
        "half": grid.half,
        "class": grid.grid_class,
        "active_voxels": grid.active_voxels,
        "bbox_min": None if grid.bbox_min is None else list(grid.bbox_min),
        "bbox_max": None if grid.bbox_max is None else list(grid.bbox_max),
        "box": None if grid.box_shape is None else list(grid.box_shape),
        "transform": grid.transform_type,
        "index_to_world": None if matrix is None else matrix.tolist(),
    }


def _problems(source: StageSource, headers: dict[str, FileHeader | str]) -> list[str]:
    """Every problem once, in the order in which it is found."""
    found: dict[str, None] = {}
    for volume in source.volumes:
        for frame in volume.frames:
            for name, field in frame.fields.items():
                header = headers[field.file_path]
                if isinstance(header, str):
                    where = f"field <{field.prim_path}>, timeCode {field.time_code:g}"
                    found[f"{where}: {header}"] = None
                elif text := _grid_problem(field, header, _components(volume, name)):
                    found[text] = None
    return list(found)


def _camera_problems(
    stage: Usd.Stage, source: StageSource, requests: Sequence[Mapping[str, Any]]
) -> list[str]:
    """What keeps smoke from being seen through the cameras in use, each once."""
    found: dict[str, None] = {}
    for volume, request in zip(source.volumes, requests, strict=True):
        camera = request["settings"]["views.camera"]["value"]
        try:
            for frame in volume.frames if camera else ():
                read_camera(stage, camera, frame.time_code)
        except StageError as error:
            found[str(error)] = None
    return list(found)

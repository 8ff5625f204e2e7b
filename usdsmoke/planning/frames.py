"""One timeCode of one Volume as dense fields: which grids, from which files, in which units."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usdsmoke.base.errors import GridNotFound, UnsupportedGrid
from usdsmoke.base.settings import Config
from usdsmoke.base.time_codes import format_time_code
from usdsmoke.base.volume import DenseField, FieldSource, FrameSource, VolumeFrame, VolumeSource
from usdsmoke.vdb.header import FileHeader, GridHeader
from usdsmoke.vdb.read import GridRequest, ReadGrids, check_readable, find_grid, read_grids
from usdsmoke.vdb.velocity import find_velocity, read_velocity


@dataclass(frozen=True)
class VelocitySource:
    """The source of a frame's velocity: one grid of vectors or three of numbers in one file."""

    field: FieldSource  # gives the file and the transform
    name: str  # the name for ``read_velocity``
    grids: tuple[GridHeader, ...]


@dataclass(frozen=True)
class MaskSource:
    """Where a frame's mask comes from."""

    field: FieldSource  # gives the file and the transform
    grid: GridHeader


def find_density(volume: VolumeSource, frame: FrameSource, header: FileHeader) -> GridHeader:
    """The density's grid, from its file's header alone.

    Raises:
        GridNotFound: the file has no such grid.
        UnsupportedGrid: smoke cannot be read from it.
    """
    request = _density_request(frame.fields[volume.density])
    grid = find_grid(header, request)
    check_readable(header, grid, request)
    return grid


def find_frame_velocity(
    volume: VolumeSource, frame: FrameSource, headers: Mapping[str, FileHeader], config: Config
) -> VelocitySource | None:
    """The velocity that belongs to a frame's density; None when there is none.

    The Volume's own relationships are searched first, then the grids of the density's file, where
    simulations usually write it without naming it on the stage.

    Args:
        headers: by file path, of the frame's files.
        config: ``stage.velocity`` names it, empty tries the usual names.

    Raises:
        GridNotFound: the named velocity does not exist.
    """
    sources = [frame.fields[name] for name in volume.velocity if name in frame.fields]
    if sources and len({source.file_path for source in sources}) == 1:
        names = [source.grid_name for source in sources]
        base = names[0].removesuffix(".x").removesuffix("_x")  # one request for three components
        grids = find_velocity(headers[sources[0].file_path], base) if base else ()
        if grids:
            return VelocitySource(sources[0], base, grids)
    density, name = frame.fields[volume.density], config.stage.velocity
    header = headers[density.file_path]
    grids = find_velocity(header, name)
    if name and not grids:
        raise GridNotFound(
            f'there is no velocity "{name}" on <{volume.prim_path}> or in '
            f"{Path(header.file_path).name} (found: {_listed(header)}). Correct stage.velocity."
        )
    return VelocitySource(density, name, grids) if grids else None


def find_frame_mask(
    volume: VolumeSource, frame: FrameSource, headers: Mapping[str, FileHeader], config: Config
) -> MaskSource | None:
    """The grid that scales a frame's effect, from headers alone; None when none is named.

    The Volume's own relationship of that name comes first, with its file, grid and transform; then
    the grid of that name in the density's file, with the transform of the density.

    Raises:
        GridNotFound: the named mask is neither; the message lists the relationships and grids.
        UnsupportedGrid: no float grid, a level set, a transform that is not linear, or a transform
            or xform of the field prim that cannot be inverted.
    """
    name = config.stage.mask
    if not name:
        return None
    field = frame.fields[volume.mask or volume.density]
    header = headers[field.file_path]
    if volume.mask:
        request = _mask_request(field, field.grid_name, field.grid_index)
    else:
        request = _mask_request(field, name, None)
        _check_has_mask(volume, header, name)
    grid = find_grid(header, request)
    check_readable(header, grid, request)
    if not abs(np.linalg.det(field.field_to_stage[:3, :3])) > 0:  # nor with NaN
        raise UnsupportedGrid(
            f"the transform of the {request.where} has a scale of 0 or NaN, so the mask cannot be "
            "sampled. Correct its scale."
        )
    return MaskSource(field, grid)


def _check_has_mask(volume: VolumeSource, header: FileHeader, name: str) -> None:
    """Raise an error that names both places where the mask could be."""
    if any(grid.name == name for grid in header.grids):
        return
    fields = ", ".join(sorted({volume.density, *volume.velocity, *volume.other_fields}))
    raise GridNotFound(
        f'there is no mask "{name}": it is not a field of <{volume.prim_path}> ({fields}) or a '
        f"grid in {Path(header.file_path).name} ({_listed(header)}). "
        "Correct stage.mask, or unset it."
    )


def _listed(header: FileHeader) -> str:
    return ", ".join(grid.label for grid in header.grids) or "no grids at all"


def is_copied(velocity: VelocitySource | None, density: FieldSource, config: Config) -> bool:
    """True if the velocity is copied to the result's files.

    If ``layer.copy_velocity`` is unset, it is copied if the stage has a field for it beside the
    density. Clients that read one file per Volume (Blender, Arnold, RenderMan) would otherwise read
    the source's file.
    """
    if velocity is None or config.layer.copy_velocity is not None:
        return velocity is not None and bool(config.layer.copy_velocity)
    return velocity.field.relationship != density.relationship and _same_place(velocity, density)


def _same_place(velocity: VelocitySource, density: FieldSource) -> bool:
    return np.allclose(velocity.field.field_to_stage, density.field_to_stage, rtol=1e-9, atol=0)


def read_frame(
    volume: VolumeSource,
    frame: FrameSource,
    config: Config,
    velocity: VelocitySource | None = None,
    time_codes_per_second: float = 24.0,
    mask: MaskSource | None = None,
    read: ReadGrids = read_grids,
) -> VolumeFrame:
    """The dense fields of one timeCode.

    Args:
        config: limits of reading, and the velocity's unit.
        velocity: from ``find_frame_velocity``; None reads no velocity.
        time_codes_per_second: turns velocities per frame, that is per timeCode, into
            velocities per second; the stage's frames per second are not used.
        mask: from ``find_frame_mask``; None reads no mask.

    Raises:
        GridError: a file or grid cannot be used.
        NonFiniteError: NaN or infinite voxels, unless ``grids.repair_nan`` replaces them.
    """
    source = frame.fields[volume.density]
    (density,) = read(source.file_path, [_density_request(source)], config.grids)
    moving = None
    if velocity is not None:
        request = GridRequest(velocity.name, velocity.field.grid_index, _where(velocity.field))
        moving = read_velocity(velocity.field.file_path, request, config.grids, read)
    if moving is not None and config.stage.velocity_unit == "frame":
        values = moving.values * np.float32(time_codes_per_second)
        moving = dataclasses.replace(moving, values=values)
    return VolumeFrame(
        time_code=frame.time_code,
        density=density,
        density_to_stage=source.field_to_stage,
        velocity=moving,
        velocity_to_stage=velocity.field.field_to_stage if velocity and moving else None,
        mask=None if mask is None else _read_mask(mask, config, read),
        mask_to_stage=None if mask is None else mask.field.field_to_stage,
        controls=frame.controls,
        camera=frame.camera,
    )


def _read_mask(mask: MaskSource, config: Config, read: ReadGrids) -> DenseField:
    """The mask, read by itself: the limits of reading apply to one grid."""
    request = _mask_request(mask.field, mask.grid.name, mask.grid.index)
    return read(mask.field.file_path, [request], config.grids)[0]


def read_velocity_grids(
    velocity: VelocitySource,
    density: FieldSource,
    config: Config,
    read: ReadGrids = read_grids,
) -> list[DenseField]:
    """The velocity's grids as they are in the file, to be written beside the density.

    Raises:
        UnsupportedGrid: the velocity's transform on the stage differs from the density's, so that
            one field prim cannot hold both.
        GridError: they cannot be read.
    """
    where = _where(velocity.field)
    if not _same_place(velocity, density):
        raise UnsupportedGrid(
            f"cannot copy the velocity ({where}): the xform of its field prim differs from that of "
            f"<{density.prim_path}>. Unset layer.copy_velocity."
        )
    requests = [GridRequest(grid.name, grid.index, where) for grid in velocity.grids]
    return read(velocity.field.file_path, requests, config.grids)


def _density_request(source: FieldSource) -> GridRequest:
    return GridRequest(source.grid_name, source.grid_index, _where(source), components=1)


def _mask_request(source: FieldSource, name: str, index: int | None) -> GridRequest:
    return GridRequest(name, index, f"mask, {_where(source)}", components=1)


def _where(source: FieldSource) -> str:
    return f"field <{source.prim_path}>, timeCode {format_time_code(source.time_code)}"

"""The grids of one timeCode of one Volume: which, and from which files; from headers alone."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from usdsmoke.base.errors import GridNotFound
from usdsmoke.base.time_codes import format_time_code
from usdsmoke.base.volume import (
    FIELD_SEPARATORS,
    FieldSource,
    FrameSource,
    VolumeSource,
    is_same_transform,
)
from usdsmoke.config.run_sections import EVERYTHING
from usdsmoke.config.settings import Config
from usdsmoke.vdb.header import FileHeader, GridHeader
from usdsmoke.vdb.read import GridRequest, check_readable, find_grid
from usdsmoke.vdb.velocity import find_velocity, without_axis


@dataclass(frozen=True)
class VelocitySource:
    """The source of a frame's velocity: one grid of vectors or three of numbers in one file."""

    field: FieldSource  # gives the file and the transform
    name: str  # of the whole: of a grid, or what three grids have in common; "": as usual
    grids: tuple[GridHeader, ...]

    @property
    def names(self) -> set[str]:
        """The names that settings may call it by."""
        return {*filter(None, [self.name]), *(grid.name for grid in self.grids)}


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
    request = density_request(frame.fields[volume.density])
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
        if shown := _shown_velocity(sources, headers[sources[0].file_path]):
            return shown
    density, name = frame.fields[volume.density], config.stage.velocity
    header = headers[density.file_path]
    grids = find_velocity(header, name)
    if name and not grids:
        raise GridNotFound(
            f'there is no velocity "{name}" on <{volume.prim_path}> or in '
            f"{Path(header.file_path).name} (found: {_listed(header)}). Correct stage.velocity."
        )
    return VelocitySource(density, name, grids) if grids else None


def is_split(volume: VolumeSource, frame: FrameSource) -> bool:
    """Whether the components of a Volume's velocity lie in several files, which is not read."""
    return len({frame.fields[n].file_path for n in volume.velocity if n in frame.fields}) > 1


def _shown_velocity(sources: Sequence[FieldSource], header: FileHeader) -> VelocitySource | None:
    """The velocity that a Volume's own relationships show, all from one file; None: none of it.

    Three relationships show a grid each. The grid of a single one, or where one of three is
    missing, may also be the first of three in the file.
    """
    first, n_named = sources[0], sum(bool(source.grid_name) for source in sources)
    base = without_axis(first.grid_name)
    if n_named == 3:
        with suppress(GridNotFound):
            wanted = [(one.grid_name, one.grid_index, field_place(one)) for one in sources]
            parts = tuple(find_grid(header, GridRequest(*request)) for request in wanted)
            if base == first.grid_name:  # u, v and w: the relationships tell what they are
                base = without_axis(first.relationship, FIELD_SEPARATORS)
            return VelocitySource(first, base, parts)
    grids = find_velocity(header, base) if base else ()
    if len(grids) == 1:
        grids = (find_grid(header, GridRequest(base, first.grid_index, field_place(first))),)
    return VelocitySource(first, base, grids) if grids else None


def find_frame_mask(
    volume: VolumeSource, frame: FrameSource, headers: Mapping[str, FileHeader], config: Config
) -> MaskSource | None:
    """The grid that scales a frame's effect, from headers alone; None when none is named.

    The Volume's own relationship of that name comes first, with its file, grid and transform; then
    the grid of that name in the density's file, with the transform of the density.

    Raises:
        GridNotFound: the named mask is neither; the message lists the relationships and grids.
        UnsupportedGrid: no float grid, a level set, or a transform that is not linear or cannot be
            inverted.
    """
    name = config.stage.mask
    if not name:
        return None
    field = frame.fields[volume.mask or volume.density]
    header = headers[field.file_path]
    if volume.mask:
        request = mask_request(field, field.grid_name, field.grid_index)
    else:
        request = mask_request(field, name, None)
        _check_has_mask(volume, header, name)
    grid = find_grid(header, request)
    check_readable(header, grid, request)
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
    density, or if ``layer.copy_fields`` names it. Clients that read one file per Volume (Blender,
    Arnold, RenderMan) would otherwise read the source's file.
    """
    if velocity is None or config.layer.copy_velocity is not None:
        return velocity is not None and bool(config.layer.copy_velocity)
    if {EVERYTHING, velocity.field.relationship, *velocity.names} & set(config.layer.copy_fields):
        return same_place(velocity, density)
    return velocity.field.relationship != density.relationship and same_place(velocity, density)


def same_place(velocity: VelocitySource, density: FieldSource) -> bool:
    """True if the field prims have the same transform on the stage, apart from rounding."""
    return is_same_transform(velocity.field.field_to_stage, density.field_to_stage)


def density_request(source: FieldSource) -> GridRequest:
    """The grid of a density: one number in a voxel."""
    return GridRequest(source.grid_name, source.grid_index, field_place(source), components=1)


def mask_request(source: FieldSource, name: str, index: int | None) -> GridRequest:
    """The grid of a mask: one number in a voxel."""
    return GridRequest(name, index, f"mask, {field_place(source)}", components=1)


def field_place(source: FieldSource) -> str:
    """Prim and timeCode of a field, for messages."""
    return f"field <{source.prim_path}>, timeCode {format_time_code(source.time_code)}"

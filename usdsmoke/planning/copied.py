"""Other fields and grids of a Volume that go into the result's files."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

from usdsmoke.base.errors import ConfigError, GridError
from usdsmoke.base.volume import FieldSource, FrameSource, VolumeSource, is_same_transform
from usdsmoke.config.run_sections import EVERYTHING
from usdsmoke.config.settings import Config
from usdsmoke.planning.estimate import FrameSize
from usdsmoke.planning.frames import VelocitySource, field_place
from usdsmoke.vdb.header import COMPONENTS, FileHeader, GridHeader
from usdsmoke.vdb.read import GridRequest, check_readable, find_grid

_NEAR = 4  # times the voxels of smoke: those of a velocity near it, at most
REPLACED = "the look's own field of this name takes its place"


@dataclass(frozen=True)
class CopiedGrid:
    """A grid that is written into a frame's file beside the result."""

    name: str  # of the grid in the result's file, and of the relationship if there is one
    field: FieldSource  # gives the source file
    grid: GridHeader
    is_field: bool  # whether the Volume has a relationship for it

    @property
    def components(self) -> int:
        """Numbers in a voxel."""
        return COMPONENTS[self.grid.value_type]

    @property
    def request(self) -> GridRequest:
        """To read it by."""
        return GridRequest(self.grid.name, self.grid.index, field_place(self.field))


Copies = tuple[CopiedGrid, ...]


class GridSizes(NamedTuple):
    """The size of grids that are read beside the density."""

    values: int = 0  # numbers in their active voxels
    dense: int = 0  # numbers in their boxes
    box: int = 0  # voxels of the largest of these


def size_beside(velocity: VelocitySource | None, others: Copies) -> GridSizes:
    """The size of a velocity, one grid or three, and of other grids."""
    grids = [] if velocity is None else [(g, 3 // len(velocity.grids)) for g in velocity.grids]
    return _sizes([*grids, *((copy.grid, copy.components) for copy in others)])


def with_copies(
    size: FrameSize,
    velocities: tuple[VelocitySource | None, VelocitySource | None],
    others: Copies,
    config: Config,
    are_moved: bool,
) -> FrameSize:
    """A frame's size with the grids that are read and written beside the density.

    Args:
        velocities: the one that is followed, and the one that is copied.
        others: other grids that are copied.
        are_moved: whether these move with the density.
    """
    followed, copied = velocities
    values, moved = size_beside(copied, ()).values, size_beside(None, others).values
    if config.layer.compact_velocity:  # near the smoke alone
        values = min(values, 3 * _NEAR * size.active_voxels)
    return replace(
        size,
        copied_values=values + moved,
        moved_values=moved if are_moved else 0,
        read_box=size_beside(followed or copied, others).box,
    )


def _sizes(grids: Sequence[tuple[GridHeader, int]]) -> GridSizes:
    """Of grids and their numbers in a voxel; where a header does not count, of the whole box."""
    boxes = [math.prod(grid.box_shape or (0, 0, 0)) for grid, _ in grids]
    values = dense = 0
    for (grid, components), box in zip(grids, boxes, strict=True):
        values += components * (box if grid.active_voxels is None else grid.active_voxels)
        dense += components * box
    return GridSizes(values, dense, max(boxes, default=0))


def find_copies(
    volume: VolumeSource,
    velocities: Sequence[VelocitySource | None],
    headers: Mapping[str, FileHeader],
    config: Config,
) -> tuple[list[Copies], dict[str, str]]:
    """The grids that are copied into each frame's file, from headers alone.

    A field is copied where all selected frames have it, in the density's place. Its grid gets the
    name of the relationship, because readers look for the one or for the other.

    Args:
        velocities: those that are copied already, by frame.
        headers: by file path, of all frames' files.

    Returns:
        The grids of each frame, and by name why others are not copied.

    Raises:
        ConfigError, GridError: a field that the settings name cannot be copied.
    """
    wanted = config.layer.copy_fields
    if not wanted:
        return [() for _ in volume.frames], {}
    found, reasons = [], dict[str, str]()
    ours = {volume.density, *config.colour_grids}
    reasons |= dict.fromkeys({*volume.copied} & {*config.colour_grids}, REPLACED)
    for frame, velocity in zip(volume.frames, velocities, strict=True):
        taken = ours | ({grid.name for grid in velocity.grids} if velocity else set())
        taken |= set(volume.velocity) if velocity else set()
        grids = {}
        for name in (name for name in volume.copied if name not in taken):
            grid = _field_copy(volume, frame, name, headers, reasons)
            if grid is not None:
                grids[name] = grid
        for grid in _grids_beside(volume, frame, headers, config):
            if grid.name not in taken | grids.keys() | set(volume.copied):
                grids[grid.name] = grid
        found.append(grids)
    for name in {name for grids in found for name in grids}:
        if not all(name in grids for grids in found):
            reasons.setdefault(name, "some of the selected frames are without it")
    kept = [tuple(grid for grid in g.values() if grid.name not in reasons) for g in found]
    for name in wanted:
        velocity = velocities[0]
        is_velocity = velocity is not None and name in {*velocity.names, *volume.velocity}
        if name == EVERYTHING or is_velocity or any(grid.name == name for grid in kept[0]):
            continue
        reason = reasons.get(name, "there is no such relationship or grid that can be read")
        raise ConfigError(
            f'cannot copy the field "{name}" of <{volume.prim_path}>: {reason}. Correct '
            "layer.copy_fields."
        )
    return kept, reasons


def _field_copy(
    volume: VolumeSource,
    frame: FrameSource,
    name: str,
    headers: Mapping[str, FileHeader],
    reasons: dict[str, str],
) -> CopiedGrid | None:
    """The grid of a relationship; None where it cannot be copied, with the reason."""
    field, density = frame.fields.get(name), frame.fields[volume.density]
    if field is None:
        reasons[name] = "some of the selected frames are without it"
        return None
    if not is_same_transform(field.field_to_stage, density.field_to_stage):
        reasons[name] = f"its field prim stands in another place than <{density.prim_path}>"
        return None
    request = GridRequest(field.grid_name, field.grid_index, field_place(field))
    header = headers[field.file_path]
    try:
        grid = find_grid(header, request)
        check_readable(header, grid, request)
    except GridError as error:
        reasons[name] = str(error)
        return None
    return CopiedGrid(name, field, grid, is_field=True)


def _grids_beside(
    volume: VolumeSource, frame: FrameSource, headers: Mapping[str, FileHeader], config: Config
) -> list[CopiedGrid]:
    """Grids of the density's file that no relationship leads to."""
    density, wanted = frame.fields[volume.density], config.layer.copy_fields
    header = headers[density.file_path]
    used = set()
    for field in frame.fields.values():
        if field.file_path == density.file_path:
            with suppress(GridError):
                request = GridRequest(field.grid_name, field.grid_index)
                used.add(find_grid(header, request).stored_name)
    found = []
    for grid in header.grids:
        asked = EVERYTHING in wanted or grid.name in wanted
        if not asked or grid.index or not grid.name or grid.stored_name in used:
            continue
        field = replace(density, relationship=grid.name, grid_name=grid.name, grid_index=None)
        try:
            check_readable(header, grid, GridRequest(grid.name, grid.index))
        except GridError:
            continue
        found.append(CopiedGrid(grid.name, field, grid, is_field=False))
    return found


def unnamed_velocities(
    volume: VolumeSource, velocities: Sequence[VelocitySource]
) -> dict[str, str]:
    """The velocities that are read but not copied, because no relationship leads to them."""
    return {
        velocity.grids[0].name: "for motion blur set layer.copy_velocity=true; the Volume has no "
        "relationship to it"
        for velocity in velocities
        if velocity.field.relationship == volume.density
    }

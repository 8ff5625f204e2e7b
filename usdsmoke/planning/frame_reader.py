"""The source frames of a run as dense fields, each read from disk once."""

import dataclasses
from collections.abc import Iterable

from usdsmoke.base.errors import UnsupportedGrid
from usdsmoke.base.volume import DenseField, FieldSource, FrameSource, VolumeFrame, VolumeSource
from usdsmoke.config.settings import Config
from usdsmoke.planning.copied import CopiedGrid
from usdsmoke.planning.frames import (
    MaskSource,
    VelocitySource,
    density_request,
    field_place,
    mask_request,
    same_place,
)
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan
from usdsmoke.vdb.content_hash import hash_fields
from usdsmoke.vdb.read import GridRequest, ReadGrids, read_grids
from usdsmoke.vdb.store import GridStore
from usdsmoke.vdb.velocity import read_velocity, scale_field


class FrameReader:
    """Reads the frames of a plan. Each grid is decoded and checked once, see ``GridStore``."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._store = GridStore(plan.estimate.bytes_written)

    def read(self, volume: VolumePlan, frame: FramePlan) -> VolumeFrame:
        """The dense fields of a frame. Do not write to its arrays.

        Raises:
            GridError: a file or grid cannot be used.
            NonFiniteError: NaN or infinite voxels, unless ``grids.repair_nan`` replaces them.
        """
        rate = self._plan.source.time_codes_per_second
        return read_frame(
            volume.source,
            frame.source,
            volume.config,
            frame.velocity,
            rate,
            frame.mask,
            self._store.read,
        )

    def release(self, frames: Iterable[FramePlan], needed: Iterable[FramePlan] = ()) -> None:
        """Give up the disk space of frames; files that ``needed`` ones are read from stay."""
        self._store.release(_files(frames) - _files(needed))

    def read_velocity_copy(self, volume: VolumePlan, frame: FramePlan) -> list[DenseField]:
        """The velocity's grids that are copied to a frame's result; none where it is not.

        Raises:
            GridError: see ``read_velocity_grids``.
        """
        if frame.copied is None:
            return []
        density = frame.source.fields[volume.source.density]
        return read_velocity_grids(frame.copied, density, volume.config, self._store.read)

    def read_others(self, volume: VolumePlan, frame: FramePlan) -> list[DenseField]:
        """The other grids that are copied to a frame's result, as they are in the source.

        Raises:
            GridError: a file or grid cannot be used.
        """
        return [
            dataclasses.replace(self._read_other(volume, grid), name=grid.name)
            for grid in frame.others
        ]

    def _read_other(self, volume: VolumePlan, grid: CopiedGrid) -> DenseField:
        (field,) = self._store.read(grid.field.file_path, [grid.request], volume.config.grids)
        return field

    def hash_sources(self, volume: VolumePlan, frame: FramePlan) -> dict[str, str]:
        """Content hashes of a frame's sources, all of which are read: of ``density``, ``mask`` and
        ``velocity`` as read, and of the other grids that are copied, by the names of the copies.

        A velocity that is only copied is hashed as it is copied.

        Raises:
            GridError, NonFiniteError: see ``read``.
        """
        found = _hashes(self.read(volume, frame))
        if "velocity" not in found and (copied := self.read_velocity_copy(volume, frame)):
            found["velocity"] = hash_fields(copied)
        others = {grid.name: self._read_other(volume, grid) for grid in frame.others}
        return {name: hash_fields([field]) for name, field in others.items()} | found


def _files(frames: Iterable[FramePlan]) -> set[str]:
    return {file_path for frame in frames for file_path in frame.files}


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
    (density,) = read(source.file_path, [density_request(source)], config.grids)
    moving = None
    if velocity is not None:
        field = velocity.field
        moving = read_velocity(
            field.file_path, velocity.grids, config.grids, read, field_place(field)
        )
        factor = _slowed(field, config)
        if config.stage.velocity_unit == "frame":
            factor *= time_codes_per_second
        moving = scale_field(moving, factor)
    return VolumeFrame(
        time_code=frame.time_code,
        density=density,
        density_to_stage=source.field_to_stage,
        velocity=moving,
        velocity_to_stage=None if velocity is None else velocity.field.field_to_stage,
        mask=None if mask is None else _read_mask(mask, config, read),
        mask_to_stage=None if mask is None else mask.field.field_to_stage,
        controls=frame.controls,
        camera=frame.camera,
        lights=frame.lights,
    )


def _slowed(field: FieldSource, config: Config) -> float:
    """What layer offsets do to a velocity, in the unit it has in the file."""
    per_frame = config.stage.velocity_unit == "frame"
    return 1 / (field.code_stretch if per_frame else field.time_stretch)


def _read_mask(mask: MaskSource, config: Config, read: ReadGrids) -> DenseField:
    """The mask, read by itself: the limits of reading apply to one grid."""
    request = mask_request(mask.field, mask.grid.name, mask.grid.index)
    return read(mask.field.file_path, [request], config.grids)[0]


def read_velocity_grids(
    velocity: VelocitySource,
    density: FieldSource,
    config: Config,
    read: ReadGrids = read_grids,
) -> list[DenseField]:
    """The velocity's grids, to be written beside the density.

    As they are in the file, but slowed down where layer offsets slow down the smoke: the result's
    layer has no such offsets.

    Raises:
        UnsupportedGrid: the velocity's transform on the stage differs from the density's, so that
            one field prim cannot hold both.
        GridError: they cannot be read.
    """
    where = field_place(velocity.field)
    if not same_place(velocity, density):
        raise UnsupportedGrid(
            f"cannot copy the velocity ({where}): the xform of its field prim differs from that of "
            f"<{density.prim_path}>. Unset layer.copy_velocity."
        )
    requests = [GridRequest(grid.name, grid.index, where) for grid in velocity.grids]
    factor = _slowed(velocity.field, config)
    grids = read(velocity.field.file_path, requests, config.grids)
    return [scale_field(grid, factor) for grid in grids]


def _hashes(frame: VolumeFrame) -> dict[str, str]:
    fields = {"density": frame.density, "mask": frame.mask, "velocity": frame.velocity}
    return {name: hash_fields([field]) for name, field in fields.items() if field is not None}

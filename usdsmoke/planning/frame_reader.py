"""The source frames of a run, each read from disk once."""

from collections.abc import Iterable

from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.planning.frames import read_frame, read_velocity_grids
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan
from usdsmoke.vdb.content_hash import hash_fields
from usdsmoke.vdb.store import GridStore


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

    def read_copied(self, volume: VolumePlan, frame: FramePlan) -> list[DenseField]:
        """The velocity's grids that are copied to a frame's result, unchanged.

        Raises:
            GridError: see ``read_velocity_grids``.
        """
        if frame.copied is None:
            return []
        density = frame.source.fields[volume.source.density]
        return read_velocity_grids(frame.copied, density, volume.config, self._store.read)


def _files(frames: Iterable[FramePlan]) -> set[str]:
    return {field.file_path for frame in frames for field in frame.source.fields.values()}


def hash_sources(frame: VolumeFrame) -> dict[str, str]:
    """Content hashes of a frame's sources: ``density``, ``mask`` and ``velocity``, as read."""
    fields = {"density": frame.density, "mask": frame.mask, "velocity": frame.velocity}
    return {name: hash_fields([field]) for name, field in fields.items() if field is not None}

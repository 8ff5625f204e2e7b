"""The frames of a run as they are asked for: to be checked, measured, stylized, shown."""

from usdsmoke.base.volume import VolumeFrame
from usdsmoke.planning.frames import read_frame
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan
from usdsmoke.vdb.content_hash import hash_fields

__all__ = ["KEPT_BYTES", "FrameReader", "hash_sources"]

KEPT_BYTES = 8 * 2**20  # of voxels, over all frames: memory must not grow with the shot


class FrameReader:
    """Reads frames from disk, and remembers the first ones as long as they are small.

    A frame is wanted two or three times in a run, and every reading starts a process. Frames that
    do not fit ``KEPT_BYTES`` together with those before are read again each time.

    Args:
        plan: which grids of which files.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._kept: dict[str, VolumeFrame] = {}
        self._n_bytes = 0

    def read(self, volume: VolumePlan, frame: FramePlan) -> VolumeFrame:
        """The dense fields of a frame; its arrays are not to be written to.

        Raises:
            GridError: a file or grid cannot be used.
            NonFiniteError: NaN or infinite voxels that are not to be repaired.
        """
        if frame.file_name in self._kept:
            return self._kept[frame.file_name]
        rate = self._plan.source.time_codes_per_second
        config = volume.config
        read = read_frame(volume.source, frame.source, config, frame.velocity, rate, frame.mask)
        fields = (read.density, read.velocity, read.mask)
        n_bytes = sum(field.values.nbytes for field in fields if field is not None)
        if self._n_bytes + n_bytes <= KEPT_BYTES:
            self._kept[frame.file_name] = read
            self._n_bytes += n_bytes
        return read


def hash_sources(frame: VolumeFrame) -> dict[str, str]:
    """Content hashes of what a frame is made from: ``density``, ``mask`` and ``velocity``, as read.

    Args:
        frame: from ``FrameReader.read``.
    """
    fields = {"density": frame.density, "mask": frame.mask, "velocity": frame.velocity}
    return {name: hash_fields([field]) for name, field in fields.items() if field is not None}

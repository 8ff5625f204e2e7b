"""Whether the disk has room for what is still to be written: by a window, or by all of a run."""

from collections.abc import Collection

from usdsmoke.planning.estimate import written_bytes
from usdsmoke.planning.job import Job
from usdsmoke.planning.make_plan import check_disk
from usdsmoke.runs.coarse import missing_starts
from usdsmoke.runs.folder import RunFolder
from usdsmoke.runs.manifests import is_useless
from usdsmoke.runs.window import WindowTask

__all__ = ["check_room"]


def check_room(
    job: Job, run: RunFolder, tasks: Collection[WindowTask], whole: bool = False
) -> None:
    """Refuse a piece of a run that does not fit the disk.

    Args:
        job: what was asked for.
        run: with what is finished of it; it need not have begun.
        tasks: the windows that are to be done; none for the coarse step alone.
        whole: the result is to be assembled too.

    Raises:
        PlanError: with what is needed and what there is.
    """
    wanted = {id(frame) for task in tasks for frame in task.frames}
    is_part = bool(tasks) and not whole
    frames = [frame for task in tasks for frame in task.frames] if is_part else None
    starts = {id(frame) for _, _, chain in missing_starts(run, job.plan, frames) for frame in chain}
    n_bytes = 0
    for number, volume in enumerate(job.plan.volumes):
        twice = {id(frame) for frame in volume.twice_frames}
        own = [task for task in tasks if task.volume_number == number]
        parts = [f.size for task in own for f in task.frames if id(f) in twice]
        once = [f for f in volume.frames if id(f) in wanted - twice]
        blended = [f for f in volume.twice_frames if whole and run.finished(f.file_name) is None]
        coarse = [f.size for f in volume.frames if id(f) in starts]
        n_bytes += written_bytes(volume.config, [f.size for f in (*once, *blended)], parts, coarse)
    check_disk(job.output, n_bytes, not is_useless(run))

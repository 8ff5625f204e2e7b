"""What all windows of a run share: the measured scenes, and the coarse step that they start from.

The coarse step sees the whole sequence at a low resolution, frame after frame. Its results lie in
the run's folder, so that whoever computes a window later starts from the same bits.
"""

import dataclasses
import time
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from usdsmoke.base.errors import FileUnreadable
from usdsmoke.base.machine import give_back_memory
from usdsmoke.base.publish import make_folders, publish_file
from usdsmoke.base.record_format import hash_file
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.job import Job
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan
from usdsmoke.runs.folder import RunFolder
from usdsmoke.runs.manifests import (
    CoarseRecord,
    coarse_file_name,
    finish_coarse,
    finished_coarse,
    hold_work,
)
from usdsmoke.runs.outputs import plain_values
from usdsmoke.runs.progress import RunProgress, RunProgressCallback
from usdsmoke.runs.sheet import sample_frames

if TYPE_CHECKING:
    from usdsmoke.base.progress import Progress
    from usdsmoke.core.sequence.coarse import CoarseStart
    from usdsmoke.core.sequence.start import Carried
    from usdsmoke.core.smoke.device import Machine
    from usdsmoke.core.views.scene import Scene

__all__ = ["coarse_starts", "measure_scenes", "missing_starts", "read_scene", "run_coarse_step"]


def measure_scenes(reader: FrameReader, plan: Plan) -> list[dict[str, Any]]:
    """Extinction and picture size of every Volume, from up to three frames of its sequence.

    Returns:
        JSON values; their numbers come back from a file bit for bit.

    Raises:
        GridError, NonFiniteError: see ``FrameReader.read``.
    """
    from usdsmoke.core.smoke.device import describe_machine
    from usdsmoke.core.views.scene import measure_scene

    describe_machine(plan.config.optimize)  # sets threads: sums depend on the number of threads
    scenes = []
    for volume in plan.volumes:
        frames = [reader.read(volume, frame) for frame in sample_frames(volume)]
        config = volume.config
        scene = measure_scene(
            frames, config.views, config.optics, plan.source.up_axis, config.grids.refine
        )
        scenes.append(plain_values(dataclasses.asdict(scene)))
    return scenes


def read_scene(run: RunFolder, volume_number: int) -> "Scene":
    """The scene of a Volume as it was measured when the run began."""
    from usdsmoke.core.views.scene import Scene

    return Scene(**run.scenes[volume_number])


def run_coarse_step(
    job: Job,
    run: RunFolder,
    reader: FrameReader,
    tell: RunProgressCallback,
    frames: Collection[FramePlan] | None = None,
) -> bool:
    """The coarse step of every sequence that several windows share, as far as it is not done.

    A second process waits for the first one's results.

    Args:
        job: what was asked for.
        run: where the results go; it has begun.
        reader: of the source's frames.
        tell: hears of every frame.
        frames: those whose starts are asked for; None: all. No other start is looked at.

    Returns:
        Whether there was anything to do.

    Raises:
        UsdSmokeError: whatever the core or the writing of files raises.
    """
    if not missing_starts(run, job.plan, frames):
        return False
    with hold_work(run):
        to_do = missing_starts(run, job.plan, frames)  # another process may have done it meanwhile
        n_frames, done = sum(len(chain) for _, _, chain in to_do), 0
        for number, volume, chain in to_do:
            _run_chain(job, run, reader, (number, volume, chain), (done, n_frames), tell)
            done += len(chain)
    return bool(to_do)


def coarse_starts(
    run: RunFolder, volume: VolumePlan, frames: Collection[FramePlan]
) -> "Callable[[float], CoarseStart | None] | None":
    """What gives a frame's coarse start by its timeCode; None where windows do without.

    Args:
        run: with the coarse step done.
        volume: of the frames.
        frames: those whose starts are asked for.

    Raises:
        FileUnreadable: by what is returned: a file has vanished or changed since it was written.
    """
    if not volume.coarse_frames:
        return None
    from usdsmoke.core.sequence.coarse import load_start

    names = {
        frame.source.time_code: coarse_file_name(frame.file_name) for frame in volume.coarse_frames
    }
    record = finished_coarse(run, {coarse_file_name(frame.file_name) for frame in frames})

    def start(time_code: float) -> "CoarseStart | None":
        name = names.get(time_code)
        if name is None:
            return None  # behind a cut, in a sequence of one window
        known = record.frames.get(name)
        if known is None or not run.is_unchanged(name, known["sha256"]):
            raise FileUnreadable(
                f"the coarse start {run.folder / name} has vanished or was changed; run the same "
                "command again, which makes it anew"
            )
        return load_start(run.folder / name)

    return start


def missing_starts(
    run: RunFolder, plan: Plan, wanted: Collection[FramePlan] | None = None
) -> list[tuple[int, VolumePlan, tuple[FramePlan, ...]]]:
    """Volume number, Volume and frames of every sequence in which a start is missing.

    Args:
        run: with its folder.
        plan: of the run.
        wanted: those whose starts are asked for, no other is looked at; None: all.
    """
    names = None if wanted is None else {coarse_file_name(frame.file_name) for frame in wanted}
    record = finished_coarse(run, names)
    to_do = []
    for number, volume in enumerate(plan.volumes):
        frames = {frame.source.time_code: frame for frame in volume.frames}
        for codes in volume.coarse_runs:
            chain = tuple(frames[code] for code in codes)
            starts = {coarse_file_name(frame.file_name) for frame in chain}
            if (starts if names is None else starts & names) - record.frames.keys():
                to_do.append((number, volume, chain))
    return to_do


def _run_chain(
    job: Job,
    run: RunFolder,
    reader: FrameReader,
    chain: tuple[int, VolumePlan, Sequence[FramePlan]],
    counted: tuple[int, int],
    tell: RunProgressCallback,
) -> None:
    """One sequence between two cuts, from its first frame to its last.

    The manifest is written after every frame: who goes on begins with the last frame that is there
    and that others start from.
    """
    from usdsmoke.core.sequence.coarse import coarse_frames, save_start
    from usdsmoke.core.smoke.device import describe_machine

    (number, volume, frames), (done, n_frames) = chain, counted
    record, started = finished_coarse(run), time.monotonic()
    here = describe_machine(job.config.optimize)
    first, known = _resumed(run, record, frames, here)

    def report(state: "Progress") -> None:
        tell(RunProgress("coarse", state.time_code, done + first + state.frame, n_frames, 0.0))

    starts = coarse_frames(
        (reader.read(volume, frame) for frame in frames[first:]),
        job.pictures(volume),
        read_scene(run, number),
        volume.config,
        report,
        job.plan.source.time_codes_per_second,
        known,
    )
    make_folders(run.folder / "coarse")
    for frame, start in zip(frames[first:], starts, strict=True):
        name = coarse_file_name(frame.file_name)
        if name not in record.frames:
            publish_file(run.folder / name, partial(save_start, start))
            digest = hash_file(run.folder / name)
            record.frames[name] = {"time_code": frame.source.time_code, "sha256": digest}
            seconds = record.seconds + time.monotonic() - started
            finish_coarse(run, CoarseRecord(run.run_id, record.frames, seconds, here.processor))
        give_back_memory()
        if all(coarse_file_name(frame.file_name) in record.frames for frame in frames):
            break  # what is left stands there already


def _resumed(
    run: RunFolder, record: CoarseRecord, frames: Sequence[FramePlan], here: "Machine"
) -> tuple[int, "Carried | None"]:
    """From which frame of a sequence on there is something to do, and what that starts with.

    Args:
        run: with the files.
        record: of what stands there unchanged.
        frames: of the sequence.
        here: the machine; what another kind of processor has made is not gone on with.
    """
    from usdsmoke.core.sequence.coarse import load_carried

    names = [coarse_file_name(frame.file_name) for frame in frames]
    n_done = next((n for n, name in enumerate(names) if name not in record.frames), len(names))
    if record.processor != here.processor:
        return 0, None
    for number in reversed(range(n_done)):
        known = load_carried(run.folder / names[number])
        if known is not None:
            return number, known
    return 0, None

"""What all windows of a run share: the measured scenes, and the coarse step that they start from.

The coarse step sees the whole sequence at a low resolution, frame after frame. Its results are in
the run's folder, so that every window starts from the same bits, whichever machine computes it.
"""

import dataclasses
import time
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from usdsmoke.base.errors import FileUnreadable
from usdsmoke.base.json_records import plain_values
from usdsmoke.base.machine import give_back_memory
from usdsmoke.base.publish import make_folders, publish_file
from usdsmoke.base.record_format import hash_file
from usdsmoke.base.time_codes import spread
from usdsmoke.config.settings import Config
from usdsmoke.pictures import find_style_size, refine_for_less
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.job import Job
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan, WindowTask, named_frames
from usdsmoke.planning.visibility import MOST_REFINED
from usdsmoke.runs.manifests import CoarseRecord, coarse_file_name, network_file_name
from usdsmoke.runs.opened import OpenRun, has_coarse_step, missing_starts
from usdsmoke.runs.progress import RunProgress, RunProgressCallback, share_of
from usdsmoke.runs.run import Run

if TYPE_CHECKING:
    from usdsmoke.base.frame_report import Progress
    from usdsmoke.core.sequence.coarse import CoarseStart
    from usdsmoke.core.sequence.start import Carried
    from usdsmoke.core.smoke.device import Machine
    from usdsmoke.core.views.scene import Scene


def measure_scenes(reader: FrameReader, job: Job) -> list[dict[str, Any]]:
    """Extinction, picture size and size of the style of every Volume, from up to three frames of
    its sequence.

    Returns:
        JSON values; their numbers come back from a file bit for bit.

    Raises:
        GridError, NonFiniteError: see ``FrameReader.read``.
    """
    from usdsmoke.core.smoke.device import describe_machine
    from usdsmoke.core.views.scene import measure_scene

    describe_machine(job.plan.config.optimize)  # and use its threads
    scenes = []
    for volume in job.plan.volumes:
        frames = [reader.read(volume, frame) for frame in measured_frames(volume)]
        config = volume.config
        scene = measure_scene(
            frames, config.views, config.optics, job.plan.source.up_axis, config.grids.parts
        )
        weighted, pictures, voxels = volume.with_all_weights, job.pictures(volume), scene.voxels
        size = find_style_size(pictures, voxels, weighted)
        refine = refine_for_less(pictures, voxels, weighted, size, MOST_REFINED)
        most_voxels = volume.frames[0].size.most_voxels  # the same for all, measured or not
        scene = dataclasses.replace(
            scene, style_size=size, style_refine=refine, most_voxels=most_voxels
        )
        if config.chooses_exposure:
            from usdsmoke.core.steps.light_share import white_exposure

            if (curve := scene.thickening) is not None:
                frames = [curve.of_frame(frame) for frame in frames]
            scene = dataclasses.replace(scene, stops=white_exposure(frames, config, scene))
        scenes.append(plain_values(dataclasses.asdict(scene)))
    return scenes


def measured_frames(volume: VolumePlan) -> list[FramePlan]:
    """Up to three frames with smoke of those that ``optics.frames`` names; of all where it names
    none of this Volume's."""
    named = dataclasses.replace(volume, frames=tuple(named_frames(volume)))
    return spread(named.filled) or spread(volume.filled)


def read_scene(run: Run, volume_number: int) -> "Scene":
    """The scene of a Volume as it was measured when the run began."""
    from usdsmoke.core.views.scene import Scene

    return Scene(**run.scenes[volume_number])


def settle_start(run: Run, volume_number: int, config: Config) -> Config:
    """The settings of a Volume, with the file of the network that the run has trained for it.

    Raises:
        FileUnreadable: the file has vanished or changed since it was written.
    """
    if not config.optimize.trains:
        return config
    digest, name = run.scenes[volume_number]["network"], network_file_name(volume_number)
    if digest and not run.is_unchanged(name, digest):
        raise FileUnreadable(
            f"the network {run.folder / name} is missing or was changed. Restore it, or run the "
            "command again with --force."
        )
    start = str(run.folder / name) if digest else ""
    return config.replace(optimize=config.optimize.replace(start=start))


def run_coarse_step(
    opened: OpenRun, tell: RunProgressCallback, frames: Collection[FramePlan] | None = None
) -> RunProgressCallback | None:
    """The coarse step of every sequence that several windows share, as far as it is not done.

    A second process waits for the first one's results.

    Args:
        opened: the run; it has begun.
        tell: called for every frame.
        frames: those whose starts are asked for, and which are computed behind it; None: all. No
            other start is looked at.

    Returns:
        What is called during the rest of the run: what is done of it counts behind this step. None
        where there was nothing to do.

    Raises:
        UsdSmokeError: whatever the core or the writing of files raises.
    """
    run, plan = opened.run, opened.plan
    if not missing_starts(run, plan, frames):
        return None
    part = _share(plan, frames)
    with run.claim():
        to_do = missing_starts(run, plan, frames)  # another process may have done it meanwhile
        n_frames, done = sum(len(chain) for _, _, chain in to_do), 0
        for number, volume, chain in to_do:
            counted, own = (done, n_frames), share_of(tell, 0.0, part)
            _run_chain(opened, (number, volume, chain), counted, own)
            done += len(chain)
    return share_of(tell, part, 1.0) if to_do else None


def share_before_windows(plan: Plan) -> float:
    """The part of a run's time that training and coarse step take, by the plan's estimate."""
    return (plan.training_seconds + plan.estimate.coarse_seconds) / plan.estimate.seconds


def _share(plan: Plan, frames: Collection[FramePlan] | None) -> float:
    """The part of the time that the coarse step takes, by the plan's estimate.

    Args:
        frames: those that are computed behind it; None: all.
    """
    coarse = plan.estimate.coarse_seconds
    n_all = sum(len(task.frames) for task in plan.tasks)
    n_behind = n_all if frames is None else len(frames)
    behind = (plan.estimate.seconds - plan.training_seconds - coarse) * n_behind / max(n_all, 1)
    return coarse / (coarse + behind) if coarse else 0.0


def coarse_starts(run: Run, task: WindowTask) -> "Callable[[float], CoarseStart | None] | None":
    """What gives the coarse start of a window's frame by its timeCode; None where windows do
    without.

    Raises:
        FileUnreadable: by what is returned: a file has vanished or changed since it was written.
    """
    volume = task.volume
    if not has_coarse_step(run, task.volume_number, volume):
        return None
    from usdsmoke.core.sequence.start_files import load_start

    codes = {code for chain in volume.coarse_runs for code in chain}
    names = {
        frame.source.time_code: coarse_file_name(frame.file_name)
        for frame in volume.frames
        if frame.source.time_code in codes
    }
    record = run.coarse({coarse_file_name(frame.file_name) for frame in task.frames})

    def start(time_code: float) -> "CoarseStart | None":
        name = names.get(time_code)
        if name is None:
            return None  # behind a cut, in a sequence of one window
        known = record.frames.get(name)
        if known is None or not run.is_unchanged(name, known["sha256"]):
            raise FileUnreadable(
                f"the coarse start {run.folder / name} is missing or was changed. Run the same "
                "command again to rebuild it."
            )
        return load_start(run.folder / name)

    return start


def _run_chain(
    opened: OpenRun,
    chain: tuple[int, VolumePlan, Sequence[FramePlan]],
    counted: tuple[int, int],
    tell: RunProgressCallback,
) -> None:
    """One sequence between two cuts, from its first frame to its last.

    The manifest is written after every frame: a process that continues begins with the last frame
    that is there and that others start from.
    """
    from usdsmoke.core.sequence.coarse import coarse_frames
    from usdsmoke.core.sequence.start_files import save_start
    from usdsmoke.core.smoke.device import describe_machine

    (number, volume, frames), (done, n_frames) = chain, counted
    job, run = opened.job, opened.run
    record, started = run.coarse(), time.monotonic()
    here = describe_machine(job.config.optimize)
    first, known = _resumed(run, record, frames, here)

    furthest = done + first  # a frame's colours come behind the next one's displacement

    def report(state: "Progress") -> None:
        nonlocal furthest
        number = done + first + state.frame
        furthest = max(number, furthest)
        tell(RunProgress("coarse", state.time_code, number, n_frames, furthest / n_frames))

    starts = coarse_frames(
        (opened.reader.read(volume, frame) for frame in frames[first:]),
        job.pictures(volume),
        read_scene(run, number),
        settle_start(run, number, volume.config),
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
            is_known = record.processor in ("", run.processor)  # another kind stays on record
            processor = here.processor if is_known else record.processor
            run.keep(CoarseRecord(run.run_id, record.frames, seconds, processor))
        give_back_memory()
        if all(coarse_file_name(frame.file_name) in record.frames for frame in frames):
            break  # the rest is there already


def _resumed(
    run: Run, record: CoarseRecord, frames: Sequence[FramePlan], here: "Machine"
) -> tuple[int, "Carried | None"]:
    """From which frame of a sequence on there is something to do, and what that starts with.

    Args:
        here: the machine; a sequence of another kind of processor is not continued.
    """
    from usdsmoke.core.sequence.start_files import load_carried

    names = [coarse_file_name(frame.file_name) for frame in frames]
    n_done = next((n for n, name in enumerate(names) if name not in record.frames), len(names))
    if record.processor != here.processor:
        return 0, None
    for number in reversed(range(n_done)):
        known = load_carried(run.folder / names[number])
        if known is not None:
            return number, known
    return 0, None

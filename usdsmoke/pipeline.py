"""The steps of a run in order: a stage is planned, stylized window by window, and assembled."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from usdsmoke.base.errors import REFUSED, ConfigError
from usdsmoke.base.machine import prepare_torch_environment
from usdsmoke.config.resolve import FilePath, Settings, Styles
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.job import Job, Request, prepare_job
from usdsmoke.planning.output_folder import resolve_output
from usdsmoke.planning.plan import Plan, WindowTask
from usdsmoke.runs.assemble import StylizeResult, assemble_run, is_whole, summarize_result
from usdsmoke.runs.budget import ELSEWHERE, PartClock
from usdsmoke.runs.coarse import run_coarse_step, share_before_windows
from usdsmoke.runs.opened import OpenRun
from usdsmoke.runs.opening import (
    FORCE,
    Course,
    continued,
    join_run,
    open_run,
    open_run_to_assemble,
)
from usdsmoke.runs.progress import RunProgressCallback, ignore_progress, share_of
from usdsmoke.runs.run_machine import machine_of, processor_note
from usdsmoke.runs.train import record_scenes
from usdsmoke.runs.window import check_storage, hash_frames, stylize_windows
from usdsmoke.usd.stage import StageOrFile

__all__ = [
    "Request",
    "StylizeResult",
    "TaskResult",
    "assemble",
    "plan",
    "plan_request",
    "plan_with_notes",
    "prepare",
    "run_coarse",
    "run_window",
    "stylize",
    "stylize_job",
]

_Planned = Callable[[Plan], None]


@dataclass(frozen=True)
class TaskResult:
    """What one task of a run left behind: a window, or the coarse step."""

    folder: Path  # of the run
    manifest: Path  # what was written, for machines; a run without a coarse step has none
    was_done: bool  # nothing was left to do
    plan: Plan
    warnings: tuple[str, ...] = ()


def plan(
    stage: StageOrFile,
    style: Styles = None,
    output: FilePath = "look",
    settings: Settings = None,
    *,
    fits: bool = True,
) -> Plan:
    """What ``stylize`` with the same arguments would do. No voxel is read, no file is written.

    Where the output folder holds a run, source files that are larger, smaller or newer than it
    found them are read for their hash, and for their grids if their bytes differ.

    Args:
        stage, style, output, settings: as in ``stylize``.
        fits: whether the memory and disk of this machine must be sufficient.

    Raises:
        UsdSmokeError: everything that can be known before voxels are read.
    """
    return plan_request(Request(stage, style, output, settings), fits)


def plan_request(request: Request, fits: bool = True, whole: bool = True) -> Plan:
    """``plan`` of a request.

    Args:
        fits: as in ``plan``.
        whole: note what is in the way of the whole run in the output folder; False: the plan is for
            a task of it.
    """
    course = Course(prepare_job(request, fits))
    found = course.plan(whole)
    if whole and (refusal := course.refusal):
        why = f"{REFUSED}: {refusal.removesuffix('.')}"
        found = replace(found, notes=(why, *found.notes))
    return found


def stylize(
    stage: StageOrFile,
    style: Styles = None,
    output: FilePath = "look",
    settings: Settings = None,
    *,
    force: bool = False,
    progress: RunProgressCallback | None = None,
    planned: _Planned | None = None,
) -> StylizeResult:
    """Stylize the smoke of a stage after one or more images and write the result as a look layer.

    A run that was stopped or killed is continued by the same call: finished windows are
    kept. Where the output folder holds a result of equal settings with more frames
    (``stage.frames``), the windows of the selected ones are done again and the others stay. Where
    it holds one with fewer frames, it is made longer. Input files are only read.

    Args:
        stage: a .usda, .usdc or .usd file, or an open stage without unsaved edits.
        style: one image file or several; None where every Volume's prim brings its own.
        output: the folder of the result; made if missing.
        settings: a YAML file, which a Volume's own settings override; a mapping such as
            ``{"windows.size": 3}`` or texts such as ``windows.size=3``, which override a Volume's
            own; a Config, which knows what is explicit; or a list of these, the strongest last.
            None takes the defaults.
        force: replace an earlier result, which stays whole until the new one is complete.
        progress: called often, with how far the run is.
        planned: called once with the plan, before anything heavy is loaded.

    Raises:
        UsdSmokeError: see ``usdsmoke.base.errors``; nothing is left behind but finished windows.
        Interrupted: by Ctrl-C.
    """
    clock = PartClock()
    # Plan: the stage and the headers of VDB files; refusals come with numbers.
    with clock.part("preparing"):
        job = _prepare(Request(stage, style, output, settings, force), planned)
    return stylize_job(job, progress, clock)


def stylize_job(
    job: Job, progress: RunProgressCallback | None = None, clock: PartClock | None = None
) -> StylizeResult:
    """``stylize`` behind its plan.

    Args:
        job: prepared for this machine.
        progress: called often, with how far the run is.
        clock: with the time of the preparation.

    Raises:
        UsdSmokeError: see ``stylize``.
        Interrupted: by Ctrl-C.
    """
    clock, tell = clock or PartClock(), progress or ignore_progress
    with ExitStack() as stack:
        # The run: begun, continued, repeated in part, or refused.
        with clock.part("preparing"), _ReadAhead(job) as ahead:
            opened = stack.enter_context(open_run(job, ahead.begin))  # loads torch
            if ahead.has_begun:
                opened.reader = ahead.reader
        to_do = opened.unfinished
        opened.check_disk(to_do, whole=True)
        # Damage and NaN show before an hour of work.
        with clock.part("reading"):
            hashes = hash_frames(opened, to_do, tell)
        opened.begin()
        # What all windows share, then the windows; these keep their own time.
        trains = any(volume.config.optimize.trains for volume in opened.plan.volumes)
        with clock.part("training" if trains else "preparing"):
            tell = record_scenes(opened, tell)
        check_storage(opened, to_do)
        with clock.part(ELSEWHERE):
            tell = run_coarse_step(opened, tell) or tell
            stylize_windows(opened, to_do, hashes, tell, redo=True)
        # Frames of two windows are blended, and the look layer is written last.
        return assemble_run(opened, tell, clock)


class _ReadAhead:
    """Reads a job's first frame in another thread, once told to; on exit it is read.

    An error is told when the frame is read again, behind what the run itself is refused for.
    """

    def __init__(self, job: Job) -> None:
        self.reader, self.has_begun = FrameReader(job.plan), False
        self._task, self._thread = job.plan.tasks[0], ThreadPoolExecutor(1, "usdsmoke")

    def begin(self) -> None:
        self.has_begun = True
        self._thread.submit(self.reader.read, self._task.volume, self._task.frames[0])

    def __enter__(self) -> "_ReadAhead":
        return self

    def __exit__(self, *error: object) -> None:
        self._thread.shutdown()


def run_coarse(
    request: Request,
    progress: RunProgressCallback | None = None,
    planned: _Planned | None = None,
    of_run: bool = False,
) -> TaskResult:
    """The step that all windows of a run share, for a queue that runs them one by one.

    Where another process is at it, its end is waited for.

    Args:
        request: what is asked for; equal for all tasks of a run.
        progress: called often, with how far the step is.
        planned: called once with the plan.
        of_run: tell how far the whole run is instead.

    Raises:
        UsdSmokeError: see ``usdsmoke.base.errors``.
        Interrupted: by Ctrl-C.
    """
    job, tell = _prepare(request, planned, whole=False), progress or ignore_progress
    with join_run(job, tell) as opened:
        opened.check_disk(())
        if not of_run and (part := share_before_windows(opened.plan)):
            tell = share_of(tell, 0.0, 1.0 / part)
        had_scenes = bool(opened.run.scenes)
        if not had_scenes:
            hash_frames(opened, opened.plan.tasks, tell)  # damage shows; the hashes are not used
            tell = record_scenes(opened, tell)
        was_done = run_coarse_step(opened, tell) is None and had_scenes
    return _task_result(opened, None, was_done)


def run_window(
    request: Request,
    window: int,
    progress: RunProgressCallback | None = None,
    planned: _Planned | None = None,
    redo: bool = False,
) -> TaskResult:
    """One window of a run, for a queue; the coarse step before it, if no one has done it yet.

    Several processes may work on one output folder, on this machine or on others that share it;
    when all windows are there, ``assemble`` makes the result. A window that is finished is left as
    it is, and one that another process is at is waited for.

    Args:
        request: what is asked for; equal for all tasks of a run. With ``force`` the run begins
            beside a result of other settings, which ``assemble`` will then replace.
        window: its number, from 0, in the order of the plan's ``windows``.
        progress: called often, with how far the window is.
        planned: called once with the plan.
        redo: do it once more though it is finished.

    Raises:
        ConfigError: there is no such window.
        OutputExists: the folder holds a run or result of other settings or inputs.
        UsdSmokeError: see ``usdsmoke.base.errors``.
        Interrupted: by Ctrl-C.
    """
    asked, tell = prepare(request), progress or ignore_progress
    job = continued(asked)
    task = _task(job, asked, window)  # refused before the plan is shown
    if planned is not None:
        planned(plan_with_notes(job, whole=False))
    with join_run(job, tell, task) as opened:
        was_done = opened.run.window(window) is not None and not redo
        if not was_done:
            task = opened.plan.task(window)
            opened.check_disk([task])
            hashes = hash_frames(opened, [task], tell)
            tell = record_scenes(opened, tell)
            check_storage(opened, [task])
            tell = run_coarse_step(opened, tell, task.frames) or tell
            stylize_windows(opened, [task], hashes, tell, redo)
    return _task_result(opened, window, was_done)


def _task(job: Job, asked: Job, window: int) -> WindowTask:
    """A window of a run.

    Raises:
        ConfigError: there is no such window; why, where the run has other frames than are asked
            for.
    """
    try:
        return job.plan.task(window)
    except ConfigError as error:
        if job is asked:
            raise
        raise ConfigError(
            f"{error} The unfinished run in {job.output} was begun with the frames "
            f"{job.config.stage.frames}. Finish it and assemble it, then send the windows of the "
            "longer shot."
        ) from None


def assemble(
    output: FilePath,
    progress: RunProgressCallback | None = None,
    look: str | None = None,
    mode: str | None = None,
) -> StylizeResult:
    """Make the result of a run whose windows are all finished: the last step of a queue.

    Called once more on a result it changes nothing, unless another ``mode`` is asked for: the same
    frames are then put on the stage in that way. Other processes at work in the folder are waited
    for, some minutes long.

    Args:
        output: the folder that the windows were written to.
        progress: called for every frame that is blended.
        look: the look's name, where the folder holds several.
        mode: ``layer.mode``; None keeps the run's.

    Raises:
        LayerError: there is no run, or one of its windows is not finished; these are listed.
        ConfigError: there is no such mode.
        OutputExists: inputs have changed since the run began, or another process is at work.
        UsdSmokeError: see ``usdsmoke.base.errors``.
        Interrupted: by Ctrl-C.
    """
    clock, tell = PartClock(), progress or ignore_progress
    with open_run_to_assemble(resolve_output(output), look, mode, tell) as opened:
        if is_whole(opened):
            return summarize_result(opened)
        return assemble_run(opened, tell, clock)


def _task_result(opened: OpenRun, window: int | None, was_done: bool) -> TaskResult:
    """A finished task, with notes where it was done already, or on another kind of processor."""
    run = opened.run
    if not was_done:
        notes = processor_note(run, machine_of(opened.job).processor)
    elif opened.job.request.force:
        notes = (
            f"{FORCE} does not redo a task that is done with these settings. To redo frames of a "
            "result, select them with stage.frames (--frames), without a window.",
        )
    else:
        notes = ()
    return TaskResult(run.folder, run.manifest_path(window), was_done, opened.plan, notes)


def prepare(request: Request) -> Job:
    """The job of a run on this machine.

    Raises:
        UsdSmokeError: everything that can be known before voxels are read.
    """
    prepare_torch_environment()
    return prepare_job(request)


def _prepare(request: Request, planned: _Planned | None, whole: bool = True) -> Job:
    """The job; the plan is told."""
    job = prepare(request)
    if planned is not None:
        planned(plan_with_notes(job, whole))
    return job


def plan_with_notes(job: Job, whole: bool = True) -> Plan:
    """The plan, with notes and costs of what is left where a run or a result goes on.

    Args:
        whole: False: the plan is for a task of the run.
    """
    return Course(job).plan(whole)

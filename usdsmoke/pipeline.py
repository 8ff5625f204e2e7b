"""The table of contents: a stage is planned, stylized window by window, and assembled."""

from collections.abc import Callable

from usdsmoke.base.errors import Interrupted, LayerError
from usdsmoke.base.given_settings import FilePath, RunSettings, Styles
from usdsmoke.base.locks import lock_output
from usdsmoke.base.machine import prepare_torch_environment
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.job import Job, Request, prepare_job, recorded_request
from usdsmoke.planning.output_folder import settle_output
from usdsmoke.planning.plan import Plan
from usdsmoke.runs.assemble import StylizeResult, assemble_run, summarize_result
from usdsmoke.runs.begin import (
    begin_run,
    how_far,
    joined_run,
    open_or_redo,
    settle_scenes,
    tidy_end,
)
from usdsmoke.runs.budget import ELSEWHERE, PartClock
from usdsmoke.runs.coarse import run_coarse_step
from usdsmoke.runs.disk import check_room
from usdsmoke.runs.finished import StepResult, check_same, is_whole, run_to_assemble
from usdsmoke.runs.machine import machine_of, processor_note
from usdsmoke.runs.manifests import finished_window, manifest_path
from usdsmoke.runs.progress import WAITING, RunProgress, RunProgressCallback
from usdsmoke.runs.tolerance import foresee_tolerance, settle_tolerance
from usdsmoke.runs.window import check_frames, list_tasks, pick_task, stylize_windows
from usdsmoke.usd.look import published_runs
from usdsmoke.usd.stage import StageOrFile

__all__ = [
    "Request",
    "StepResult",
    "StylizeResult",
    "assemble",
    "plan",
    "run_coarse",
    "run_window",
    "stylize",
]

_Planned = Callable[[Plan], None]


def plan(request: Request, fits: bool = True) -> Plan:
    """What ``stylize`` with the same arguments would do; no voxel is read, no file is written.

    With ``optimize.target_error`` a calibration in the output folder is used. Without one the
    plan is that before the choice, and says so.

    Args:
        request: what is asked for.
        fits: whether memory and disk of this machine must be sufficient; not if others work.

    Raises:
        UsdSmokeError: everything that can be known before voxels are read.
    """
    job = prepare_job(request, fits)
    return foresee_tolerance(job, job.with_config).plan


def stylize(
    stage: StageOrFile,
    style: Styles = None,
    output: FilePath = "look",
    settings: RunSettings = None,
    *,
    force: bool = False,
    progress: RunProgressCallback | None = None,
    planned: _Planned | None = None,
) -> StylizeResult:
    """Stylize the smoke of a stage after one or more images and write the result as a look layer.

    A run that was stopped, however rudely, is continued by the same call: finished windows are
    kept. Where the output folder holds a result of equal settings with more frames
    (``stage.frames``), the windows of the selected ones are done again and the others stay. Input
    files are only read.

    Args:
        stage: a .usda, .usdc or .usd file, or an open stage without unsaved edits.
        style: one image file or several; None where every Volume's prim brings its own.
        output: the folder of the result; made if missing.
        settings: a YAML file or a Config, which a Volume's own settings override; a mapping or
            texts such as ``windows.size=3``, which override a Volume's own; or a list of these,
            the strongest last. None takes the defaults.
        force: replace an earlier result, which stays whole until the new one is complete.
        progress: called often, with how far the run is.
        planned: called once with the plan, before anything heavy is loaded.

    Raises:
        UsdSmokeError: see ``usdsmoke.base.errors``; nothing is left behind but finished windows.
        Interrupted: by Ctrl-C.
    """
    clock, tell = PartClock(), progress or _tell_nobody
    request = Request(stage, style, output, settings, force)
    job = clock.timed("preparing", _prepare, request, planned)
    with lock_output(job.output) as lock:
        job, run, redone = open_or_redo(job)
        to_do = [
            task
            for task in list_tasks(job.plan)
            if task.window.index in redone or finished_window(run, task.window.index) is None
        ]
        with tidy_end(run, lock, lambda: how_far(run, job.plan)):
            check_room(job, run, to_do, whole=True)
            reader = FrameReader(job.plan)
            hashes = clock.timed("reading", check_frames, reader, to_do, tell)
            begin_run(job, run)
            settle_scenes(job, run, reader)
            clock.timed(ELSEWHERE, run_coarse_step, job, run, reader, tell)
            clock.timed(ELSEWHERE, stylize_windows, job, run, reader, to_do, hashes, tell, True)
            return assemble_run(job, run, reader, tell, clock)


def run_coarse(
    request: Request,
    progress: RunProgressCallback | None = None,
    planned: _Planned | None = None,
) -> StepResult:
    """The step that all windows of a run share, for a queue that runs them one by one.

    Where another process is at it, its end is waited for.

    Args:
        request: what is asked for; equal for all tasks of a run.
        progress: called often, with how far the step is.
        planned: called once with the plan.

    Raises:
        UsdSmokeError: see ``usdsmoke.base.errors``.
        Interrupted: by Ctrl-C.
    """
    job, tell = _prepare(request, planned), progress or _tell_nobody
    with joined_run(job, tell) as (job, run, lock):
        with tidy_end(run, lock, lambda: "stopped in the coarse step; run the command again"):
            check_room(job, run, ())
            reader = FrameReader(job.plan)
            had_scenes = bool(run.scenes)
            if not had_scenes:
                check_frames(reader, list_tasks(job.plan), tell)
                settle_scenes(job, run, reader)
            was_done = not run_coarse_step(job, run, reader, tell) and had_scenes
            notes = () if was_done else processor_note(run, machine_of(job).processor)
    return StepResult(run.folder, run.folder / "coarse.json", was_done, job.plan, notes)


def run_window(
    request: Request,
    window: int,
    progress: RunProgressCallback | None = None,
    planned: _Planned | None = None,
    again: bool = False,
) -> StepResult:
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
        again: do it once more though it is finished.

    Raises:
        ConfigError: there is no such window.
        OutputExists: the folder holds a run or result of other settings or inputs.
        UsdSmokeError: see ``usdsmoke.base.errors``.
        Interrupted: by Ctrl-C.
    """
    job, tell = _prepare(request, planned), progress or _tell_nobody
    task = pick_task(job.plan, window)
    with joined_run(job, tell, task) as (job, run, lock):
        manifest = manifest_path(run, window)
        if not again and finished_window(run, window) is not None:
            return StepResult(run.folder, manifest, True, job.plan)
        with tidy_end(run, lock, lambda: f"stopped in window {window}; run the command again"):
            reader = FrameReader(job.plan)
            task = pick_task(job.plan, window)  # with what the run has settled
            check_room(job, run, [task])
            hashes = check_frames(reader, [task], tell)
            settle_scenes(job, run, reader)
            run_coarse_step(job, run, reader, tell, task.frames)
            stylize_windows(job, run, reader, [task], hashes, tell, again)
            notes = processor_note(run, machine_of(job).processor)
    return StepResult(run.folder, manifest, False, job.plan, notes)


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
    output, clock = settle_output(output), PartClock()
    if not output.is_dir():
        raise LayerError(f"there is no folder {output}; give the one that windows were written to")
    tell = progress or _tell_nobody
    with lock_output(output, waits=lambda: tell(WAITING)):
        run = run_to_assemble(output, look)
        job = prepare_job(recorded_request(output, run.request, mode), fits=False)
        check_same(run, job)
        if (
            run.complete
            and run.run_id in published_runs(job.targets.look_layer)
            and is_whole(run, job)
        ):
            return summarize_result(job, run)
        try:
            return assemble_run(job, run, FrameReader(job.plan), tell, clock)
        except KeyboardInterrupt:
            raise Interrupted("stopped; run the same command again to continue") from None


def _prepare(request: Request, planned: _Planned | None) -> Job:
    """The job with the settings that a tolerance comes to; the plan is told."""
    prepare_torch_environment()
    job = prepare_job(request)
    job = settle_tolerance(job, job.with_config)
    if planned is not None:
        planned(job.plan)
    return job


def _tell_nobody(report: RunProgress) -> None:
    """Takes the place of a progress callback that was not given."""

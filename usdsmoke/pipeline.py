"""The main job from end to end: stage -> plan -> grids -> core -> grids -> layer, nothing else."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from usdsmoke.base.config import Config
from usdsmoke.base.errors import Interrupted, LayerError
from usdsmoke.base.given_settings import (
    FilePath,
    Settings,
    Styles,
    resolve_settings,
    style_paths,
)
from usdsmoke.base.locks import lock_output
from usdsmoke.base.machine import prepare_torch_environment
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.job import Job, prepare_job, published_runs, requested_job
from usdsmoke.planning.originals import settle_output
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

__all__ = [
    "StepResult",
    "StylizeResult",
    "assemble",
    "plan_stylize",
    "run_coarse",
    "run_window",
    "stylize",
]


def plan_stylize(
    stage: FilePath,
    style: Styles,
    output: FilePath,
    config: Settings = None,
    settings: Mapping[str, Any] | Sequence[str] = (),
    fits: bool = True,
) -> Plan:
    """What ``stylize`` with the same arguments would do; no voxel is read, no file is written.

    With ``optimize.target_error`` a calibration that the output folder has is used; without one the
    plan is that before the choice, and says so.

    Args:
        stage: as in ``stylize``, like those that follow it.
        style: one image file or several; None where every Volume's prim brings its own.
        output: the folder of the result.
        config: settings.
        settings: further ones, stronger than ``config``.
        fits: whether memory and disk of this machine must be large enough; not if others work.

    Raises:
        UsdSmokeError: everything that can be known before voxels are read.
    """
    resolved, explicit = resolve_settings(config, settings)
    styles = style_paths(style)

    def prepare(config: Config) -> Job:
        return prepare_job(stage, styles, Path(output), config, fits, explicit)

    return foresee_tolerance(prepare(resolved), prepare).plan


def stylize(
    stage: FilePath,
    style: Styles,
    output: FilePath,
    config: Settings = None,
    settings: Mapping[str, Any] | Sequence[str] = (),
    force: bool = False,
    progress: RunProgressCallback | None = None,
    planned: Callable[[Plan], None] | None = None,
) -> StylizeResult:
    """Stylize the smoke of a stage after one or more images and write the result as a look layer.

    A run that was stopped, however rudely, is continued by the same call: finished windows are
    kept. Where the output folder holds a result of equal settings with more frames
    (``stage.frames``), the windows of the selected ones are done again and the others stay. Input
    files are only read.

    Args:
        stage: a .usda, .usdc or .usd file.
        style: one image file or several; None where every Volume's prim brings its own.
        output: the folder of the result; made if missing.
        config: a YAML file, a mapping of sections, or ready made; None takes the defaults.
        settings: further ones, stronger than ``config`` and than what a Volume's prim asks for:
            a mapping of sections, or texts such as ``windows.size=3``.
        force: replace an earlier result, which stays whole until the new one is.
        progress: called often, with how far the run is.
        planned: called once with the plan, before anything heavy is loaded.

    Raises:
        UsdSmokeError: see ``usdsmoke.base.errors``; nothing is left behind but finished windows.
        Interrupted: by Ctrl-C.
    """
    clock = PartClock()
    job = clock.timed("preparing", _prepare, stage, style, output, config, settings, planned)
    tell = progress or _tell_nobody
    with lock_output(job.output) as lock:
        job, run, redone = open_or_redo(
            job,
            force,
            lambda config: prepare_job(
                stage, style_paths(style), job.output, config, explicit=job.explicit
            ),
        )
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
    stage: FilePath,
    style: Styles,
    output: FilePath,
    config: Settings = None,
    settings: Mapping[str, Any] | Sequence[str] = (),
    force: bool = False,
    progress: RunProgressCallback | None = None,
    planned: Callable[[Plan], None] | None = None,
) -> StepResult:
    """The step that all windows of a run share, for a queue that runs them one by one.

    Where another process is at it, its end is waited for. See ``run_window`` for the arguments.

    Raises:
        UsdSmokeError: see ``usdsmoke.base.errors``.
        Interrupted: by Ctrl-C.
    """
    job = _prepare(stage, style, output, config, settings, planned)
    tell = progress or _tell_nobody
    with joined_run(job, force, tell) as (job, run, lock):
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
    stage: FilePath,
    style: Styles,
    output: FilePath,
    window: int,
    config: Settings = None,
    settings: Mapping[str, Any] | Sequence[str] = (),
    force: bool = False,
    progress: RunProgressCallback | None = None,
    planned: Callable[[Plan], None] | None = None,
    again: bool = False,
) -> StepResult:
    """One window of a run, for a queue; the coarse step before it, if no one has done it yet.

    Several processes may work on one output folder, on this machine or on others that share it;
    when all windows are there, ``assemble`` makes the result. A window that is finished is left as
    it is, and one that another process is at is waited for.

    Args:
        stage: as in ``stylize``, like those that follow it.
        style: one image file or several; None where every Volume's prim brings its own.
        output: the folder of the result.
        window: its number, from 0, in the order of the plan's ``windows``.
        config: settings.
        settings: further ones, stronger than ``config``.
        force: begin beside a result of other settings, which ``assemble`` will then replace.
        progress: called often, with how far the window is.
        planned: called once with the plan.
        again: do it once more though it is finished.

    Raises:
        ConfigError: there is no such window.
        OutputExists: the folder holds a run or result of other settings or inputs.
        UsdSmokeError: see ``usdsmoke.base.errors``.
        Interrupted: by Ctrl-C.
    """
    job = _prepare(stage, style, output, config, settings, planned)
    task, tell = pick_task(job.plan, window), progress or _tell_nobody
    with joined_run(job, force, tell, task) as (job, run, lock):
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
        job = requested_job(output, run.request, mode)
        check_same(run, job)
        if run.complete and run.run_id in published_runs(job) and is_whole(run, job):
            return summarize_result(job, run)
        try:
            return assemble_run(job, run, FrameReader(job.plan), tell, clock)
        except KeyboardInterrupt:
            raise Interrupted("stopped; run the same command again to continue") from None


def _prepare(
    stage: FilePath,
    style: Styles,
    output: FilePath,
    config: Settings,
    settings: Mapping[str, Any] | Sequence[str],
    planned: Callable[[Plan], None] | None,
) -> Job:
    prepare_torch_environment()
    resolved, explicit = resolve_settings(config, settings)
    job = _settled(stage, style, Path(output), resolved, explicit)
    if planned is not None:
        planned(job.plan)
    return job


def _settled(
    stage: FilePath, style: Styles, output: Path, config: Config, explicit: frozenset[str]
) -> Job:
    def prepare(config: Config) -> Job:
        return prepare_job(stage, style_paths(style), output, config, explicit=explicit)

    return settle_tolerance(prepare(config), prepare)


def _tell_nobody(report: RunProgress) -> None:
    """Takes the place of a progress callback that was not given."""

"""Which run a call belongs to: begun, continued, joined by several processes, or done again."""

import dataclasses
import json
from collections.abc import Callable, Iterator, Set
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from usdsmoke.base.errors import Interrupted, OutputExists
from usdsmoke.base.locks import OutputLock, lock_output
from usdsmoke.planning.features import features_hashes
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.job import Job, describe_request
from usdsmoke.planning.plan import Plan
from usdsmoke.runs.changes import list_changes
from usdsmoke.runs.choice import Describe, find_equal, open_run, taken_up
from usdsmoke.runs.coarse import measure_scenes, missing_starts
from usdsmoke.runs.description import describe_run
from usdsmoke.runs.folder import RunFolder, find_runs
from usdsmoke.runs.machine import machine_of, settle_description, with_settled
from usdsmoke.runs.manifests import (
    finished_window,
    forget_beginning,
    hold_beginning,
    is_useless,
    remove_locks,
)
from usdsmoke.runs.progress import WAITING, RunProgressCallback
from usdsmoke.runs.window import WindowTask, list_tasks
from usdsmoke.usd.look import published_runs

__all__ = [
    "begin_run",
    "describing",
    "frames_again",
    "how_far",
    "joined_run",
    "open_or_redo",
    "settle_scenes",
    "tidy_end",
]


def open_or_redo(job: Job) -> tuple[Job, RunFolder, Set[int]]:
    """The run of a whole job, and which of its windows are to be done again though they are done.

    A selection of a result's own frames means these frames once more: the job becomes the result's.
    What the job leaves to the machine is settled, or as it was when the run was begun.

    Args:
        job: what was asked for.

    Raises:
        OutputExists: there is a result or an unfinished run of other settings, without ``force``.
        ConfigError: the device is not there.
    """
    force = job.request.force
    if not force and (again := frames_again(job)) is not None:
        return again
    published = published_runs(job.targets.look_layer)
    run = open_run(job.output, job.config.layer.look, describing(job), published, force)
    return with_settled(job, run), run, frozenset()


def frames_again(job: Job) -> tuple[Job, RunFolder, Set[int]] | None:
    """The whole job, its run and the windows to do, where the job is a part of a result's frames.

    Args:
        job: what was asked for.

    Raises:
        OutputExists: the result is of other settings or inputs.
    """
    published = published_runs(job.targets.look_layer)
    for run in find_runs(job.output):
        if run.complete and run.run_id in published and _has_other_frames(job, run):
            frames = run.description["settings"]["stage"]["frames"]
            stage = dataclasses.replace(job.config.stage, frames=frames)
            whole = job.with_config(dataclasses.replace(job.config, stage=stage))
            if redone := _windows_of(whole.plan, job.plan):
                _refuse_other(run, whole)
                return with_settled(whole, run), run, redone
    return None


@contextmanager
def joined_run(
    job: Job, tell: RunProgressCallback, task: WindowTask | None = None
) -> Iterator[tuple[Job, RunFolder, OutputLock]]:
    """The run of a job that several processes may work on, begun if it was not; the folder is held.

    Of two processes that begin different runs at once one is refused: the record is there before a
    frame is read.

    Args:
        job: what was asked for; with ``force`` begun beside a result of other settings.
        tell: hears of it where others at work have to be waited for, some minutes at most.
        task: the window that is to be done: no other inputs are read where the run has begun and
            this window's coarse starts are there. None: all.

    Yields:
        The job with what the run has settled of the machine, the run, and the lock.

    Raises:
        OutputExists: the folder holds a run or result of other settings or inputs, and ``force``
            does not say to begin beside it.
        ConfigError: the device is not there.
    """
    describe, look, force = describing(job, task), job.config.layer.look, job.request.force

    def waits() -> None:
        tell(WAITING)

    if force and find_equal(job.output, describe) is None:
        # Unfinished runs of other settings go: nobody may be at them.
        with lock_output(job.output, waits=waits):
            open_run(job.output, look, describe, published_runs(job.targets.look_layer), force)
    with lock_output(job.output, alone=False, waits=waits) as lock:
        run = find_equal(job.output, describe)
        if run is None:
            published = published_runs(job.targets.look_layer)  # as it is now, after the waiting
            open_run(job.output, look, describe, published, force, alone=False)  # or be refused
            with _held_beginning(job.output, lock):
                run = find_equal(job.output, describe)
                if run is None:
                    run = open_run(job.output, look, describe, published, force, alone=False)
                    begin_run(with_settled(job, run), run)
        yield with_settled(job, run), run, lock


def begin_run(job: Job, run: RunFolder) -> None:
    """Make the run's record, or take up what another process has begun.

    Args:
        job: with what the run has settled of the machine.
        run: from ``open_or_redo``.

    Raises:
        ConfigError: the device is not there.
        WriteFailed: the operating system refused.
    """
    if run.has_begun or run.adopt():
        run.tidy()
        return
    described = job.plan.to_dict()
    # What of the plan stays with the result: nothing that names folders of this machine.
    plan = {key: described[key] for key in ("windows", "needed", "omitted", "estimate")}
    run.begin(plan, describe_request(job), machine_of(job).processor)


def settle_scenes(job: Job, run: RunFolder, reader: FrameReader) -> None:
    """Measure the scenes of a run that has begun, if no one has.

    Raises:
        GridError, NonFiniteError: see ``FrameReader.read``.
        WriteFailed: the operating system refused.
    """
    if not run.scenes:
        run.keep_scenes(measure_scenes(reader, job.plan))


@contextmanager
def tidy_end(run: RunFolder, lock: OutputLock, how_far: Callable[[], str]) -> Iterator[None]:
    """Let a refusal leave nothing behind, and let Ctrl-C say how far the run is.

    Args:
        run: what is worked on.
        lock: on its output folder.
        how_far: a sentence; asked for after Ctrl-C only.

    Raises:
        Interrupted: in the place of Ctrl-C.
    """
    try:
        yield
    except BaseException as error:
        message = how_far() if isinstance(error, KeyboardInterrupt) else ""
        if is_useless(run) and lock.is_alone():
            remove_locks(run)
            run.remove()
        if message:
            raise Interrupted(message) from None
        raise


def how_far(run: RunFolder, plan: Plan) -> str:
    """How much of a run is finished, and how to go on."""
    tasks = list_tasks(plan)
    done = [task for task in tasks if finished_window(run, task.window.index) is not None]
    if is_useless(run):
        return "stopped before the first window was finished; nothing was left behind"
    n_frames = sum(len(task.window.time_codes) for task in done)
    return (
        f"stopped with {n_frames} of {plan.n_frames} frames finished, {len(done)} of {len(tasks)} "
        f"windows, in {run.folder}; run the same command again to continue"
    )


@contextmanager
def _held_beginning(output: Path, lock: OutputLock) -> Iterator[None]:
    """Begin a run while no other process does; a refusal leaves no lock file in an empty folder."""
    try:
        with hold_beginning(output):
            yield
    except BaseException:
        if not any(find_runs(output)) and lock.is_alone():
            forget_beginning(output)
        raise


def _refuse_other(run: RunFolder, whole: Job) -> None:
    """Refuse to do frames of a result again with other settings or inputs."""
    changes = list_changes(run.description, describing(whole)(run))
    if changes:
        raise OutputExists(
            f"there is a result of other settings or inputs in {run.output}: {changes}; bring them "
            "back to make single frames again, choose another output folder or look, or replace "
            "the whole result with --force"
        )


def _has_other_frames(job: Job, run: RunFolder) -> bool:
    """Whether a job selects timeCodes, and others than a run of its look did."""
    frames = run.description["settings"]["stage"]["frames"]
    return (
        run.look == job.config.layer.look
        and bool(job.config.stage.frames)
        and bool(frames != job.config.stage.frames)
    )


def _windows_of(whole: Plan, part: Plan) -> frozenset[int]:
    """The windows that hold the frames of a part; none when there are frames that no window has."""
    homes = {
        (task.volume.source.prim_path, code): task.window.index
        for task in list_tasks(whole)
        for code in task.window.time_codes
    }
    wanted = [
        (volume.source.prim_path, frame.source.time_code)
        for volume in part.volumes
        for frame in volume.frames
    ]
    if not all(place in homes for place in wanted):
        return frozenset()
    return frozenset(homes[place] for place in wanted)


def describing(job: Job, task: WindowTask | None = None) -> Describe:
    """How a job compares with runs: what it leaves to the machine is as it was for the run.

    Args:
        job: what was asked for.
        task: the window that is to be done; see ``joined_run``.
    """
    features_hash = features_hashes(volume.config.features for volume in job.plan.volumes)

    def describe(run: RunFolder | None) -> dict[str, Any]:
        if run is None:
            return _as_stored(settle_description(describe_run(job, features_hash), job))
        known, wanted = run.description.get("files", {}), _files_read(job, run, task)
        described = describe_run(job, features_hash, known, wanted)
        return _as_stored(taken_up(described, run.description))

    return describe


def _files_read(job: Job, run: RunFolder, task: WindowTask | None) -> set[str] | None:
    """The input files that a window reads; None: all, also where the run is only beginning."""
    if task is None or not run.scenes or missing_starts(run, job.plan, task.frames):
        return None
    return {field.file_path for frame in task.frames for field in frame.source.fields.values()}


def _as_stored(description: dict[str, Any]) -> dict[str, Any]:
    """As it comes back from a record."""
    stored: dict[str, Any] = json.loads(json.dumps(description))
    return stored

"""Which run a call belongs to: begun, continued, joined, done again, made longer, or refused."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from usdsmoke.base.errors import Interrupted, LayerError, OutputExists
from usdsmoke.base.locks import OutputLock, hold_file, lock_output
from usdsmoke.base.publish import remove_empty
from usdsmoke.planning.job import Job, prepare_job, recorded_request
from usdsmoke.planning.plan import Plan, WindowTask
from usdsmoke.runs.delivery import check_targets
from usdsmoke.runs.identity import Identity
from usdsmoke.runs.opened import OpenRun, missing_starts
from usdsmoke.runs.opening.growth import (
    Growth,
    continued,
    find_growth,
    has_frames_of,
    result_frames,
    take_over,
)
from usdsmoke.runs.opening.refusals import (
    FORCE,
    find_results,
    other_result,
    refuse_beside_unfinished,
    refuse_damaged,
    refuse_result,
    unfinished_in_the_way,
)
from usdsmoke.runs.progress import WAITING, RunProgressCallback
from usdsmoke.runs.run import Run, damaged_records, find_runs, new_run
from usdsmoke.runs.run_machine import with_known_voxels, with_settled
from usdsmoke.usd.look import published_runs

_BEGINNING = "vdb/begin.lock"  # held while a run begins


# A whole run, by one process


@contextmanager
def open_run(job: Job, accepted: Callable[[], object] = lambda: None) -> Iterator[OpenRun]:
    """The run of a whole job; no other process is in the output folder.

    A selection of a result's own frames means these frames once more: the job becomes the result's.
    One of these and more makes the result longer.

    Args:
        accepted: called where a run begins with its first frame, before torch is loaded.

    Raises:
        OutputExists: there is a result or an unfinished run of other settings, without ``force``.
        ConfigError: the device is not there.
        Interrupted: in the place of Ctrl-C.
    """
    with lock_output(job.output) as lock:
        again = None if job.request.force else frames_again(job)
        if again is not None:
            opened = OpenRun(again[1], again[0], lock, again[2])
        else:
            growth = find_growth(job)
            job = growth.job if growth else job
            run = _choose_run(job, Identity(job), growth=growth, accepted=accepted)
            opened = OpenRun(run, with_settled(job, run), lock)
            _take_over(opened, growth)
        with _tidy_end(opened):
            yield opened


def frames_again(job: Job) -> tuple[Job, Run, frozenset[int]] | None:
    """The whole job, its run and the windows to do, where the job is a part of a result's frames.

    Raises:
        OutputExists: the result is of other settings or inputs, or beside it is an unfinished run.
    """
    published = published_runs(job.targets.look_layer)
    selected, look = job.config.stage.frames, job.config.layer.look
    for run in find_runs(job.output):
        if not (run.complete and run.run_id in published and run.look == look):
            continue
        if selected and not has_frames_of(job, run):
            frames = result_frames(job, run)
            config = job.config.replace(stage=job.config.stage.replace(frames=frames))
            if "stage.frames" not in run.request.get("explicit", ()):  # the record stays as it was
                config = config.with_explicit(config.explicit - {"stage.frames"})
            whole = job.with_config(config)
            if numbers := _windows_of(whole.plan, job.plan):
                if changes := Identity(whole).changes(run):
                    if changes.only_files and whole.plan.n_frames == job.plan.n_frames:
                        return None  # see ``find_growth``
                    raise other_result(run.output, changes, is_part=True)
                refuse_beside_unfinished(job)
                return with_settled(whole, run), run, numbers
    return None


def _windows_of(whole: Plan, part: Plan) -> frozenset[int]:
    """The windows that hold the frames of a part; none when there are frames that no window has."""
    homes = {
        (task.volume.source.prim_path, code): task.number
        for task in whole.tasks
        for code in task.window.time_codes
    }
    requested = [
        (volume.source.prim_path, frame.source.time_code)
        for volume in part.volumes
        for frame in volume.frames
    ]
    if not all(place in homes for place in requested):
        return frozenset()
    return frozenset(homes[place] for place in requested)


# A task of a run, by one of several processes


@contextmanager
def join_run(
    job: Job, tell: RunProgressCallback, task: WindowTask | None = None
) -> Iterator[OpenRun]:
    """The run of a job that several processes may work on, begun if it was not.

    Of two processes that begin different runs at once one is refused: the record is there before a
    frame is read.

    Args:
        job: what was asked for; with ``force`` begun beside a result of other settings.
        tell: called if other processes at work have to be waited for, some minutes at most.
        task: the window that is to be done: no other inputs are read where the run has begun, is
            not a result yet, and this window's coarse starts are there. None: the coarse step.

    Raises:
        OutputExists: the folder holds a run or result of other settings or inputs, without
            ``force``.
        ConfigError: the device is not there.
        Interrupted: in the place of Ctrl-C.
    """

    def reads(run: Run) -> set[str] | None:
        if (
            task is None
            or run.complete
            or not run.scenes
            or missing_starts(run, job.plan, task.frames)
        ):
            return None
        return {file_path for frame in task.frames for file_path in frame.files}

    def waits() -> None:
        tell(WAITING)

    growth = find_growth(job)
    job = growth.job if growth else job
    identity = Identity(job, reads)
    if job.request.force and _find_equal(job.output, identity) is None:
        # Unfinished runs of other settings are removed: no other process may be at work on them.
        with lock_output(job.output, waits=waits):
            _choose_run(job, identity)
    with lock_output(job.output, alone=False, waits=waits) as lock:
        run = _find_equal(job.output, identity)
        if run is not None and growth is not None and not run.scenes:
            with _beginning(job.output, lock):  # another process takes over what stays
                run = _find_equal(job.output, identity)
        if run is None:
            _choose_run(job, identity, alone=False, growth=growth)  # or be refused
            with _beginning(job.output, lock):
                run = _find_equal(job.output, identity)
                if run is None:
                    run = _choose_run(job, identity, alone=False, growth=growth)
                    opened = OpenRun(run, with_settled(job, run), lock)
                    _take_over(opened, growth)
                    opened.begin()
        doing = "the coarse step" if task is None else f"window {task.number}"
        opened = OpenRun(run, with_settled(job, run), lock, task=doing)
        with _tidy_end(opened):
            yield opened


@contextmanager
def _beginning(output: Path, lock: OutputLock) -> Iterator[None]:
    """Begin a run while no other process does; a refusal leaves no lock file in an empty folder,
    where the file system can tell that nobody else is working there."""
    try:
        with hold_file(output / _BEGINNING):
            yield
    except BaseException:
        if not any(find_runs(output)) and lock.is_alone():
            (output / _BEGINNING).unlink(missing_ok=True)
            remove_empty([output / "vdb"])
        raise


def _take_over(opened: OpenRun, growth: Growth | None) -> None:
    """Begin a run that makes a result longer with what stays of it; once."""
    if growth is not None and not opened.run.scenes:
        opened.run.grown_from = (*growth.earlier.grown_from, growth.earlier.run_id)
        opened.begin()
        take_over(growth, opened.run)


@contextmanager
def _tidy_end(opened: OpenRun) -> Iterator[None]:
    """Let an error leave nothing behind, and let Ctrl-C say how far the run is."""
    try:
        yield
    except BaseException as error:
        message = opened.how_far() if isinstance(error, KeyboardInterrupt) else ""
        if opened.run.is_useless() and opened.lock.is_alone():
            opened.run.remove_locks()
            opened.run.remove()
        if message:
            raise Interrupted(message) from None
        raise


# The assembly


@contextmanager
def open_run_to_assemble(
    output: Path, look: str | None, mode: str | None, tell: RunProgressCallback
) -> Iterator[OpenRun]:
    """The run whose windows an output folder holds: the one that is not complete, if any.

    Args:
        output: the output folder, without links.
        look: the look's name; None where the folder leaves no choice.
        mode: ``layer.mode`` in the place of the run's.
        tell: called if other processes at work have to be waited for, some minutes at most.

    Raises:
        LayerError: there is none, or several.
        OutputExists: the inputs are not those the run was begun with.
        Interrupted: in the place of Ctrl-C.
    """
    if not output.is_dir():
        raise LayerError(f"there is no folder {output}. Give the folder with the windows.")
    with lock_output(output, waits=lambda: tell(WAITING)) as lock:
        run = _run_to_assemble(output, look)
        job = continued(prepare_job(recorded_request(output, run.request, mode), fits=False))
        check_targets(job)
        changes = Identity(job).changes(run)
        if changes:
            raise OutputExists(
                f"the inputs of the run in {run.folder} have changed: {changes}. "
                f"Restore them, or stylize again with {FORCE}.",
                changes.details,
            )
        try:
            yield OpenRun(run, with_known_voxels(job, run.scenes), lock)
        except KeyboardInterrupt:
            raise Interrupted("stopped. Run the same command again to continue.") from None


def _run_to_assemble(output: Path, look: str | None) -> Run:
    runs = [run for run in find_runs(output) if look in (None, run.look)]
    unfinished = [run for run in runs if not run.complete]
    if not (runs or look) and (damaged := damaged_records(output)):
        raise LayerError(
            f"{damaged[0]} is damaged, so its run cannot be assembled. If a look layer shows files "
            "of that folder, leave both as they are: the result is complete. Otherwise remove the "
            "folder, and start the run again."
        )
    if not runs:
        named = f" of the look {look}" if look else ""
        raise LayerError(
            f"there is no run{named} in {output}. Give the output folder of a run, or start one "
            "with 'usdsmoke stylize ... --window K'."
        )
    looks = sorted({run.look for run in unfinished or runs})
    if len(looks) > 1:
        raise LayerError(f"{output} holds several looks: {', '.join(looks)}. Name one with --look.")
    if len(unfinished) > 1:
        keys = ", ".join(run.folder.name for run in unfinished)
        raise LayerError(
            f"{output}/vdb holds {len(unfinished)} unfinished runs ({keys}). Remove the folders of "
            "those that you do not need."
        )
    run = (unfinished or runs)[0]
    if not run.request:
        raise LayerError(
            f"the run in {run.folder} does not record how it was started. Repeat the 'usdsmoke "
            "stylize' command that started it."
        )
    return run


# The runs of an output folder


def _find_equal(output: Path, identity: Identity) -> Run | None:
    """A run of the same settings and inputs: the unfinished one before the complete one."""
    runs = [run for run in find_runs(output) if identity.is_of(run)]
    return min(runs, key=lambda run: run.complete, default=None)


def _choose_run(
    job: Job,
    identity: Identity,
    alone: bool = True,
    growth: Growth | None = None,
    accepted: Callable[[], object] = lambda: None,
) -> Run:
    """The run to begin or to continue; with ``force``, runs that never became a result go away.

    Runs of other looks in the same folder do not matter. A look layer may point to a run that was
    stopped before its last step; such a run is continued like any other.

    Args:
        alone: no other process is in the folder; otherwise its unfinished runs stay.
        growth: the result that may be in the way, because it is made longer.
        accepted: see ``open_run``.

    Raises:
        OutputExists: there is a result, an unfinished run of other settings, or a damaged record of
            this run, without ``force``.
        LayerError: see ``check_targets``.
    """
    output, force = job.output, job.request.force
    check_targets(job)
    published, runs, results = find_results(job)
    unfinished = [run for run_id, run in runs.items() if run_id not in results]
    others = [run for run in unfinished if not identity.is_of(run)]
    refuse_result(job, growth)
    given_up = [run for run in others if run.run_id not in published]
    if others and not (force and (alone or not given_up)):
        raise unfinished_in_the_way(output, others[0], identity)
    for run in given_up:
        run.remove()
    for run in unfinished:
        if run not in others:
            run.complete = False
            return run
    if growth is not None:  # the machine stays the same too
        return new_run(output, identity.beside(growth.earlier), identity.stamps)
    accepted()  # the machine is looked at meanwhile
    run = new_run(output, identity.alone(), identity.stamps)
    if not force:
        refuse_damaged(run)
    return run

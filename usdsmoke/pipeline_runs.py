"""Which run a call belongs to: begun, continued, joined by several processes, or done again."""

import dataclasses
import json
from collections.abc import Callable, Iterator, Set
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from usdsmoke.config import Config, config_to_dict
from usdsmoke.errors import Interrupted, LayerError, OutputExists
from usdsmoke.locks import OutputLock, lock_output
from usdsmoke.pipeline_coarse import measure_scenes
from usdsmoke.pipeline_features import features_hashes
from usdsmoke.pipeline_frames import FrameReader
from usdsmoke.pipeline_inputs import Job, describe_request, describe_run, published_runs
from usdsmoke.pipeline_windows import list_tasks
from usdsmoke.plan import Plan
from usdsmoke.run_changes import list_changes
from usdsmoke.run_folder import RunFolder, find_runs, open_run
from usdsmoke.run_windows import finished_window, is_useless

__all__ = [
    "begin_run",
    "check_same",
    "how_far",
    "is_whole",
    "joined_run",
    "open_or_redo",
    "run_to_assemble",
    "tidy_end",
]


def open_or_redo(
    job: Job, force: bool, prepare: Callable[[Config], Job]
) -> tuple[Job, RunFolder, Set[int]]:
    """The run of a whole job, and which of its windows are to be done again though they are done.

    A selection of a result's own frames means these frames once more: the job becomes the result's.

    Args:
        job: what was asked for.
        force: replace a result, and give up unfinished runs of other settings.
        prepare: makes the same job with other settings.

    Raises:
        OutputExists: there is a result or an unfinished run of other settings, without ``force``.
    """
    published = published_runs(job)
    if not force:
        for run in find_runs(job.output):
            if run.complete and run.run_id in published and _selects_other_frames(job, run):
                frames = run.description["settings"]["stage"]["frames"]
                stage = dataclasses.replace(job.config.stage, frames=frames)
                whole = prepare(dataclasses.replace(job.config, stage=stage))
                redone = _windows_of(whole.plan, job.plan)
                if redone and describe_run(whole, _features_hash(whole.plan)) == run.description:
                    return whole, run, redone
    description = describe_run(job, _features_hash(job.plan))
    return job, open_run(job.output, description, published, force), frozenset()


@contextmanager
def joined_run(job: Job, force: bool) -> Iterator[tuple[RunFolder, OutputLock]]:
    """The run of a job that several processes may work on, begun or not; the folder is held.

    Raises:
        OutputExists: the folder holds a run or result of other settings or inputs, and ``force``
            does not say to begin beside it.
    """
    description = describe_run(job, _features_hash(job.plan))
    if force and _equal_run(job.output, description) is None:
        with lock_output(job.output):  # unfinished runs of other settings go: nobody may be at them
            open_run(job.output, description, published_runs(job), force)
    with lock_output(job.output, alone=False) as lock:
        run = _equal_run(job.output, description)
        if run is None:
            run = open_run(job.output, description, published_runs(job), force)
        yield run, lock


def begin_run(job: Job, run: RunFolder, reader: FrameReader) -> None:
    """Measure the scenes and make the run's record, or take up what another process has begun.

    Raises:
        GridError, NonFiniteError: see ``FrameReader.read``.
        WriteFailed: the operating system refused.
    """
    if run.scenes or run.adopt():
        run.tidy()
        return
    described = job.plan.to_dict()
    # What of the plan stays with the result: nothing that names folders of this machine.
    plan = {key: described[key] for key in ("windows", "needed", "omitted", "estimate")}
    run.begin(plan, describe_request(job), measure_scenes(reader, job.plan))


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


def run_to_assemble(output: Path, look: str | None = None) -> RunFolder:
    """The run whose windows an output folder holds: the one that is not complete, if any.

    Args:
        output: the output folder.
        look: the look's name; None where the folder leaves no choice.

    Raises:
        LayerError: there is none, or several.
    """
    runs = [run for run in find_runs(output) if look in (None, run.look)]
    unfinished = [run for run in runs if not run.complete]
    if not runs:
        named = f" of the look {look}" if look else ""
        raise LayerError(
            f"there is no run{named} in {output}; begin one with 'usdsmoke stylize ... --window "
            "K', or give the folder that its windows were written to"
        )
    looks = sorted({run.look for run in unfinished or runs})
    if len(looks) > 1:
        raise LayerError(
            f"{output} holds several looks: {', '.join(looks)}; name one of them with --look"
        )
    if len(unfinished) > 1:
        keys = ", ".join(run.folder.name for run in unfinished)
        raise LayerError(
            f"{output}/vdb holds {len(unfinished)} unfinished runs ({keys}); remove the folders of "
            "those that are not wanted"
        )
    run = (unfinished or runs)[0]
    if not run.request:
        raise LayerError(
            f"the run in {run.folder} does not tell what it was begun with; run 'usdsmoke stylize' "
            "as it was begun"
        )
    return run


def check_same(run: RunFolder, job: Job) -> None:
    """Refuse inputs that are not those the run was begun with.

    Raises:
        OutputExists: names what has changed.
    """
    changes = list_changes(
        run.description, _as_stored(describe_run(job, run.description["features_hash"]))
    )
    if changes:
        raise OutputExists(
            f"the inputs of the run in {run.folder} are no longer the same: {changes}; bring them "
            "back, or stylize again with --force"
        )


def is_whole(run: RunFolder, job: Job) -> bool:
    """Whether a complete run still has all files that the job wants, made from the parts that are
    there."""
    frames = [frame.file_name for volume in job.plan.volumes for frame in volume.frames]
    files = [*job.targets.written, *(run.output / name for name in run.files)]
    records = [run.finished(name) for name in frames]
    parts = [part for record in records if record for part in record.get("parts", {}).items()]
    standing = [run.is_unchanged(name, sha) for name, sha in parts if (run.folder / name).exists()]
    return all(records) and all(path.is_file() for path in files) and all(standing)


def _selects_other_frames(job: Job, run: RunFolder) -> bool:
    """Whether a run has the job's settings but for the timeCodes."""
    settings = config_to_dict(job.config)
    theirs = run.description.get("settings", {})
    same = [
        value == settings.get(section, {}).get(key)
        for section, values in theirs.items()
        for key, value in values.items()
        if (section, key) != ("stage", "frames")
    ]
    frames = theirs.get("stage", {}).get("frames", "")
    return all(same) and bool(job.config.stage.frames) and frames != job.config.stage.frames


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


def _equal_run(output: Path, description: dict[str, Any]) -> RunFolder | None:
    """A run of the same description: the unfinished one before the complete one."""
    runs = [run for run in find_runs(output) if run.description == _as_stored(description)]
    return min(runs, key=lambda run: run.complete, default=None)


def _as_stored(description: dict[str, Any]) -> dict[str, Any]:
    """As it comes back from a record."""
    stored: dict[str, Any] = json.loads(json.dumps(description))
    return stored


def _features_hash(plan: Plan) -> str:
    return features_hashes(volume.config.features for volume in plan.volumes)

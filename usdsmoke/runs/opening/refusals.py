"""What of an output folder is in the way of a job, and how a refusal says it."""

from collections.abc import Collection, Sequence
from pathlib import Path

from usdsmoke.base.errors import OutputExists
from usdsmoke.base.naming import RUNS_FOLDER
from usdsmoke.base.time_codes import format_time_codes
from usdsmoke.planning.job import Job
from usdsmoke.runs.changes import Changes
from usdsmoke.runs.delivery import check_targets
from usdsmoke.runs.identity import Identity
from usdsmoke.runs.opening.growth import Growth, compare_run
from usdsmoke.runs.run import Run, find_runs
from usdsmoke.usd.look import published_runs

_MOST_NAMED = 3  # frames in a message
FORCE = "--force (force=True in Python)"


def refuse_runs(job: Job, growth: Growth | None) -> None:
    """Refuse a whole job for what is in its output folder, as ``open_run`` does; but not for a
    damaged record, which only the machine that runs it knows to be one of this job.

    Raises:
        OutputExists: as of ``refuse_result``; or there is an unfinished run of other settings.
        LayerError: see ``check_targets``.
    """
    check_targets(job)
    _, runs, results = find_results(job)
    if not (runs or results) or job.request.force:
        return
    refuse_result(job, growth)
    identity = Identity(job)
    for run_id, run in runs.items():
        if run_id not in results and not identity.is_of(run):
            raise unfinished_in_the_way(job.output, run, identity)


def refuse_result(job: Job, growth: Growth | None) -> None:
    """Refuse a job for a result of its look.

    Args:
        growth: the result that may be there, because it goes on.

    Raises:
        OutputExists: there is one, without ``force``.
    """
    _, runs, results = find_results(job)
    in_the_way = results - ({growth.earlier.run_id} if growth else set())
    if in_the_way and not job.request.force:
        known = [runs[run_id] for run_id in sorted(in_the_way) if run_id in runs]
        raise _result_in_the_way(job, known)


def refuse_damaged(run: Run) -> None:
    """Refuse to begin a run beside a folder of the same run whose record cannot be read.

    Raises:
        OutputExists: there is such a folder.
    """
    if damaged := run.damaged():
        raise OutputExists(
            f"{damaged[0]}, the record of this run, is damaged, so the run cannot be continued. "
            f"Remove the folder that it is in, or begin again with {FORCE}."
        )


def find_results(job: Job) -> tuple[Collection[str], dict[str, Run], set[str]]:
    """Ids of published runs, the runs of the job's look by id, and ids of finished results."""
    published = published_runs(job.targets.look_layer)
    runs = {run.run_id: run for run in find_runs(job.output) if run.look == job.config.layer.look}
    results = {run_id for run_id in published if run_id not in runs or runs[run_id].complete}
    return published, runs, results


def refuse_beside_unfinished(job: Job) -> None:
    """Refuse to repeat frames of a result where an unfinished run of its look would be removed.

    Raises:
        OutputExists: there is such a run.
    """
    _, runs, results = find_results(job)
    for run_id, other in runs.items():
        if run_id not in results and not other.complete:
            raise OutputExists(
                f"{other.folder} holds an unfinished run of this look, which would be removed when "
                "frames of its result are repeated. Finish it first, or remove this folder."
            )


def unfinished_in_the_way(output: Path, run: Run, identity: Identity) -> OutputExists:
    """The refusal for an unfinished run of other settings."""
    changes = identity.changes(run)
    return OutputExists(
        f"{output} holds an unfinished run with different settings or inputs: {changes}. "
        "Finish it with its own settings, choose another output folder, or discard it with "
        f"{FORCE}.",
        changes.details,
    )


def _result_in_the_way(job: Job, known: Sequence[Run]) -> OutputExists:
    """Why a result stays as it is, and what can be done instead."""
    output = job.output
    advice = f"choose another output folder or look, or replace it with {FORCE}."
    if not known:
        return OutputExists(
            f"{output} already holds a result, and the record of its run in {output / RUNS_FOLDER} "
            f"is missing or damaged. {advice[0].upper()}{advice[1:]}"
        )
    run = known[0]
    if changes := compare_run(job, run):
        return other_result(output, changes)
    codes_of = {name: float(frame["time_code"]) for name, frame in run.frames.items()}
    all_codes = format_time_codes(sorted(set(codes_of.values())))
    lost = [name for name in sorted(run.frames) if run.finished(name) is None]
    if lost:
        named = ", ".join(lost[:_MOST_NAMED])
        more = f" and {len(lost) - _MOST_NAMED} more" if len(lost) > _MOST_NAMED else ""
        codes = format_time_codes(sorted({codes_of[name] for name in lost}))
        are = "is" if len(lost) == 1 else "are"
        repair = f"Repeat the run with --frames={codes} (the setting stage.frames)"
        if codes == all_codes:  # then it is no part that is asked for
            repair = f"Repeat the run with {FORCE}"
        return OutputExists(
            f"{named}{more} {are} missing or changed in {run.folder}. {repair} to repair the "
            "result."
        )
    has_parts = len(set(codes_of.values())) > 1
    again = "redo some of its frames with stage.frames (--frames), " if has_parts else ""
    return OutputExists(
        f"{output} already holds this result. Change its mode with 'usdsmoke assemble', {again}"
        f"{advice}"
    )


def other_result(output: Path, changes: Changes, is_part: bool = False) -> OutputExists:
    """The refusal for a result of other settings.

    Args:
        is_part: some of the result's frames are asked for, and its other frames depend on what has
            changed too.
    """
    longer = "select the result's frames and more to make it longer, " if changes.frames else ""
    if changes.only_files and is_part:
        longer = "select all of the result's frames to do again what depends on these files, "
    return OutputExists(
        f"{output} already holds a result with different settings or inputs: {changes}. "
        f"Restore them, {longer}choose another output folder or look, or replace the result with "
        f"{FORCE}.",
        changes.details,
    )

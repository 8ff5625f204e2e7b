"""Finished parts of a run: what a task returns, which run is assembled, and whether it holds."""

from dataclasses import dataclass
from pathlib import Path

from usdsmoke.base.errors import LayerError, OutputExists
from usdsmoke.planning.job import Job
from usdsmoke.planning.plan import Plan
from usdsmoke.runs.begin import describing
from usdsmoke.runs.changes import list_changes
from usdsmoke.runs.folder import RunFolder, find_runs

__all__ = ["StepResult", "check_same", "is_whole", "run_to_assemble"]


@dataclass(frozen=True)
class StepResult:
    """What a part of a run left behind: one window, or the coarse step."""

    folder: Path  # of the run
    manifest: Path  # what was written, for machines; a run without a coarse step has none
    was_done: bool  # nothing was left to do
    plan: Plan
    warnings: tuple[str, ...] = ()


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
    changes = list_changes(run.description, describing(job)(run))
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

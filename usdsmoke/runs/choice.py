"""Which run of an output folder is meant: continued, begun beside it, or refused with a reason."""

import copy
from collections.abc import Callable, Mapping, Set
from pathlib import Path
from typing import Any

from usdsmoke.base.errors import OutputExists
from usdsmoke.base.time_codes import format_time_codes
from usdsmoke.runs.changes import list_changes
from usdsmoke.runs.folder import RunFolder, find_runs, new_run

__all__ = ["Describe", "find_equal", "open_run", "taken_up"]

# The description of what is asked for, as it compares with a run's; None: on its own.
Describe = Callable[[RunFolder | None], dict[str, Any]]

_OPEN = {"threads": 0, "device": "auto"}  # values of ``optimize`` that leave it to the machine
_MOST_NAMED = 3  # frames in a message


def taken_up(description: Mapping[str, Any], earlier: Mapping[str, Any]) -> dict[str, Any]:
    """A description in which what is left to the machine is as it was when a run began.

    Args:
        description: of what is asked for.
        earlier: the run's.
    """
    taken = copy.deepcopy(dict(description))
    before = earlier.get("settings", {}).get("optimize", {})
    optimize = taken.get("settings", {}).get("optimize", {})
    for name, value in _OPEN.items():
        if name in before and optimize.get(name) == value:
            optimize[name] = before[name]
    return taken


def find_equal(output: Path, describe: Describe) -> RunFolder | None:
    """A run of the same settings and inputs: the unfinished one before the complete one.

    Args:
        output: the output folder; need not exist.
        describe: what is asked for.
    """
    runs = [run for run in find_runs(output) if describe(run) == run.description]
    return min(runs, key=lambda run: run.complete, default=None)


def open_run(
    output: Path,
    look: str,
    describe: Describe,
    published: Set[str],
    force: bool,
    alone: bool = True,
) -> RunFolder:
    """The run to begin or to continue; with ``force``, runs that never became a result go away.

    Runs of other looks in the same folder do not count. A look layer may point to a run that was
    stopped before its last step; such a run is continued like any other.

    Args:
        output: the output folder; need not exist.
        look: the look's name.
        describe: what is asked for.
        published: run ids that this look's layers in the folder name; "" for one that names none.
        force: replace a result, and give up unfinished runs of other settings.
        alone: no other process is in the folder; otherwise its unfinished runs stay.

    Raises:
        OutputExists: there is a result or an unfinished run of other settings, without ``force``.
    """
    runs = {run.run_id: run for run in find_runs(output) if run.look == look}
    results = {run_id for run_id in published if run_id not in runs or runs[run_id].complete}
    unfinished = [run for run_id, run in runs.items() if run_id not in results]
    others = [run for run in unfinished if describe(run) != run.description]
    if results and not force:
        known = [runs[run_id] for run_id in sorted(results) if run_id in runs]
        raise OutputExists(_result_in_the_way(output, known[0] if known else None, describe))
    given_up = [run for run in others if run.run_id not in published]
    if others and not (force and (alone or not given_up)):
        changes = list_changes(others[0].description, describe(others[0]))
        raise OutputExists(
            f"{output} holds an unfinished run of other settings or inputs: {changes}; run it "
            "again as it was to finish it, choose another output folder, or give it up with --force"
        )
    for run in given_up:
        run.remove()
    for run in unfinished:
        if run not in others:
            run.complete = False
            return run
    return new_run(output, describe(None))


def _result_in_the_way(output: Path, run: RunFolder | None, describe: Describe) -> str:
    """Why a result stays as it is, and what can be done instead."""
    advice = "choose another output folder or look, or replace it with --force"
    if run is None:
        return f"there is a result in {output} already; {advice}"
    changes = list_changes(run.description, describe(run))
    if changes:
        return f"there is a result of other settings or inputs in {output}: {changes}; {advice}"
    lost = [name for name in sorted(run.frames) if run.finished(name) is None]
    if lost:
        named = ", ".join(lost[:_MOST_NAMED])
        more = f" and {len(lost) - _MOST_NAMED} more" if len(lost) > _MOST_NAMED else ""
        codes = format_time_codes(sorted({float(run.frames[name]["time_code"]) for name in lost}))
        return (
            f"the result in {output} is damaged: {named}{more} in {run.folder} "
            f"{'is' if len(lost) == 1 else 'are'} missing or changed; make "
            f"{'it' if len(lost) == 1 else 'them'} again by the same command with --frames={codes}"
        )
    return (
        f"there is a result in {output} already; put it together in another mode with 'usdsmoke "
        f"assemble', make single frames again with --frames, {advice}"
    )

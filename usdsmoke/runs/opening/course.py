"""What a call does with what is in its output folder, as its plan tells it beforehand."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from functools import cached_property

from usdsmoke.base.errors import LayerError, OutputExists
from usdsmoke.base.time_codes import name_time_codes
from usdsmoke.planning.job import Job
from usdsmoke.planning.make_plan import estimate_part
from usdsmoke.planning.plan import Plan, WindowTask
from usdsmoke.planning.remarks import fine_marks_remarks, measured_remarks
from usdsmoke.runs.identity import Identity
from usdsmoke.runs.manifests import coarse_file_name
from usdsmoke.runs.opening.choose import frames_again
from usdsmoke.runs.opening.growth import Growth, find_growth
from usdsmoke.runs.opening.refusals import find_results, refuse_runs
from usdsmoke.runs.run import Run


class Course:
    """Whether a job begins a run, goes on with one, makes a result longer, or does a part of one
    again. Nothing is written, and what is asked for twice is found once."""

    def __init__(self, job: Job) -> None:
        self._job = job

    def plan(self, whole: bool = True) -> Plan:
        """The job's plan, with notes on what stays and the costs of what is left to do.

        Args:
            whole: False: for a task of the run, where it does not matter which others are done.
        """
        again = self._again
        if isinstance(again, str):
            return self._job.plan
        if again is not None:
            return _repeated(again[0], again[2], self._job.plan)
        growth, unfinished = self._growth, self._unfinished if whole else None
        plan = growth.job.plan if growth else self._job.plan
        if unfinished is not None:
            return _resumed(unfinished, plan)
        if growth is None and self.refusal:  # nothing is measured
            return replace(plan, notes=tuple(_lasting_notes(self._job)))
        return _grown(growth) if growth else plan

    @property
    def refusal(self) -> str:
        """Why ``open_run`` would refuse the whole job; "" where it would not."""
        if self._again is not None:
            return self._again if isinstance(self._again, str) else ""
        growth = self._growth
        try:
            refuse_runs(growth.job if growth else self._job, growth)
        except (OutputExists, LayerError) as error:
            return str(error)
        return ""

    @cached_property
    def _again(self) -> tuple[Job, Run, frozenset[int]] | str | None:
        """As of ``frames_again``, or why it refuses."""
        try:
            return None if self._job.request.force else frames_again(self._job)
        except OutputExists as error:
            return str(error)

    @cached_property
    def _growth(self) -> Growth | None:
        return find_growth(self._job)

    @cached_property
    def _unfinished(self) -> Run | None:
        """The stopped run that the job goes on with."""
        job = self._growth.job if self._growth else self._job
        _, runs, results = find_results(job)
        stopped = [run for run_id, run in runs.items() if run_id not in results]
        identity = Identity(job)
        return next((run for run in stopped if identity.is_of(run)), None)


def _repeated(job: Job, numbers: Collection[int], part: Plan) -> Plan:
    whole = job.plan
    done = [task for task in whole.tasks if task.number in numbers]
    stay = [task for task in whole.tasks if task.number not in numbers]
    kept, _ = _kept_and_left(stay, done)
    notes = ["the output folder holds this result", kept, f"to do again: {_named(done)}"]
    notes += _lasting_notes(job)
    estimate = estimate_part(whole, done, {*_frames(whole)})
    return replace(part, notes=tuple(notes), estimate=estimate)


def _grown(growth: Growth) -> Plan:
    plan, stay = growth.job.plan, [task for task, _ in growth.windows]
    again = [
        f"finished {name_time_codes(sorted(codes))} are computed again and change: {why}"
        for why, codes in growth.finished_again.items()
    ]
    kept_and_left = _kept_and_left(stay, growth.to_do)
    notes = [*growth.notes, *kept_and_left, *again, *_lasting_notes(growth.job)]
    started = {name for name in _frames(plan) if coarse_file_name(name) in growth.starts}
    estimate = estimate_part(plan, growth.to_do, started)
    return replace(plan, notes=tuple(notes), estimate=estimate)


def _resumed(run: Run, plan: Plan) -> Plan:
    left = [task for task in plan.tasks if not run.manifest_path(task.number).is_file()]
    numbers = {task.number for task in left}
    done = [task for task in plan.tasks if task.number not in numbers]
    note = f"a run that was stopped goes on; done: {_named(done) if done else 'no window yet'}"
    started = {n for n in _frames(plan) if (run.folder / coarse_file_name(n)).is_file()}
    estimate = estimate_part(plan, left, started)
    return replace(plan, notes=(note, *plan.notes), estimate=estimate)


def _frames(plan: Plan) -> Iterator[str]:
    return (frame.file_name for volume in plan.volumes for frame in volume.frames)


def _lasting_notes(job: Job) -> list[str]:
    """The notes but those on measuring, because nothing is measured again."""
    measured = measured_remarks(job.plan.volumes)
    for volume in job.plan.volumes:
        measured += fine_marks_remarks(volume, job.pictures(volume))
    return [note for note in job.plan.notes if note not in measured]


def _kept_and_left(stay: Sequence[WindowTask], left: Sequence[WindowTask]) -> tuple[str, str]:
    kept = f"{_named(stay)}, " if stay else ""
    return f"kept: {kept}extinction and picture size", f"to do: {_named(left)}"


def _named(tasks: Sequence[WindowTask]) -> str:
    return name_time_codes(sorted({code for task in tasks for code in task.window.time_codes}))

"""A run as tasks: the coarse step, then windows in any order, then the assembly."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from usdsmoke.pipeline import Request, plan_with_notes, run_coarse, run_window
from usdsmoke.planning.job import Job, prepare_job
from usdsmoke.planning.plan import Plan
from usdsmoke.planning.visibility import check_visibility
from usdsmoke.runs.delivery import check_targets
from usdsmoke.runs.opening import find_growth, frames_again, refuse_result
from usdsmoke.runs.progress import RunProgressCallback


@dataclass(frozen=True)
class Tasks:
    """What every task of a run is given.

    Attributes:
        request: if some frames of a result are selected, with all of its frames.
        plan: of the whole run.
        redo: windows to compute once more though they are finished.
    """

    request: Request
    plan: Plan
    redo: frozenset[int] = frozenset()

    @property
    def windows(self) -> dict[int, float]:
        """The first timeCode of each window to do, by its number, in order."""
        windows = [window for volume in self.plan.volumes for window in volume.windows]
        starts = {window.index: min(window.time_codes) for window in windows}
        return {number: starts[number] for number in sorted(self.redo or starts)}

    def run(self, window: int | None, progress: RunProgressCallback | None = None) -> None:
        """Do a window, or the coarse step; in any process that sees the same files.

        Raises:
            UsdSmokeError: the errors of ``run_window``.
        """
        if window is None:
            run_coarse(self.request, progress, of_run=True)
        else:
            request = replace(self.request, force=False)
            run_window(request, window, progress, redo=window in self.redo)


def divide_run(request: Request, planned: Callable[[Plan], None] | None = None) -> Tasks:
    """The tasks of a run that begins, goes on or repeats frames of a result, for other machines.

    Args:
        request: what is asked for.
        planned: called once with the plan.

    Raises:
        PlanError: a camera sees none of the smoke.
        OutputExists: a finished result is in the way.
    """
    job = prepare_job(request, fits=False)
    if planned is not None:
        planned(plan_with_notes(job))
    check_visibility(job.plan.volumes)
    return divide_job(job)


def divide_job(job: Job) -> Tasks:
    """``divide_run`` behind its plan.

    Raises:
        OutputExists: a finished result is in the way.
    """
    if not job.request.force and job.config.stage.frames:
        repeated = frames_again(job)
        if repeated is not None:
            job, _, numbers = repeated
            return Tasks(job.request.with_config(job.config), job.plan, frozenset(numbers))
    check_targets(job)
    growth = find_growth(job)
    refuse_result(job, growth)
    return Tasks(job.request, growth.job.plan if growth else job.plan)

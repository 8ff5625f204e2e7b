"""Takes the points of a sweep one by one until its share of the time is used."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from usdsmoke.report.budget import Budget
from usdsmoke.report.conclude import conclude
from usdsmoke.report.measure import Clock, measure
from usdsmoke.report.records import CPU_TIME, WALL_TIME, Omission, Plan, Point, SweepResult, Task

if TYPE_CHECKING:
    from usdsmoke.report.case import Case

__all__ = ["Sweep", "Tell", "run_sweeps"]

# sweep, what is done in it, share of the time that is used
Tell = Callable[[str, str, float], None]


@dataclass(frozen=True)
class Sweep:
    """One question to a scene."""

    name: str
    title: str
    weight: float  # of its share of the time
    applies: Callable[["Case"], str]  # why the scene has no use for it, or ""
    plan: Callable[["Case"], Plan]


def run_sweeps(
    sweeps: Sequence[Sweep], case: "Case", budget: Budget, clock: Clock, tell: Tell
) -> tuple[list[SweepResult], list[Omission]]:
    """Every sweep that the scene has a use for, as far as the time allows.

    Args:
        sweeps: the most useful first.
        case: the scene.
        budget: what they share; a point that is begun is finished.
        clock: of the measurements.
        tell: hears of every point before it is taken.

    Returns:
        What was measured, and what was not, with the reason.
    """
    results, omitted = [], []
    wanted = []
    for sweep in sweeps:
        reason = sweep.applies(case)
        if reason:
            omitted.append(Omission(sweep.title, reason))
        else:
            wanted.append(sweep)
    for number, sweep in enumerate(wanted):
        if budget.left <= 0:
            omitted.append(Omission(sweep.title, _no_time(budget)))
            continue
        end = budget.until([later.weight for later in wanted[number:]])
        tell(sweep.title, "reference", _share(budget))
        plan = _timed_by(sweep.plan(case), case.on_gpu)
        points, missing = _take(sweep, plan, end, budget, clock, case.on_gpu, tell)
        if not points:
            omitted.append(Omission(sweep.title, _no_time(budget)))
            continue
        if missing:
            reason = f"{_no_time(budget)}: {'; '.join(missing)}"
            omitted.append(Omission(f"Points of “{sweep.title}”", reason))
        found = SweepResult(sweep.name, sweep.title, plan, tuple(points), tuple(missing))
        results.append(conclude(found))
    return results, omitted


def _take(
    sweep: Sweep,
    plan: Plan,
    end: float,
    budget: Budget,
    clock: Clock,
    on_gpu: bool,
    tell: Tell,
) -> tuple[list[Point], list[str]]:
    """The points that fit, and those that do not: a curve and the names of its points each."""
    points: list[Point] = []
    missing: dict[str, list[str]] = {}
    rates: dict[str, float] = {}  # seconds per unit of effort, by curve
    for task in plan.tasks:
        name = f"{task.curve}, {task.label}"
        rate = rates.get(task.curve, max(rates.values(), default=0.0))
        expected = rate * task.effort * (plan.n_runs + plan.warm_up)
        if budget.left <= 0 or (points and budget.spent + expected > end):
            missing.setdefault(task.curve, []).append(task.label)
            continue
        tell(sweep.title, name, _share(budget))
        started = budget.spent
        points.append(_measured(task, plan, clock, on_gpu))
        rates[task.curve] = (budget.spent - started) / task.effort / (plan.n_runs + plan.warm_up)
    return points, [f"{curve} ({', '.join(labels)})" for curve, labels in missing.items()]


def _measured(task: Task, plan: Plan, clock: Clock, on_gpu: bool) -> Point:
    task.prepare()
    found = measure(task.work, task.error, plan.n_runs, clock, plan.warm_up, task.size)
    cost = found.size or (found.wall if on_gpu else found.cpu)
    return Point(
        task.curve, task.label, task.configured, task.setting, found.error, cost, found.cpu,
        found.wall, plan.n_runs,
    )  # fmt: skip


def _timed_by(plan: Plan, on_gpu: bool) -> Plan:
    """On a GPU the clock on the wall counts, and the diagram says so."""
    return replace(plan, y_label=WALL_TIME) if on_gpu and plan.y_label == CPU_TIME else plan


def _share(budget: Budget) -> float:
    return min(budget.spent / budget.seconds, 1.0)


def _no_time(budget: Budget) -> str:
    return f"did not fit the {budget.seconds:g} s that the report was given"

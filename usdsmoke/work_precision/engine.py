"""Measures the points of sweeps in order until the time is over.

First each sweep gets its three most useful points, since fewer say nothing. The remaining time goes
to the remaining points. A point that is not expected to fit is passed over and named.
"""

import resource
import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.planning.plan import Omission
from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.page import verdict_on
from usdsmoke.work_precision.records import (
    CPU_TIME,
    WALL_TIME,
    LeftOut,
    Plan,
    Point,
    SweepResult,
    Task,
    spread_of,
)

_FEWEST = 3  # points of a sweep, where it has as many

# sweep, point, share of the time that is used
Tell = Callable[[str, str, float], None]


@dataclass(frozen=True)
class Sweep:
    """One question to a scene."""

    name: str
    title: str
    applies: Callable[[Case], str]  # why the scene has no use for it, or ""
    plan: Callable[[Case], Plan]  # raises LeftOut if it does not fit case.allowed seconds


class Budget:
    """The time that a report may take."""

    def __init__(self, seconds: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.seconds, self._clock = seconds, clock
        self._began = clock()

    @property
    def spent(self) -> float:
        """Seconds since the beginning."""
        return self._clock() - self._began

    @property
    def left(self) -> float:
        """Remaining seconds; negative if a point took longer than expected."""
        return self.seconds - self.spent


def cpu_seconds() -> float:
    """CPU time of this process and of the children that have ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


@dataclass(frozen=True)
class Clock:
    """Where times come from."""

    wall: Callable[[], float] = time.perf_counter
    cpu: Callable[[], float] = cpu_seconds
    settle: Callable[[], None] = lambda: None  # waits for work that a GPU has in its queue


@dataclass(frozen=True)
class _Run:
    result: Any
    cpu: float
    wall: float


@dataclass
class _Progress:
    """A sweep with its measured points and the rest."""

    sweep: Sweep
    plan: Plan
    pending: list[Task]
    points: list[Point] = field(default_factory=list)
    rate: float = 0.0  # seconds per unit of effort, with all runs of a point
    failure: str = ""

    def first(self) -> list[Task]:
        """What is missing of the first three points: the configured one and the cheapest others."""
        n = min(_FEWEST, len(self.plan.tasks)) - len(self.points)
        ranked = sorted(self.pending, key=lambda task: (not task.configured, self.expected(task)))
        chosen = ranked[: max(n, sum(task.configured for task in self.pending))]
        return [task for task in self.pending if task in chosen]

    def expected(self, task: Task) -> float:
        """Seconds that a point is expected to take; 0 if nothing is known."""
        return self.rate * task.effort


def measure(task: Task, plan: Plan, clock: Clock, known: dict[Hashable, list[_Run]]) -> Point:
    """Measure one point: all of its runs, or those of an equal point in ``known``.

    Errors are computed outside the time that is taken.
    """
    runs = known.get(task.key, []) if task.key is not None else []
    if not runs:
        task.prepare()
        if plan.warm_up:
            task.work(0)
        runs = [_timed(task, number, clock) for number in range(plan.n_runs)]
        if task.key is not None:
            known[task.key] = runs
    results = [run.result for run in runs]
    cpu, wall = (spread_of([getattr(run, name) for run in runs]) for name in ("cpu", "wall"))
    cost = spread_of([task.size(r) for r in results]) if task.size else cpu
    notes = ", ".join(dict.fromkeys(filter(None, map(task.note, results)))) if task.note else ""
    return Point(
        task.curve,
        f"{task.label} ({notes})" if notes else task.label,
        task.configured,
        spread_of([task.error(result) for result in results]),
        wall if plan.y_label == WALL_TIME else cost,
        cpu,
        wall,
        len(runs),
    )


def _timed(task: Task, number: int, clock: Clock) -> _Run:
    clock.settle()
    wall, cpu = clock.wall(), clock.cpu()
    result = task.work(number)
    clock.settle()
    return _Run(result, clock.cpu() - cpu, clock.wall() - wall)


def run_sweeps(
    sweeps: Sequence[Sweep], case: Case, budget: Budget, clock: Clock, tell: Tell
) -> tuple[list[SweepResult], list[Omission]]:
    """Measure the sweeps that the scene has a use for, as far as the time allows.

    Args:
        sweeps: the most useful first.
        tell: called before each point.

    Returns:
        Results, and what was left out with the reason. Each result has three points at least, or
        all of its sweep's.
    """
    engine = _Engine(case, budget, clock, tell)
    useful, omitted = [], []
    for sweep in sweeps:
        if reason := sweep.applies(case):
            omitted.append(Omission(sweep.title, reason))
        else:
            useful.append(sweep)
    # The first points of each sweep; then, with what is left, sweeps that did not fit before.
    begun: dict[str, _Progress | str] = {}
    for number, sweep in enumerate(useful):
        last = number == len(useful) - 1
        begun[sweep.name] = engine.begin(sweep, budget.left * (1.0 if last else 0.5))
    for sweep in useful:
        if isinstance(begun[sweep.name], str) and budget.left > 0:
            begun[sweep.name] = engine.begin(sweep, budget.left)
    # The remaining points.
    for item in begun.values():
        if isinstance(item, _Progress) and not item.first():
            engine.take(item, list(item.pending), budget.left)
    results = []
    for sweep in useful:
        result, reason = _result(begun[sweep.name], budget)
        results += [result] if result else []
        if reason:
            what = f"Points of “{sweep.title}”" if result else sweep.title
            omitted.append(Omission(what, reason))
    return results, omitted


class _Engine:
    def __init__(self, case: Case, budget: Budget, clock: Clock, tell: Tell) -> None:
        self._case, self._budget, self._clock, self._tell = case, budget, clock, tell
        self._known: dict[Hashable, list[_Run]] = {}

    def begin(self, sweep: Sweep, allowed: float) -> _Progress | str:
        """Plan a sweep and take its first points; a text says why that was not possible."""
        if allowed <= 0:
            return "no time was left"
        self._tell(sweep.title, "reference", self._share())
        end = self._budget.spent + allowed
        self._case.allowed = allowed
        try:
            plan = sweep.plan(self._case)
        except LeftOut as reason:
            return str(reason)
        except UsdSmokeError as error:
            empty = Plan((), "", "", "")
            return _Progress(sweep, empty, [], failure=_one_line(error))
        if self._case.on_gpu and plan.y_label == CPU_TIME:
            plan = replace(plan, y_label=WALL_TIME)
        rate = plan.rate * (plan.n_runs + plan.warm_up)
        item = _Progress(sweep, plan, list(plan.tasks), rate=rate)
        if sum(item.expected(task) for task in item.first()) > end - self._budget.spent:
            seconds = sum(item.expected(task) for task in item.first())
            return f"its first points take about {seconds:.2g} s"
        while (first := item.first()) and not item.failure:
            if not self.take(item, first[:1], self._budget.left):
                break
        return item

    def take(self, item: _Progress, tasks: Sequence[Task], allowed: float) -> int:
        """Measure the tasks that fit; their number."""
        end, n_taken = self._budget.spent + allowed, 0
        for task in tasks:
            before = self._budget.spent
            known = task.key is not None and task.key in self._known
            expected = 0.0 if known else item.expected(task)
            if self._budget.left <= 0 or before + expected > end:
                continue
            self._tell(item.sweep.title, f"{task.curve}, {task.label}", self._share())
            try:
                item.points.append(measure(task, item.plan, self._clock, self._known))
            except UsdSmokeError as error:  # other points are reported all the same
                item.failure = _one_line(error)
                break
            item.pending.remove(task)
            n_taken += 1
            if not known:
                item.rate = (self._budget.spent - before) / task.effort
        return n_taken

    def _share(self) -> float:
        return min(self._budget.spent / self._budget.seconds, 1.0)


def too_long(budget: Budget) -> str:
    """How the reason of what was left out for lack of time begins."""
    return f"did not fit the {budget.seconds:g} s of the report"


def _result(item: _Progress | str, budget: Budget) -> tuple[SweepResult | None, str]:
    """A sweep's result, if it has enough points, and why something is missing."""
    late = too_long(budget)
    if isinstance(item, str):
        return None, f"{late}: {item}"
    reason = f"ended with an error: {item.failure}" if item.failure else late
    if item.first() or not item.plan.tasks:
        return None, reason
    missing = tuple(_labelled(item, task) for task in item.pending)
    plan = item.plan
    if plan.chance is not None:
        plan = replace(plan, uncertain=plan.chance())
    result = SweepResult(item.sweep.name, item.sweep.title, plan, tuple(item.points), missing)
    result = replace(result, verdict=verdict_on(result))
    return result, f"{reason}: {'; '.join(missing)}" if missing else ""


def _labelled(item: _Progress, task: Task) -> str:
    seconds = item.expected(task)
    return f"{task.label} (about {seconds:.2g} s)" if seconds > 0 else task.label


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".")

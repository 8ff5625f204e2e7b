"""Takes the points of sweeps one by one as far as the time goes, and names what it did not reach.

Every sweep has a share of what is left. For its first three points, below which a curve says
nothing, it may go beyond that, to half of what is left, and further once it is begun. Time that is
over at the end goes to the sweeps and points that were passed over.
"""

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.work_precision.budget import Budget
from usdsmoke.work_precision.conclude import conclude
from usdsmoke.work_precision.measure import Clock, Measured, Run, summarize, timed_runs
from usdsmoke.work_precision.records import (
    CPU_TIME,
    WALL_TIME,
    LeftOut,
    Omission,
    Plan,
    Point,
    SweepResult,
    Task,
)

if TYPE_CHECKING:
    from usdsmoke.work_precision.case import Case

__all__ = ["Sweep", "Tell", "run_sweeps"]

_FEWEST = 3  # points of a sweep, where it has as many
_NO_TIME = "no time was left for it"

# sweep, what is done in it, share of the time that is used
Tell = Callable[[str, str, float], None]


@dataclass(frozen=True)
class Sweep:
    """One question to a scene."""

    name: str
    title: str
    weight: float  # of its share of the time
    applies: Callable[["Case"], str]  # why the scene has no use for it, or ""
    plan: Callable[["Case"], Plan]  # may raise LeftOut, by what case.allowed seconds suffice for


@dataclass(frozen=True)
class _Failed:
    """Why a sweep ended with nothing."""

    reason: str


@dataclass
class _UnderWay:
    """A sweep with what was measured and what was not."""

    sweep: Sweep
    plan: Plan
    pending: list[Task]
    taken: list[tuple[Task, Measured]] = field(default_factory=list)
    rates: dict[str, float] = field(default_factory=dict)  # seconds per unit of effort, by curve
    failure: str = ""  # what ended it

    @property
    def missing(self) -> int:
        """Points that it has too few."""
        return len(self.needed)

    @property
    def needed(self) -> list[Task]:
        """What it lacks: the configured point, and the cheapest others up to three in all."""
        too_few = max(min(_FEWEST, len(self.plan.tasks)) - len(self.taken), 0)
        ranked = sorted(self.pending, key=lambda task: (not task.configured, self.expected(task)))
        n_configured = sum(task.configured for task in self.pending)
        return ranked[: max(too_few, n_configured)]

    def rate(self, curve: str) -> float:
        """Seconds that a unit of effort is expected to take; 0 where nothing is known."""
        return self.rates.get(curve, max(self.rates.values(), default=self.plan.rate))

    def expected(self, task: Task) -> float:
        """Seconds of a point, by what others took; 0 where nothing is known."""
        return self.rate(task.curve) * task.effort * (self.plan.n_runs + self.plan.warm_up)


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
        What was measured, and what was not, with the reason. No sweep has fewer than three points,
        or all of its own.
    """
    omitted, wanted = [], []
    for sweep in sweeps:
        reason = sweep.applies(case)
        if reason:
            omitted.append(Omission(sweep.title, reason))
        else:
            wanted.append(sweep)
    found = _Engine(case, budget, clock, tell).run(wanted)
    under_way = [item for item in found.values() if isinstance(item, _UnderWay)]
    everything = [measured for item in under_way for _, measured in item.taken]
    results = []
    for sweep in wanted:
        item = found[sweep.name]
        if isinstance(item, _Failed):
            omitted.append(Omission(sweep.title, item.reason))
            continue
        if isinstance(item, str):
            omitted.append(Omission(sweep.title, f"{_no_time(budget)}: {item}"))
            continue
        if item.missing:
            reason = item.failure or f"{_no_time(budget)}: {_too_few(item)}"
            omitted.append(Omission(sweep.title, reason))
            continue
        missing = _missing(item)
        if missing:
            reason = f"{item.failure or _no_time(budget)}: {'; '.join(missing)}"
            omitted.append(Omission(f"Points of “{sweep.title}”", reason))
        points = _points(item, case.on_gpu, everything)
        plan = item.plan
        if plan.chance is not None:
            plan = replace(plan, uncertain=plan.chance())
        results.append(conclude(SweepResult(sweep.name, sweep.title, plan, points, missing)))
    return results, omitted


class _Engine:
    def __init__(self, case: "Case", budget: Budget, clock: Clock, tell: Tell) -> None:
        self._case, self._budget, self._clock, self._tell = case, budget, clock, tell
        self._known: dict[Hashable, list[Run]] = {}  # by key

    def run(self, wanted: Sequence[Sweep]) -> dict[str, _UnderWay | _Failed | str]:
        """By name: what became of each, or why it was left out."""
        budget = self._budget
        found: dict[str, _UnderWay | _Failed | str] = {}
        for number, sweep in enumerate(wanted):
            end = budget.until([later.weight for later in wanted[number:]])
            found[sweep.name] = self._begun(sweep, end, max(end, budget.spent + budget.left / 2))
        for sweep in wanted:  # with what is left
            if isinstance(found[sweep.name], str) and budget.left > 0:
                found[sweep.name] = self._begun(sweep, budget.seconds, budget.seconds)
        begun = [item for item in found.values() if isinstance(item, _UnderWay)]
        for item in sorted(begun, key=lambda item: item.missing == 0):
            self._take(item, budget.seconds, budget.seconds)
        return found

    def _begun(self, sweep: Sweep, end: float, least_end: float) -> _UnderWay | _Failed | str:
        """A sweep with the points that fit; ``least_end`` holds for the first three."""
        if self._budget.left <= 0:
            return _NO_TIME
        self._tell(sweep.title, "reference", self._share())
        self._case.allowed = least_end - self._budget.spent
        try:
            plan = sweep.plan(self._case)
        except LeftOut as reason:
            return str(reason)
        except UsdSmokeError as error:
            return _Failed(_failure(error))
        plan = _timed_by(plan, self._case.on_gpu)
        item = _UnderWay(sweep, plan, list(plan.tasks))
        self._take(item, end, least_end)
        return item

    def _take(self, item: _UnderWay, end: float, least_end: float) -> None:
        for task in list(item.pending):
            spent = self._budget.spent
            if item.taken:  # what was begun is not given up for others
                least_end = self._budget.seconds
            if item.failure or self._budget.left <= 0 or self._hopeless(item, least_end):
                return
            limit = least_end if item.missing else end
            if spent + self._expected(item, task) > limit:
                continue
            self._tell(item.sweep.title, f"{task.curve}, {task.label}", self._share())
            known = task.key is not None and task.key in self._known
            try:
                item.taken.append((task, self._measured(item.plan, task)))
            except UsdSmokeError as error:  # what others have measured is written all the same
                item.failure = _failure(error)
                return
            item.pending.remove(task)
            if not known:
                n_runs = item.plan.n_runs + item.plan.warm_up
                item.rates[task.curve] = (self._budget.spent - spent) / task.effort / n_runs

    def _hopeless(self, item: _UnderWay, end: float) -> bool:
        """Whether a sweep cannot come to three points with the configured one among them."""
        return self._budget.spent + sum(self._expected(item, task) for task in item.needed) > end

    def _expected(self, item: _UnderWay, task: Task) -> float:
        if task.key is not None and task.key in self._known:
            return 0.0
        return item.expected(task)

    def _measured(self, plan: Plan, task: Task) -> Measured:
        task.prepare()
        runs: Iterable[Run] = timed_runs(task.work, plan.n_runs, self._clock, plan.warm_up)
        if task.key is not None:
            runs = self._known[task.key] if task.key in self._known else self._kept(task.key, runs)
        return summarize(runs, task.error, task.size, task.note, task.trace)

    def _kept(self, key: Hashable, runs: Iterable[Run]) -> list[Run]:
        self._known[key] = list(runs)
        return self._known[key]

    def _share(self) -> float:
        return min(self._budget.spent / self._budget.seconds, 1.0)


def _missing(item: _UnderWay) -> tuple[str, ...]:
    """A curve each, with the names of its points and what they would take."""
    by_curve: dict[str, list[str]] = {}
    for task in item.pending:
        seconds = item.expected(task)
        about = f": about {seconds:.2g} s" if seconds > 0 else ""
        by_curve.setdefault(task.curve, []).append(f"{task.label}{about}")
    return tuple(f"{curve} ({', '.join(labels)})" for curve, labels in by_curve.items())


def _too_few(item: _UnderWay) -> str:
    seconds = sum(item.expected(task) for task in item.needed)
    if seconds == 0:
        return _NO_TIME
    return f"the first points of it would take about {seconds:.2g} s more than was left"


def _points(item: _UnderWay, on_gpu: bool, everything: Sequence[Measured]) -> tuple[Point, ...]:
    """The points; those that did the same work, in any sweep, share the times of all their runs."""
    measured = [_with_times_of_equals(found, everything) for _, found in item.taken]
    points = []
    for (task, _), found in zip(item.taken, measured, strict=True):
        cost = found.size or (found.wall if on_gpu else found.cpu)
        notes = ", ".join(dict.fromkeys(note for note in found.notes if note))
        label = f"{task.label} ({notes})" if notes else task.label
        points.append(
            Point(
                task.curve, label, task.configured, task.setting, found.error, cost, found.cpu,
                found.wall, item.plan.n_runs, task.offered,
            )
        )  # fmt: skip
    return tuple(points)


def _with_times_of_equals(found: Measured, others: Sequence[Measured]) -> Measured:
    if not found.traces:
        return found
    same = [other for other in others if other.traces == found.traces]
    times = dict.fromkeys((other.cpu_times, other.wall_times) for other in same)  # each once
    return replace(
        found,
        cpu_times=tuple(value for cpu, _ in times for value in cpu),
        wall_times=tuple(value for _, wall in times for value in wall),
    )


def _timed_by(plan: Plan, on_gpu: bool) -> Plan:
    """On a GPU the clock on the wall counts, and the diagram says so."""
    return replace(plan, y_label=WALL_TIME) if on_gpu and plan.y_label == CPU_TIME else plan


def _failure(error: UsdSmokeError) -> str:
    return f"it ended with an error: {' '.join(str(error).split())}".rstrip(".")


def _no_time(budget: Budget) -> str:
    return f"did not fit the {budget.seconds:g} s that the report was given"

"""What a report is made of: points on curves, curves in sweeps, sweeps and omissions on a page."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

__all__ = [
    "CPU_TIME",
    "WALL_TIME",
    "Figures",
    "LeftOut",
    "Omission",
    "Plan",
    "Point",
    "Report",
    "Spread",
    "SweepResult",
    "Task",
]

CPU_TIME, WALL_TIME = "CPU time [s]", "wall-clock time [s]"


class LeftOut(Exception):
    """Raised by a sweep's plan: why it is left out in the time that there is."""


@dataclass(frozen=True)
class Spread:
    """The middle of several runs, and how far they lie apart."""

    median: float
    low: float
    high: float

    def overlaps(self, other: "Spread") -> bool:
        """Whether some run of the one lies beyond some run of the other."""
        return self.low <= other.high and other.low <= self.high


@dataclass(frozen=True)
class Task:
    """A point that is to be measured."""

    curve: str
    label: str
    work: Callable[[int], Any]  # number of the run -> result; this is timed
    error: Callable[[Any], float]  # of a result; this is not
    setting: float | None = None  # what changes along the curve, where it is a number
    configured: bool = False
    effort: float = 1.0  # expected time, in any unit that all tasks of a sweep share
    size: Callable[[Any], float] | None = None  # cost of a result that is no time, such as bytes
    prepare: Callable[[], None] = lambda: None  # what is done once, before time is taken
    offered: bool = True  # whether a setting of usdsmoke leads there
    key: Hashable = None  # tasks of one key, in any sweep, are one work: done and timed once
    note: Callable[[Any], str] | None = None  # of a result: what the label does not know before
    trace: Callable[[Any], Hashable] | None = None  # of a result: equal where the work was the same


@dataclass(frozen=True)
class Plan:
    """What a sweep wants to do, most useful points first."""

    tasks: Sequence[Task]
    x_label: str
    about: str  # what is done, in a sentence or two
    reference: str  # against what errors are measured, and what says that it is right
    y_label: str = CPU_TIME
    setting: str = ""  # what the numbers along a curve are, where an order can be fitted to them
    uncertain: float = 0.0  # how far the reference itself may be off, where a second one tells
    chance: Callable[[], float] | None = None  # the same, where it is only known after the points
    n_runs: int = 3
    warm_up: bool = False
    rate: float = 0.0  # seconds that a unit of effort is expected to take; 0: not known before
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Point:
    """One measured point."""

    curve: str
    label: str
    configured: bool
    setting: float | None
    error: Spread
    cost: Spread  # what is drawn: CPU seconds, wall seconds on a GPU, or bytes
    cpu: Spread  # seconds, of this process and its children
    wall: Spread  # seconds
    n_runs: int
    offered: bool = True  # whether a setting of usdsmoke leads there


@dataclass(frozen=True)
class SweepResult:
    """A sweep with what was measured and what follows from it."""

    name: str  # also of its picture's file
    title: str
    plan: Plan
    points: tuple[Point, ...]
    missing: tuple[str, ...]  # points that did not fit the time
    sentences: Mapping[str, str] = field(default_factory=dict)  # by curve
    verdict: str = ""  # on the configured point

    @property
    def curves(self) -> dict[str, list[Point]]:
        """The points by curve; along each in the order of its numbers, or of cost without any."""
        found: dict[str, list[Point]] = {}
        for point in self.points:
            found.setdefault(point.curve, []).append(point)
        for points in found.values():
            points.sort(key=lambda p: (p.setting or 0.0, p.cost.median))
        return found


@dataclass(frozen=True)
class Omission:
    """Something that the report does not hold, and why."""

    what: str
    reason: str


@dataclass(frozen=True)
class Figures:
    """Facts in rows: a name and a text each."""

    title: str
    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Report:
    """Everything that stands on the page."""

    title: str
    facts: tuple[Figures, ...]  # scene, machine, versions
    sweeps: tuple[SweepResult, ...]
    omissions: tuple[Omission, ...]
    notes: tuple[str, ...] = ()

"""What a report is made of: points on curves, curves in sweeps, sweeps and omissions on a page."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from usdsmoke.planning.plan import Omission

CPU_TIME, WALL_TIME = "CPU time [s]", "wall-clock time [s]"


class LeftOut(Exception):
    """Raised by a sweep's plan. The text says why the sweep does not fit the time."""


@dataclass(frozen=True)
class Spread:
    """Median and range of several runs."""

    median: float
    low: float
    high: float

    def overlaps(self, other: "Spread") -> bool:
        """Whether the two ranges have a value in common."""
        return self.low <= other.high and other.low <= self.high


def spread_of(values: Sequence[float]) -> Spread:
    """Median, smallest and largest.

    >>> spread_of([3.0, 1.0, 2.0])
    Spread(median=2.0, low=1.0, high=3.0)
    """
    return Spread(median(values), min(values), max(values))


@dataclass(frozen=True)
class Task:
    """A point that can be measured."""

    curve: str
    label: str
    work: Callable[[int], Any]  # number of the run -> result; this is timed
    error: Callable[[Any], float]  # of a result; this is not timed
    configured: bool = False
    effort: float = 1.0  # expected time, in a unit that all tasks of a sweep share
    size: Callable[[Any], float] | None = None  # cost of a result that is not a time, e.g. bytes
    prepare: Callable[[], None] = lambda: None  # done once, before the clock starts
    key: Hashable = None  # tasks with one key, in any sweep, are the same work: done once
    note: Callable[[Any], str] | None = None  # of a result: an addition to the label


@dataclass(frozen=True)
class Plan:
    """What a sweep measures, most useful points first."""

    tasks: Sequence[Task]
    x_label: str
    about: str  # what is done, in a sentence or two
    reference: str  # what errors are measured against, and why that is right
    y_label: str = CPU_TIME
    uncertain: float = 0.0  # errors that differ by less are equal, as far as the reference tells
    chance: Callable[[], float] | None = None  # the same, where only the points can tell
    n_runs: int = 3
    warm_up: bool = False
    rate: float = 0.0  # seconds per unit of effort, if known before the first point
    film: Callable[[], bytes] | None = None  # an animation of the results, WebP; empty: none


@dataclass(frozen=True)
class Point:
    """A measured point."""

    curve: str
    label: str
    configured: bool
    error: Spread
    cost: Spread  # CPU seconds, wall-clock seconds on a GPU, or bytes
    cpu: Spread  # seconds, of this process and its children
    wall: Spread  # seconds
    n_runs: int


@dataclass(frozen=True)
class SweepResult:
    """A sweep with its points and what follows from them."""

    name: str  # also of its diagram's file
    title: str
    plan: Plan
    points: tuple[Point, ...]
    missing: tuple[str, ...] = ()  # labels of points that did not fit the time
    verdict: str = ""  # on the configured point

    @property
    def configured(self) -> Point | None:
        """The configured point."""
        return next((point for point in self.points if point.configured), None)

    @property
    def curves(self) -> dict[str, list[Point]]:
        """The points of each curve, in the order of their costs."""
        found: dict[str, list[Point]] = {}
        for point in sorted(self.points, key=lambda p: p.cost.median):
            found.setdefault(point.curve, []).append(point)
        return found


@dataclass(frozen=True)
class Report:
    """Everything on the page."""

    title: str
    facts: Mapping[str, Mapping[str, str]]  # scene, machine, versions: text by name
    sweeps: tuple[SweepResult, ...]
    omissions: tuple[Omission, ...]
    notes: tuple[str, ...] = ()

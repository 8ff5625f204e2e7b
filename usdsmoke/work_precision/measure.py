"""How long something takes: several runs, their median and spread."""

import resource
import time
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from usdsmoke.work_precision.records import Spread

__all__ = ["Clock", "Measured", "Run", "measure", "spread_of", "summarize", "timed_runs"]


def _cpu_seconds() -> float:
    """CPU time of this process and of its children that have ended: VDB files are written there."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


@dataclass(frozen=True)
class Clock:
    """What time is taken from; a test brings its own."""

    wall: Callable[[], float] = time.perf_counter
    cpu: Callable[[], float] = _cpu_seconds
    settle: Callable[[], None] = lambda: None  # waits for work that a GPU still has to do


@dataclass(frozen=True)
class Run:
    """One run of a point."""

    result: Any
    cpu: float  # seconds
    wall: float


@dataclass(frozen=True)
class Measured:
    """All runs of one point."""

    errors: tuple[float, ...]
    cpu_times: tuple[float, ...]  # seconds
    wall_times: tuple[float, ...]
    size: Spread | None = None
    notes: tuple[str, ...] = ()  # of the results
    traces: tuple[Hashable, ...] = ()

    @property
    def error(self) -> Spread:
        """Of all runs."""
        return spread_of(self.errors)

    @property
    def cpu(self) -> Spread:
        """Seconds of this process and its children."""
        return spread_of(self.cpu_times)

    @property
    def wall(self) -> Spread:
        """Seconds by the clock on the wall."""
        return spread_of(self.wall_times)


def measure(
    work: Callable[[int], Any],
    error: Callable[[Any], float],
    n_runs: int,
    clock: Clock,
    warm_up: bool = False,
    size: Callable[[Any], float] | None = None,
) -> Measured:
    """Do something several times; its error is looked at outside of the time that is taken.

    Args:
        work: number of the run -> result.
        error: of a result.
        n_runs: at least 1.
        clock: seconds.
        warm_up: do it once more before, untimed: for work of milliseconds.
        size: of a result, where that and not time is what it costs.
    """
    return summarize(timed_runs(work, n_runs, clock, warm_up), error, size)


def timed_runs(
    work: Callable[[int], Any], n_runs: int, clock: Clock, warm_up: bool = False
) -> Iterator[Run]:
    """The runs one by one, each done when it is asked for; arguments as of ``measure``."""
    if warm_up:
        work(0)
    for number in range(n_runs):
        clock.settle()
        started = clock.wall(), clock.cpu()
        result = work(number)
        clock.settle()
        wall, cpu = clock.wall() - started[0], clock.cpu() - started[1]
        yield Run(result, cpu, wall)


def summarize(
    runs: Iterable[Run],
    error: Callable[[Any], float],
    size: Callable[[Any], float] | None = None,
    note: Callable[[Any], str] | None = None,
    trace: Callable[[Any], Hashable] | None = None,
) -> Measured:
    """What the runs of a point have in all; of every result at once, so that none is kept."""
    errors, cpu, wall, sizes, notes, traces = [], [], [], [], [], []
    for run in runs:
        cpu.append(run.cpu)
        wall.append(run.wall)
        errors.append(error(run.result))
        if size is not None:
            sizes.append(size(run.result))
        if note is not None:
            notes.append(note(run.result))
        if trace is not None:
            traces.append(trace(run.result))
    size_of_all = spread_of(sizes) if sizes else None
    return Measured(
        tuple(errors), tuple(cpu), tuple(wall), size_of_all, tuple(notes), tuple(traces)
    )


def spread_of(values: Sequence[float]) -> Spread:
    """Median, smallest and largest.

    >>> spread_of([3.0, 1.0, 2.0])
    Spread(median=2.0, low=1.0, high=3.0)
    """
    return Spread(median(values), min(values), max(values))

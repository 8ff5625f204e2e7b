"""How long something takes: several runs, their median and spread."""

import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from usdsmoke.report.records import Spread

__all__ = ["Clock", "Measured", "measure", "spread_of"]


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
class Measured:
    """All runs of one point."""

    error: Spread
    cpu: Spread
    wall: Spread
    size: Spread | None


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
    if warm_up:
        work(0)
    errors, cpu, wall, sizes = [], [], [], []
    for number in range(n_runs):
        clock.settle()
        started = clock.wall(), clock.cpu()
        result = work(number)
        clock.settle()
        wall.append(clock.wall() - started[0])
        cpu.append(clock.cpu() - started[1])
        errors.append(error(result))
        if size is not None:
            sizes.append(size(result))
    return Measured(
        spread_of(errors), spread_of(cpu), spread_of(wall), spread_of(sizes) if sizes else None
    )


def spread_of(values: Sequence[float]) -> Spread:
    """Median, smallest and largest.

    >>> spread_of([3.0, 1.0, 2.0])
    Spread(median=2.0, low=1.0, high=3.0)
    """
    return Spread(median(values), min(values), max(values))

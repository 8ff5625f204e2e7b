"""The time of a run by part.

The parts add up to the whole, or to more where a frame is painted while another one is written.
Windows and the coarse step keep their own time in their manifests. A call adds the time of its own
work. So the time of a run of several processes is the sum of their times.
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import islice
from typing import Protocol, TypeVar

from usdsmoke.base.frame_report import FrameReport

ELSEWHERE = "elsewhere"  # time that windows and the coarse step keep themselves

_Item = TypeVar("_Item")


class TimedWindow(Protocol):
    """A window of a run with its time."""

    @property
    def seconds(self) -> float:
        """All of its time."""

    @property
    def timings(self) -> Mapping[str, float]:
        """Seconds by part: ``reading``, and ``writing``, of which ``hashing`` and ``verifying`` are
        parts."""


class PartClock:
    """Seconds of a call by part, and in all, from now on."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._began = clock, clock()
        self.parts: dict[str, float] = {}

    @property
    def total(self) -> float:
        """Seconds since the beginning."""
        return self._clock() - self._began

    @contextmanager
    def part(self, part: str) -> Iterator[None]:
        """The time of a block goes to a part, also where it fails."""
        started = self._clock()
        try:
            yield
        finally:
            self.parts[part] = self.parts.get(part, 0.0) + self._clock() - started


def timed_items(clock: PartClock, part: str, items: Iterable[_Item]) -> Iterator[_Item]:
    """The same items. The time to get each is added to a part."""
    iterator = iter(items)
    while True:
        with clock.part(part):
            found = list(islice(iterator, 1))
        if not found:
            return
        yield found[0]


def step_seconds(reports: Iterable[FrameReport]) -> dict[str, float]:
    """Seconds of each step, summed over frames; a step that no frame has is left out."""
    spent: dict[str, list[float]] = {}
    for report in reports:
        for name, step in report.steps.items():
            spent.setdefault(name, []).append(step.seconds)
    return {name: math.fsum(spent[name]) for name in sorted(spent, reverse=True)}  # shape, colour


def run_seconds(
    windows: Sequence[TimedWindow], reports: Iterable[FrameReport], coarse: float, clock: PartClock
) -> dict[str, float]:
    """Seconds by part, in the order of the work; ``all`` is their sum.

    Args:
        windows: all windows of the run.
        reports: of all frames of the windows; a frame of two windows has two.
        coarse: seconds of the coarse step.
        clock: of this call, with ``preparing``, ``reading``, ``training`` and ``assembling``.
    """
    reports, own = list(reports), clock.parts
    storage = math.fsum(report.storage_seconds for report in reports)
    checks = {part: _of(windows, part) for part in ("hashing", "verifying")}
    written = _of(windows, "writing") - sum(checks.values()) - storage  # these are parts of it
    parts = {
        "preparing": own.get("preparing", 0.0),
        "reading": own.get("reading", 0.0) + _of(windows, "reading"),
        "training": own.get("training", 0.0),
        "coarse step": coarse,
        **step_seconds(reports),
        "transport": math.fsum(report.transport_seconds for report in reports),
        "estimates": math.fsum(report.estimate_seconds for report in reports),
        "writing": max(written, 0.0),
        **checks,
        "assembling": own.get("assembling", 0.0),
    }
    whole = clock.total - own.get(ELSEWHERE, 0.0) + coarse + math.fsum(w.seconds for w in windows)
    parts["the rest"] = max(whole - math.fsum(parts.values()), 0.0)
    return {name: value for name, value in parts.items() if value > 0} | {"all": whole}


def _of(windows: Sequence[TimedWindow], part: str) -> float:
    return math.fsum(window.timings.get(part, 0.0) for window in windows)

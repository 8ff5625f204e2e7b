"""Where the time of a run went, part by part; the parts add up to the whole.

Windows and the coarse step keep their own time with them, whoever computed them and when; a call
adds what it did around them. So the time of a run that several processes worked on is the sum of
theirs.
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, ParamSpec, TypeVar

from usdsmoke.runs.manifests import WindowRecord

__all__ = ["ELSEWHERE", "PartClock", "run_seconds", "timed_items"]

ELSEWHERE = "elsewhere"  # a part that is kept with windows and the coarse step
_STEPS = ("shape", "colour")

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


class PartClock:
    """Seconds of a call's parts, and of all of it, from now on.

    Args:
        clock: for tests.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._began = clock, clock()
        self.parts: dict[str, float] = {}

    @property
    def total(self) -> float:
        """Seconds since the beginning."""
        return self._clock() - self._began

    def timed(
        self,
        part: str,
        call: Callable[_Arguments, _Result],
        *arguments: _Arguments.args,
        **named: _Arguments.kwargs,
    ) -> _Result:
        """What a call gives; its time goes to a part, also where it fails."""
        started = self._clock()
        try:
            return call(*arguments, **named)
        finally:
            spent = self._clock() - started
            self.parts[part] = self.parts.get(part, 0.0) + spent


def timed_items(clock: PartClock, part: str, items: Iterable[_Result]) -> Iterator[_Result]:
    """The same items; the time that getting each takes goes to a part."""
    iterator = iter(items)
    while True:
        try:
            item = clock.timed(part, next, iterator)
        except StopIteration:
            return
        yield item


def run_seconds(
    windows: Sequence[WindowRecord], coarse: float, clock: PartClock
) -> dict[str, float]:
    """Seconds by part, in the order of the work; ``all`` is their sum.

    Args:
        windows: the manifests of all windows.
        coarse: of the coarse step.
        clock: of this call, with ``preparing``, ``reading`` and ``assembling``.
    """
    reports = [frame["report"] for window in windows for frame in window.frames.values()]
    storage = math.fsum(_estimates(report, "storage") for report in reports)
    own = clock.parts
    parts = {
        "preparing": own.get("preparing", 0.0),
        "reading": own.get("reading", 0.0) + _of(windows, "reading"),
        "coarse step": coarse,
        **{step: math.fsum(_seconds(report.get(step)) for report in reports) for step in _STEPS},
        "estimates": math.fsum(_estimates(report) for report in reports),
        "writing": max(_of(windows, "writing") - storage, 0.0),  # files say what they lost
        "assembling": own.get("assembling", 0.0),
    }
    whole = clock.total - own.get(ELSEWHERE, 0.0) + coarse + math.fsum(w.seconds for w in windows)
    parts["the rest"] = max(whole - math.fsum(parts.values()), 0.0)
    return {name: value for name, value in parts.items() if value > 0} | {"all": whole}


def _of(windows: Sequence[WindowRecord], part: str) -> float:
    return math.fsum(window.timings.get(part, 0.0) for window in windows)


def _estimates(report: Mapping[str, Any], prefix: str = "") -> float:
    """Seconds of a frame's estimates; the transport's stands with the step."""
    found = [
        _seconds(entry)
        for name, entry in report.get("errors", {}).items()
        if name.startswith(prefix)
    ]
    if not prefix:
        found.append(_seconds((report.get("shape") or {}).get("transport error")))
    return math.fsum(found)


def _seconds(entry: Any) -> float:
    value = entry.get("seconds") if isinstance(entry, Mapping) else None
    return float(value) if isinstance(value, (int, float)) else 0.0

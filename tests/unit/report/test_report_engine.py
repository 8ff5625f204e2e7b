"""Points are taken while there is time; what is left out is named."""

from collections.abc import Callable
from typing import Any

import pytest

from usdsmoke.errors import ConfigError
from usdsmoke.report.budget import Budget, parse_budget
from usdsmoke.report.engine import Sweep, run_sweeps
from usdsmoke.report.measure import Clock, measure
from usdsmoke.report.records import Plan, Task


class FakeTime:
    """A clock that goes on only where work says so."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now

    def work(self, seconds: float) -> Callable[[int], float]:
        def run(number: int) -> float:
            self.now += seconds
            return 0.1 * (number + 1)

        return run


class NoCase:
    """As much of a case as the engine looks at."""

    on_gpu = False


def sweep_of(
    time: FakeTime, name: str, efforts: list[float], each: float, reason: str = "", **plan: Any
) -> Sweep:
    tasks = [
        Task("curve", f"{name}{n}", time.work(each * effort), lambda found: found, effort=effort)
        for n, effort in enumerate(efforts)
    ]
    made = Plan(tasks, "error", "about", "reference", **plan)
    return Sweep(name, f"Sweep {name}", 1.0, lambda case: reason, lambda case: made)


def run(sweeps: list[Sweep], time: FakeTime, seconds: float) -> Any:
    clock = Clock(time, time)
    told: list[str] = []
    found = run_sweeps(
        sweeps, NoCase(), Budget(seconds, time), clock, lambda *words: told.append(words[1])
    )
    return *found, told


def test_the_time_is_kept_but_for_what_was_begun() -> None:
    time = FakeTime()
    sweeps = [sweep_of(time, name, [1, 1, 2, 4, 8, 16], 1.0) for name in "abc"]
    results, omitted, _ = run(sweeps, time, 60.0)
    assert time.now - 100.0 <= 60.0
    assert [result.name for result in results] == ["a", "b", "c"]
    assert omitted and all("did not fit the 60 s" in item.reason for item in omitted)


def test_a_point_that_would_not_fit_is_not_begun_and_named() -> None:
    time = FakeTime()
    results, omitted, told = run([sweep_of(time, "a", [1, 100, 2], 1.0)], time, 20.0)
    assert [point.label for point in results[0].points] == ["a0", "a2"]
    assert results[0].missing == ("curve (a1)",) and "curve, a1" not in told
    assert time.now == 100.0 + 3 * (1 + 2)
    assert "curve (a1)" in omitted[0].reason


def test_what_an_earlier_sweep_does_not_use_is_left_to_the_later_ones() -> None:
    time = FakeTime()
    sweeps = [sweep_of(time, "a", [1], 1.0), sweep_of(time, "b", [1] * 8, 1.0)]
    results, omitted, _ = run(sweeps, time, 30.0)
    assert len(results[1].points) == 8 and not omitted


def test_sweeps_that_find_no_time_left_are_named() -> None:
    time = FakeTime()
    sweeps = [sweep_of(time, "a", [1], 50.0), sweep_of(time, "b", [1], 1.0)]
    results, omitted, _ = run(sweeps, time, 20.0)
    assert [result.name for result in results] == ["a"]
    assert omitted[0].what == "Sweep b" and "did not fit" in omitted[0].reason


def test_a_sweep_without_use_takes_no_time_and_its_reason_is_told() -> None:
    time = FakeTime()
    results, omitted, told = run([sweep_of(time, "a", [1], 1.0, "no such thing")], time, 20.0)
    assert not results and not told and time.now == 100.0
    assert (omitted[0].what, omitted[0].reason) == ("Sweep a", "no such thing")


def test_median_and_spread_of_runs_and_a_warm_up_that_does_not_count() -> None:
    time, seconds = FakeTime(), iter([50.0, 3.0, 1.0, 2.0])

    def work(number: int) -> int:
        time.now += next(seconds)
        return number

    found = measure(work, lambda number: 10.0 + number, 3, Clock(time, time), warm_up=True)
    assert (found.wall.median, found.wall.low, found.wall.high) == (2.0, 1.0, 3.0)
    assert (found.error.median, found.error.low, found.error.high) == (11.0, 10.0, 12.0)


def test_the_error_is_looked_at_outside_of_the_time() -> None:
    time = FakeTime()

    def error(found: float) -> float:
        time.now += 1000.0
        return found

    assert measure(time.work(1.0), error, 2, Clock(time, time)).cpu.high == 1.0


@pytest.mark.parametrize(
    ("text", "seconds"), [("300s", 300), ("5min", 300), ("1h", 3600), ("90", 90), ("0.5 min", 30)]
)
def test_durations(text: str, seconds: float) -> None:
    assert parse_budget(text) == seconds


@pytest.mark.parametrize("text", ["", "five", "5 days", "-3s", "0", "0.5s", "5m in"])
def test_what_is_no_duration_is_refused_with_what_is(text: str) -> None:
    with pytest.raises(ConfigError, match="wanted a number of seconds, minutes or hours"):
        parse_budget(text)

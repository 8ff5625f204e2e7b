"""Points are taken while there is time; what is left out is named."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from usdsmoke.base.errors import FeatureError
from usdsmoke.work_precision.engine import Budget, Clock, Sweep, measure, run_sweeps
from usdsmoke.work_precision.records import LeftOut, Plan, Task


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
    allowed = 0.0


def sweep_of(
    time: FakeTime, name: str, efforts: list[float], each: float, reason: str = "", **plan: Any
) -> Sweep:
    tasks = [
        Task("curve", f"{name}{n}", time.work(each * effort), lambda found: found, effort=effort)
        for n, effort in enumerate(efforts)
    ]
    made = Plan(tasks, "error", "about", "reference", **plan)
    return Sweep(name, f"Sweep {name}", lambda case: reason, lambda case: made)


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
    results, omitted, told = run([sweep_of(time, "a", [1, 100, 2, 1], 1.0)], time, 20.0)
    assert [point.label for point in results[0].points] == ["a0", "a2", "a3"]
    assert results[0].missing == ("a1 (about 3e+02 s)",) and "curve, a1" not in told
    assert time.now == 100.0 + 3 * (1 + 2 + 1)
    assert "a1" in omitted[0].reason


def test_time_that_is_over_goes_to_the_points_that_were_passed_over() -> None:
    time = FakeTime()
    sweeps = [sweep_of(time, "a", [1, 1, 1, 5], 1.0), sweep_of(time, "b", [1, 1, 1], 1.0)]
    results, omitted, told = run(sweeps, time, 35.0)
    assert [point.label for point in results[0].points] == ["a0", "a1", "a2", "a3"]
    assert told[-1] == "curve, a3" and not omitted  # after those of b


def test_few_sweeps_with_three_points_are_better_than_many_with_fewer() -> None:
    time = FakeTime()
    sweeps = [sweep_of(time, name, [1, 1, 1, 1], 1.0) for name in "abc"]
    results, omitted, _ = run(sweeps, time, 21.0)
    assert [len(result.points) for result in results] == [3, 3]
    assert len([item for item in omitted if item.what.startswith("Sweep ")]) == 1
    assert time.now - 100.0 <= 21.0


def test_a_sweep_that_was_begun_comes_to_three_points_before_others_begin() -> None:
    time = FakeTime()
    sweeps = [sweep_of(time, name, [1, 1, 1], 4.0) for name in "ab"]  # 12 s a point
    results, omitted, _ = run(sweeps, time, 40.0)
    assert [(result.name, len(result.points)) for result in results] == [("a", 3)]
    assert omitted[-1].what == "Sweep b"


def test_a_sweep_without_its_configured_point_is_left_out() -> None:
    time = FakeTime()
    sweep = sweep_of(time, "a", [1, 1, 1, 100], 1.0)

    def plan(case: Any) -> Plan:
        made = sweep.plan(case)
        return replace(made, tasks=[*made.tasks[:3], replace(made.tasks[3], configured=True)])

    results, omitted, _ = run([replace(sweep, plan=plan)], time, 20.0)
    assert not results and omitted[0].what == "Sweep a"


def test_a_sweep_that_says_that_it_does_not_fit_is_asked_again_at_the_end() -> None:
    time, sweep_asked = FakeTime(), []
    sweep = sweep_of(time, "a", [1, 1, 1], 1.0)

    def plan(case: Any) -> Plan:
        sweep_asked.append(case.allowed)
        if len(sweep_asked) == 1:
            raise LeftOut("too dear")
        return sweep.plan(case)

    sweeps = [replace(sweep, plan=plan), sweep_of(time, "b", [1, 1, 1], 1.0)]
    results, omitted, _ = run(sweeps, time, 40.0)
    assert sweep_asked == [20.0, 31.0]
    assert {result.name for result in results} == {"a", "b"} and not omitted
    results, omitted, _ = run([replace(sweep, plan=_refusing)], time, 40.0)
    assert not results and omitted[0].reason.endswith("too dear")


def test_the_first_reason_stays_where_no_time_is_left_to_ask_again() -> None:
    time = FakeTime()
    sweep = sweep_of(time, "a", [1, 1, 1], 1.0)
    greedy = sweep_of(time, "b", [20], 1.0)
    _, omitted, _ = run([replace(sweep, plan=_refusing), greedy], time, 40.0)
    assert omitted[0].reason.endswith("too dear")


def _refusing(case: Any) -> Plan:
    raise LeftOut("too dear")


def test_the_same_work_is_done_and_timed_once_in_a_report() -> None:
    time = FakeTime()
    one, other = (sweep_of(time, name, [2, 1, 1], 1.0) for name in "ab")

    def shared(sweep: Sweep) -> Sweep:
        tasks = sweep.plan(NoCase()).tasks  # type: ignore[arg-type]
        first = replace(tasks[0], key="the same", configured=True)
        made = replace(sweep.plan(NoCase()), tasks=[first, *tasks[1:]])  # type: ignore[arg-type]
        return replace(sweep, plan=lambda case: made)

    results, _, _ = run([shared(one), shared(other)], time, 100.0)
    assert results[0].points[0].cost == results[1].points[0].cost
    assert time.now == 100.0 + 3 * (2 + 1 + 1) + 3 * (1 + 1)


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


def test_median_and_spread_of_runs_and_a_warm_up_that_is_not_timed() -> None:
    time, seconds = FakeTime(), iter([50.0, 3.0, 1.0, 2.0])

    def work(number: int) -> int:
        time.now += next(seconds)
        return number

    task = Task("curve", "a", work, lambda number: 10.0 + number, note=lambda number: "noted")
    plan = Plan([task], "error", "about", "reference", warm_up=True)
    found = measure(task, plan, Clock(time, time), {})
    assert (found.wall.median, found.wall.low, found.wall.high) == (2.0, 1.0, 3.0)
    assert (found.error.median, found.error.low, found.error.high) == (11.0, 10.0, 12.0)
    assert found.label == "a (noted)"


def test_the_error_is_computed_outside_of_the_time() -> None:
    time = FakeTime()

    def error(found: float) -> float:
        time.now += 1000.0
        return found

    task = Task("curve", "a", time.work(1.0), error)
    plan = Plan([task], "error", "about", "reference", n_runs=2)
    assert measure(task, plan, Clock(time, time), {}).cpu.high == 1.0


def failing(time: FakeTime, name: str, at: int) -> Sweep:
    """A sweep whose point of this number, or whose plan before the first one, ends in an error."""

    def fail(number: int) -> float:
        raise FeatureError("no such\nweights.")

    def plan(case: Any) -> Plan:
        works = [fail if n == at else time.work(1.0) for n in range(5)]
        if at < 0:
            fail(at)
        tasks = [Task("curve", f"{name}{n}", w, lambda found: found) for n, w in enumerate(works)]
        return Plan(tasks, "error", "about", "reference")

    return Sweep(name, f"Sweep {name}", lambda case: "", plan)


@pytest.mark.parametrize("at", [-1, 0, 2])
def test_a_sweep_that_ends_in_an_error_leaves_the_others(at: int) -> None:
    time = FakeTime()
    sweeps = [sweep_of(time, "a", [1] * 3, 1.0), failing(time, "b", at)]
    results, omitted, _ = run([*sweeps, sweep_of(time, "c", [1] * 3, 1.0)], time, 300.0)
    assert [result.name for result in results] == ["a", "c"]
    assert (omitted[0].what, omitted[0].reason) == (
        "Sweep b", "ended with an error: no such weights",
    )  # fmt: skip


def test_points_before_an_error_are_kept_where_there_are_three() -> None:
    time = FakeTime()
    results, omitted, _ = run([failing(time, "b", 3)], time, 300.0)
    assert [point.label for point in results[0].points] == ["b0", "b1", "b2"]
    assert "no such weights: b3" in omitted[0].reason

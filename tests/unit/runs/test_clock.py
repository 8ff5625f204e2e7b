"""The parts of a run's time add up to all of it, whoever took the windows and when."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from usdsmoke.base.frame_report import (
    Estimate,
    FrameErrors,
    FrameReport,
    StepReport,
    TransportReport,
)
from usdsmoke.planning.plan import Omission
from usdsmoke.runs.budget import ELSEWHERE, PartClock, run_seconds, timed_items
from usdsmoke.runs.budget.error_budget import make_budget
from usdsmoke.runs.manifests import WindowRecord
from usdsmoke.ui.cli.budget_text import budget_text


class FakeTime:
    def __init__(self) -> None:
        self.now = 50.0

    def __call__(self) -> float:
        return self.now

    def spend(self, seconds: float) -> float:
        self.now += seconds
        return seconds


def window(seconds: float) -> WindowRecord:
    report = FrameReport(
        shape=StepReport(seconds=2.0),
        transport=TransportReport(error=Estimate(0.1, 0.25)),
        colour=StepReport(seconds=3.0),
        errors=FrameErrors(resolution=Estimate(0.1, 0.5), storage_density=Estimate(0.0, 0.25)),
        transport_seconds=0.5,
    )
    reports = {"a.vdb": report, "parts/b.vdb": FrameReport(left_out="empty frame")}
    frames = {name: {"report": report.to_json()} for name, report in reports.items()}
    timings = {"reading": 1.0, "writing": 1.25, "hashing": 0.125, "verifying": 0.375}
    return WindowRecord("run", 0, "/smoke", [1.0], [2.0], frames, seconds, timings)


def test_the_parts_add_up_to_what_all_processes_took() -> None:
    time = FakeTime()
    clock = PartClock(time)
    # The time elsewhere is one of the windows'.
    for part, seconds in (("preparing", 0.5), ("reading", 4), (ELSEWHERE, 9), ("assembling", 2)):
        with clock.part(part):
            time.spend(seconds)
    windows = [window(9.0), window(10.0)]
    reports = [report for one in windows for report in one.reports.values()]
    found = run_seconds(windows, reports, 6.0, clock)
    assert found["all"] == 0.5 + 4 + 2 + 9 + 10 + 6
    assert sum(value for name, value in found.items() if name != "all") == pytest.approx(31.5)
    assert (found["reading"], found["coarse step"], found["assembling"]) == (6.0, 6.0, 2.0)
    assert found["preparing"] == 0.5
    assert (found["shape"], found["colour"], found["estimates"]) == (4.0, 6.0, 2.0)
    assert found["transport"] == 1.0
    assert (found["hashing"], found["verifying"]) == (0.25, 0.75)
    assert found["writing"] == 1.0  # without these, and without the time of storage errors
    assert found["the rest"] == pytest.approx(2.0)


def test_the_time_that_items_take_to_come_is_theirs_and_not_that_between() -> None:
    time = FakeTime()
    clock = PartClock(time)
    for _ in timed_items(clock, "reading", (time.spend(1.0) for _ in range(3))):
        time.spend(10.0)
    assert clock.parts == {"reading": 3.0} and clock.total == 33.0


def test_time_counts_where_work_fails() -> None:
    time = FakeTime()
    clock = PartClock(time)

    with pytest.raises(ValueError), clock.part("reading"):
        time.spend(2.0)
        raise ValueError
    assert clock.parts == {"reading": 2.0}


def test_the_table_tells_every_part_and_what_the_plan_left_out() -> None:
    seconds = {"reading": 1.25, "shape": 75.0, "all": 76.25}
    omitted = [Omission("mask field", "none is named"), Omission("the shot's camera", "likewise")]
    text = budget_text(make_budget([]), seconds, omitted)
    assert text.endswith("time: reading 1.2 s, shape 1 min 15 s; 1 min 16 s in all")
    assert "mask field; the shot's camera" in text and "none is named" not in text
    text = budget_text(make_budget([]), seconds, starting=0.5)
    assert text.endswith("time: starting 0.5 s, reading 1.2 s, shape 1 min 15 s; 1 min 17 s in all")


def test_a_process_tells_since_when_it_runs() -> None:
    code = (
        "import time; began = time.time(); time.sleep(0.3)\n"
        "from usdsmoke.base.machine import process_seconds\n"
        "print(time.time() - began, process_seconds())"
    )
    begun = time.time()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    inside, told = map(float, done.stdout.split())
    if not Path("/proc/self/stat").exists():
        assert told == 0
    else:
        assert inside - 0.05 <= told <= time.time() - begun + 0.05

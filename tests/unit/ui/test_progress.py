"""Progress: the share never falls and ends at one; lines in a log, bars on a terminal."""

import io
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from usdsmoke.base.frame_report import Progress
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.schedule import octave_iterations, warm_iterations
from usdsmoke.runs.budget import Finding
from usdsmoke.runs.progress import RunProgress, WorkMeter
from usdsmoke.ui.cli.progress_bar import ConsoleProgress
from usdsmoke.ui.cli.text import format_seconds


def reports_of(config: Config, warm: list[bool]) -> list[tuple[int, Progress]]:
    """Every record of a run with its frame, as the core sends them."""
    reports = []
    for frame, is_warm in enumerate(warm):
        for step in config.optimize.steps:
            plan = octave_iterations(getattr(config, step).iterations, config.optimize.iterations)
            if is_warm:
                plan = warm_iterations(plan, config.windows.warm_iterations)
            octaves = [octave for octave, n in enumerate(plan) for _ in range(n)]
            reports += [
                (frame, Progress(step, frame, 0, 1, octave, len(plan), n, len(octaves), 2.0))
                for n, octave in enumerate(octaves)
            ]
    return reports


@given(
    st.lists(st.integers(1, 6), min_size=1, max_size=4),
    st.lists(st.booleans(), min_size=1, max_size=4),
    st.sampled_from([["shape"], ["colour"], ["shape", "colour"]]),
)
def test_the_share_rises_with_every_iteration_and_ends_at_one(
    iterations: list[int], warm: list[bool], steps: list[str]
) -> None:
    config = resolve_config(
        {
            "optimize": {"steps": steps},
            "shape": {"iterations": iterations},
            "colour": {"iterations": iterations},
        }
    )
    meter = WorkMeter(config, warm)
    shares = [meter.share(report, frame) for frame, report in reports_of(config, warm)]
    assert all(earlier < later for earlier, later in pairwise([0.0, *shares]))
    assert shares[-1] == pytest.approx(1.0)


def test_steps_of_two_frames_that_are_done_in_turn_count_by_themselves() -> None:
    """The next frame's shape step comes before a frame's colour step."""
    config = Config()
    reports = reports_of(config, [False, True])
    order = [(0, "shape"), (1, "shape"), (0, "colour"), (1, "colour")]
    in_turn = [(f, r) for part in order for f, r in reports if (f, r.step) == part]
    meter = WorkMeter(config, [False, True])
    shares = [meter.share(report, frame) for frame, report in in_turn]
    assert all(earlier < later for earlier, later in pairwise([0.0, *shares]))
    assert shares[-1] == pytest.approx(1.0)
    assert 0.4 < shares[len(shares) // 2] < 0.7


def test_a_frame_that_ends_early_counts_as_done() -> None:
    meter = WorkMeter(Config(), [False, False])
    first = next(report for _, report in reports_of(Config(), [False]))
    assert 0 < meter.share(first, 0) < 0.01
    assert meter.finish(0) == meter.now == pytest.approx(0.5)
    assert meter.finish(1) == pytest.approx(1.0)


def test_octaves_of_the_shared_coarse_step_do_not_count_in_windows() -> None:
    """A frame with such a start reports the iterations of its finest octave alone."""
    config = resolve_config({"optimize": {"steps": ["colour"]}})
    n = config.colour.iterations[-1]
    meter = WorkMeter(config, [False], [1])
    reports = [Progress("colour", 0, 0, 1, 2, 3, done, n, 2.0) for done in range(n)]
    shares = [meter.share(report, 0) for report in reports]
    assert shares == pytest.approx([(done + 1) / n for done in range(n)])


def test_the_fine_octave_counts_for_more_than_the_coarse_one() -> None:
    config = resolve_config({"optimize": {"steps": ["colour"]}, "colour": {"iterations": [10, 10]}})
    coarse_done = WorkMeter(config, [False]).share(Progress("colour", 1, 0, 1, 0, 2, 9, 20, 1.0), 0)
    assert coarse_done == pytest.approx(0.4 / (0.4 + 1.15))  # 0.15 + 1/4 against 0.15 + 1


def test_a_frame_that_starts_from_its_neighbour_counts_for_less() -> None:
    meter = WorkMeter(Config(), [False, True])
    assert 0.5 < meter.finish(0) < 0.9


def run_in_log(steps: list[str], n_iterations: int) -> list[str]:
    """The lines that a log gets when an iteration takes one second."""
    stream, now = io.StringIO(), [0.0]

    def clock() -> float:
        now[0] += 1.0
        return now[0]

    with ConsoleProgress(Console(file=stream, force_terminal=False, width=40), clock) as progress:
        for step in steps:
            for n in range(n_iterations):
                share = (n + 1) / n_iterations
                progress(RunProgress(step, 7.0, 0, 2, share, octave=1, n_octaves=3, loss=0.25))
    return stream.getvalue().splitlines()


def test_a_log_gets_a_line_now_and_then_with_step_octave_loss_and_time_left() -> None:
    lines = run_in_log(["shape"], 100)
    assert len(lines) == 10
    assert lines[3] == " 31% shape frame 1/2 (t=7) octave 2/3 loss 0.25 1 min 9 s left"
    assert not any("\x1b" in line or "\r" in line for line in lines)


def test_a_log_gets_a_line_when_a_step_begins() -> None:
    lines = run_in_log(["shape", "colour"], 5)
    assert [line.split()[1] for line in lines] == ["shape", "colour"]


def test_steps_without_iterations_tell_neither_loss_nor_time() -> None:
    stream = io.StringIO()
    with ConsoleProgress(Console(file=stream, force_terminal=False)) as progress:
        progress(RunProgress("check", 3.5, 1, 4, 0.0))
    assert stream.getvalue() == "  0% check frame 2/4 (t=3.5)\n"


def test_windows_of_several_processes_are_told_apart() -> None:
    stream = io.StringIO()
    with ConsoleProgress(Console(file=stream, force_terminal=False)) as progress:
        progress(RunProgress("write", 3.0, 1, 4, 0.5, window=2))
    assert "window 2" in stream.getvalue() and "frame 2/4" in stream.getvalue()


def test_a_terminal_gets_a_bar() -> None:
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=120)
    with ConsoleProgress(console) as progress:
        progress(RunProgress("colour", 1.0, 0, 1, 0.5, octave=0, n_octaves=3, loss=1.0))
        progress._bars.refresh()
    assert "octave 1/3" in stream.getvalue()
    assert "━" in stream.getvalue()
    assert " 50%" in stream.getvalue()


def test_a_finding_of_several_frames_is_told_once() -> None:
    stream = io.StringIO()
    rises = [Finding(f"smoke.{n}.vdb", "optimiser", "no fall", "Do more") for n in (1, 2)]
    with ConsoleProgress(Console(file=stream, width=200)) as progress:
        for finding in rises:
            progress(RunProgress("found", 1.0, 0, 2, 0.5, findings=(finding,)))
    assert stream.getvalue().splitlines() == ["note: smoke.1.vdb: no fall. Do more."]


def test_a_message_is_shown_as_it_is() -> None:
    stream = io.StringIO()
    with ConsoleProgress(Console(file=stream, width=20)) as progress:
        progress.say("[red]no markup[/red] and no wrapping of long lines")
    assert stream.getvalue() == "[red]no markup[/red] and no wrapping of long lines\n"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0, "0 s"), (59.6, "1 min 0 s"), (3599.4, "59 min 59 s"), (3600, "1 h 0 min")],
)
def test_durations_are_told_in_the_units_people_use(seconds: float, text: str) -> None:
    assert format_seconds(seconds) == text


def test_windows_at_once_get_no_more_lines() -> None:
    stream = io.StringIO()
    with ConsoleProgress(Console(file=stream, force_terminal=False), lambda: 0.0) as progress:
        for _ in range(20):
            progress(RunProgress("colour", 8.0, 7, 8, 0.5, window=0))
            progress(RunProgress("colour", 9.0, 0, 8, 0.5, window=1))
    assert len(stream.getvalue().splitlines()) == 2


def test_a_log_gets_a_line_for_the_last_frame_of_a_step() -> None:
    stream = io.StringIO()
    with ConsoleProgress(Console(file=stream, force_terminal=False)) as progress:
        for frame in range(4):
            progress(RunProgress("write", 1.0 + frame, frame, 4, 1.0))
    assert [line.split()[3] for line in stream.getvalue().splitlines()] == ["1/4", "4/4"]

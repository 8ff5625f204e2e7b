"""Progress: the share never falls and ends at one; lines in a log, bars on a terminal."""

import io
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from usdsmoke.config import Config, resolve_config
from usdsmoke.core.progress import Progress
from usdsmoke.estimate import octave_iterations
from usdsmoke.progress import ConsoleProgress, WorkMeter, format_seconds


def reports_of(config: Config, n_frames: int) -> list[Progress]:
    """Every record of a run, as the core sends them."""
    reports = []
    for frame in range(n_frames):
        for step in config.optimize.steps:
            octaves = octave_iterations(
                getattr(config, step).iterations, config.optimize.iterations
            )
            numbers = [octave for octave, n in enumerate(octaves) for _ in range(n)]
            reports += [
                Progress(step, frame + 1, frame, n_frames, octave, len(octaves), i, len(numbers), 2)
                for i, octave in enumerate(numbers)
            ]
    return reports


@given(
    st.lists(st.integers(1, 6), min_size=1, max_size=4),
    st.integers(1, 3),
    st.sampled_from([["shape"], ["colour"], ["shape", "colour"]]),
)
def test_the_share_rises_with_every_iteration_and_ends_at_one(
    iterations: list[int], n_frames: int, steps: list[str]
) -> None:
    config = resolve_config(
        {
            "optimize": {"steps": steps},
            "shape": {"iterations": iterations},
            "colour": {"iterations": iterations},
        }
    )
    meter = WorkMeter(config)
    shares = [meter.share(report) for report in reports_of(config, n_frames)]
    assert all(earlier < later for earlier, later in pairwise(shares))  # type: ignore[operator]
    assert shares[-1] == pytest.approx(1.0)


def test_the_fine_octave_counts_for_more_than_the_coarse_one() -> None:
    config = resolve_config({"optimize": {"steps": ["colour"]}, "colour": {"iterations": [10, 10]}})
    meter = WorkMeter(config)
    coarse_done = meter.share(Progress("colour", 1, 0, 1, 0, 2, 9, 20, 1.0))
    assert coarse_done == pytest.approx(0.4 / (0.4 + 1.15))  # 0.15 + 1/4 against 0.15 + 1


def test_steps_without_iterations_have_no_share() -> None:
    assert WorkMeter(Config()).share(Progress("check", 1, 0, 1, 0, 0, 0, 0, 0.0)) is None


def run_in_log(config: Config, n_frames: int) -> str:
    stream, now = io.StringIO(), [0.0]

    def clock() -> float:
        now[0] += 0.5
        return now[0]

    console = Console(file=stream, force_terminal=False, width=100)
    with ConsoleProgress(console, config, clock) as progress:
        for report in reports_of(config, n_frames):
            progress(report)
    return stream.getvalue()


def test_a_log_gets_a_line_now_and_then_with_step_octave_loss_and_time_left() -> None:
    lines = run_in_log(Config(), 1).splitlines()
    assert 5 < len(lines) < 60
    assert any(
        "shape frame 1/1 (t=1) octave 2/3 loss 2" in line and line.endswith("left")
        for line in lines
    )
    assert not any("\x1b" in line or "\r" in line for line in lines)


def test_the_time_left_is_what_the_rest_takes_at_the_same_pace() -> None:
    config = resolve_config({"optimize": {"steps": ["colour"]}, "colour": {"iterations": [100]}})
    line = run_in_log(config, 1).splitlines()[1]
    share = float(line.split("%")[0])
    left = line.rsplit("loss 2 ", 1)[1].removesuffix(" left")
    assert left == format_seconds(100 - share)  # two readings of half a second an iteration


def test_a_terminal_gets_a_bar() -> None:
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=120)
    with ConsoleProgress(console, Config()) as progress:
        for report in reports_of(Config(), 1)[:50]:
            progress(report)
        progress._bars.refresh()
    assert "octave 1/3" in stream.getvalue()
    assert "━" in stream.getvalue()


def test_a_message_is_shown_as_it_is() -> None:
    stream = io.StringIO()
    with ConsoleProgress(Console(file=stream, width=20), Config()) as progress:
        progress.say("[red]no markup[/red] and no wrapping of long lines")
    assert stream.getvalue() == "[red]no markup[/red] and no wrapping of long lines\n"

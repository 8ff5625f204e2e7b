"""Windows: every frame once, in order, none too long, none across a cut."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from usdsmoke.config import WindowsConfig
from usdsmoke.errors import ShapeError
from usdsmoke.windows import split_windows

TIME_CODES = st.lists(st.integers(-1000, 1000), unique=True, max_size=40).map(
    lambda numbers: [number / 4 for number in sorted(numbers)]
)


@given(TIME_CODES, st.integers(1, 12))
def test_every_frame_is_in_exactly_one_window_and_in_order(
    time_codes: list[float], size: int
) -> None:
    windows = split_windows(time_codes, WindowsConfig(size=size))
    assert [t for window in windows for t in window.time_codes] == time_codes
    assert [window.index for window in windows] == list(range(len(windows)))
    assert all(1 <= len(window.time_codes) <= size for window in windows)


@given(st.integers(1, 60), st.integers(1, 12))
def test_without_gaps_all_but_the_last_window_are_full(n_frames: int, size: int) -> None:
    windows = split_windows([float(t) for t in range(n_frames)], WindowsConfig(size=size))
    assert all(len(window.time_codes) == size for window in windows[:-1])


def test_a_window_is_the_same_whatever_comes_after_it() -> None:
    short = split_windows([1.0, 2.0, 3.0, 4.0], WindowsConfig(size=2))
    long = split_windows([1.0, 2.0, 3.0, 4.0, 5.0], WindowsConfig(size=2))
    assert long[: len(short)] == short


def test_no_window_reaches_over_a_cut() -> None:
    time_codes = [1.0, 2.0, 3.0, 100.0, 101.0, 102.0]
    windows = split_windows(time_codes, WindowsConfig(size=8))
    assert [window.time_codes for window in windows] == [(1, 2, 3), (100, 101, 102)]


def test_a_regular_step_of_two_is_no_cut() -> None:
    windows = split_windows([1.0, 3.0, 5.0, 7.0], WindowsConfig(size=8))
    assert len(windows) == 1
    assert all(later - earlier == 2 for earlier, later in pairwise(windows[0].time_codes))


def test_no_frames_are_no_windows() -> None:
    assert split_windows([], WindowsConfig()) == ()


@pytest.mark.parametrize("time_codes", [[2.0, 1.0], [1.0, 1.0], [1.0, float("nan")]])
def test_time_codes_that_do_not_rise_are_refused(time_codes: list[float]) -> None:
    with pytest.raises(ShapeError, match="wanted them ascending"):
        split_windows(time_codes, WindowsConfig())

"""Windows: every frame once, in order, none too long, none across a cut."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from usdsmoke.base.errors import ShapeError
from usdsmoke.config.run_sections import WindowsConfig
from usdsmoke.planning.windows import coarse_runs, find_cuts, split_windows

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
    assert all(1 <= len(window.time_codes) < 1.5 * size for window in windows)


@given(st.integers(1, 60), st.integers(1, 12), st.integers(0, 6))
def test_without_gaps_all_but_the_last_window_are_full(
    n_frames: int, size: int, overlap: int
) -> None:
    config = WindowsConfig(size=size, overlap=overlap)
    *others, last = split_windows([float(t) for t in range(n_frames)], config)
    assert all(len(window.time_codes) == size for window in others)
    assert not others or len(last.time_codes) >= min(overlap, size / 2)


def test_a_windows_own_frames_are_the_same_whatever_comes_after_it() -> None:
    short = split_windows([1.0, 2.0, 3.0, 4.0], WindowsConfig(size=2))
    long = split_windows([1.0, 2.0, 3.0, 4.0, 5.0], WindowsConfig(size=2))
    assert [window.time_codes for window in long[:2]] == [window.time_codes for window in short]


@given(TIME_CODES, st.integers(2, 12), st.integers(0, 6))
def test_a_window_goes_on_as_far_as_the_overlap_and_the_next_window_reach(
    time_codes: list[float], size: int, overlap: int
) -> None:
    windows = split_windows(time_codes, WindowsConfig(size=size, overlap=overlap))
    for window, later in pairwise(windows):
        wanted = min(overlap, size, len(later.time_codes)) if later.continues else 0
        assert window.overlap == later.time_codes[:wanted]
    assert not windows or windows[-1].overlap == ()


def test_nothing_overlaps_or_is_joined_across_a_cut() -> None:
    time_codes = [1.0, 2.0, 3.0, 4.0, 100.0, 101.0, 102.0]
    windows = split_windows(time_codes, WindowsConfig(size=2))
    assert [window.continues for window in windows] == [False, True, False, True]
    assert [window.overlap for window in windows] == [(3, 4), (), (102,), ()]
    assert coarse_runs(windows) == ((1, 2, 3, 4), (100, 101, 102))


def test_windows_of_one_frame_stand_alone() -> None:
    windows = split_windows([1.0, 2.0, 3.0], WindowsConfig(size=1))
    assert all(not window.continues and not window.overlap for window in windows)
    assert coarse_runs(windows) == ()


def test_windows_of_several_volumes_are_counted_through() -> None:
    windows = split_windows([1.0, 2.0, 3.0], WindowsConfig(size=2), first_index=5)
    assert [window.index for window in windows] == [5, 6]


def test_no_window_reaches_over_a_cut() -> None:
    time_codes = [1.0, 2.0, 3.0, 100.0, 101.0, 102.0]
    windows = split_windows(time_codes, WindowsConfig(size=8))
    assert [window.time_codes for window in windows] == [(1, 2, 3), (100, 101, 102)]


def test_a_regular_step_of_two_is_no_cut() -> None:
    windows = split_windows([1.0, 3.0, 5.0, 7.0], WindowsConfig(size=8))
    assert len(windows) == 1
    assert all(later - earlier == 2 for earlier, later in pairwise(windows[0].time_codes))


@pytest.mark.parametrize("rate", [1.0, 1000 / 24, 1 / 24], ids=["frames", "ms", "seconds"])
def test_samples_between_some_frames_are_no_cut(rate: float) -> None:
    time_codes = [rate * t for t in (1, 2, 3, 4, 5, 5.25, 5.5, 5.75, 6, 6.25, 6.5, 6.75, 7, 8)]
    (window,) = split_windows(time_codes, WindowsConfig(size=20), frame_length=rate)
    assert len(window.time_codes) == len(time_codes)


def test_a_gap_of_more_than_two_frames_is_a_cut_also_beside_samples_between_frames() -> None:
    assert find_cuts([1, 2, 2.25, 2.5, 2.75, 3, 6, 7]) == ((3, 6),)


def test_a_gap_of_frames_is_no_cut_where_the_usual_step_is_as_long() -> None:
    assert find_cuts([0, 5, 10, 20, 25], frame_length=1) == ()
    assert find_cuts([0, 5, 10, 21, 26], frame_length=1) == ((10, 21),)


def test_no_frames_are_no_windows() -> None:
    assert split_windows([], WindowsConfig()) == ()


@pytest.mark.parametrize("time_codes", [[2.0, 1.0], [1.0, 1.0], [1.0, float("nan")]])
def test_time_codes_that_do_not_rise_are_refused(time_codes: list[float]) -> None:
    with pytest.raises(ShapeError, match="ascending"):
        split_windows(time_codes, WindowsConfig())

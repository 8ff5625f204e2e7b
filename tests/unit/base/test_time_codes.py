"""Selections of timeCodes: what is read, what is taken, what is refused, how they are written."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from usdsmoke.base.errors import ConfigError
from usdsmoke.base.time_codes import (
    format_time_code,
    format_time_codes,
    parse_frames,
    select_frames,
    spread,
)


@pytest.mark.parametrize(
    ("text", "existing", "selected"),
    [
        ("", [3, 1, 2], (1, 2, 3)),
        ("1-24", [0, 1, 7.5, 24, 25], (1, 7.5, 24)),
        ("1,5,9", [1, 2, 5, 9], (1, 5, 9)),
        ("1-6x2", [1, 2, 3, 4, 4.5, 5], (1, 3, 5)),
        ("-3-5", [-4, -3, 0, 5, 6], (-3, 0, 5)),
        ("-5--3", [-6, -5, -4, -3, -2], (-5, -4, -3)),
        ("1.5", [1, 1.5, 2], (1.5,)),
        ("0-1x0.25", [0.0, 0.1, 0.25, 0.5, 0.75, 1.0], (0.0, 0.25, 0.5, 0.75, 1.0)),
        (" 1 - 3 , 8 ", [1, 3, 8], (1, 3, 8)),
        ("1-3,2-4", [1, 2, 3, 4], (1, 2, 3, 4)),
    ],
)
def test_a_selection_takes_the_existing_time_codes_it_names(text, existing, selected):
    assert select_frames(parse_frames(text), existing) == (selected, ())


@pytest.mark.parametrize(
    ("text", "missing"),
    [
        ("1-9,30,31-31", (1, 9, 30, 31)),  # without a step, a range requests its ends
        ("2-4", ()),
        ("2-4x1", (3,)),
        ("2-8x2", (6, 8)),
        ("0-1000000000x0.001", (0, 1e9)),  # too many steps to look for each
    ],
)
def test_requested_time_codes_that_do_not_exist_are_reported(text, missing):
    assert select_frames(parse_frames(text), [2, 4])[1] == missing


def test_rounding_of_a_layer_offset_does_not_lose_a_time_code():
    assert select_frames(parse_frames("5"), [5.00000001])[0] == (5.00000001,)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("all", "'all'.* such as 1-24"),
        ("1,,2", "'' in '1,,2'"),
        ("1-", "'1-'"),
        ("1-4y2", "'1-4y2'"),
        ("24-1", "'24-1' .*backwards.* 1-24"),
        ("1-9x0", "the step .*1-9x0.* is 0"),
        ("1-9x-2", "the step .* is -2"),
        ("1e3", "'1e3'"),
    ],
)
def test_nonsense_is_refused_with_the_part_and_what_was_wanted(text, reason):
    with pytest.raises(ConfigError, match=reason):
        parse_frames(text)


@pytest.mark.parametrize(
    ("codes", "text"),
    [
        ([], ""),
        ([7], "7"),
        ([1, 2], "1,2"),
        ([1, 2, 3, 9], "1-3,9"),
        ([1.5, 2, 2.5, 3], "1.5-3x0.5"),
        ([-2, -1, 0], "-2-0"),
        ([1000001, 1000002], "1000001,1000002"),
    ],
)
def test_many_time_codes_are_written_short(codes, text):
    assert format_time_codes(codes) == text


@given(st.sets(st.integers(-200, 200).map(lambda n: n / 4), max_size=30))
def test_what_is_written_short_selects_exactly_the_same_again(codes):
    if codes:  # an empty text means all
        selected, missing = select_frames(parse_frames(format_time_codes(codes)), codes)
        assert selected == tuple(sorted(codes))
        assert not missing


@pytest.mark.parametrize(("code", "text"), [(7.0, "7"), (-0.5, "-0.5"), (1234567.0, "1234567")])
def test_a_time_code_is_written_as_people_write_it(code, text):
    assert format_time_code(code) == text


@pytest.mark.parametrize(
    ("count", "wanted"), [(0, []), (1, [0]), (3, [0, 1, 2]), (4, [0, 2, 3]), (9, [0, 4, 8])]
)
def test_some_are_taken_evenly_from_the_first_to_the_last(count: int, wanted: list[int]) -> None:
    assert spread(range(count)) == wanted


@given(st.floats(-100, 100), st.floats(0.05, 50), st.integers(1, 60))
def test_what_is_printed_selects_the_same_time_codes(first: float, step: float, count: int) -> None:
    codes = [first + n * step for n in range(count)]
    selected, missing = select_frames(parse_frames(format_time_codes(codes)), codes)
    assert (list(selected), missing) == (codes, ())
    for code in codes:
        assert select_frames(parse_frames(format_time_code(code)), codes) == ((code,), ())

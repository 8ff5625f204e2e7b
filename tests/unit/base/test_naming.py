"""File names: different for different things, in the order of timeCodes, readable by Blender."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from usdsmoke.base.errors import LayerError
from usdsmoke.base.naming import frame_file_names, volume_stems

PRIM_NAMES = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,5}", fullmatch=True)
PRIM_PATHS = st.lists(PRIM_NAMES, min_size=1, max_size=3).map(lambda names: "/" + "/".join(names))


@given(st.lists(PRIM_PATHS, unique=True, max_size=6), st.sampled_from(["", "look"]))
def test_stems_differ_even_where_case_does_not_count(paths: list[str], name: str) -> None:
    stems = volume_stems(paths, name)
    assert len(stems) == len(paths)
    assert len({stem.casefold() for stem in stems}) == len(stems)
    assert all(re.fullmatch(r"[\w-]+", stem) for stem in stems)


def test_stems_are_the_prims_names_where_these_differ() -> None:
    assert volume_stems(["/a/plume", "/a/fog"]) == ("plume", "fog")
    assert volume_stems(["/a/plume"], "fx") == ("fx",)
    assert volume_stems(["/a/plume", "/a/fog"], "fx") == ("fx_plume", "fx_fog")
    assert volume_stems(["/a_b/c", "/a/b_c", "/x/c", "/x/b_c"])[:2] == ("a_b_c", "a_b_c_2")


@given(st.lists(st.integers(0, 200_000), unique=True, min_size=1, max_size=20).map(sorted))
def test_whole_numbers_are_the_last_digits_and_rise_with_time(codes: list[int]) -> None:
    names = frame_file_names("plume", [float(code) for code in codes])
    numbers = [re.fullmatch(r"plume\.(\d{4,})\.vdb", name)[1] for name in names]  # type: ignore[index]
    assert [int(number) for number in numbers] == codes
    assert list(names) == sorted(names)


@given(st.lists(st.integers(-8_000, 8_000), unique=True, min_size=2, max_size=20))
def test_fractions_get_names_of_their_own_with_the_timecode_in_it(eighths: list[int]) -> None:
    codes = [number / 8 for number in sorted(eighths)]
    names = frame_file_names("plume", codes)
    assert [float(name[len("plume.") : -len(".vdb")]) for name in names] == codes


def test_timecodes_too_close_for_names_are_refused() -> None:
    with pytest.raises(LayerError, match="1e-6"):
        frame_file_names("plume", [1.0, 1.0 + 1e-9])

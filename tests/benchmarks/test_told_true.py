"""The study of told and true errors: what counts as within a factor of 2."""

import math

import pytest

from benchmarks.told_true import Row


@pytest.mark.parametrize(
    ("told", "true", "wanted"),
    [
        (0.10, 0.10, True),
        (0.10, 0.19, True),
        (0.10, 0.21, False),
        (0.10, 0.049, False),
        (0.10, 0.0, False),
        (4e-4, 9e-4, True),  # both too small to matter
        (4e-4, 2e-3, False),
        (0.10, math.nan, False),
    ],
)
def test_a_row_is_right_within_a_factor_of_two(told: float, true: float, wanted: bool) -> None:
    assert Row("scene", "row", told, true).within is wanted

"""Iterations of octaves and of frames that start from their neighbour."""

import pytest

from usdsmoke.core.smoke.schedule import octave_iterations, warm_iterations


@pytest.mark.parametrize("total", [3, 7, 10, 100, 1000])
@pytest.mark.parametrize("per_octave", [[60, 50, 40], [1, 1, 1], [5, 0, 300]])
def test_a_total_is_met_where_every_octave_can_have_an_iteration(per_octave, total):
    found = octave_iterations(per_octave, total)
    assert sum(found) == total
    assert [n == 0 for n in found] == [n == 0 for n in per_octave]


def test_no_octave_in_use_falls_below_one_iteration():
    assert octave_iterations([60, 50, 40], 1) == [1, 1, 1]


def test_no_total_and_no_iterations_leave_the_list_as_it_is():
    assert octave_iterations([3, 2], None) == [3, 2]
    assert octave_iterations([0, 0], 50) == [0, 0]


def test_a_warm_frame_refines_only_the_finest_octave_in_use():
    assert warm_iterations([60, 50, 40], 0.5) == [0, 0, 20]
    assert warm_iterations([60, 50, 0], 0.1) == [0, 5, 0]
    assert warm_iterations([60, 1], 0.1) == [0, 1]
    assert warm_iterations([0, 0], 0.5) == [0, 0]

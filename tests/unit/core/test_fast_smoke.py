"""Frames whose smoke comes from where there was none: nothing is carried, compared or averaged."""

import dataclasses

import numpy as np
import pytest

from tests.smoke_fixtures import frame_of, puff
from tests.stylize_fixtures import by_voxel, quick_config, run_core
from usdsmoke.base.volume import VolumeFrame

CONFIG = quick_config(shape={"iterations": [2, 3]}, colour={"iterations": [2, 3]})


def pair(voxels_a_frame: float) -> list[VolumeFrame]:
    """Two equal frames; the velocity says that smoke comes from so many voxels away."""
    velocity = np.array([24.0 * voxels_a_frame, 0.0, 0.0])
    return [frame_of(puff(12), time_code=float(code), velocity=velocity) for code in (1, 2)]


@pytest.mark.parametrize("steps", [["shape", "colour"], ["colour"]])
def test_a_frame_whose_smoke_comes_from_nowhere_starts_anew_and_warns(steps):
    config = quick_config(
        shape={"iterations": [2, 3]}, colour={"iterations": [2, 3]}, optimize={"steps": steps}
    )
    first, second = run_core(pair(200.0), config)
    assert not first.report.warnings
    (warning,) = second.report.warnings
    assert "100%" in warning and "timeCode 2" in warning and "unit" in warning
    assert all(step.iterations == (2, 3) for step in second.report.steps.values())
    assert second.report.temporal.colour is None
    assert second.report.temporal.displacement is None


def test_a_frame_before_unlike_smoke_is_as_if_it_were_alone():
    alone = run_core(pair(200.0)[:1], CONFIG)[0]
    first = run_core(pair(200.0), CONFIG)[0]
    for name in ("density", "emission"):
        assert by_voxel(getattr(first, name)) == by_voxel(getattr(alone, name))


@pytest.mark.parametrize("voxels", [0.0, 1.0])
def test_smoke_that_hardly_moves_follows_the_frame_before(voxels):
    second = run_core(pair(voxels), CONFIG)[1]
    assert not second.report.warnings
    assert len(second.report.colour.iterations) == 1
    assert 0 < second.report.temporal.colour < 1
    assert second.report.temporal.displacement > 0


def test_smoke_that_jumps_without_a_velocity_starts_anew_too():
    first, second = (frame_of(puff(12), time_code=float(code)) for code in (1, 2))
    far = dataclasses.replace(second.density, ijk_min=(40, 0, 0))
    results = run_core([first, dataclasses.replace(second, density=far)], CONFIG)
    assert "starts anew" in results[1].report.warnings[0]

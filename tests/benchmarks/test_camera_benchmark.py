"""The benchmark of cameras runs, and its cases differ as they are meant to."""

import pytest

from benchmarks.camera_cost import half_out, near_eye
from tests.smoke_fixtures import random_style

QUICK = [
    "colour.iterations=[2]", "shape.iterations=[1]", "views.pool=2", "views.image_size=24",
    "features.layers=[oriented1]",
]  # fmt: skip


@pytest.fixture(autouse=True)
def plain_style(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing that would have to be painted."""
    monkeypatch.setattr("benchmarks.camera_cost.painted_waves", random_style)


def test_a_half_is_worked_on_where_the_picture_shows_a_half() -> None:
    found = half_out(24, QUICK, 1)
    voxels = [found[name][1] for name in ("no camera", "whole", "half")]
    assert voxels[0] == voxels[1] and voxels[2] / voxels[0] == pytest.approx(0.5, abs=0.01)
    errors = [error for _, _, error in found.values()]
    assert min(errors) > 0 and len(set(errors)) == 3


def test_parallel_and_perspective_views_give_results_of_their_own() -> None:
    found = near_eye(16, [1.0], QUICK)
    parallel, perspective = found[1.0]["parallel"], found[1.0]["perspective"]
    assert parallel[1] > 0 and perspective[1] > 0
    assert parallel[1] != pytest.approx(perspective[1], rel=1e-6)

"""What a plan remarks on, and what a run of a part of a shot says at its end."""

from pathlib import Path

import pytest

from tests.fixtures.pipeline_fixtures import FakeCore, Shot, make_shot
from usdsmoke.pipeline import Request, plan_request, stylize
from usdsmoke.planning.plan import Plan


@pytest.fixture
def shot(tmp_path: Path) -> Shot:
    return make_shot(tmp_path)


def plan_of(shot: Shot, *settings: str) -> Plan:
    return plan_request(Request(shot.stage, shot.style, shot.output, list(settings)))


def test_ordinary_settings_are_not_remarked_on(shot: Shot) -> None:
    assert plan_of(shot).notes == ()


def test_a_learning_rate_far_above_the_default_is_remarked_on(shot: Shot) -> None:
    (note,) = plan_of(shot, "colour.learning_rate=50").notes
    assert "colour.learning_rate=50" in note
    assert plan_of(shot, "colour.learning_rate=0.1").notes == ()
    assert plan_of(shot, "colour.learning_rate=50", "optimize.steps=[shape]").notes == ()


def test_a_part_of_a_shot_is_measured_on_that_part_and_the_plan_says_so(shot: Shot) -> None:
    (note,) = plan_of(shot, "stage.frames=1-2").notes
    assert "2 selected of 3" in note and "optics.gamma" in note
    known = ("optics.gamma=1", "optics.gamma_shape=1")
    assert plan_of(shot, "stage.frames=1-2", *known).notes == ()
    assert plan_of(shot, "stage.frames=1-2", known[0]).notes


@pytest.mark.usefixtures("core")
def test_at_the_end_the_extinctions_are_told_that_keep_the_look(shot: Shot, core: FakeCore) -> None:
    told = stylize(shot.stage, shot.style, shot.output, "stage.frames=1-2").warnings
    scene = core.measure_scene([], None, None, "Y", 1)
    gamma = scene.gamma_w * scene.reference_voxel_size
    assert any(f"optics.gamma={gamma:g}" in text for text in told)
    whole = stylize(shot.stage, shot.style, shot.folder / "whole").warnings
    assert not any("optics.gamma" in text for text in whole)

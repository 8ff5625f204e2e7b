"""What a plan says of the stage's lights."""

from pathlib import Path

import pytest

from tests.fixtures.pipeline_fixtures import Shot, make_shot
from usdsmoke.pipeline import plan
from usdsmoke.planning.plan import Plan

LIGHTS = """
def DistantLight "sun"
{
}

def SphereLight "lamp"
{
}
"""


@pytest.fixture
def shot(tmp_path: Path) -> Shot:
    return make_shot(tmp_path, 1)


def plan_of(shot: Shot, lights: str, *settings: str) -> Plan:
    shot.stage.write_text(shot.stage.read_text() + lights)
    return plan(shot.stage, shot.style, shot.output, list(settings))


def test_lights_are_left_out_while_the_smoke_scatters_none(shot: Shot) -> None:
    made = plan_of(shot, LIGHTS)
    said = {item.what: item.reason for item in made.omitted}
    assert "optics.albedo" in said["lights </sun>, </lamp>"]
    assert not any("</sun>" in text for text in (*made.needed, *made.notes))
    assert made.source.volumes[0].frames[0].lights == ()


def test_lights_that_light_the_smoke_are_needed_and_others_named(shot: Shot) -> None:
    made = plan_of(shot, LIGHTS, "optics.albedo=0.8")
    said = {item.what: item.reason for item in made.omitted}
    assert "SphereLight" in said["light </lamp>"] and len(made.source.lights) == 2
    for texts in (made.needed, made.notes):
        (sentence,) = (text for text in texts if "</sun>" in text)
        assert "optics.albedo" in sentence


def test_scattering_without_a_light_is_said_to_do_nothing(shot: Shot) -> None:
    said = {item.what for item in plan_of(shot, "", "optics.albedo=0.8").omitted}
    assert "scattering (optics.albedo)" in said


def test_without_lights_the_plan_does_not_speak_of_them(shot: Shot) -> None:
    made = plan_of(shot, "")
    told = (*made.needed, *made.notes, *(item.what for item in made.omitted))
    assert not any("light" in text for text in told)

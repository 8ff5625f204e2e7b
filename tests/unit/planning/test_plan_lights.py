"""What a plan says of the stage's lights."""

import math
import re
from pathlib import Path

import pytest

from tests.fixtures.pipeline_fixtures import Shot, make_shot
from usdsmoke.base.errors import ConfigError
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


def test_a_stage_with_a_sun_is_lit_by_default_and_the_plan_says_how_to_leave_it_out(
    shot: Shot,
) -> None:
    made = plan_of(shot, LIGHTS)
    said = {item.what: item.reason for item in made.omitted}
    assert "SphereLight" in said["light </lamp>"] and len(made.source.lights) == 2
    (needed,) = (text for text in made.needed if "</sun>" in text)
    for fact in ("10%", "optics.albedo", "from 0 0 1", "colour 3.36 3.36 3.36", "0 leaves it out"):
        assert fact in needed
    (note,) = (text for text in made.notes if "made for its lights" in text)
    assert not any("</sun>" in text for text in made.notes)  # said once
    white = 0.1 * 3.36 / (8 * math.pi)  # of a wall that faces the sun
    assert f"{white:.2g} times as bright" in note


def test_lights_are_left_out_where_the_smoke_scatters_none(shot: Shot) -> None:
    shot.stage.write_text(shot.stage.read_text() + LIGHTS)
    for setting, why in (("optics.albedo=0", "albedo"), ("optimize.steps=[shape]", "colour step")):
        made = plan(shot.stage, shot.style, shot.output, [setting])
        said = {item.what: item.reason for item in made.omitted}
        assert why in said["lights </sun>, </lamp>"]
        assert not any("</sun>" in text for text in (*made.needed, *made.notes))
        assert made.source.volumes[0].frames[0].lights == ()


def test_lights_of_the_settings_are_named_and_the_stage_s_left_out(shot: Shot) -> None:
    made = plan_of(shot, LIGHTS, "optics.sun=[0,2,0]", "optics.albedo=0.8", "optics.exposure=-1")
    (needed,) = (text for text in made.needed if "optics.sun" in text)
    assert "80%" in needed and "from 0 1 0" in needed
    said = {item.what: item.reason for item in made.omitted}
    assert "optics.sun" in said["lights </sun>, </lamp>"]
    (note,) = (text for text in made.notes if "made for its lights" in text)
    assert f"{0.8 / 8 / 2:.2g} times" in note


def test_a_light_that_changes_is_told_where_it_is_brightest(tmp_path: Path) -> None:
    values = "bool inputs:normalize = 1\nfloat inputs:intensity.timeSamples = { 1: 1, 2: 5, 3: 2 }"
    made = plan_of(make_shot(tmp_path, 3), f'def DistantLight "sun"\n{{\n{values}\n}}\n')
    (needed,) = (text for text in made.needed if "</sun>" in text)
    assert "colour 5 5 5 at timeCode 2" in needed
    (note,) = (text for text in made.notes if "made for its lights" in text)
    assert f"{0.1 * 5 / (8 * math.pi):.2g} times as bright as white at timeCode 2" in note


@pytest.mark.parametrize("towards", [(0.3, -2.0, 0.4), (0.0, 1.0, 0.0), (-1.0, 0.5, -3.0)])
def test_lights_of_the_settings_are_told_as_lights_that_a_stage_can_have(
    shot: Shot, towards: tuple[float, float, float]
) -> None:
    settings = [f"optics.sun={list(towards)}", "optics.sky=[0.1,0.2,0.3]"]
    named = plan_of(shot, "", *settings)
    (note,) = (text for text in named.notes if "other renderer" in text)
    number = r"(-?[\d.e+-]+)"
    triple = rf" = \({number}, {number}, {number}\)"
    (colour, sky), (turn,) = (
        re.findall(f"{name}{triple}", note) for name in ("inputs:color", "xformOp:rotateXYZ")
    )
    for said in ("DistantLight", "DomeLight", "inputs:intensity = 1", "inputs:normalize = 1"):
        assert said in note
    authored = plan_of(
        shot,
        f"""
def DistantLight "key"
{{
    bool inputs:normalize = 1
    float inputs:intensity = 1
    color3f inputs:color = ({", ".join(colour)})
    double3 xformOp:rotateXYZ = ({", ".join(turn)})
    uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
}}

def DomeLight "sky"
{{
    float inputs:intensity = 1
    color3f inputs:color = ({", ".join(sky)})
}}
""",
    )
    for ours, theirs in zip(
        *(p.volumes[0].frames[0].source.lights for p in (named, authored)), strict=True
    ):
        assert theirs.colour == pytest.approx(ours.colour, rel=1e-5)
        assert (theirs.towards is None) is (ours.towards is None)
        assert ours.towards is None or theirs.towards == pytest.approx(ours.towards, abs=1e-5)
    assert not any("other renderer" in text for text in authored.notes)


@pytest.mark.parametrize(
    "setting", [["optics.sky=[0,0,0]"], ["optics.sun=[0,1,0]", "optics.sun_colour=[0,0,0]"]]
)
def test_black_lights_of_the_settings_take_the_place_of_the_stage_s_too(
    shot: Shot, setting: list[str]
) -> None:
    made = plan_of(shot, LIGHTS, *setting)
    said = {item.what: item.reason for item in made.omitted}
    assert "optics.sky" in said["lights </sun>, </lamp>"]
    assert "black" in said["scattering (optics.albedo)"]
    assert not any("light" in text for text in (*made.needed, *made.notes))
    assert all(frame.source.lights == () for frame in made.volumes[0].frames)


def test_bounces_are_named_as_needed_or_left_out_and_refused_where_the_albedo_is_painted(
    shot: Shot,
) -> None:
    sun = "optics.sun=[1,0,0]"
    made = plan_of(shot, "", sun)
    assert any("optics.bounces" in item.reason for item in made.omitted)
    assert not any("optics.bounces" in text for text in made.needed)
    made = plan(shot.stage, shot.style, shot.output, [sun, "optics.bounces=true"])
    assert not any("optics.bounces" in f"{item.what} {item.reason}" for item in made.omitted)
    assert any("optics.bounces" in text for text in made.needed)
    made = plan(shot.stage, shot.style, shot.output, ["optics.bounces=true"])
    assert any("optics.bounces" in item.what for item in made.omitted)
    for target in ("albedo", "both"):
        with pytest.raises(ConfigError, match=r"optics\.bounces"):
            settings = [sun, "optics.bounces=true", f"colour.target={target}"]
            plan(shot.stage, shot.style, shot.output, settings)


def test_scattering_without_a_light_is_said_to_do_nothing(shot: Shot) -> None:
    said = {item.what for item in plan_of(shot, "", "optics.albedo=0.8").omitted}
    assert "scattering (optics.albedo)" in said


def test_without_lights_the_plan_does_not_speak_of_them(shot: Shot) -> None:
    made = plan_of(shot, "")
    told = (*made.needed, *made.notes, *(item.what for item in made.omitted))
    assert not any("light" in text for text in told)


@pytest.mark.parametrize("target", ["albedo", "both"])
def test_an_albedo_is_painted_where_light_shows_it_and_refused_where_none_does(
    shot: Shot, target: str
) -> None:
    setting = f"colour.target={target}"
    with pytest.raises(ConfigError, match=r"optics\.sun"):
        plan(shot.stage, shot.style, shot.output, [setting])
    made = plan(shot.stage, shot.style, shot.output, [setting, "optics.sun=[1,0,0]"])
    assert any(
        ("100%" if target == "albedo" else "50%") in text and "optics.sun" in text
        for text in made.needed
    )
    assert any("paints" in text and "scattering" in text for text in made.needed)
    (written,) = (text for text in made.needed if text.startswith("one VDB file"))
    assert "Cd" in written and ("emission" in written) is (target == "both")
    uneven = [setting, "optics.sun=[1,0,0]", "optics.anisotropy=0.5"]
    if target == "both":
        with pytest.raises(ConfigError, match="anisotropy"):
            plan(shot.stage, shot.style, shot.output, uneven)
    else:
        plan(shot.stage, shot.style, shot.output, uneven)


@pytest.mark.parametrize("sky", ["1e-45", "1e-30", "1e30"])
@pytest.mark.parametrize("target", ["albedo", "both"])
def test_an_albedo_in_light_that_no_exposure_shows_is_refused(
    shot: Shot, target: str, sky: str
) -> None:
    """Or it is the noise that it starts from, with no word of it."""
    settings = [f"colour.target={target}", f"optics.sky=[{sky},{sky},{sky}]"]
    with pytest.raises(ConfigError, match=r"optics\.sky.* 40 stops"):
        plan(shot.stage, shot.style, shot.output, settings)
    plan(shot.stage, shot.style, shot.output, [settings[0], "optics.sky=[1e-9,1e9,1]"])


def test_light_that_no_exposure_brings_to_white_is_refused_whatever_is_painted(shot: Shot) -> None:
    with pytest.raises(ConfigError, match=r"optics\.sky.* 40 stops"):
        plan(shot.stage, shot.style, shot.output, ["optics.sky=[1e39,1,1]"])
    plan(shot.stage, shot.style, shot.output, ["optics.sky=[1e39,1,1]", "optics.albedo=0"])
    plan(shot.stage, shot.style, shot.output, ["optics.sky=[1e-39,0,0]"])

"""The preview of a look that was made for the stage's lights draws their light in it."""

import math

import numpy as np
import pytest
from PIL import Image

from tests.fixtures.preview_fixtures import look_of_four_frames, parts
from tests.fixtures.usd_fixtures import write_text
from usdsmoke.pictures.preview import preview

# behind the eye of a front view
SUN = """
    def DistantLight "sun"
    {
        float inputs:intensity = 6
        bool inputs:normalize = 1
        color3f inputs:color = (1, 0.5, 0.25)
        float xformOp:rotateX = 90
        uniform token[] xformOpOrder = ["xformOp:rotateX"]
    }
"""


def picture(tmp_path, name, body, albedo=0.8, more=""):
    """Scene-linear emission of a look with other opinions above it."""
    look = tmp_path / "out/shot_look.usda"
    if not look.exists():
        look_of_four_frames(tmp_path)
    text = f"""#usda 1.0
(
    subLayers = [@{look}@]
    metersPerUnit = 0.5
    upAxis = "Z"
    timeCodesPerSecond = 25
)
over "World"
{{
    over "smoke"
    {{
        float usdSmoke:albedo = {albedo}
        {more}
    }}
    {body}
}}
"""
    stage = write_text(tmp_path / f"{name}.usda", text)
    (file_path,) = preview(stage, tmp_path / f"{name}.exr", frames="2", width=24).files
    return parts(file_path)["emission"][1]


@pytest.fixture
def added(tmp_path):
    """What a sun adds to the preview, by the light's and the volume's opinions."""
    dark = picture(tmp_path, "dark", "")

    def light(name, body=SUN, **values):
        return picture(tmp_path, name, body, **values) - dark

    return light


def test_sunlight_is_added_in_its_colour_and_in_proportion_to_the_albedo(added):
    full, half = added("full"), added("half", albedo=0.4)
    assert full[..., 0].max() > 0.01
    assert np.allclose(full[..., 1], full[..., 0] / 2, atol=1e-5)
    assert np.allclose(full[..., 2], full[..., 0] / 4, atol=1e-5)
    assert np.allclose(full, 2 * half, atol=1e-5)
    assert not added("off", albedo=0).any()


def test_no_light_of_a_sun_from_the_front_is_above_the_closed_form(added):
    """Of a wall of any thickness: E albedo / 8 pi."""
    most = 6 * 0.8 / (8 * math.pi)
    assert 0.05 * most < added("full").max() <= 1.1 * most


def test_an_invisible_sun_adds_nothing_and_anisotropy_turns_its_light_away(added):
    invisible = SUN.replace("float", 'token visibility = "invisible"\n        float', 1)
    assert not added("out", invisible).any()
    forward = added("forward", more="float usdSmoke:anisotropy = 0.5")
    share = (1 - 0.25) / 1.5**3  # of the phase function straight back, to that of all sides
    assert np.allclose(forward, share * added("full"), atol=1e-4)


def test_lights_that_a_look_records_take_the_place_of_the_stage_s(added):
    named = "float3[] usdSmoke:lights = [(0, -1, 0), (6, 3, 1.5)]"
    assert np.allclose(added("own", body="", more=named), added("full"), atol=1e-6)
    assert np.allclose(added("both", more=named), added("full"), atol=1e-6)


def test_bounces_that_a_look_records_brighten_its_smoke(added):
    many, once = added("many", more="bool usdSmoke:bounces = true"), added("once")
    assert (many >= once - 1e-6).all()
    assert 1.02 * once.sum() < many.sum() < 3 * once.sum()


def test_a_png_is_drawn_at_the_look_s_exposure_and_an_exr_without(tmp_path):
    plain = picture(tmp_path, "plain", "")
    exposed = picture(tmp_path, "exposed", "", more="float usdSmoke:exposure = -20")
    assert np.allclose(plain, exposed)
    brightest = []
    for name in ("plain", "exposed"):
        stage, target = tmp_path / f"{name}.usda", tmp_path / f"{name}.png"
        preview(stage, target, frames="2", width=24, background="black")
        with Image.open(target) as shown:
            brightest.append(np.asarray(shown.convert("L"))[-24:].max())
    assert brightest[1] < 30 < brightest[0]

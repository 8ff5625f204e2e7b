"""The colour step under light: what it paints, what hides the light, and what stays as it was."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fixtures.camera_fixtures import looking
from tests.fixtures.smoke_fixtures import frame_of, puff, smoke_of
from tests.fixtures.stylize_fixtures import quick_config, run_core, scene_of
from usdsmoke.base.volume import CameraSource, DenseField, LightSource, Scattering, VolumeFrame
from usdsmoke.config.look_sections import MOST_STOPS
from usdsmoke.config.settings import Config
from usdsmoke.core.sequence.frame_state import make_context, open_frame
from usdsmoke.core.sequence.stylize import StylizedFrame
from usdsmoke.core.steps.light_share import white_exposure
from usdsmoke.core.views.cameras import orbit_view
from usdsmoke.core.views.lighting import light_smoke, lit_emission
from usdsmoke.runs.budget.findings import find_frame

SUN = LightSource("/sun", (9.0, 9.0, 9.0), (0.0, 0.6, 0.8))
STYLE = np.full((24, 24, 3), 0.5, np.float32)
COLOUR = {
    "optimize": {"steps": ["colour"]},
    "colour": {"iterations": [30], "learning_rate": 0.1},
    "features": {"layers": ["learned0"]},
}


HALF = Config(optics={"albedo": 0.5})


def stylized(frame: VolumeFrame, **optics: object) -> StylizedFrame:
    config = quick_config(**COLOUR, optics=optics)
    (result,) = run_core([frame], config, styles=[STYLE], scene=scene_of([frame], config))
    return result


def painted(frame: VolumeFrame, albedo: float) -> np.ndarray:
    return stylized(frame, albedo=albedo).emission.values


def in_light(brightness: float) -> VolumeFrame:
    light = replace(SUN, colour=(brightness,) * 3)
    return replace(frame_of(puff(12)), lights=(light,))


def test_smoke_in_light_glows_less_where_the_light_comes_from() -> None:
    frame = frame_of(puff(14))
    dark, lit = painted(frame, 0.9), painted(replace(frame, lights=(SUN,)), 0.9)
    assert 0 < lit.sum() < 0.9 * dark.sum()
    sides = (slice(7, 14), slice(7))
    near, far = (lit[:, :, side].sum() / dark[:, :, side].sum() for side in sides)
    assert near < far  # the sun is at +k


def test_light_on_smoke_that_scatters_none_changes_no_bit() -> None:
    frame = frame_of(puff(10))
    lit = replace(frame, lights=(SUN,))
    assert (painted(frame, 0.0) == painted(lit, 0.0)).all()
    assert (painted(frame, 0.9) == painted(frame, 0.0)).all()


def test_smoke_that_its_light_makes_bright_is_no_dark_area() -> None:
    """However little emission is left for it."""
    frame = replace(frame_of(puff(12)), lights=(LightSource("/sky", (30.0, 30.0, 30.0)),))
    before, after = (lifted(frame, lift) for lift in (0.0, 0.9))
    assert 0 < before.max() < 0.02  # a dark colour
    assert after == pytest.approx(before, abs=1e-5)


def lifted(frame: VolumeFrame, lift: float) -> np.ndarray:
    colour = {**COLOUR["colour"], "occlusion": 0.0, "lift": lift}
    config = quick_config(**{**COLOUR, "colour": colour})
    (result,) = run_core([frame], config, styles=[STYLE], scene=scene_of([frame], config))
    return result.emission.values


def test_smoke_in_light_scatters_a_tenth_of_it_by_default() -> None:
    assert (painted(in_light(9.0), 0.1) == stylized(in_light(9.0)).emission.values).all()


def test_an_exposure_stands_for_brighter_lights_and_dims_what_is_written() -> None:
    bright, dim = stylized(in_light(8.0)), stylized(in_light(2.0), exposure=2.0)
    assert (dim.emission.values == bright.emission.values / 4).all()
    assert dim.report.light.advised == bright.report.light.advised + 2


@pytest.mark.parametrize(("brightness", "told"), [(0.01, "visible"), (5.0, ""), (1e5, "white")])
def test_light_that_vanishes_or_clips_is_told_with_the_exposure_that_mends_it(
    brightness: float, told: str
) -> None:
    found = stylized(in_light(brightness), albedo=0.5).report
    findings = list(find_frame("a.vdb", found, HALF))
    if not told:
        assert not any("exposure" in finding.setting for finding in findings)
        return
    (finding,) = (f for f in findings if f.setting == "optics.exposure")
    assert told in finding.cause
    mended = stylized(in_light(brightness), albedo=0.5, exposure=found.light.advised).report
    assert not any(f.setting == "optics.exposure" for f in find_frame("a.vdb", mended, HALF))
    assert 0.02 < mended.light.share < 1 and mended.light.outshone < 0.02


def test_dim_light_that_no_one_asks_for_may_be_invisible() -> None:
    found = stylized(in_light(0.01)).report
    assert found.light.share < 0.02
    assert not any("exposure" in f.setting for f in find_frame("a.vdb", found, Config()))


@pytest.mark.parametrize("brightness", [1e-14, 1e14])
def test_no_exposure_out_of_its_limits_is_advised(brightness: float) -> None:
    found = stylized(in_light(brightness), albedo=0.5).report
    (finding,) = (f for f in find_frame("a.vdb", found, HALF) if f.setting == "optics.exposure")
    assert "optics.exposure" not in finding.remedy and "brightness" in finding.remedy


SKY = LightSource("/sky", (1.5, 1.5, 1.5))
DIM_SKY = LightSource("/sky", (1e-14, 0.0, 0.0))


def targeted(target: str, *lights: LightSource, style: np.ndarray = STYLE) -> StylizedFrame:
    frame = replace(frame_of(puff(12)), lights=lights)
    config = quick_config(**{**COLOUR, "colour": {**COLOUR["colour"], "target": target}})
    (result,) = run_core([frame], config, styles=[style], scene=scene_of([frame], config))
    return result


def per_extinction(result: StylizedFrame, field: DenseField) -> np.ndarray:
    smoke = result.density.values > 0
    gamma_w = scene_of([frame_of(puff(12))], quick_config()).gamma_w
    return field.values[smoke] / (gamma_w * result.density.values[smoke])[:, None]


def test_a_painted_albedo_is_a_share_and_takes_the_colour_of_the_style() -> None:
    red = np.broadcast_to(np.float32([0.7, 0.2, 0.2]), (24, 24, 3)).copy()
    found = targeted("albedo", SKY, style=red)
    assert found.emission is None
    albedo = per_extinction(found, found.scattering)
    assert albedo.min() >= 0 and albedo.max() <= 1 + 1e-6
    assert albedo[:, 0].mean() > 2 * albedo[:, 1:].mean()
    assert found.report.light.share == 1 and found.report.light.outshone == 0


@pytest.mark.parametrize(("light", "named"), [((1.0, 0.0, 0.0), True), ((1.0, 0.9, 0.7), False)])
def test_light_that_lacks_a_colour_of_the_style_is_told(light, named: bool) -> None:
    result = targeted("albedo", replace(SKY, colour=light))
    found = [f for f in find_frame("a.vdb", result.report, Config()) if "faintest" in f.cause]
    assert [f.setting for f in found] == ["colour.target"] * named
    assert result.report.light.faintest == pytest.approx(min(light) / max(light), abs=1e-3)


def test_smoke_that_no_light_reaches_is_told() -> None:
    """Only the back of thick smoke is painted, and the sun is in front."""
    frame = frame_of(puff(12))
    share = np.zeros((12, 12, 12), np.float32)
    share[3:9, 3:9, :2] = 1
    mask = DenseField("mask", share, frame.density.ijk_min, frame.density.index_to_world)
    sun = replace(SUN, towards=(0.0, 0.0, 1.0))
    config = quick_config(
        **{**COLOUR, "colour": {**COLOUR["colour"], "target": "albedo", "iterations": [2]}},
        optics={"gamma": 1e4, "exposure": 0.0},
    )
    frame = replace(frame, lights=(sun,), mask=mask, mask_to_stage=frame.density_to_stage)
    (result,) = run_core([frame], config, styles=[STYLE], scene=scene_of([frame], config))
    (finding,) = (
        f for f in find_frame("a.vdb", result.report, Config()) if f.setting == "optics.exposure"
    )
    assert "none" in finding.cause and "optics.exposure=" not in finding.remedy


def test_a_chosen_exposure_is_within_the_limits_of_the_setting() -> None:
    config = quick_config(colour={"target": "albedo"})
    frame = replace(frame_of(puff(12)), lights=(DIM_SKY,))
    assert white_exposure([frame], config, scene_of([frame], config)) == MOST_STOPS


def test_a_chosen_exposure_is_of_what_the_camera_sees() -> None:
    """Forward scattering: smoke is bright against the sun, and dark from where the sun is."""
    config = quick_config(
        colour={"target": "albedo"}, optics={"anisotropy": 0.6}, views={"camera": "/camera"}
    )
    frame = replace(frame_of(puff(12)), lights=(replace(SUN, towards=(0.0, 0.0, 1.0)),))
    scene = scene_of([frame], config)
    with_sun, against = (
        white_exposure([replace(frame, camera=looking((6, 6, z), (6, 6, 6)))], config, scene)
        for z in (60, -48)
    )
    assert with_sun > against + 3


def test_light_alone_is_drawn_where_a_frame_has_no_emission() -> None:
    frame = frame_of(puff(12))
    density = replace(frame.density, ijk_min=(900, 900, 900))
    empty = DenseField(
        "emission", np.zeros((0, 0, 0, 3), np.float32), (0, 0, 0), np.eye(4), (0.0, 0.0, 0.0)
    )
    view = orbit_view(0.0, 0.0, "Y", np.full(3, 906.0), 16, 16, 1.0)
    scattering = Scattering((SUN,), 0.5)
    found = lit_emission(density, (empty, None), np.eye(4), 1.0, scattering, view)
    alone = lit_emission(density, (None, None), np.eye(4), 1.0, scattering, view)
    assert found.ijk_min == density.ijk_min and found.values.shape[:3] == density.values.shape
    assert found.values.max() > 0 and np.array_equal(found.values, alone.values)


def test_with_both_what_light_cannot_give_is_emitted_and_the_picture_needs_no_light() -> None:
    found, plain = targeted("both", SKY, SUN), targeted("emission")
    colours = per_extinction(plain, plain.emission)
    emitted, albedo = (per_extinction(found, f) for f in (found.emission, found.scattering))
    assert 0 <= albedo.min() and albedo.max() <= 0.5 + 1e-6
    assert (emitted >= 0).all() and (emitted <= colours + 1e-6).all()
    assert emitted.sum() < 0.95 * colours.sum()
    glows = emitted > 1e-4
    assert np.allclose(albedo[glows], 0.5, atol=1e-5)  # all of the light is scattered first
    smoke = smoke_of(puff(12))
    scene = scene_of([frame_of(puff(12))], quick_config())
    lighting = light_smoke(smoke, scene.gamma_w, Scattering((SKY, SUN), 1.0))
    light = lighting.on(smoke.positions).scattered(np.array([0.0, 0.0, -1.0])).numpy()
    place = np.argwhere(found.density.values > 0)
    assert (place == smoke.ijk.numpy()).all()
    assert np.allclose(emitted + albedo * light, colours, atol=1e-5)


@pytest.mark.parametrize("hidden", [False, True])
def test_smoke_that_the_camera_does_not_see_casts_its_shadow(hidden: bool) -> None:
    density = np.zeros((12, 12, 60), np.float32)
    density[:, :, :12] = puff(12)
    if hidden:
        density[:, :, 48:] = 5 * puff(12)
    place = np.eye(4)
    place[:3, :3] = [[0, 0, -1], [0, 1, 0], [1, 0, 0]]  # looks along -i, from +i
    place[3, :3] = [100.0, 5.5, 5.5]
    camera = CameraSource("/cam", place, 100.0, 20.0, 20.0, 0.0, 0.0, (0.1, 1e4), False)
    sun = replace(SUN, towards=(0.0, 0.0, 1.0))
    frame = replace(frame_of(density), camera=camera, lights=(sun,))
    config = quick_config(**COLOUR, optics={"albedo": 0.9, "gamma": 0.4}, views={"camera": "/cam"})
    context = make_context([STYLE], scene_of([frame], config), config, None, 24.0, None, 1)
    opened = open_frame(frame, context)
    assert int(opened.smoke.ijk[:, 2].max()) < 20  # the camera sees the near puff alone
    light = opened.lighting().on(opened.smoke.positions).scattered(np.array([-1.0, 0.0, 0.0]))
    middle = float(light[((opened.smoke.ijk - 5).abs() <= 1).all(1)].mean())
    assert (middle < 0.02) is hidden


def test_smoke_around_the_eye_itself_is_lit() -> None:
    density = replace(frame_of(puff(12)).density, ijk_min=(900, 900, 900))
    scattering = Scattering((SUN,), 0.5, anisotropy=0.5)
    for eye in (906.0, 906.001):  # a voxel's centre, and beside it
        view = replace(orbit_view(0.0, 0.0, "Y", np.full(3, eye), 16, 16, 1.0), focal=16.0)
        found = lit_emission(density, (None, None), np.eye(4), 1.0, scattering, view)
        assert np.isfinite(found.values).all() and found.values.max() > 0

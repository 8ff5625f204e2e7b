"""The stage's lights: what is read, what is left out by name, and what a look says of them."""

import math

import numpy as np
import pytest
from pxr import UsdGeom, UsdLux

from tests.fixtures.usd_fixtures import (
    density_prim,
    finish_frame,
    needs_usd,
    sequence,
    volume_prim,
    world,
    write_sequence,
    write_text,
)
from usdsmoke.base.errors import ConfigError
from usdsmoke.base.record_format import RECORD_FORMAT, RunRecord
from usdsmoke.config.look_sections import OpticsConfig
from usdsmoke.config.run_sections import LayerConfig, StageConfig
from usdsmoke.usd.inspect import inspect
from usdsmoke.usd.look import StylizedVolume, author_look
from usdsmoke.usd.stage import composed_volumes, find_volumes, lit_by, open_stage

SUN = 'def DistantLight "sun" {\n%s\n}'
RECORD = RunRecord(RECORD_FORMAT, "3f2b8c1e-0a4d-4c57-9d0e-5b7a1f6c2d34", "1")


def shot(tmp_path, *lights):
    write_sequence(tmp_path, (1, 2, 3))
    body = volume_prim(density_prim(sequence((1, 2, 3)))) + "\n".join(lights)
    return write_text(tmp_path / "shot.usda", world(body))


SCATTERS = OpticsConfig()


def lit(tmp_path, *lights, optics=SCATTERS):
    stage = open_stage(shot(tmp_path, *lights))
    return lit_by(stage, find_volumes(stage, StageConfig()), [optics])


def only_light(tmp_path, *lights):
    (light,) = lit(tmp_path, *lights).volumes[0].frames[0].lights
    return light


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ("", 50000 * math.pi * math.sin(math.radians(0.53 / 2)) ** 2),
        ("float inputs:intensity = 3\nbool inputs:normalize = 1", 3),
        ("float inputs:intensity = 3\nfloat inputs:angle = 0\nfloat inputs:exposure = -1", 1.5),
        ("float inputs:intensity = 2\nfloat inputs:angle = 180", 2 * math.pi),
        ("float inputs:intensity = 2\nfloat inputs:angle = 240", 2.5 * math.pi),
        ("float inputs:intensity = 2\nfloat inputs:angle = 999", 4 * math.pi),
    ],
)
def test_the_irradiance_of_a_distant_light_follows_usdlux(tmp_path, values, expected):
    light = only_light(tmp_path, SUN % values)
    assert light.colour == pytest.approx((expected,) * 3, rel=1e-5)
    assert light.towards == (0.0, 0.0, 1.0)  # it shines along its -Z


def test_colour_temperature_and_direction_come_from_the_composed_stage(tmp_path):
    warm = """color3f inputs:color = (1, 0.5, 0.25)
        bool inputs:normalize = 1
        float inputs:intensity = 2
        bool inputs:enableColorTemperature = 1
        float inputs:colorTemperature = 3000"""
    turned = f"""def Xform "rig"
    {{
        float3 xformOp:scale = (1, 1, 9)
        float xformOp:rotateX = -90
        uniform token[] xformOpOrder = ["xformOp:rotateX", "xformOp:scale"]
        {SUN % warm}
    }}"""
    light = only_light(tmp_path, turned)
    temperature = np.array(UsdLux.BlackbodyTemperatureAsRgb(3000))
    assert light.colour == pytest.approx(tuple(2 * temperature * [1, 0.5, 0.25]))
    assert light.towards == pytest.approx((0, 1, 0), abs=1e-6)
    assert light.prim_path == "/World/rig/sun"


def test_a_light_may_be_animated_and_go_out(tmp_path):
    values = """float inputs:intensity.timeSamples = { 1: 1, 3: 5 }
        bool inputs:normalize = 1
        token visibility.timeSamples = { 1: "inherited", 3: "invisible" }"""
    frames = lit(tmp_path, SUN % values).volumes[0].frames
    found = [[light.colour[0] for light in frame.lights] for frame in frames]
    assert found == [[1.0], [3.0], []]


def test_direction_and_temperature_are_those_of_the_frame(tmp_path):
    values = """bool inputs:normalize = 1
        float inputs:intensity = 1
        bool inputs:enableColorTemperature = 1
        float inputs:colorTemperature = 6500
        float inputs:colorTemperature.timeSamples = { 1: 2000, 3: 9000 }
        float xformOp:rotateY = 10
        float xformOp:rotateY.timeSamples = { 1: 0, 3: 90 }
        uniform token[] xformOpOrder = ["xformOp:rotateY"]"""
    frames = lit(tmp_path, SUN % values).volumes[0].frames
    lights = [frame.lights[0] for frame in frames]
    half = math.sqrt(0.5)
    for light, towards in zip(lights, [(0, 0, 1), (half, 0, half), (1, 0, 0)], strict=True):
        assert light.towards == pytest.approx(towards, abs=1e-6)
    for light, kelvin in zip(lights, [2000, 5500, 9000], strict=True):
        assert light.colour == pytest.approx(tuple(UsdLux.BlackbodyTemperatureAsRgb(kelvin)))


def test_a_light_that_cannot_be_used_at_some_frames_is_named_with_them(tmp_path):
    values = "float inputs:intensity.timeSamples = { 1: 1, 2: -3, 3: 5 }"
    source = lit(tmp_path, SUN % values)
    assert source.unused_lights["/World/sun"].endswith("at timeCode 2")
    assert [len(frame.lights) for frame in source.volumes[0].frames] == [1, 0, 1]


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ("bool inputs:shadow:enable = 0", True),
        ("float inputs:shadow:distance = 3", True),
        ("color3f inputs:shadow:color = (0.1, 0, 0)", True),
        ("bool inputs:shadow:enable = 1", False),
    ],
)
def test_shadows_that_are_cast_all_the_same_are_told(tmp_path, value, told):
    light = SUN.replace('"sun" {', '"sun" (\nprepend apiSchemas = ["ShadowAPI"]\n) {') % value
    notes = [note for note in lit(tmp_path, light).volumes[0].notes if "/World/sun" in note]
    assert bool(notes) is told and all(value.split()[1] in note for note in notes)


@pytest.mark.parametrize("kind", ["DomeLight", "DomeLight_1"])
def test_both_kinds_of_dome_are_read(tmp_path, kind):
    values = "float inputs:intensity = 2"
    assert only_light(tmp_path, f'def {kind} "sky" {{\n{values}\n}}').colour == (2, 2, 2)
    texture = f'def {kind} "hdr" {{\nasset inputs:texture:file = @a.exr@\n}}'
    assert "texture" in lit(tmp_path, texture).unused_lights["/World/hdr"]


def test_a_dome_gives_its_radiance_and_what_cannot_be_used_is_named(tmp_path):
    source = lit(
        tmp_path,
        'def DomeLight "sky" {\ncolor3f inputs:color = (0.1, 0.2, 0.4)\n'
        "float inputs:exposure = 1\n}",
        'def DomeLight "hdr" {\nasset inputs:texture:file = @sky.exr@\n}',
        'def SphereLight "lamp" { }',
        'def DistantLight "off" {\nfloat inputs:intensity = 0\n}',
    )
    (light,) = source.volumes[0].frames[0].lights
    assert light.colour == pytest.approx((0.2, 0.4, 0.8)) and light.towards is None
    assert source.unused_lights.keys() == {"/World/hdr", "/World/lamp"}
    assert "texture" in source.unused_lights["/World/hdr"]
    assert "SphereLight" in source.unused_lights["/World/lamp"]
    assert len(source.lights) == 4


def test_light_linking_decides_which_volume_is_lit(tmp_path):
    elsewhere = """rel collection:lightLink:includes = </World/other>
        uniform bool collection:lightLink:includeRoot = 0"""
    assert lit(tmp_path, SUN % elsewhere).volumes[0].frames[0].lights == ()


def test_smoke_that_scatters_nothing_has_no_lights(tmp_path):
    source = lit(tmp_path, SUN % "", 'def SphereLight "lamp" { }', optics=None)
    assert not any(frame.lights for frame in source.volumes[0].frames)
    assert source.lights == ("/World/sun", "/World/lamp") and source.unused_lights == {}


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ("float inputs:intensity = -1", "emits"),
        ("float inputs:exposure = 3000", "emits"),
        ("float inputs:exposure = 200", "emits"),  # more than single precision holds
        ("float inputs:intensity = inf", "inputs:intensity"),
        ("float inputs:angle = nan", "inputs:angle"),
        ("float inputs:exposure = nan", "inputs:exposure"),
        ('string inputs:intensity = "bright"', "inputs:intensity"),
        ("float inputs:color = 2", "inputs:color"),
        (
            "bool inputs:enableColorTemperature = 1\nfloat inputs:colorTemperature = nan",
            "inputs:colorTemperature",
        ),
    ],
)
def test_light_that_is_no_light_is_left_out_by_its_path(tmp_path, values, said):
    source = lit(tmp_path, SUN % values)
    assert said in source.unused_lights["/World/sun"]
    assert source.volumes[0].frames[0].lights == ()


@pytest.mark.parametrize(
    "settings",
    [
        {"sun": [0.0, 0.0, 1.0], "sun_colour": [1e300, 0.0, 0.0]},
        {"sky": [0.0, 1e13, 0.0]},
    ],
)
def test_light_of_the_settings_that_cannot_be_computed_is_refused_by_its_name(tmp_path, settings):
    with pytest.raises(ConfigError, match=r"optics\.(sun_colour|sky) is"):
        lit(tmp_path, optics=OpticsConfig(**settings))


def test_a_light_that_is_off_is_off_at_any_exposure(tmp_path):
    source = lit(tmp_path, SUN % "float inputs:intensity = 0\nfloat inputs:exposure = 3000")
    assert source.unused_lights == {} and source.volumes[0].frames[0].lights == ()


def test_lights_of_the_settings_take_the_place_of_the_stage_s(tmp_path):
    optics = OpticsConfig(sun=[0.0, 0.0, 4.0], sun_colour=[3.0, 2.0, 1.0], sky=[0.1, 0.2, 0.3])
    source = lit(tmp_path, SUN % "", optics=optics)
    sun, sky = source.volumes[0].frames[-1].lights
    assert (sun.towards, sun.colour) == ((0, 0, 1), (3, 2, 1))
    assert (sky.towards, sky.colour) == (None, (0.1, 0.2, 0.3))
    assert source.lights == ("/World/sun",)
    with pytest.raises(ConfigError, match=r"optics\.sun"):
        lit(tmp_path, optics=OpticsConfig(sun=[0.0, 0.0, 0.0]))


def test_inspect_lists_the_lights_of_a_volume(tmp_path):
    found = inspect(shot(tmp_path, SUN % "", 'def RectLight "panel" { }'))
    (light,) = found["volumes"][0]["lights"]
    assert light["prim_path"] == "/World/sun" and light["type"] == "distant"
    assert any("</World/panel>" in note for note in found["notes"])


@needs_usd(26, 3)
@pytest.mark.parametrize("albedo", [0.0, 0.75])
def test_a_lit_look_says_so_and_its_material_scatters_as_much(tmp_path, albedo):
    path = shot(tmp_path, SUN % "bool inputs:normalize = 1\nfloat inputs:intensity = 2")
    stage = open_stage(path)
    source = find_volumes(stage, StageConfig())
    frame = finish_frame(tmp_path / "out/vdb/smoke.0002.vdb", 2.0, False, ("density", "emission"))
    result = StylizedVolume(
        source.volumes[0], [frame], 0.5, albedo=albedo, anisotropy=0.3 if albedo else 0.0
    )
    config = LayerConfig(material_targets=["glslfx", "mtlx", "arnold", "karma"])
    files = author_look(stage, source, [result], tmp_path / "out", config, RECORD)
    root = open_stage(files.root_stage)
    prim = root.GetPrimAtPath("/World/smoke")
    said = prim.GetAttribute("usdSmoke:albedo")
    assert bool(said and said.HasAuthoredValue()) is (albedo > 0)
    material = root.GetPrimAtPath("/World/smoke/look_material")
    found = {child.GetName(): child for child in material.GetChildren()}
    assert found["glslfx_volume"].GetAttribute("inputs:albedo").Get(2) == albedo
    assert found["arnold_volume"].GetAttribute("inputs:scatter").Get(2) == albedo
    for name, attribute in (
        ("mtlx_vdf", "anisotropy"),
        ("kma_volume", "anisotropy"),
        ("arnold_volume", "scatter_anisotropy"),
    ):
        uneven = found[name].GetAttribute(f"inputs:{attribute}")
        assert bool(uneven) is (albedo > 0)
        assert not uneven or uneven.Get() == pytest.approx(0.3)
    absorbed = found["mtlx_absorption_rate"].GetAttribute("inputs:in2").Get(2)
    assert absorbed == pytest.approx(0.5 * (1 - albedo) / UsdGeom.GetStageMetersPerUnit(stage))
    (shown,) = composed_volumes(root, source, 2)
    if albedo:
        assert (shown.scattering.albedo, shown.scattering.lights[0].colour[0]) == (0.75, 2.0)
        assert shown.scattering.is_uneven
    else:
        assert shown.scattering is None


@needs_usd(26, 3)
@pytest.mark.parametrize("emits", [False, True])
def test_a_field_of_albedos_is_connected_in_every_renderer(tmp_path, emits):
    stage = open_stage(shot(tmp_path, SUN % "bool inputs:normalize = 1"))
    source = find_volumes(stage, StageConfig())
    names = ("density", "emission", "Cd") if emits else ("density", "Cd")
    frame = finish_frame(tmp_path / "out/vdb/smoke.0002.vdb", 2.0, False, names)
    result = StylizedVolume(
        source.volumes[0],
        [frame],
        0.5,
        {name: name for name in names},
        albedo=0.9,
        scatter_field="Cd",
    )
    config = LayerConfig(material_targets=["glslfx", "mtlx", "arnold", "karma", "renderman"])
    files = author_look(stage, source, [result], tmp_path / "out", config, RECORD)
    root = open_stage(files.root_stage)
    material = root.GetPrimAtPath("/World/smoke/look_material")
    found = {child.GetName(): child for child in material.GetChildren()}

    def behind(name, attribute):
        """The shader that an input comes from."""
        (path,) = found[name].GetAttribute(f"inputs:{attribute}").GetConnections()
        return root.GetPrimAtPath(path.GetPrimPath())

    assert found["glslfx_volume"].GetAttribute("inputs:albedo").Get(2) == 1  # of the field's colour
    assert behind("glslfx_volume", "scatter").GetAttribute("inputs:fieldname").Get() == "Cd"
    arnold = {name: found["arnold_volume"].GetAttribute(f"inputs:{name}").Get() for name in (
        "scatter_color_channel", "scatter_color", "emission_mode")}  # fmt: skip
    assert arnold["scatter_color_channel"] == "Cd" and arnold["scatter_color"] == (1, 1, 1)
    assert arnold["emission_mode"] == ("channel" if emits else "none")
    for context in ("mtlx", "kma"):
        volume = "mtlx_vdf" if context == "mtlx" else "kma_volume"
        rate = behind(volume, "scattering")
        assert rate.GetAttribute("info:id").Get() == "ND_multiply_vector3FA"
        rest = behind(volume, "absorption")
        assert rest.GetAttribute("info:id").Get() == "ND_subtract_vector3"
        assert behind(rest.GetName(), "in2") == rate
        colour = behind(behind(rate.GetName(), "in1").GetName(), "in")
        assert colour.GetAttribute("inputs:geomprop").Get() == "Cd"
    diffuse = behind("ri_volume", "diffuseColor")
    assert behind(diffuse.GetName(), "inputRGB").GetAttribute("inputs:varname").Get() == "Cd"
    glows = [
        found["mtlx_volume"].GetAttribute("inputs:edf"),
        found["kma_volume"].GetAttribute("inputs:emission"),
        found["arnold_volume"].GetAttribute("inputs:emission_channel"),
        found["ri_volume"].GetAttribute("inputs:emitColor"),
        found["glslfx_volume"].GetAttribute("inputs:emission"),
    ]
    assert [bool(attribute) for attribute in glows] == [emits] * 5
    (shown,) = composed_volumes(root, source, 2)
    assert shown.colour is not None and shown.scattering.albedo == 1

"""Which renderers do not show a look with a material of the source, by their own shaders."""

import pytest
from pxr import Usd

from usdsmoke.usd.materials import (
    brightness_words,
    find_materials,
    hiding_words,
    opacity_words,
)

STAGE = """#usda 1.0
def Volume "smoke" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    rel material:binding = </theirs>
}
def Material "theirs"
{
    SHADERS
}
"""
STORM = """token outputs:glslfx:volume.connect = </theirs/storm.outputs:out>
        def Shader "storm"
        {
            uniform token info:implementationSource = "sourceAsset"
            uniform asset info:glslfx:sourceAsset = @./theirs.glslfx@
            %s
            token outputs:out
        }
        def Shader "reader"
        {
            uniform token info:id = "HwFieldReader_float3"
            token inputs:fieldname = "%s"
            float3 outputs:result
        }"""
READS = "float3 inputs:glow.connect = </theirs/reader.outputs:result>"
ARNOLD = """token outputs:arnold:volume.connect = </theirs/arnold.outputs:out>
        def Shader "arnold"
        {
            uniform token info:id = "arnold:standard_volume"
            %s
            token outputs:out
        }"""
CHANNEL = 'string inputs:emission_channel = "emission"'


@pytest.mark.parametrize(("shaders", "hidden"), [
    ((STORM % (READS, "density"), ARNOLD % CHANNEL), ["glslfx"]),
    ((STORM % (READS, "emission"), ARNOLD % ""), ["arnold"]),
    ((STORM % (READS, "emission"), ARNOLD % CHANNEL), []),
    ((STORM % (READS, "density"), ARNOLD % ""), ["glslfx", "arnold"]),
    # a number in Storm, whatever its name
    ((STORM % ("float3 inputs:emission = (1, 1, 1)", "emission"), ARNOLD % CHANNEL), ["glslfx"]),
    # the usual form of look development: a channel that the material offers
    (('string inputs:grid = "emission"',
      ARNOLD % "string inputs:emission_channel.connect = </theirs.inputs:grid>"), []),
    ((ARNOLD % 'string inputs:aov_name = "emission"',), ["arnold"]),
    ((ARNOLD % (CHANNEL + '\nstring inputs:emission_mode = "none"'),), ["arnold"]),
    ((ARNOLD % (CHANNEL + "\nfloat inputs:emission = 0"),), ["arnold"]),
])  # fmt: skip
def test_each_renderer_whose_own_shader_hides_the_look_is_named(shaders, hidden):
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(STAGE.replace("SHADERS", "\n".join(shaders)))
    (found,) = find_materials(stage.GetPrimAtPath("/smoke"))
    assert sorted(found.hidden_in(["emission"])) == sorted(hidden)
    if hidden == ["glslfx"]:
        what, renderers = hiding_words(found, ["emission"])
        assert "outputs:glslfx:volume" in what and "arnold" not in what and renderers == "Storm"


@pytest.mark.parametrize(("mode", "is_told"), [
    ("", False), ('\nstring inputs:emission_mode = "channel"', False),
    ('\nstring inputs:emission_mode = "density"', True),
])  # fmt: skip
def test_a_shader_that_multiplies_emission_by_density_is_told_for_absolute_emission(mode, is_told):
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(STAGE.replace("SHADERS", ARNOLD % (CHANNEL + mode)))
    (found,) = find_materials(stage.GetPrimAtPath("/smoke"))
    told = brightness_words(found, "absolute")
    assert bool(told) == is_told and (not told or "Arnold" in told)
    assert not brightness_words(found, "perDensity")


@pytest.mark.parametrize(("density", "is_told"), [
    ("", True), ("\nfloat inputs:density = 6.7", True), ("\nfloat inputs:density = 60", False),
    ("\nfloat inputs:density.connect = </theirs.inputs:number>", False),
    ("\nfloat inputs:density.connect = </theirs/driver.outputs:out>", False),
])  # fmt: skip
def test_a_shader_that_multiplies_density_by_a_number_far_from_the_look_s_is_told(density, is_told):
    stage = Usd.Stage.CreateInMemory()
    driver = 'float inputs:number = 67\ndef Shader "driver" {\nfloat outputs:out\n}\n'
    shaders = driver + ARNOLD % (CHANNEL + density)
    stage.GetRootLayer().ImportFromString(STAGE.replace("SHADERS", shaders))
    (found,) = find_materials(stage.GetPrimAtPath("/smoke"))
    told = opacity_words(found, 67.6)
    assert bool(told) == is_told and (not told or "67.6" in told)
    assert not opacity_words(found, found.densities.get("arnold", 1.0))

"""The material of a look: what it holds, what it takes the place of, and what hides a look."""

import pytest
from pxr import Sdf, Usd, UsdShade

from tests.fixtures.preview_fixtures import referenced
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
from usdsmoke.base.record_format import RECORD_FORMAT, RunRecord
from usdsmoke.base.volume import EarlierLooks
from usdsmoke.config.run_sections import LayerConfig, StageConfig
from usdsmoke.usd.gate import validate_look
from usdsmoke.usd.look import StylizedVolume, author_look
from usdsmoke.usd.rules import validate
from usdsmoke.usd.stage import composed_volumes, find_volumes, open_stage

RECORD = RunRecord(RECORD_FORMAT, "3f2b8c1e-0a4d-4c57-9d0e-5b7a1f6c2d34", "1")
SMOKE, OURS = "/World/smoke", "/World/smoke/look_material"
GRIDS = ("density", "emission")
BOUND = "rel material:binding = </World/theirs>\n"
API = 'prepend apiSchemas = ["MaterialBindingAPI"]'


def material(reads="density", terminal="volume", name="theirs"):
    """A material whose shader reads one field."""
    return f"""def Material "{name}"
    {{
        token outputs:{terminal}.connect = </World/{name}/volume.outputs:out>
        def Shader "volume"
        {{
            uniform token info:id = "SomeVolume"
            float inputs:density.connect = </World/{name}/reader.outputs:result>
            token outputs:out
        }}
        def Shader "reader"
        {{
            uniform token info:id = "HwFieldReader_float"
            token inputs:fieldname = "{reads}"
            float outputs:result
        }}
    }}
    """


def shot(folder, theirs="", binding="", header="", codes=(1, 2)):
    """A stage of one Volume, bound to a material or not."""
    write_sequence(folder, codes)
    volume = volume_prim(f"{binding}{density_prim(sequence(codes))}")
    if binding:
        volume = volume.replace('def Volume "smoke"', f'def Volume "smoke" (\n{API}\n)', 1)
    text = world(theirs + volume)
    return write_text(
        folder / "shot.usda", text.replace('def Xform "World"', header, 1) if header else text
    )


def look(stage_file, folder, extinctions=None, frames="", grids=GRIDS, earlier=None, **config):
    """Author a look of gamma_w 0.5; the files' voxels do not matter."""
    stage = open_stage(stage_file)
    source = find_volumes(stage, StageConfig(frames=frames))
    volume = source.volumes[0]
    written = [
        finish_frame(folder / f"vdb/s.{int(f.time_code):04d}.vdb", f.time_code, False, grids)
        for f in volume.frames
    ]
    result = StylizedVolume(
        volume, written, 0.5, {name: name for name in grids}, extinction_samples=extinctions or {}
    )
    return author_look(stage, source, [result], folder, LayerConfig(**config), RECORD, earlier)


def opened(stage_file):
    return Usd.Stage.Open(str(stage_file))


def bound(stage_file, purpose=""):
    """Path of the material that USD resolves for the Volume, by USD alone."""
    stage = opened(stage_file)
    binding = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(SMOKE))
    found, _ = binding.ComputeBoundMaterial(purpose)
    return str(found.GetPath()) if found else ""


def shader(stage, context):
    """The volume shader that a renderer of this context finds on the look's material."""
    return UsdShade.Material.Get(stage, OURS).ComputeVolumeSource(context)[0]


def values(source):
    return {item.GetBaseName(): item.Get() for item in source.GetInputs()}


@pytest.mark.parametrize("mode", ["sublayer", "reference", "layer"])
def test_a_volume_without_a_material_is_bound_to_one_that_reads_the_look(tmp_path, mode):
    files = look(shot(tmp_path), tmp_path / "out", mode=mode)
    root = files.root_stage
    if mode == "layer":  # composed as the user does it
        root = write_text(
            tmp_path / "mine.usda", "#usda 1.0\n(subLayers = [@out/look.usda@, @shot.usda@])\n"
        )
    assert bound(root) == bound(root, "full") == bound(root, "preview") == OURS
    stage = opened(root)
    storm = shader(stage, "glslfx")
    assert storm.GetImplementationSource() == "sourceAsset"
    assert storm.GetSourceAsset("glslfx").resolvedPath == str(tmp_path / "out/look.glslfx")
    found = values(storm)
    assert found["extinctionPerDensity"] == 0.5 and found["albedo"] == 0
    for name, kind in (("density", "float"), ("emission", "float3")):
        reader = storm.GetInput(name).GetConnectedSources()[0][0].source
        assert UsdShade.Shader(reader).GetShaderId() == f"HwFieldReader_{kind}"
        assert reader.GetInput("fieldname").Get() == name


def test_the_variant_without_a_look_has_no_material(tmp_path):
    root = look(shot(tmp_path), tmp_path / "out", mode="reference").root_stage
    stage = opened(root)
    world_prim = stage.GetPrimAtPath("/World")
    world_prim.GetVariantSet("look").SetVariantSelection("original")
    assert not stage.GetPrimAtPath(OURS)
    assert not UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(SMOKE)).ComputeBoundMaterial()[0]


def test_the_shader_gets_the_length_of_the_volumes_unit_on_the_stage(tmp_path):
    scaled = 'def Xform "World" {\ndouble3 xformOp:scale = (100, 100, 100)\n'
    scaled += 'uniform token[] xformOpOrder = ["xformOp:scale"]\n'
    source = shot(tmp_path)
    text = source.read_text().replace('def Xform "World"\n{', scaled, 1)
    assert "xformOp:scale" in text
    source.write_text(text)
    stage = opened(look(source, tmp_path / "out").root_stage)
    assert values(shader(stage, "glslfx"))["stageUnitsPerUnit"] == pytest.approx(100)


def test_materialx_counts_per_metre_with_the_types_of_its_node_definitions(tmp_path):
    source = shot(tmp_path)
    source.write_text(source.read_text().replace("metersPerUnit = 1", "metersPerUnit = 0.01", 1))
    unit = opened(source).GetMetadata("metersPerUnit")
    stage = opened(look(source, tmp_path / "out").root_stage)
    volume = shader(stage, "mtlx")
    assert volume.GetShaderId() == "ND_volume"
    vdf = UsdShade.Shader(volume.GetInput("vdf").GetConnectedSources()[0][0].source)
    edf = UsdShade.Shader(volume.GetInput("edf").GetConnectedSources()[0][0].source)
    assert (vdf.GetShaderId(), edf.GetShaderId()) == ("ND_absorption_vdf", "ND_uniform_edf")
    assert vdf.GetInput("absorption").GetTypeName() == Sdf.ValueTypeNames.Float3
    assert edf.GetInput("color").GetTypeName() == Sdf.ValueTypeNames.Color3f
    vector = vdf.GetInput("absorption").GetConnectedSources()[0][0].source
    rate = vector.GetInput("in").GetConnectedSources()[0][0].source
    assert rate.GetInput("in2").Get() == pytest.approx(0.5 / unit)
    light = edf.GetInput("color").GetConnectedSources()[0][0].source
    assert light.GetInput("in2").Get() == pytest.approx(1 / unit)


def test_only_the_targets_that_are_asked_for_are_written(tmp_path):
    files = look(shot(tmp_path), tmp_path / "out", material_targets=["arnold", "karma"])
    stage = opened(files.root_stage)
    outputs = {item.GetBaseName() for item in UsdShade.Material.Get(stage, OURS).GetOutputs()}
    assert outputs == {"arnold:volume", "kma:volume"}
    arnold = shader(stage, "arnold")
    assert arnold.GetShaderId() == "arnold:standard_volume"
    assert values(arnold) == {
        "density": 0.5, "density_channel": "density", "scatter": 0.0, "scatter_color": (1, 1, 1),
        "emission_mode": "channel", "emission": 1.0, "emission_channel": "emission",
    }  # fmt: skip
    karma = shader(stage, "kma")
    assert karma.GetShaderId() == "kma_volume"
    assert {item.GetBaseName() for item in karma.GetInputs()} == {"absorption", "emission"}
    assert files.shader is None and not list((tmp_path / "out").glob("*.glslfx"))


def test_renderman_multiplies_density_by_gamma_w(tmp_path):
    """After Pixar's documents: rendered nowhere."""
    files = look(shot(tmp_path), tmp_path / "out", material_targets=["renderman"])
    stage = opened(files.root_stage)
    volume = shader(stage, "ri")
    assert volume.GetShaderId() == "PxrVolume"

    def source_of(item, name):
        (found,), _ = item.GetInput(name).GetConnectedSources()
        return UsdShade.Shader(found.source.GetPrim())

    remap = source_of(volume, "densityFloat")
    authored = {name: value for name, value in values(remap).items() if value is not None}
    assert authored == {"outputMax": 0.5, "clampInput": 0, "clampOutput": 0}
    assert values(source_of(source_of(remap, "inputRGB"), "input"))["varname"] == "density"
    assert values(source_of(volume, "emitColor")) == {"varname": "emission", "type": "color"}
    assert values(source_of(volume, "diffuseColor"))["outputMax"] == 0


def test_frames_that_show_the_source_are_smoke_as_without_a_material(tmp_path):
    files = look(shot(tmp_path, codes=(1, 2, 3)), tmp_path / "out", {2.0: 0.25}, "2")
    stage = opened(files.root_stage)
    storm = shader(stage, "glslfx")
    for name, expected in (("extinctionPerDensity", [1, 0.25, 1]), ("albedo", [0.18, 0, 0.18])):
        found = [storm.GetInput(name).Get(code) for code in (1, 2, 3)]
        assert found == pytest.approx(expected)


@pytest.mark.parametrize(
    ("settings", "grids"),
    [({"material": "none"}, ("density", "emission")), ({}, ("density",))],
    ids=["none", "no colour"],
)
def test_no_material_where_none_is_asked_for_or_needed(tmp_path, settings, grids):
    files = look(shot(tmp_path), tmp_path / "out", grids=grids, **settings)
    assert bound(files.root_stage) == ""
    assert "Material" not in files.look_layer.read_text()
    assert files.shader is None


def test_a_bound_volume_material_stays_unless_it_is_to_be_replaced(tmp_path):
    source = shot(tmp_path, material(), BOUND)
    kept = look(source, tmp_path / "kept")
    assert bound(kept.root_stage) == "/World/theirs"
    replaced = look(source, tmp_path / "replaced", material="replace")
    assert bound(replaced.root_stage) == OURS


def test_bindings_for_one_purpose_are_replaced_too(tmp_path):
    binding = BOUND.replace("binding", "binding:full")
    replaced = look(shot(tmp_path, material(), binding), tmp_path / "out", material="replace")
    assert bound(replaced.root_stage, "full") == bound(replaced.root_stage) == OURS


def test_a_binding_that_is_stronger_than_descendants_is_left_alone(tmp_path):
    header = f'def Xform "World" (\n{API}\n)'
    source = shot(tmp_path, material(), "", header)
    text = source.read_text()
    strong = BOUND.replace("\n", ' (bindMaterialAs = "strongerThanDescendants")\n')
    source.write_text(text.replace(f"{header}\n{{", f"{header}\n{{\n{strong}", 1))
    assert bound(source) == "/World/theirs"
    files = look(source, tmp_path / "out", material="replace")
    assert bound(files.root_stage) == "/World/theirs"
    assert not opened(files.root_stage).GetPrimAtPath(OURS)


def bound_above(folder, theirs, relation, api=API):
    """A stage whose Volume is bound by a relationship of the prim above."""
    header = f'def Xform "World" (\n{api}\n)'
    source = shot(folder, theirs, "", header)
    text = source.read_text().replace(f"{header}\n{{", f"{header}\n{{\n{relation}\n", 1)
    return write_text(source, text)


@needs_usd(26, 5)
@pytest.mark.parametrize("config", [{}, {"material": "replace"}])
@pytest.mark.parametrize("terminal", ["surface", "volume"])
def test_a_stronger_material_above_hides_the_look_whatever_it_draws(tmp_path, terminal, config):
    strong = BOUND.replace("\n", ' (bindMaterialAs = "strongerThanDescendants")')
    source = bound_above(tmp_path, material(terminal=terminal), strong)
    files = look(source, tmp_path / "out", **config)
    assert bound(files.root_stage) == "/World/theirs"
    findings, _ = validate_look(files.root_stage)
    (found,) = [item for item in findings if item.rule == "LookHidden"]
    assert "/World/theirs" in found.message and "replace" not in found.message
    (theirs,) = find_volumes(open_stage(source), StageConfig()).volumes[0].materials
    assert not theirs.can_replace


COLLECTION = """uniform token collection:all:expansionRule = "expandPrims"
    rel collection:all:includes = </World>
    rel material:binding:collection:{}all = [</World.collection:all>, </World/theirs>]"""


@needs_usd(26, 5)
@pytest.mark.parametrize("relation", [
    BOUND, BOUND.replace("binding", "binding:full"), COLLECTION.format(""),
    COLLECTION.format("full:"),
])  # fmt: skip
def test_a_weak_binding_above_gives_way_for_every_purpose(tmp_path, relation):
    api = 'prepend apiSchemas = ["MaterialBindingAPI", "CollectionAPI:all"]'
    source = bound_above(tmp_path, material(terminal="surface"), relation, api)
    assert bound(source, "full") == "/World/theirs"
    files = look(source, tmp_path / "out")
    assert bound(files.root_stage, "full") == bound(files.root_stage) == OURS
    assert "LookHidden" not in {item.rule for item in validate(files.root_stage)}


def test_a_material_for_surfaces_alone_does_not_count(tmp_path):
    source = shot(tmp_path, material(terminal="surface"), BOUND)
    assert bound(look(source, tmp_path / "out").root_stage) == OURS


def test_a_prim_of_the_name_keeps_it(tmp_path):
    source = shot(tmp_path, "", 'def Scope "look_material" {}\n')
    assert bound(look(source, tmp_path / "out").root_stage) == f"{OURS}_2"


@needs_usd(26, 5)
@pytest.mark.parametrize(
    ("theirs", "settings", "hidden"),
    [
        ({"reads": "density"}, {}, True),
        ({"reads": "density", "terminal": "arnold:volume"}, {}, True),
        ({"reads": "emission"}, {}, False),
        ({"reads": "density"}, {"material": "replace"}, False),
        ({"reads": "density", "terminal": "surface"}, {}, False),
    ],
)
def test_a_material_that_hides_the_look_is_found(tmp_path, theirs, settings, hidden):
    files = look(shot(tmp_path, material(**theirs), BOUND), tmp_path / "out", **settings)
    found = [item for item in validate(files.root_stage) if item.rule == "LookHidden"]
    assert [item.prim_path for item in found] == ([SMOKE] if hidden else [])
    if hidden:
        assert "/World/theirs" in found[0].message
        assert "layer.material=replace" in found[0].message
        assert found[0].severity == "error"  # nobody sees this look


@needs_usd(26, 5)
def test_a_source_without_a_look_hides_nothing(tmp_path):
    found = validate(shot(tmp_path, material(), BOUND))
    assert "LookHidden" not in {item.rule for item in found}


@pytest.mark.parametrize(("theirs", "left"), [("", ""), (material(), "/World/theirs")])
def test_no_material_of_an_earlier_look_is_left_under_a_look_without(tmp_path, theirs, left):
    source = shot(tmp_path, theirs, BOUND if theirs else "")
    first = look(source, tmp_path / "first", material="replace")
    assert bound(first.root_stage) == OURS
    earlier = EarlierLooks(fields={SMOKE: ("emission",)})
    look(source, tmp_path / "second", earlier=earlier, material="none")
    layers = "@second/look.usda@, @first/look.usda@, @shot.usda@"
    both = write_text(tmp_path / "both.usda", f"#usda 1.0\n(subLayers = [{layers}])\n")
    assert bound(both) == left


def test_a_look_under_another_scale_is_rescaled_for_previews(tmp_path):
    root = look(shot(tmp_path), tmp_path / "out").root_stage
    scaled = referenced(root, scale=8)
    found = {}
    for stage_file in (root, scaled):
        stage = open_stage(stage_file)
        source = find_volumes(stage, StageConfig())
        (found[stage_file],) = composed_volumes(stage, source, 1.0)
    assert (found[root].extinction, found[root].rescale) == (0.5, 1.0)
    assert found[scaled].rescale == pytest.approx(1 / 8)
    assert found[scaled].extinction == pytest.approx(0.5 / 8)


@needs_usd(26, 5)
@pytest.mark.parametrize(("scale", "unit", "factors"), [
    (1, 0.5, ""), (50, 0.01, "for Arnold and RenderMan by 0.02."),
    (1, 0.01, "for MaterialX and Karma by 50."),
    (4, 1, "for Arnold and RenderMan by 0.25, and for MaterialX and Karma by 0.125."),
])  # fmt: skip
def test_the_factors_of_renderers_that_do_not_adapt_to_another_unit_are_told(
    tmp_path, scale, unit, factors
):
    source = shot(tmp_path)
    assert opened(source).GetMetadata("metersPerUnit") == 0.5
    root = look(source, tmp_path / "out").root_stage
    told = [f for f in validate(referenced(root, scale, unit)) if f.rule == "LookUnits"]
    assert not any(" 1 times" in item.message for item in told)
    assert [item.message.endswith(factors) for item in told] == ([True] if factors else [])

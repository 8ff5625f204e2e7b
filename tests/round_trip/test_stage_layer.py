"""Stage to look to stage: what is added is ours, what was there stays, both can be told apart."""

import shutil
from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdUtils

from tests.fixtures.usd_fixtures import (
    HEADER,
    density_prim,
    file_hashes,
    make_look,
    needs_usd,
    plume_stage,
    sampled,
    sequence,
    shown_file,
    volume_prim,
    world,
    write_sequence,
    write_text,
)
from usdsmoke.usd.rules import validate
from usdsmoke.usd.stage import open_stage

DENSITY, EMISSION = "/World/smoke/density", "/World/smoke/emission"
MATERIAL = "/World/smoke/look_material"
UNKNOWN_RENDERER = {"MissingShaderIdInRegistry", "MissingSourceTypeInRegistry"}


def opinions(stage: Usd.Stage) -> dict[str, str]:
    """Every composed value, default and sampled, resolved, by property path; metadata left out."""
    found = {}
    for prim in stage.TraverseAll():
        for attribute in prim.GetAuthoredAttributes():
            values = [attribute.Get()] + [
                attribute.Get(code) for code in attribute.GetTimeSamples()
            ]
            found[str(attribute.GetPath())] = repr(
                [getattr(value, "resolvedPath", value) for value in values]
            )
        for relationship in prim.GetAuthoredRelationships():
            found[str(relationship.GetPath())] = repr(relationship.GetTargets())
        found[str(prim.GetPath())] = repr((prim.GetTypeName(), prim.GetAppliedSchemas()))
    return found


@pytest.mark.parametrize("layer_format", ["usda", "usdc"])
@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd"])
def test_the_look_adds_to_the_source_and_nothing_of_the_source_changes(
    tmp_path, suffix, layer_format
):
    text_file = plume_stage(tmp_path / "in")
    stage_file = text_file.with_suffix(suffix)
    if suffix != ".usda":
        assert open_stage(text_file).GetRootLayer().Export(str(stage_file))
    before = file_hashes(tmp_path / "in")
    source = opinions(open_stage(stage_file))
    files = make_look(stage_file, tmp_path / "out", layer_format=layer_format)
    assert files.look_layer.name == f"look.{layer_format}"
    assert files.root_stage.name == "shot_look.usda"
    assert file_hashes(tmp_path / "in") == before
    result = opinions(open_stage(files.root_stage))
    changed = {path for path, value in source.items() if result.get(path) != value}
    assert changed == {"/World/smoke", "/World/smoke.extent", f"{DENSITY}.filePath"}
    added = set(result) - set(source)
    assert all(
        path.startswith((EMISSION, MATERIAL, "/World/smoke.usdSmoke:", "/World/smoke.authorship:"))
        or path in ("/World/smoke.field:emission", "/World/smoke.material:binding")
        for path in added
    )


def test_every_time_code_of_the_source_shows_our_file_or_its_own(tmp_path):
    stage_file = plume_stage(tmp_path, range(1, 7))
    stage = open_stage(make_look(stage_file, tmp_path / "out", frames="3-4").root_stage)
    assert stage.GetPrimAtPath(DENSITY).GetAttribute("filePath").GetTimeSamples() == list(
        range(1, 7)
    )
    for code in (0, 1, 2, 2.5, 5, 6, 99):
        held = max(1, min(6, int(code)))
        assert shown_file(stage, DENSITY, code) == str(tmp_path / f"cache/smoke.{held:04d}.vdb")
        assert shown_file(stage, EMISSION, code) is None
    for code in (3, 3.5, 4, 4.9):
        expected = str(tmp_path / f"out/vdb/smoke.{int(code):04d}.vdb")
        assert shown_file(stage, DENSITY, code) == expected
        assert shown_file(stage, EMISSION, code) == expected
    assert (
        stage.GetPrimAtPath(DENSITY)
        .GetAttribute("filePath")
        .Get()
        .resolvedPath.endswith("out/vdb/smoke.0003.vdb")
    )


def test_our_opinions_stand_in_our_layer_above_the_sources(tmp_path):
    stage_file = plume_stage(tmp_path)
    files = make_look(stage_file, tmp_path / "out")
    stage = open_stage(files.root_stage)
    names = [layer.realPath for layer in stage.GetLayerStack(includeSessionLayers=False)]
    assert names == [str(files.root_stage), str(files.look_layer), str(stage_file)]
    attribute = stage.GetPrimAtPath(DENSITY).GetAttribute("filePath")
    stack = attribute.GetPropertyStack(Usd.TimeCode(1))
    assert [spec.layer.realPath for spec in stack] == [str(files.look_layer), str(stage_file)]
    emission = stage.GetPrimAtPath(EMISSION).GetPrimStack()
    assert [spec.layer.realPath for spec in emission] == [str(files.look_layer)]
    root = Sdf.Layer.FindOrOpen(str(files.root_stage))
    assert not root.rootPrims
    look = Sdf.Layer.FindOrOpen(str(files.look_layer))
    assert look.GetPrimAtPath(DENSITY).specifier == Sdf.SpecifierOver
    assert look.GetPrimAtPath("/World/smoke").typeName == ""
    assert not stage.GetSessionLayer().rootPrims


def test_muting_the_look_gives_the_source_back(tmp_path):
    stage_file = plume_stage(tmp_path)
    files = make_look(stage_file, tmp_path / "out")
    stage = open_stage(files.root_stage)
    assert opinions(stage) != opinions(open_stage(stage_file))
    stage.MuteLayer(str(files.look_layer))
    assert opinions(stage) == opinions(open_stage(stage_file))


def test_a_moved_folder_still_resolves(tmp_path):
    make_look(plume_stage(tmp_path / "a"), tmp_path / "a/out", frames="2-3")
    shutil.move(tmp_path / "a", tmp_path / "elsewhere/b")
    stage = open_stage(tmp_path / "elsewhere/b/out/shot_look.usda")
    here = str(tmp_path / "elsewhere/b")
    assert shown_file(stage, DENSITY, 1) == f"{here}/cache/smoke.0001.vdb"
    assert shown_file(stage, DENSITY, 2) == f"{here}/out/vdb/smoke.0002.vdb"
    assert shown_file(stage, EMISSION, 3) == f"{here}/out/vdb/smoke.0003.vdb"


def test_all_dependencies_are_found_and_none_is_absolute(tmp_path):
    files = make_look(plume_stage(tmp_path), tmp_path / "out", frames="2-3")
    _, assets, missing = UsdUtils.ComputeAllDependencies(str(files.root_stage))
    assert not missing
    names = {Path(asset).relative_to(tmp_path).as_posix() for asset in assets}
    assert {"cache/smoke.0001.vdb", "out/vdb/smoke.0002.vdb", "cache/smoke.0004.vdb"} <= names
    assert str(tmp_path) not in files.look_layer.read_text()
    assert str(tmp_path) not in files.root_stage.read_text()


@needs_usd(26, 5)
@pytest.mark.parametrize(("layer_format", "empty"), [("usda", False), ("usdc", True)])
def test_every_validator_there_is_passes_on_the_result(tmp_path, capfd, layer_format, empty):
    stage_file = plume_stage(tmp_path)
    files = make_look(
        stage_file, tmp_path / "out", "2", layer_format=layer_format, ours=True, empty=empty
    )
    from pxr import UsdValidation

    assert validate(files.root_stage) == []
    assert validate(files.look_layer) == []
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) >= 30
    stage = Usd.Stage.Open(str(files.root_stage))
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert {error.GetName() for error in errors} <= UNKNOWN_RENDERER
    places = [str(error.GetSites()[0].GetProperty().GetPath()) for error in errors]
    assert all(place.startswith(MATERIAL) for place in places)
    assert not stage.GetCompositionErrors()
    assert capfd.readouterr() == ("", "")


def test_reading_writing_and_opening_say_nothing_on_the_terminal(tmp_path, capfd):
    files = make_look(plume_stage(tmp_path), tmp_path / "out")
    opinions(open_stage(files.root_stage))
    assert capfd.readouterr() == ("", "")


def test_foreign_metadata_and_opinions_survive(tmp_path):
    write_sequence(tmp_path, [1])
    header = HEADER.replace(
        "(\n",
        '(\n    customLayerData = { string studio = "ours"; asset logo = @./logo.png@ }\n'
        "    kilogramsPerUnit = 3\n"
        '    colorManagementSystem = "ocio"\n    colorConfiguration = @./config.ocio@\n',
        1,
    )
    extra = 'custom string note = "keep" (customData = { int a = 1 })'
    stage_file = write_text(
        tmp_path / "shot.usda", world(volume_prim(density_prim(sequence([1]), extra=extra)), header)
    )
    stage = open_stage(make_look(stage_file, tmp_path / "out").root_stage)
    root = stage.GetRootLayer()
    assert root.customLayerData["studio"] == "ours"
    assert root.customLayerData["logo"] == Sdf.AssetPath("../logo.png")
    assert root.pseudoRoot.GetInfo("kilogramsPerUnit") == 3.0
    assert root.colorConfiguration == Sdf.AssetPath("../config.ocio")
    assert root.colorManagementSystem == "ocio"
    note = stage.GetPrimAtPath(DENSITY).GetAttribute("note")
    assert (note.Get(), note.GetCustomData()) == ("keep", {"a": 1})


def test_a_prim_from_a_payload_behind_an_offset_sublayer_and_a_variant_is_overridden(tmp_path):
    write_sequence(tmp_path / "asset", [1, 2])
    write_text(tmp_path / "asset/smoke.usda", world(volume_prim(density_prim(sequence([1, 2])))))
    inner = f"""{HEADER}
def "World" (
    variants = {{ string size = "big" }}
    prepend variantSets = "size"
)
{{
    variantSet "size" = {{
        "big" (payload = @./asset/smoke.usda@</World>) {{}}
        "none" {{}}
    }}
}}
"""
    write_text(tmp_path / "inner.usda", inner)
    offset = HEADER.replace("(\n", "(\n    subLayers = [@./inner.usda@ (offset = 100)]\n", 1)
    stage_file = write_text(tmp_path / "shot.usda", offset)
    files = make_look(stage_file, tmp_path / "out", frames="102")
    stage = open_stage(files.root_stage)
    assert shown_file(stage, DENSITY, 101) == str(tmp_path / "asset/cache/smoke.0001.vdb")
    assert shown_file(stage, DENSITY, 102) == str(tmp_path / "out/vdb/smoke.0102.vdb")
    assert shown_file(stage, EMISSION, 102) == str(tmp_path / "out/vdb/smoke.0102.vdb")


def test_rates_axis_and_units_of_the_source_hold_on_the_result(tmp_path):
    header = HEADER.replace("timeCodesPerSecond = 25", "timeCodesPerSecond = 48")
    write_sequence(tmp_path, [1, 2])
    stage_file = write_text(
        tmp_path / "shot.usda", world(volume_prim(density_prim(sequence([1, 2]))), header)
    )
    files = make_look(stage_file, tmp_path / "out")
    for layer_file in (files.root_stage, files.look_layer):
        layer = Sdf.Layer.FindOrOpen(str(layer_file))
        info = layer.pseudoRoot.GetInfo
        assert (info("upAxis"), info("metersPerUnit"), info("defaultPrim")) == ("Z", 0.5, "World")
        assert (info("timeCodesPerSecond"), info("framesPerSecond")) == (48.0, 25.0)
        assert (info("startTimeCode"), info("endTimeCode")) == (1.0, 4.0)
    stage = open_stage(files.root_stage)
    assert stage.GetPrimAtPath(DENSITY).GetAttribute("filePath").GetTimeSamples() == [1.0, 2.0]


def test_a_source_without_rates_is_not_rescaled(tmp_path):
    header = '#usda 1.0\n(\n    defaultPrim = "World"\n    framesPerSecond = 30\n)\n'
    write_sequence(tmp_path, [30, 60])
    stage_file = write_text(
        tmp_path / "shot.usda", world(volume_prim(density_prim(sequence([30, 60]))), header)
    )
    source = open_stage(stage_file)
    result = open_stage(make_look(stage_file, tmp_path / "out", frames="60").root_stage)
    assert result.GetTimeCodesPerSecond() == source.GetTimeCodesPerSecond()
    assert result.GetPrimAtPath(DENSITY).GetAttribute("filePath").GetTimeSamples() == [30.0, 60.0]
    assert result.GetMetadata("metersPerUnit") == source.GetMetadata("metersPerUnit")


@needs_usd(26, 11)  # earlier ones do not list AuthorshipAPI
def test_a_look_over_a_look_keeps_both_records_and_the_first_ones_frames(tmp_path):
    stage_file = plume_stage(tmp_path)
    first = make_look(stage_file, tmp_path / "one", frames="1-2")
    second = make_look(
        first.root_stage, tmp_path / "two", "2-3", run_id="aaaaaaaa-0000-4000-8000-0"
    )
    stage = open_stage(second.root_stage)
    for path in (DENSITY, EMISSION):
        assert shown_file(stage, path, 1) == str(tmp_path / "one/vdb/smoke.0001.vdb")
        assert shown_file(stage, path, 2) == str(tmp_path / "two/vdb/smoke.0002.vdb")
    assert shown_file(stage, EMISSION, 4) is None
    schemas = stage.GetPrimAtPath("/World/smoke").GetAppliedSchemas()
    assert [name for name in schemas if name.startswith("AuthorshipAPI:")] == [
        "AuthorshipAPI:usdsmoke_aaaaaaaa",
        "AuthorshipAPI:usdsmoke_3f2b8c1e",
    ]


def test_gaps_and_grids_by_index_outside_the_range_stay_as_they_were(tmp_path):
    write_sequence(tmp_path, [1, 3])
    values = {1: "@./cache/smoke.0001.vdb@", 2: "None", 3: "@./cache/smoke.0003.vdb@"}
    body = volume_prim(
        density_prim(
            sampled("asset filePath", values),
            grid=sampled("token fieldName", {1: '"soot"', 3: '"fog"'}),
            extra="int fieldIndex = 2",
        )
    )
    stage_file = write_text(tmp_path / "shot.usda", world(body))
    stage = open_stage(make_look(stage_file, tmp_path / "out", frames="3").root_stage)
    prim = stage.GetPrimAtPath(DENSITY)
    names, indices = prim.GetAttribute("fieldName"), prim.GetAttribute("fieldIndex")
    assert [names.Get(code) for code in (1, 2, 3, 4)] == ["soot", "soot", "density", "density"]
    assert [indices.Get(code) for code in (1, 2, 3, 4)] == [2, 2, 0, 0]
    assert shown_file(stage, DENSITY, 2) is None
    assert shown_file(stage, DENSITY, 1) == str(tmp_path / "cache/smoke.0001.vdb")
    assert shown_file(stage, DENSITY, 3) == str(tmp_path / "out/vdb/smoke.0003.vdb")


def test_what_is_not_animated_gets_a_default_and_no_samples(tmp_path):
    write_sequence(tmp_path, [1])
    body = volume_prim(density_prim("asset filePath = @./cache/smoke.0001.vdb@"))
    stage_file = write_text(tmp_path / "shot.usda", world(body))
    stage = open_stage(make_look(stage_file, tmp_path / "out").root_stage)
    for path in (DENSITY, EMISSION):
        attribute = stage.GetPrimAtPath(path).GetAttribute("filePath")
        assert attribute.GetTimeSamples() == []
        assert attribute.Get().resolvedPath == str(tmp_path / "out/vdb/smoke.0001.vdb")
        assert shown_file(stage, path, 77) == str(tmp_path / "out/vdb/smoke.0001.vdb")


def test_a_source_field_without_a_name_stays_without_one_outside_the_range(tmp_path):
    write_sequence(tmp_path, [1, 2])
    body = volume_prim(density_prim(sequence([1, 2]), grid=""))
    stage_file = write_text(tmp_path / "shot.usda", world(body))
    stage = open_stage(make_look(stage_file, tmp_path / "out", frames="2").root_stage)
    name = stage.GetPrimAtPath(DENSITY).GetAttribute("fieldName")
    assert [name.Get(code) for code in (1, 2)] == [None, "density"]

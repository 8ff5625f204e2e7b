"""The mode ``reference``: an asset whose variants are the looks, and what switching them gives."""

from pathlib import Path
from typing import Any

import pytest
from pxr import Sdf, Usd

from tests.fixtures.shot_fixtures import FOG, PLUME, BigShot, make_big_shot
from tests.fixtures.stage_reader import read_stage
from tests.fixtures.usd_fixtures import (
    HEADER,
    density_prim,
    file_hashes,
    make_look,
    needs_usd,
    plume_stage,
    sequence,
    volume_prim,
    world,
    write_sequence,
    write_text,
)
from usdsmoke.base.errors import LayerError
from usdsmoke.usd.look import check_asset
from usdsmoke.usd.rules import validate
from usdsmoke.usd.stage import open_stage

ROOTS = ("/World", "/Caches")  # of the big shot: those that a look has opinions on
RUNS = {"ember": "aaaaaaaa-0000-4000-8000-0", "frost": "bbbbbbbb-0000-4000-8000-0"}


@pytest.fixture
def big(tmp_path: Path) -> BigShot:
    return make_big_shot(tmp_path)


def make_asset(shot: BigShot, look: str, **options: Any) -> Path:
    files = make_look(
        shot.stage, shot.output, mode="reference", look=look, run_id=RUNS[look], **options
    )
    assert files.root_stage == shot.output / "shot_asset.usda"
    return files.root_stage


def without(told: dict[str, Any], *keys: str) -> dict[str, Any]:
    return {key: value for key, value in told.items() if key not in keys}


def timeless(prims: dict[str, Any]) -> dict[str, Any]:
    """Without the moment at which a look was written."""
    for prim in prims.values():
        properties = prim["properties"]
        for name in [name for name in properties if name.endswith(":created")]:
            del properties[name]
    return prims


def is_class(prim: dict[str, Any]) -> bool:
    return bool(prim["specifier"] == "Sdf.SpecifierClass")


@pytest.mark.parametrize("layer_format", ["usda", "usdc"])
def test_original_is_the_source_to_the_last_value(big: BigShot, layer_format: str) -> None:
    """Two root prims with looks, bindings and connections from one to another, classes, a payload,
    offsets, an instance: everything but the classes, whose opinions come with those who inherit."""
    source = read_stage(big.stage)
    asset = read_stage(make_asset(big, "ember", layer_format=layer_format), original=ROOTS)
    shown = {path: prim for path, prim in source["prims"].items() if not is_class(prim)}
    assert len(source["prims"]) - len(shown) == 2
    assert asset["prims"] == shown
    assert without(asset, "prims", "layers") == without(source, "prims", "layers")
    assert asset["errors"] == [] and asset["stderr"] == source["stderr"] == ""


def test_a_look_in_the_asset_is_what_the_root_stage_of_the_other_mode_shows(big: BigShot) -> None:
    root = read_stage(
        make_look(big.stage, big.output, look="ember", run_id=RUNS["ember"]).root_stage
    )
    asset = read_stage(make_asset(big, "ember"))
    shown = {path: prim for path, prim in root["prims"].items() if not is_class(prim)}
    assert timeless(asset["prims"]) == timeless(shown)
    assert without(asset, "prims", "layers") == without(root, "prims", "layers")
    files = asset["prims"]["/World/fx/plume/fields/density"]["properties"]["filePath"]["samples"]
    assert files == {
        f"{code}.0": str(big.output / f"vdb/smoke.{code:04d}.vdb") for code in (111, 112, 113)
    }
    emission = asset["prims"]["/Caches/emission"]
    assert emission["type"] == "OpenVDBAsset"
    assert asset["prims"][FOG]["properties"]["field:emission"] == ["/Caches/emission"]


def test_every_look_of_the_folder_is_a_variant_and_the_last_one_is_selected(big: BigShot) -> None:
    make_asset(big, "frost")
    asset_file = make_asset(big, "ember", frames="111")
    stage = open_stage(asset_file)
    for root in ROOTS:
        look = stage.GetPrimAtPath(root).GetVariantSet("look")
        assert sorted(look.GetVariantNames()) == ["ember", "frost", "original"]
        assert look.GetVariantSelection() == "ember"
    prim = stage.GetPrimAtPath(PLUME)
    run = prim.GetAttribute("usdSmoke:run")
    assert run.Get() == RUNS["ember"]
    for root in ROOTS:
        stage.GetPrimAtPath(root).GetVariantSet("look").SetVariantSelection("frost")
    assert prim.GetAttribute("usdSmoke:run").Get() == RUNS["frost"]


def test_a_look_without_emission_leaves_none_of_another_looks(big: BigShot) -> None:
    make_asset(big, "frost")
    told = read_stage(make_asset(big, "ember", names=["density"]))
    assert "field:emission" not in told["prims"][PLUME]["properties"]
    assert "field:emission" not in told["prims"][FOG]["properties"]
    assert "/Caches/emission" not in told["prims"]


def test_looks_of_another_source_and_foreign_layers_are_no_variants(big: BigShot) -> None:
    other = plume_stage(big.folder / "other")
    make_look(other, big.output, look="other")
    write_text(big.output / "look_broken.usda", "no layer")
    write_text(big.output / "look_foreign.usda", HEADER)
    stage = open_stage(make_asset(big, "ember"))
    names = stage.GetPrimAtPath("/World").GetVariantSet("look").GetVariantNames()
    assert sorted(names) == ["ember", "original"]


def test_the_prim_stack_is_asset_look_source(big: BigShot) -> None:
    stage = open_stage(make_asset(big, "ember"))
    density = stage.GetPrimAtPath("/World/fx/plume/fields/density")
    names = [Path(spec.layer.realPath).name for spec in density.GetPrimStack()]
    assert names == ["look_ember.usda", "plume.usda", "plume_payload.usda"]
    names = [Path(spec.layer.realPath).name for spec in stage.GetPrimAtPath(FOG).GetPrimStack()]
    assert names == ["shot_asset.usda"] * 2 + ["look_ember.usda", "shot.usda", "layout.usda"]
    assert [Path(layer.realPath).name for layer in stage.GetLayerStack(False)] == [
        "shot_asset.usda"
    ]


def test_a_shot_references_the_asset_and_chooses_a_look(big: BigShot) -> None:
    write_sequence(big.folder, [1, 2])
    body = volume_prim(density_prim(sequence([1, 2])))
    stage_file = write_text(big.folder / "plume.usda", world(body))
    asset = make_look(stage_file, big.output, mode="reference").root_stage
    layer = Sdf.Layer.CreateAnonymous(".usda")
    for name, look in (("a", "original"), ("b", "stylized")):
        spec = Sdf.CreatePrimInLayer(layer, f"/{name}")
        spec.specifier = Sdf.SpecifierDef
        spec.referenceList.prependedItems = [Sdf.Reference(str(asset))]
        spec.variantSelections["look"] = look
    stage = Usd.Stage.Open(layer)
    shown = [
        Path(
            stage.GetPrimAtPath(f"/{name}/smoke/density").GetAttribute("filePath").Get(2).path
        ).parent.name
        for name in "ab"
    ]
    assert shown == ["cache", "vdb"]


def test_volume_and_field_that_are_root_prims_themselves_switch_as_well(tmp_path: Path) -> None:
    write_sequence(tmp_path, [1, 2])
    volume = 'def Volume "smoke"\n{\n rel field:density = </density>\n}\n'
    text = HEADER + volume + density_prim(sequence([1, 2]))
    stage_file = write_text(tmp_path / "shot.usda", text)
    asset = make_look(stage_file, tmp_path / "out", mode="reference").root_stage
    source, look = read_stage(stage_file), read_stage(asset)
    assert look["prims"]["/smoke"]["properties"]["field:emission"] == ["/emission"]
    assert look["prims"]["/emission"]["type"] == "OpenVDBAsset"
    original = read_stage(asset, original=("/smoke", "/density", "/emission"))
    left = original["prims"].pop("/emission")  # undefined, without type and properties
    assert (left["specifier"], left["type"], left["properties"]) == ("Sdf.SpecifierOver", "", {})
    assert original["prims"] == source["prims"]
    assert look["stderr"] == original["stderr"] == ""


def test_neither_source_nor_looks_are_touched_by_another_look(big: BigShot) -> None:
    make_asset(big, "frost")
    before = {**file_hashes(big.folder / "in"), **file_hashes(big.output)}
    make_asset(big, "ember")
    after = {**file_hashes(big.folder / "in"), **file_hashes(big.output)}
    changed = {name for name in before if before[name] != after[name]}
    assert {name for name in changed if not name.startswith("vdb/")} == {"shot_asset.usda"}
    assert str(big.folder) not in (big.output / "shot_asset.usda").read_text()


@needs_usd(26, 5)
def test_the_asset_passes_every_validator(big: BigShot) -> None:
    asset = make_asset(big, "ember", ours=True)
    (found,) = [item for item in validate(asset) if item not in validate(big.stage)]
    assert (found.rule, found.prim_path) == ("LookHidden", "/World/set/fog")  # has a material


REFUSED = {
    "variants": (
        'def "World" (\n prepend variantSets = "look"\n)\n{\n variantSet "look" = {\n'
        '  "a" {\n  }\n }\n}',
        "</World> .*variant set 'look'",
    ),
    "inherits": (
        'def "World"\n{\n def "a" (inherits = </Base>)\n {\n }\n}\ndef "Base"\n{\n}',
        "</World/a> inherits from </Base>, .*not a class",
    ),
    "instance": (
        'def "Looks"\n{\n}\ndef "Protos"\n{\n def "tree"\n {\n  def "leaf"\n  {\n'
        '   rel material:binding = </Looks>\n  }\n }\n}\ndef "World"\n{\n def "t" (\n'
        "instanceable = true\n references = </Protos/tree>\n )\n {\n }\n}",
        r"</World/t/leaf\.material:binding> .*in an instance .* </Looks>",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_an_asset_cannot_hold_is_refused_with_advice(tmp_path: Path, case: str) -> None:
    text, reason = REFUSED[case]
    stage = open_stage(write_text(tmp_path / "a.usda", f"{HEADER}\n{text}\n"))
    with pytest.raises(LayerError, match=reason) as caught:
        check_asset(stage)
    assert "--mode sublayer" in str(caught.value)

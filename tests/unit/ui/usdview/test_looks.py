"""Toggling between looks and the source, by layers and by variants, as the stage shows it."""

from pathlib import Path

import pytest
from pxr import Sdf, Usd

from tests.fixtures.shot_fixtures import PLUME, make_big_shot
from tests.fixtures.usd_fixtures import (
    HEADER,
    density_prim,
    file_hashes,
    make_look,
    plume_stage,
    shown_file,
    write_text,
)
from tests.fixtures.usdview_fixtures import FakeApi, FakeWindow, open_in_usdview
from usdsmoke.ui.usdview.actions import run_action
from usdsmoke.ui.usdview.looks import find_looks

FIRST, SECOND = ("3f2b8c1e-0a4d-4c57-9d0e-5b7a1f6c2d34", "77aa8c1e-0a4d-4c57-9d0e-5b7a1f6c2d34")

VARIANTS = """
def Xform "Asset" (
    variants = {{ string look = "stylized" }}
    prepend variantSets = "look"
)
{{
    variantSet "look" = {{
        {names}
    }}
}}
"""


def toggle(api: FakeApi) -> str:
    """What a toggle says when all went well."""
    window = FakeWindow()
    run_action("toggle", "Toggle", api, window)
    assert window.warnings == []
    (said,) = window.said
    return said


def shown(api: FakeApi) -> str:
    """The folder of the file that the plume shows at timeCode 1."""
    assert api.stage is not None
    return Path(str(shown_file(api.stage, "/World/smoke/density", 1))).parent.name


@pytest.fixture
def two_looks(tmp_path: Path) -> Path:
    """A stage with two looks over one source; the second one is the stronger."""
    source = plume_stage(tmp_path)
    for folder, run_id in (("one", FIRST), ("two", SECOND)):
        make_look(source, tmp_path / folder, run_id=run_id)
        (tmp_path / folder / "vdb").rename(tmp_path / folder / f"vdb_{folder}")
        look = tmp_path / folder / "look.usda"
        text = look.read_text().replace("./vdb/", f"./vdb_{folder}/")
        if folder == "two":
            text = text.replace("created = ", 'created = "9999" # ')
        look.write_text(text)
    layers = "@two/look.usda@, @one/look.usda@, @shot.usda@"
    return write_text(tmp_path / "all.usda", HEADER.replace("(", f"(\n subLayers = [{layers}]", 1))


def test_one_look_goes_and_comes_back_and_files_stay_as_they_are(tmp_path: Path) -> None:
    files = make_look(plume_stage(tmp_path), tmp_path / "out")
    before = file_hashes(tmp_path)
    api, _ = open_in_usdview(files.root_stage)
    assert shown(api) == "vdb"
    assert toggle(api) == "original: muted look.usda"
    assert shown(api) == "cache"
    assert not api.stage.GetPrimAtPath("/World/smoke/emission")
    assert toggle(api) == f"stylized: look.usda, run {FIRST}"
    assert shown(api) == "vdb"
    assert file_hashes(tmp_path) == before


def test_several_looks_follow_one_another_and_then_the_source(two_looks: Path) -> None:
    api, _ = open_in_usdview(two_looks)
    assert [look.run for look in find_looks(api.stage)] == [FIRST, SECOND]
    seen = [shown(api)]
    for _ in range(4):
        toggle(api)
        seen.append(shown(api))
    assert seen == ["vdb_two", "cache", "vdb_one", "vdb_two", "cache"]


def test_edits_of_a_muted_look_that_were_not_saved_are_there_again(tmp_path: Path) -> None:
    files = make_look(plume_stage(tmp_path), tmp_path / "out")
    api, _ = open_in_usdview(files.root_stage)
    layer = Sdf.Layer.Find(str(files.look_layer))
    layer.GetAttributeAtPath("/World/smoke.usdSmoke:seed").default = 99
    del layer
    toggle(api)
    toggle(api)
    assert api.stage.GetPrimAtPath("/World/smoke").GetAttribute("usdSmoke:seed").Get() == 99


def test_the_look_of_another_volume_stays(tmp_path: Path) -> None:
    files = make_look(plume_stage(tmp_path), tmp_path / "out")
    api, _ = open_in_usdview(files.root_stage, "/Other")
    api.selectedPrims = [api.stage.DefinePrim("/Other", "Volume")]
    window = FakeWindow()
    run_action("toggle", "Toggle", api, window)
    assert "</Other>" in window.warnings[0][1]
    assert shown(api) == "vdb" and api.stage.GetMutedLayers() == []


def test_a_look_is_found_behind_a_reference(tmp_path: Path) -> None:
    files = make_look(plume_stage(tmp_path), tmp_path / "out")
    text = HEADER + f'\ndef "Set" {{\n def "Fire" (references = @{files.root_stage}@) {{}}\n}}\n'
    api, _ = open_in_usdview(write_text(tmp_path / "set.usda", text), "/Set")
    assert toggle(api) == "original: muted look.usda"
    shows = shown_file(api.stage, "/Set/Fire/smoke/density", 1)
    assert shows is not None and "/cache/" in shows
    toggle(api)
    assert "/vdb/" in str(shown_file(api.stage, "/Set/Fire/smoke/density", 1))


def test_a_look_that_is_the_root_itself_cannot_be_muted(tmp_path: Path) -> None:
    files = make_look(plume_stage(tmp_path), tmp_path / "out")
    look = Sdf.Layer.FindOrOpen(str(files.look_layer))
    look.subLayerPaths = ["../shot.usda"]
    api, _ = open_in_usdview(files.look_layer)
    window = FakeWindow()
    run_action("toggle", "Toggle", api, window)
    assert "muted" in window.warnings[0][1]


def variant_stage(folder: Path, names: tuple[str, ...] = ("fire", "original", "stylized")) -> Path:
    """A Volume with looks as variants of the Xform above it; each shows a folder of its name."""
    body = "\n".join(
        f'''"{name}" {{
            def Volume "smoke"
            {{
                rel field:density = </Asset/smoke/density>
                {density_prim(f"asset filePath = @./{name}/a.vdb@")}
            }}
        }}'''
        for name in names
    )
    return write_text(folder / "asset.usda", HEADER + VARIANTS.format(names=body))


def test_variants_are_switched_in_the_session_layer_with_the_source_first(tmp_path: Path) -> None:
    api, _ = open_in_usdview(variant_stage(tmp_path), "/Asset/smoke/density")
    seen = []
    for _ in range(4):
        said = toggle(api)
        value = api.stage.GetPrimAtPath("/Asset/smoke/density").GetAttribute("filePath").Get()
        seen.append(str(value.path))
        assert said.startswith(f"{Path(seen[-1]).parent.name}: variant of </Asset>")
        api.selectedPrims = [api.stage.GetPrimAtPath("/Asset/smoke/density")]
    assert seen == ["./original/a.vdb", "./fire/a.vdb", "./stylized/a.vdb", "./original/a.vdb"]
    assert not api.stage.GetRootLayer().dirty
    selection = api.stage.GetSessionLayer().GetPrimAtPath("/Asset").variantSelections
    assert dict(selection) == {"look": "original"}


def test_somebody_elses_variant_set_is_left_alone(tmp_path: Path) -> None:
    api, _ = open_in_usdview(variant_stage(tmp_path, ("fire", "stylized")))
    window = FakeWindow()
    run_action("toggle", "Toggle", api, window)
    assert "no look" in window.warnings[0][1]


def test_without_a_session_layer_a_variant_cannot_be_chosen(tmp_path: Path) -> None:
    root = Sdf.Layer.FindOrOpen(str(variant_stage(tmp_path)))
    stage = Usd.Stage.Open(root, sessionLayer=None)
    window = FakeWindow()
    run_action("toggle", "Toggle", FakeApi(stage, [], Usd.TimeCode(1)), window)
    assert "session layer" in window.warnings[0][1]


def test_an_asset_of_several_root_prims_is_switched_as_a_whole(tmp_path: Path) -> None:
    shot = make_big_shot(tmp_path)
    for look, run_id in (("ember", FIRST), ("frost", SECOND)):
        files = make_look(shot.stage, shot.output, mode="reference", look=look, run_id=run_id)
    assert files.root_stage is not None
    api, _ = open_in_usdview(files.root_stage, PLUME)
    seen = []
    for _ in range(4):
        said = toggle(api).split(":")[0]
        roots = [api.stage.GetPrimAtPath(path) for path in ("/World", "/Caches")]
        assert {prim.GetVariantSet("look").GetVariantSelection() for prim in roots} == {said}
        run = api.stage.GetPrimAtPath(PLUME).GetAttribute("usdSmoke:run")
        seen.append((said, run.Get() if run else None))
        api.selectedPrims = [api.stage.GetPrimAtPath(PLUME)]
    assert seen == [("original", None), ("ember", FIRST), ("frost", SECOND), ("original", None)]
    assert api.stage.GetMutedLayers() == []


def test_two_copies_of_an_asset_are_switched_one_by_one(tmp_path: Path) -> None:
    variant_stage(tmp_path)
    copies = "".join(f'def "{n}" (references = @./asset.usda@</Asset>) {{}}\n' for n in "ab")
    api, _ = open_in_usdview(write_text(tmp_path / "set.usda", HEADER + copies), "/a")
    assert toggle(api) == "original: variant of </a>"
    selections = {n: api.stage.GetPrimAtPath(f"/{n}").GetVariantSet("look") for n in "ab"}
    found = {n: item.GetVariantSelection() for n, item in selections.items()}
    assert found == {"a": "original", "b": "stylized"}


def test_volumes_below_several_root_prims_of_an_asset_go_one_step_together(tmp_path: Path) -> None:
    file_path = variant_stage(tmp_path)
    text = file_path.read_text()
    second = text[text.index("def Xform") :].replace("Asset", "Other")
    api, _ = open_in_usdview(write_text(file_path, text + second))
    for expected in ("original", "fire", "stylized"):
        assert toggle(api) == f"{expected}: variant of </Asset>; {expected}: variant of </Other>"

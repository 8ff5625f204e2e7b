"""What the menu's items do, on small stages through a stand-in of usdview's api."""

import shlex
import sys
from pathlib import Path

import pytest
from pxr import Usd, UsdVol

from tests.usd_fixtures import (
    HEADER,
    density_prim,
    file_hashes,
    make_look,
    plume_stage,
    sequence,
    volume_prim,
    world,
    write_sequence,
    write_text,
    write_vdb,
)
from tests.usdview_fixtures import FakeApi, FakeWindow, open_in_usdview
from usdsmoke.cli_arguments import build_parser
from usdsmoke.run_folder import RunFolder
from usdsmoke.usdview.actions import run_action
from usdsmoke.usdview.volumes import selected_volumes


def do(name: str, api: FakeApi) -> FakeWindow:
    """A window after one action that went well."""
    window = FakeWindow()
    run_action(name, "Item", api, window)
    assert window.warnings == []
    return window


def refusal(name: str, api: FakeApi) -> str:
    """The one message of an action that could not be done."""
    window = FakeWindow()
    run_action(name, "Item", api, window)
    ((title, message),) = window.warnings
    assert (title, window.texts, window.copied) == ("Item", [], [])
    return message


@pytest.fixture
def two_plumes(tmp_path: Path) -> Path:
    """Volumes /World/a and /World/b below one Xform, b with time samples of its own."""
    write_sequence(tmp_path, [1, 2, 3, 4])
    bodies = [
        volume_prim(density_prim(sequence(codes)), name)
        for name, codes in (("a", [1, 2]), ("b", [1, 3, 4]))
    ]
    return write_text(tmp_path / "two plumes.usda", world("".join(bodies)))


# What is selected


@pytest.mark.parametrize(
    ("selection", "expected"),
    [
        ([], ["/World/a", "/World/b"]),
        (["/World"], ["/World/a", "/World/b"]),
        (["/World/b"], ["/World/b"]),
        (["/World/b", "/World/a"], ["/World/a", "/World/b"]),
        (["/World/a/density"], ["/World/a"]),
    ],
)
def test_a_selection_leads_to_its_volumes(
    two_plumes: Path, selection: list[str], expected: list[str]
) -> None:
    api, _ = open_in_usdview(two_plumes, *selection)
    found = selected_volumes(api.stage, api.selectedPrims)
    assert [str(volume.GetPath()) for volume in found] == expected


def test_a_field_prim_leads_to_those_that_show_it_and_not_to_the_one_it_lies_in(
    two_plumes: Path,
) -> None:
    api, _ = open_in_usdview(two_plumes, "/World/a/density")
    shared = api.stage.GetPrimAtPath("/World/b").GetRelationship("field:density")
    shared.SetTargets(["/World/a/density"])
    api.stage.GetPrimAtPath("/World/a").GetRelationship("field:density").SetTargets([])
    found = selected_volumes(api.stage, api.selectedPrims)
    assert [str(volume.GetPath()) for volume in found] == ["/World/b"]


def test_a_selection_without_volumes_is_answered_with_those_that_there_are(
    two_plumes: Path,
) -> None:
    api, _ = open_in_usdview(two_plumes)
    api.selectedPrims = [api.stage.DefinePrim("/Elsewhere")]
    for name in ("inspect", "provenance", "toggle", "copy_frame", "copy_all"):
        message = refusal(name, api)
        assert "at </Elsewhere>" in message and "</World/a>, </World/b>" in message


def test_a_stage_without_volumes_or_no_stage_becomes_a_message(tmp_path: Path) -> None:
    api, _ = open_in_usdview(write_text(tmp_path / "bare.usda", HEADER))
    assert "no Volume on this stage" in refusal("inspect", api)
    api.stage = None
    assert "no stage is open" in refusal("validate", api)


def test_volumes_behind_payloads_that_are_not_loaded_are_hinted_at(tmp_path: Path) -> None:
    plume_stage(tmp_path)
    text = HEADER + '\ndef "World" (payload = @shot.usda@</World>) {\n}\n'
    stage = Usd.Stage.Open(str(write_text(tmp_path / "top.usda", text)), Usd.Stage.LoadNone)
    api = FakeApi(stage, [stage.GetPseudoRoot()], Usd.TimeCode(1))
    assert "1 payloads are not loaded" in refusal("inspect", api)


# Inspect and validate


def test_inspection_tells_the_selected_volumes_and_sees_edits_of_the_session(
    two_plumes: Path,
) -> None:
    api, _ = open_in_usdview(two_plumes, "/World/b")
    ((_, text),) = do("inspect", api).texts
    assert "Volume </World/b>: 3 frames, 1 to 4" in text and "/World/a" not in text
    with Usd.EditContext(api.stage, api.stage.GetSessionLayer()):
        api.stage.GetPrimAtPath("/World/b").SetActive(False)
        api.selectedPrims = [api.stage.GetPseudoRoot()]
    ((_, text),) = do("inspect", api).texts
    assert "Volume </World/a>" in text and "/World/b" not in text


def test_inspection_of_a_missing_file_names_it_in_a_message(two_plumes: Path) -> None:
    (two_plumes.parent / "cache/smoke.0003.vdb").unlink()
    api, _ = open_in_usdview(two_plumes)
    message = refusal("inspect", api)
    assert "timeCode 3" in message and "./cache/smoke.0003.vdb" in message


def test_validation_is_of_the_open_stage_with_its_unsaved_edits(tmp_path: Path) -> None:
    api, _ = open_in_usdview(plume_stage(tmp_path))
    assert do("validate", api).said[-1] == "shot.usda: nothing to say"
    api.stage.GetPrimAtPath("/World/smoke/density").GetAttribute("fieldName").Set("fog")
    ((_, text),) = do("validate", api).texts
    assert "GridMissing </World/smoke/density>" in text


def test_what_nobody_foresaw_becomes_a_message(
    two_plumes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(stage: Usd.Stage) -> None:
        raise KeyError("surprise")

    monkeypatch.setattr("usdsmoke.usdview.looks.find_looks", fail)
    api, _ = open_in_usdview(two_plumes)
    assert "unexpected KeyError: 'surprise'" in refusal("provenance", api)
    monkeypatch.setitem(sys.modules, "usdsmoke.validators", None)
    assert "usdsmoke needs OpenUSD 26.11" in refusal("validate", api)


# Provenance


def test_provenance_tells_record_and_volume_also_while_the_look_is_muted(tmp_path: Path) -> None:
    files = make_look(plume_stage(tmp_path), tmp_path / "out")
    api, _ = open_in_usdview(files.root_stage, "/World/smoke")
    ((_, text),) = do("provenance", api).texts
    assert "Volume </World/smoke>: shows run 3f2b8c1e-" in text
    assert "usdsmoke_3f2b8c1e softwareVersion: 1.2.3" in text
    assert f"look {files.look_layer}\n" in text and "  styles: 1\n    x.png=ff" in text
    assert "  seed: 7" in text and "    a.b=1" in text
    do("toggle", api)
    ((_, text),) = do("provenance", api).texts
    assert "Volume </World/smoke>: shows its source" in text
    assert f"look {files.look_layer} (muted)\n" in text and "  seed: 7" in text


def test_provenance_of_a_source_says_that_it_shows_its_source(two_plumes: Path) -> None:
    api, _ = open_in_usdview(two_plumes, "/World/b")
    assert do("provenance", api).texts == [("provenance", "Volume </World/b>: shows its source")]


# Command line


def parsed(command: str) -> dict[str, object]:
    """The command as the parser of ``usdsmoke`` takes it."""
    program, *arguments = shlex.split(command)
    assert program == "usdsmoke"
    return vars(build_parser().parse_args(arguments))


def test_the_command_is_quoted_and_names_stage_volumes_and_frames(two_plumes: Path) -> None:
    api, _ = open_in_usdview(two_plumes, time_code=2.5)
    window = do("copy_all", api)
    command = parsed(window.copied[0])
    assert command["stage"] == str(two_plumes) and " " in two_plumes.name
    assert command["prim"] == ["/World/a", "/World/b"] and command["frames"] == "1-4"
    assert command["output"] == str(two_plumes.parent / "two plumes_look")
    assert command["style"] == ["STYLE.png"]
    ((_, text),) = window.texts
    assert "STYLE.png stands for your style image" in text


@pytest.mark.parametrize(
    ("time_code", "frames"), [(2.5, "1,2"), (3.0, "2,3"), (0.0, "1"), (None, "1")]
)
def test_this_frame_is_the_one_that_each_volume_holds(
    two_plumes: Path, time_code: float | None, frames: str
) -> None:
    api, _ = open_in_usdview(two_plumes, time_code=time_code)
    assert parsed(do("copy_frame", api).copied[0])["frames"] == frames


def test_smoke_that_is_not_animated_needs_no_frames(tmp_path: Path) -> None:
    write_vdb(tmp_path / "still.vdb")
    body = volume_prim(density_prim("asset filePath = @./still.vdb@"))
    (tmp_path / "still_look").mkdir()
    api, _ = open_in_usdview(write_text(tmp_path / "still.usda", world(body)))
    command = parsed(do("copy_frame", api).copied[0])
    assert command["frames"] is None
    assert command["output"] == str(tmp_path / "still_look_2")


def test_the_command_of_a_result_stylizes_its_source_with_its_styles(tmp_path: Path) -> None:
    files = make_look(plume_stage(tmp_path), tmp_path / "out")
    api, _ = open_in_usdview(files.root_stage, "/World/smoke/density")
    window = do("copy_all", api)
    assert parsed(window.copied[0])["style"] == ["x.png"]
    assert "shows a look already" in window.texts[0][1]

    run = RunFolder(tmp_path / "out/vdb/0123", {}, "3f2b8c1e-0a4d-4c57-9d0e-5b7a1f6c2d34")
    run.begin({}, {"stage": "../shot.usda", "styles": ["../a b.png", "../c.png"]}, [])
    window = do("copy_all", api)
    command = parsed(window.copied[0])
    assert command["stage"] == str(tmp_path / "shot.usda")
    assert command["style"] == [str(tmp_path / "a b.png"), str(tmp_path / "c.png")]
    assert window.texts == []


def test_edits_that_the_command_cannot_see_are_noted(two_plumes: Path) -> None:
    api, _ = open_in_usdview(two_plumes)
    UsdVol.Volume(api.stage.GetPrimAtPath("/World/a")).GetPrim().SetMetadata("comment", "edited")
    assert (
        "unsaved edits are not in the command's stage: two plumes.usda"
        in (do("copy_all", api).texts[0][1])
    )


def test_a_stage_without_a_file_cannot_be_named_in_a_command(two_plumes: Path) -> None:
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().subLayerPaths = [str(two_plumes)]
    api = FakeApi(stage, [], Usd.TimeCode(1))
    assert "has no file; save it first" in refusal("copy_all", api)


def test_no_action_changes_a_file(tmp_path: Path) -> None:
    files = make_look(plume_stage(tmp_path), tmp_path / "out", ours=True)
    before = file_hashes(tmp_path)
    api, _ = open_in_usdview(files.root_stage)
    for name in ("inspect", "provenance", "validate", "toggle", "copy_frame", "copy_all", "toggle"):
        do(name, api)
    assert file_hashes(tmp_path) == before

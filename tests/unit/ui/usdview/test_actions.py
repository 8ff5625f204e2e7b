"""What the menu's items do, on small stages through a stand-in of usdview's api."""

import sys
from pathlib import Path

import pytest
from pxr import Usd

from tests.fixtures.usd_fixtures import (
    HEADER,
    file_hashes,
    make_look,
    needs_usd,
    plume_stage,
    write_text,
)
from tests.fixtures.usdview_fixtures import FakeApi, do, open_in_usdview, refusal, two_plumes_stage
from usdsmoke.ui.usdview.volumes import selected_volumes


@pytest.fixture
def two_plumes(tmp_path: Path) -> Path:
    """See ``two_plumes_stage``."""
    return two_plumes_stage(tmp_path)


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
    assert "no Volume" in refusal("inspect", api)
    api.stage = None
    assert "no stage" in refusal("validate", api)


def test_volumes_behind_payloads_that_are_not_loaded_are_hinted_at(tmp_path: Path) -> None:
    plume_stage(tmp_path)
    text = HEADER + '\ndef "World" (payload = @shot.usda@</World>) {\n}\n'
    stage = Usd.Stage.Open(str(write_text(tmp_path / "top.usda", text)), Usd.Stage.LoadNone)
    api = FakeApi(stage, [stage.GetPseudoRoot()], Usd.TimeCode(1))
    assert "1 payload" in refusal("inspect", api)


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


def test_inspection_names_a_missing_file_beside_the_rest(two_plumes: Path) -> None:
    (two_plumes.parent / "cache/smoke.0003.vdb").unlink()
    api, _ = open_in_usdview(two_plumes)
    ((_, text),) = do("inspect", api).texts
    problems = [line for line in text.splitlines() if line.startswith("problem: ")]
    assert problems and "timeCode 3" in problems[0]
    assert "smoke.0002.vdb" in text


@needs_usd(26, 5)
def test_validation_is_of_the_open_stage_with_its_unsaved_edits(tmp_path: Path) -> None:
    api, _ = open_in_usdview(plume_stage(tmp_path))
    assert do("validate", api).said[-1] == "shot.usda: no findings"
    api.stage.GetPrimAtPath("/World/smoke/density").GetAttribute("fieldName").Set("fog")
    ((_, text),) = do("validate", api).texts
    assert "GridMissing </World/smoke/density>" in text


def test_what_nobody_foresaw_becomes_a_message(
    two_plumes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(stage: Usd.Stage) -> None:
        raise KeyError("surprise")

    monkeypatch.setattr("usdsmoke.ui.usdview.looks.find_looks", fail)
    api, _ = open_in_usdview(two_plumes)
    assert "unexpected KeyError: 'surprise'" in refusal("provenance", api)
    monkeypatch.setitem(sys.modules, "usdsmoke.usd.rules", None)
    assert "OpenUSD 24.05" in refusal("validate", api)


# Provenance


def test_provenance_tells_record_and_volume_also_while_the_look_is_muted(tmp_path: Path) -> None:
    files = make_look(plume_stage(tmp_path), tmp_path / "out")
    api, _ = open_in_usdview(files.root_stage, "/World/smoke")
    ((_, text),) = do("provenance", api).texts
    assert "Volume </World/smoke>: shows run 3f2b8c1e-" in text
    assert "usdsmoke_3f2b8c1e softwareVersion: 1.2.3" in text
    assert "\nlook look.usda\n" in text and f"record     {files.look_layer}" in text
    assert "style      x.png  ff" in text and "seed       7" in text
    do("toggle", api)
    ((_, text),) = do("provenance", api).texts
    assert "Volume </World/smoke>: shows its source" in text
    assert "\nlook look.usda (muted)\n" in text and "seed       7" in text


def test_provenance_of_a_source_says_that_it_shows_its_source(two_plumes: Path) -> None:
    api, _ = open_in_usdview(two_plumes, "/World/b")
    assert do("provenance", api).texts == [("provenance", "Volume </World/b>: shows its source")]


@needs_usd(26, 5)  # validate is among them
def test_no_action_changes_a_file(tmp_path: Path) -> None:
    files = make_look(plume_stage(tmp_path), tmp_path / "out", ours=True)
    before = file_hashes(tmp_path)
    api, _ = open_in_usdview(files.root_stage)
    for name in ("inspect", "provenance", "validate", "toggle", "copy_frame", "copy_all", "toggle"):
        do(name, api)
    assert file_hashes(tmp_path) == before

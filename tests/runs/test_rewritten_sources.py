"""Source files that are written again: what is done, what stays, and what is refused."""

import dataclasses
import os
from pathlib import Path

import pytest

from tests.fixtures.pipeline_fixtures import (
    FakeCore,
    Shot,
    contents,
    make_shot,
    rewrite_source,
    run,
)
from usdsmoke import rerun, verify
from usdsmoke.audit.record import find_records
from usdsmoke.base.errors import OutputExists
from usdsmoke.pipeline import Request, assemble, run_window
from usdsmoke.pipeline import plan as make_plan
from usdsmoke.ui.cli.main import main

WINDOWS = ("windows.size=2", "windows.overlap=1")


@pytest.fixture
def long_shot(tmp_path: Path) -> Shot:
    return make_shot(tmp_path / "shot", n_frames=12)


ALONE = ("windows.size=4", "windows.overlap=0", "windows.shared_octaves=0")


def test_one_rewritten_source_file_redoes_its_window_alone(
    long_shot: Shot, core: FakeCore, capsys: pytest.CaptureFixture[str]
) -> None:
    first = run(long_shot, *ALONE)
    inodes = [path.stat().st_ino for path in first.frames]
    rewrite_source(long_shot, 6)
    core.stylized.clear()
    more = [text for setting in ALONE for text in ("--set", setting)]
    assert main(long_shot.arguments(*more, "--jobs", "1")) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "smoke.0006.vdb has other content" in said
    assert "to do: timeCodes 5-8" in said and "kept: timeCodes 1-4,9-12," in said
    assert core.stylized == [5, 6, 7, 8]
    (found,) = find_records(long_shot.output)
    files = [found.place(frame.file) for frame in found.record.frames]
    stay = [path.stat().st_ino == inode for path, inode in zip(files, inodes, strict=True)]
    assert stay == [True] * 4 + [False] * 4 + [True] * 4
    assert verify(found.file) == []
    with pytest.raises(OutputExists, match="usdsmoke assemble"):
        run(long_shot, *ALONE)
    (root,) = long_shot.output.glob("shot_look.usda")
    fresh = run(dataclasses.replace(long_shot, output=long_shot.folder / "at_once"), *ALONE)
    assert contents(root) == contents(fresh.root_stage)


def test_a_rewritten_source_file_redoes_what_starts_from_it(
    long_shot: Shot, core: FakeCore
) -> None:
    """Coarse starts look two frames ahead, and go on to the end."""
    run(long_shot, *WINDOWS)
    rewrite_source(long_shot, 9)
    core.coarse.clear(), core.stylized.clear()
    result = run(long_shot, *WINDOWS)
    assert core.coarse == [7, 8, 9, 10, 11, 12]  # from the last one that stays on
    assert core.stylized[0] == 5 and {1, 2, 3, 4} & {*core.stylized} == set()
    fresh = run(dataclasses.replace(long_shot, output=long_shot.folder / "at_once"), *WINDOWS)
    assert contents(result.root_stage) == contents(fresh.root_stage)


def test_a_rewritten_source_file_leaves_the_extinction_that_was_measured_on_it(
    long_shot: Shot, core: FakeCore, tmp_path: Path
) -> None:
    run(long_shot, *ALONE)
    rewrite_source(long_shot, 12)
    core.scene = dataclasses.replace(core.scene, gamma_w=3.0)
    result = run(long_shot, *ALONE)
    assert result.extinction == {"/World/smoke": 2.0}
    (found,) = find_records(rerun(result.look_layer, tmp_path / "again").result.look_layer)
    assert found.record.extinction["/World/smoke"].colour == 2.0


def test_source_files_that_are_all_rewritten_are_a_refusal_with_its_reason(
    long_shot: Shot, core: FakeCore
) -> None:
    run(long_shot, *ALONE)
    for code in range(1, 13):
        rewrite_source(long_shot, code)
    with pytest.raises(OutputExists, match=r"smoke\.0001\.vdb .*smoke\.0005\.vdb ") as caught:
        run(long_shot, *ALONE)
    assert "select all" not in str(caught.value) and "measured" not in str(caught.value)
    assert core.stylized == [*range(1, 13)]


@pytest.mark.parametrize(("overlap", "redone"), [(0, {3, 4, 5, 6}), (1, {1, 2, 3, 4, 5, 6})])
def test_one_rewritten_file_of_a_short_shot_redoes_the_windows_that_it_reaches(
    tmp_path: Path, core: FakeCore, overlap: int, redone: set[float]
) -> None:
    """With default settings but windows of two: coarse starts look two frames ahead."""
    shot = make_shot(tmp_path / "shot", n_frames=6)
    settings = ("windows.size=2", f"windows.overlap={overlap}", "optics.gamma=2",
                "optics.gamma_shape=1", "layer.contact_sheet=0")  # fmt: skip
    run(shot, *settings)
    rewrite_source(shot, 5)
    core.stylized.clear()
    result = run(shot, *settings)
    assert {*core.stylized} == redone
    assert verify(result.look_layer) == []
    fresh = run(dataclasses.replace(shot, output=shot.folder / "at_once"), *settings)
    assert contents(result.root_stage) == contents(fresh.root_stage)


def test_one_rewritten_file_of_a_single_window_is_no_refusal(
    tmp_path: Path, core: FakeCore
) -> None:
    shot = make_shot(tmp_path / "shot", n_frames=4)
    run(shot)
    rewrite_source(shot, 2)
    core.stylized.clear()
    notes = make_plan(shot.stage, shot.style, shot.output).notes
    run(shot)
    assert core.stylized == [1, 2, 3, 4]
    assert "to do: timeCodes 1-4" in " ".join(notes)


@pytest.mark.usefixtures("core")
def test_a_part_of_a_result_whose_source_was_rewritten_is_refused_with_what_to_select(
    long_shot: Shot,
) -> None:
    run(long_shot, *ALONE)
    rewrite_source(long_shot, 6)
    with pytest.raises(OutputExists, match="select all"):
        run(long_shot, *ALONE, "stage.frames=6")


def test_a_rewritten_source_file_redoes_windows_of_a_farm(long_shot: Shot, core: FakeCore) -> None:
    run(long_shot, *ALONE)
    rewrite_source(long_shot, 6)
    core.stylized.clear()
    request = Request(long_shot.stage, long_shot.style, long_shot.output, ALONE)
    assert [run_window(request, window).was_done for window in (2, 0, 1)] == [True, True, False]
    assemble(long_shot.output)
    assert core.stylized == [5, 6, 7, 8]


@pytest.mark.usefixtures("core")
def test_a_plan_beside_a_result_does_not_read_files_that_look_as_they_did(
    long_shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = sorted((long_shot.folder / "in/cache").glob("*.vdb"))
    for file_path in files:
        os.utime(file_path, (1_000_000_000, 1_000_000_000))
    run(long_shot)
    rewrite_source(long_shot, 2)
    read = []
    monkeypatch.setattr("usdsmoke.runs.identity.hash_file", lambda name: read.append(name) or "0")
    found = make_plan(long_shot.stage, long_shot.style, long_shot.output)
    assert read == [str(files[1])]
    assert any("smoke.0002.vdb" in note for note in found.notes)


@pytest.mark.usefixtures("core")
def test_the_plan_of_a_frame_that_is_done_again_speaks_of_its_result(
    long_shot: Shot,
) -> None:
    run(long_shot, *ALONE)
    settings = [*ALONE, "stage.frames=6"]
    notes = " ".join(make_plan(long_shot.stage, long_shot.style, long_shot.output, settings).notes)
    assert "to do again: timeCodes 5-8" in notes and "kept: timeCodes 1-4,9-12, extinction" in notes
    assert "measured on 1 of" not in notes
    fresh = make_plan(long_shot.stage, long_shot.style, long_shot.folder / "fresh", settings).notes
    assert "measured on 1 of" in " ".join(fresh)

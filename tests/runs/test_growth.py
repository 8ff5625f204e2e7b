"""Looks that grow: what stays, what is done, and what is said where nothing may."""

import dataclasses
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.fixtures.grids_fixtures import raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import (
    FakeCore,
    Shot,
    contents,
    make_shot,
    rewrite_source,
    run,
    shown_files,
)
from tests.fixtures.usd_fixtures import (
    density_prim,
    file_hashes,
    sequence,
    volume_prim,
    world,
    write_text,
    write_vdb,
)
from usdsmoke import rerun, verify
from usdsmoke.audit.record import find_records
from usdsmoke.base.errors import Interrupted, OutputExists
from usdsmoke.pipeline import Request, assemble, run_window
from usdsmoke.pipeline import plan as make_plan
from usdsmoke.planning.plan import Plan
from usdsmoke.ui.cli.main import main

WINDOWS = ("windows.size=2", "windows.overlap=1")


@pytest.fixture
def long_shot(tmp_path: Path) -> Shot:
    return make_shot(tmp_path / "shot", n_frames=12)


def made_at_once(shot: Shot, frames: str, measured: str) -> dict[float, object]:
    """The result of a run of all frames, in another folder."""
    other = dataclasses.replace(shot, output=shot.folder / "at_once")
    settings = (*WINDOWS, f"stage.frames={frames}", f"optics.frames={measured}")
    return contents(run(other, *settings).root_stage)


@pytest.mark.usefixtures("core")
def test_a_look_of_two_frames_becomes_one_of_four_by_the_same_command(long_shot: Shot) -> None:
    run(long_shot, "stage.frames=1-2")
    result = run(long_shot, "stage.frames=1-4")
    assert [path.name for path in result.frames] == [f"smoke.000{n}.vdb" for n in (1, 2, 3, 4)]
    assert len(list(long_shot.output.glob("vdb/*"))) == 1
    assert verify(result.look_layer) == []


def test_windows_with_the_same_frames_and_starts_stay(long_shot: Shot, core: FakeCore) -> None:
    first = run(long_shot, *WINDOWS, "stage.frames=1-8")
    before = {path.name: path.stat().st_ino for path in first.frames}
    core.stylized.clear(), core.coarse.clear()
    result = run(long_shot, *WINDOWS, "stage.frames=1-12")
    # starts of 1 to 6 stay, so windows 1-2 (with 3) and 3-4 (with 5) do
    assert core.coarse == [7, 8, 9, 10, 11, 12]
    assert core.stylized == [5, 6, 7, 7, 8, 9, 9, 10, 11, 11, 12]
    assert [path.stat().st_ino == before.get(path.name) for path in result.frames][:4] == [
        True, True, False, True,  # 3 is blended again from both parts
    ]  # fmt: skip
    assert contents(result.root_stage) == made_at_once(long_shot, "1-12", "1-8")


@pytest.mark.usefixtures("core")
def test_a_look_grows_at_both_ends_and_more_than_once(long_shot: Shot) -> None:
    for frames in ("4-5", "4-9", "1-12"):
        result = run(long_shot, *WINDOWS, f"stage.frames={frames}")
    assert contents(result.root_stage) == made_at_once(long_shot, "1-12", "4,5")
    (found,) = find_records(result.look_layer)
    assert len(found.record.grown_from) == 2
    (of_frame,) = find_records(result.frames[0])
    assert of_frame.file == result.look_layer


def test_a_look_grows_as_windows_of_a_farm(long_shot: Shot, core: FakeCore) -> None:
    earlier = run(long_shot, *WINDOWS, "stage.frames=1-8")
    (first,) = find_records(earlier.look_layer)
    core.stylized.clear()
    settings = (*WINDOWS, "stage.frames=1-12")
    request = Request(long_shot.stage, long_shot.style, long_shot.output, settings)
    done = [run_window(request, window) for window in (5, 0, 3, 2, 4, 1)]
    assert [task.was_done for task in done] == [False, True, False, False, False, True]
    result = assemble(long_shot.output)
    assert contents(result.root_stage) == made_at_once(long_shot, "1-12", "1-8")
    (found,) = find_records(result.look_layer)
    assert found.record.grown_from == (first.record.run,)
    (kept,) = find_records(result.frames[0])
    assert kept.file == result.look_layer
    with pytest.raises(OutputExists, match="already holds"):
        run(long_shot, *settings)


def test_a_stopped_growth_leaves_the_result_and_goes_on(long_shot: Shot, core: FakeCore) -> None:
    first = run(long_shot, *WINDOWS, "stage.frames=1-8")
    before = file_hashes(first.frames[0].parent)

    def stop(code: float) -> None:
        if code == 9:
            raise KeyboardInterrupt

    core.before_frame = stop
    with pytest.raises(Interrupted):
        run(long_shot, *WINDOWS, "stage.frames=1-12")
    assert file_hashes(first.frames[0].parent) == before
    assert len(shown_files(first.root_stage)) == 12  # four show the source
    core.before_frame = lambda code: None
    core.stylized.clear()
    result = run(long_shot, *WINDOWS, "stage.frames=1-12")
    assert core.stylized[0] == 9  # the window that was interrupted, behind its last finished frame
    assert contents(result.root_stage) == made_at_once(long_shot, "1-12", "1-8")


def test_the_real_core_gives_a_grown_look_the_bits_of_one_made_at_once(tmp_path: Path) -> None:
    """What is taken over must not depend on later frames: see ``frames_ahead``."""
    shot = make_shot(tmp_path / "shot", n_frames=9)
    axes = np.meshgrid(*[np.linspace(-1, 1, n) for n in (8, 10, 8)], indexing="ij")
    for code in range(1, 10):
        radius = 0.5 + 0.04 * code
        ball = np.clip(radius - sum(axis**2 for axis in axes), 0, 1) * (1 + code / 10)
        write_raw(shot.stage.parent / f"cache/smoke.{code:04d}.vdb", raw_grid(ball))
    quick = (
        "optimize.iterations=4", "views.image_size=24", "views.pool=2", "optimize.threads=1",
        "layer.contact_sheet=0", "optimize.error_budget=false", "stage.motion=estimate",
        "features.layers=[oriented1,oriented2]",
    )  # fmt: skip
    first = run(shot, *WINDOWS, *quick, "stage.frames=1-7")
    old = {path.name: path.stat().st_ino for path in first.frames}
    grown = run(shot, *WINDOWS, *quick)
    stay = [path.name for path in grown.frames if path.stat().st_ino == old.get(path.name)]
    assert stay == ["smoke.0001.vdb", "smoke.0002.vdb", "smoke.0004.vdb"]  # 3 is blended again
    other = dataclasses.replace(shot, output=tmp_path / "at_once")
    at_once = run(other, *WINDOWS, *quick, "optics.frames=1-7")
    assert contents(grown.root_stage) == contents(at_once.root_stage)


@pytest.mark.usefixtures("core")
def test_a_grown_look_is_made_again_from_its_record(long_shot: Shot, tmp_path: Path) -> None:
    run(long_shot, *WINDOWS, "stage.frames=1-8")
    result = run(long_shot, *WINDOWS)
    again = rerun(result.look_layer, tmp_path / "again")
    assert again.differences == ()


@pytest.mark.usefixtures("core")
def test_the_plan_says_what_a_look_grows_from(long_shot: Shot) -> None:
    run(long_shot, "stage.frames=1-8")
    found = make_plan(long_shot.stage, long_shot.style, long_shot.output, "stage.frames=1-10")
    assert any("from the frames 1-8 to 1-10" in note for note in found.notes)
    found = make_plan(long_shot.stage, long_shot.style, long_shot.output, "optimize.seed=2")
    assert not any("grows" in note for note in found.notes)


def test_a_look_with_default_windows_grows_and_the_plan_names_what_stays(
    tmp_path: Path, core: FakeCore
) -> None:
    shot = make_shot(tmp_path / "shot", n_frames=20)
    first = run(shot, "stage.frames=1-16", "layer.contact_sheet=0")
    before = {path.name: path.stat().st_ino for path in first.frames}
    settings = ("stage.frames=1-20", "layer.contact_sheet=0")
    found = make_plan(shot.stage, shot.style, shot.output, settings)
    assert "kept: timeCodes 1-8, extinction and picture size" in found.notes
    assert "to do: timeCodes 9-20" in found.notes
    assert not any("measured" in note for note in found.notes)
    fresh = make_plan(shot.stage, shot.style, tmp_path / "fresh", settings)
    assert found.estimate.seconds < 0.8 * fresh.estimate.seconds
    core.stylized.clear()
    grown = run(shot, *settings)
    assert min(core.stylized) == 9
    stay = [path.name for path in grown.frames if path.stat().st_ino == before.get(path.name)]
    assert stay == [f"smoke.{code:04d}.vdb" for code in range(1, 9)]


@pytest.mark.usefixtures("core")
@pytest.mark.parametrize(
    ("first", "then", "settings", "kept", "why"),
    [
        ("1-2", "1-4", (), "", ["has other frames"]),
        ("1-8", "1-11", (), "", ["has other frames"]),
        ("1-8", "1-12", (), "", ["shares other frames"]),
        ("1-12", "1-16", (), "", ["coarse step that they start from", "has other frames"]),
        ("1-16", "1-20", (), "1-8", ["shares other frames"]),
        ("1-24", "1-28", (), "1-16", ["shares other frames"]),
        ("1-2", "1-4", ("windows.size=1",), "1,2", []),
        ("1-8", "1-20", ("windows.overlap=0", "windows.shared_octaves=0"), "1-8", []),
    ],
)
def test_the_plan_says_which_finished_frames_stay_and_why_others_change(
    tmp_path: Path, first: str, then: str, settings: tuple[str, ...], kept: str, why: list[str]
) -> None:
    shot, quick = make_shot(tmp_path / "shot", n_frames=28), ("layer.contact_sheet=0",)
    run(shot, *settings, *quick, f"stage.frames={first}")
    settings = (*settings, *quick, f"stage.frames={then}")
    notes = make_plan(shot.stage, shot.style, shot.output, settings).notes
    (stays,) = [note for note in notes if note.startswith("kept: ")]
    assert stays == f"kept: {f'timeCodes {kept}, ' if kept else ''}extinction and picture size"
    again = [note for note in notes if note.startswith("finished ")]
    assert len(again) == len(why), again
    assert all(text in note for text, note in zip(why, again, strict=True)), again


def test_the_plan_of_a_run_that_goes_on_tells_the_time_that_is_left(
    long_shot: Shot, core: FakeCore
) -> None:
    def stop(code: float) -> None:
        if code == 9:
            raise KeyboardInterrupt

    def told() -> Plan:
        return make_plan(long_shot.stage, long_shot.style, long_shot.output, WINDOWS)

    whole = told()
    core.before_frame = stop
    with pytest.raises(Interrupted):
        run(long_shot, *WINDOWS)
    left = told()
    assert left.estimate.seconds < 0.5 * whole.estimate.seconds
    assert any("goes on; done: timeCodes 1-6" in note for note in left.notes), left.notes


@pytest.mark.usefixtures("core")
def test_frames_that_a_simulation_adds_make_a_look_of_all_frames_longer(long_shot: Shot) -> None:
    short = make_shot(long_shot.folder / "day_one", n_frames=3)
    run(short)
    shutil.copyfile(long_shot.stage, short.stage)
    for code in range(4, 13):
        name = f"smoke.{code:04d}.vdb"
        shutil.copyfile(long_shot.folder / "in/cache" / name, short.folder / "in/cache" / name)
    assert len(run(short).frames) == 12


@pytest.mark.usefixtures("core")
def test_a_refusal_says_in_words_what_differs(
    long_shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    run(long_shot, "stage.frames=1-2")

    def refused(*more: str) -> str:
        assert main(long_shot.arguments(*more)) == 1
        return capsys.readouterr().err.splitlines()[-1]

    assert "frames were 1,2, now 3,4" in refused("--frames", "3-4")
    words = refused("--frames", "3-4", "--set", "optimize.seed=1")
    assert words.index("optimize.seed was 0, now 1") < words.index("frames were 1,2, now 3,4")
    # more frames are no reason: what keeps the look from growing is
    words = refused("--frames", "1-4", "--set", "optimize.seed=1")
    assert "optimize.seed was 0, now 1" in words and "frames were" not in words
    assert "make it longer" not in words
    text = long_shot.stage.read_text()
    moved = "double3 xformOp:translate = (1, 0, 0)\nuniform token[] xformOpOrder = "
    moved += '["xformOp:translate"]\n'
    place = text.index("{", text.index("def Volume")) + 1
    long_shot.stage.write_text(f"{text[:place]}\n{moved}{text[place:]}")
    words = refused("--frames", "1-4")
    assert "the place of </World/smoke> differs (a transform)" in words
    assert "frames were" not in words and "camera" not in words
    long_shot.stage.write_text(text)
    Image.new("RGB", (20, 20), "red").save(long_shot.style)
    assert "style image style.png has other content" in refused("--frames", "1-2")
    shutil.copyfile(long_shot.style, long_shot.style.with_name("ember.png"))
    other = dataclasses.replace(long_shot, style=long_shot.style.with_name("ember.png"))
    assert main(other.arguments("--frames", "1-2")) == 1
    assert "the style was style.png, now ember.png" in capsys.readouterr().err
    cache = write_vdb(long_shot.folder / "in/cache/smoke.0002.vdb", ("density",), value=0.125)
    os.utime(cache, (1_000_000_000, 1_000_000_000))
    assert "cache/smoke.0002.vdb has other content, written 2001-09-0" in refused("--frames", "1-4")


@pytest.mark.usefixtures("core")
def test_a_look_of_an_unfinished_simulation_is_finished_with_or_without_the_same_flag(
    tmp_path: Path,
) -> None:
    shot = make_shot(tmp_path / "shot", n_frames=5)
    cache, away = shot.stage.parent / "cache", tmp_path / "away"
    away.mkdir()
    for code in (3, 4, 5):
        (cache / f"smoke.{code:04d}.vdb").rename(away / f"{code}.vdb")
    quick = ("windows.size=1", "layer.contact_sheet=0")
    run(shot, *quick, "stage.allow_missing=true")
    for code in (3, 4):
        (away / f"{code}.vdb").rename(cache / f"smoke.{code:04d}.vdb")
    assert [change.kind for change in verify(shot.output)] == ["stage-frames"]
    again = make_plan(shot.stage, shot.style, shot.output, [*quick, "stage.frames=1-4"])
    assert "kept: timeCodes 1,2, extinction and picture size" in again.notes
    assert len(run(shot, *quick, "stage.allow_missing=true").frames) == 4
    (away / "5.vdb").rename(cache / "smoke.0005.vdb")
    result = run(shot, *quick)  # nothing is missing any more
    assert len(result.frames) == 5 and verify(result.look_layer) == []


def test_frames_that_the_stage_gets_hinder_no_repair_of_those_that_are_done(
    tmp_path: Path, core: FakeCore
) -> None:
    shot, quick = make_shot(tmp_path / "shot", n_frames=6), ("windows.size=1",)
    whole = shot.stage.read_text()
    part = world(volume_prim(density_prim(sequence((1, 2, 3, 4)))))
    shot.stage.write_text(part.replace("(\n", "(\nendTimeCode = 4\n", 1))
    first = run(shot, *quick)
    shot.stage.write_text(whole.replace("(\n", "(\nendTimeCode = 6\n", 1))
    core.stylized.clear()
    assert [change.kind for change in verify(first.look_layer)] == ["stage-frames"]
    with pytest.raises(OutputExists):
        run(shot, *quick, "stage.frames=1-4")
    assert len(run(shot, *quick, "stage.frames=2").frames) == 4  # redone
    assert core.stylized == [2]
    first.frames[2].unlink()
    assert len(run(shot, *quick, "stage.frames=3").frames) == 4  # repaired
    request = Request(shot.stage, shot.style, shot.output, (*quick, "stage.frames=1-4"))
    assert run_window(request, 0).was_done  # a task that is tried again
    assert len(run(shot, *quick).frames) == 6


@pytest.mark.usefixtures("core")
def test_tasks_of_all_frames_go_on_though_the_stage_gets_more(tmp_path: Path) -> None:
    shot, quick = make_shot(tmp_path / "shot", n_frames=3), ("windows.size=1",)
    whole = shot.stage.read_text()
    shot.stage.write_text(world(volume_prim(density_prim(sequence((1, 2))))))
    request = Request(shot.stage, shot.style, shot.output, quick)
    run_window(request, 0)
    shot.stage.write_text(whole)
    assert run_window(request, 0).was_done
    run_window(request, 1)
    assert len(assemble(shot.output).frames) == 2
    assert len(run(shot, *quick).frames) == 3


@pytest.mark.usefixtures("core")
def test_hashes_are_printed_on_request(long_shot: Shot, capsys: pytest.CaptureFixture[str]) -> None:
    run(long_shot, "stage.frames=1-2")
    for code in (1, 2):
        rewrite_source(long_shot, code)
    assert main(long_shot.arguments("--frames", "1-2")) == 1
    assert 'smoke.0002.vdb: was "' not in capsys.readouterr().err
    assert main(long_shot.arguments("--frames", "1-2", "--verbose")) == 1
    assert 'smoke.0002.vdb: was "' in capsys.readouterr().err


@pytest.mark.usefixtures("core")
def test_a_refusal_names_the_variant_that_was_switched(long_shot: Shot) -> None:
    shot = dataclasses.replace(long_shot, stage=long_shot.stage.with_name("takes.usda"))
    for name, stem in (("a", "smoke"), ("b", "other")):
        for code in (1, 2):
            target = shot.folder / f"in/cache/{stem}.000{code}.vdb"
            write_vdb(target, ("density",), value=0.5 if name == "a" else 0.75)
    fields = "".join(
        f"""
        "{name}" {{
            def OpenVDBAsset "density"
            {{
                asset filePath.timeSamples = {{
                    1: @cache/{stem}.0001.vdb@, 2: @cache/{stem}.0002.vdb@ }}
                token fieldName = "density"
            }}
        }}"""
        for name, stem in (("a", "smoke"), ("b", "other"))
    )

    def select(name: str) -> None:
        write_text(
            shot.stage,
            f"""#usda 1.0
            def Volume "smoke" (
                variantSets = ["take"]
                variants = {{ string take = "{name}" }} )
            {{
                rel field:density = </smoke/density>
                variantSet "take" = {{ {fields} }}
            }}""",
        )

    select("b")
    run(shot)
    select("a")
    with pytest.raises(OutputExists, match=r"the variant </smoke>\{take\}"):
        run(shot)


@pytest.mark.usefixtures("core")
def test_repeated_frames_of_a_result_keep_a_longer_run_that_is_not_finished(
    long_shot: Shot,
) -> None:
    run(long_shot, *WINDOWS, "stage.frames=1-5")
    settings = [*WINDOWS, "stage.frames=1-9"]
    run_window(Request(long_shot.stage, long_shot.style, long_shot.output, settings), 1)
    before = file_hashes(long_shot.output)
    with pytest.raises(OutputExists, match="unfinished"):
        run(long_shot, *WINDOWS, "stage.frames=4")
    assert file_hashes(long_shot.output) == before

"""Runs that are stopped, continued, refused, replaced: what stands in the folder afterwards."""

import dataclasses
import random
import re
import threading
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.fixtures.grids_fixtures import check_content
from tests.fixtures.pipeline_fixtures import (
    FakeCore,
    Shot,
    contents,
    copied,
    make_shot,
    run,
    shown_files,
    values_of,
    write_nan,
)
from tests.fixtures.usd_fixtures import file_hashes, write_text, write_vdb
from usdsmoke.base import publish
from usdsmoke.base.errors import Interrupted, LayerError, NonFiniteError, OutputExists, WriteFailed
from usdsmoke.base.volume import DenseField
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.core.smoke.device import Machine
from usdsmoke.pipeline import assemble, stylize
from usdsmoke.planning.job import Job
from usdsmoke.runs import identity
from usdsmoke.runs.budget import Finding
from usdsmoke.runs.run_machine import machine_of
from usdsmoke.vdb import store
from usdsmoke.vdb.read import GridRequest, read_grids

RESTYLIZE = ["stage.restylize=true"]


def stop_at(core: FakeCore, time_code: float) -> None:
    """Let Ctrl-C come just before a frame is stylized."""

    def stop(now: float) -> None:
        if now == time_code:
            raise KeyboardInterrupt

    core.before_frame = stop


def stop_no_more(core: FakeCore) -> None:
    core.before_frame = lambda time_code: None
    core.stylized.clear()


@pytest.mark.usefixtures("core")
def test_a_result_is_not_overwritten_without_force(shot: Shot) -> None:
    run(shot)
    before = file_hashes(shot.output)
    for settings, message in (
        ((), r"out already holds .*--force"),
        (
            ("optimize.seed=1",),
            r"different settings .*: the setting optimize\.seed was 0, now 1.*--force",
        ),
    ):
        with pytest.raises(OutputExists, match=message):
            run(shot, *settings)
    assert file_hashes(shot.output) == before


def test_the_first_frame_is_read_once_while_the_machine_is_looked_at(
    shot: Shot, core: FakeCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads, begun = Counter[Path](), threading.Event()

    def read(file_path: Path, requests: list[GridRequest], config: GridsConfig) -> list[DenseField]:
        reads[Path(file_path)] += 1
        begun.set()
        return read_grids(file_path, requests, config)

    def look(job: Job) -> Machine:
        assert begun.wait(30)  # passes only if another thread reads meanwhile
        return machine_of(job)

    monkeypatch.setattr(store, "read_grids", read)
    monkeypatch.setattr(identity, "machine_of", look)
    stop_at(core, 2.0)
    with pytest.raises(Interrupted):
        run(shot, "windows.size=1")
    assert list(reads.values()) == [1, 1, 1]
    reads.clear()
    with pytest.raises(OutputExists):
        run(shot, "windows.size=1", "optimize.seed=1")
    assert not reads  # it is refused
    stop_no_more(core)
    run(shot, "windows.size=1", "layer.contact_sheet=0")
    assert Path(shot.stage.parent / "cache/smoke.0001.vdb") not in reads  # its window is finished


@pytest.mark.usefixtures("core")
@pytest.mark.parametrize("settings", [(), ("optimize.seed=1",)], ids=["same", "other"])
def test_force_replaces_a_result_and_leaves_none_of_its_files(
    shot: Shot, settings: tuple[str, ...]
) -> None:
    old = run(shot)
    new = run(shot, *settings, force=True)
    assert not any(file_path.exists() for file_path in old.frames)
    assert list(shown_files(new.root_stage).values()) == [str(path) for path in new.frames]
    assert len(list(shot.output.glob("vdb/*"))) == 1


@pytest.mark.parametrize("time_code", [1.0, 3.0])
def test_the_old_result_stays_whole_until_the_new_one_is_complete(
    shot: Shot, core: FakeCore, time_code: float
) -> None:
    old = run(shot)
    before = {path: path.read_bytes() for path in (*old.frames, old.look_layer, old.root_stage)}

    stop_at(core, time_code)
    with pytest.raises(Interrupted):
        run(shot, "optimize.seed=1", force=True)
    assert {path: path.read_bytes() for path in before} == before
    assert list(shown_files(old.root_stage).values()) == [str(path) for path in old.frames]
    stop_no_more(core)
    new = run(shot, "optimize.seed=1", force=True)
    assert values_of(new.frames[0], "emission")[0, 0, 0, 0] == pytest.approx(0.625 / 2 * 2)
    assert not any(path.exists() for path in old.frames)


def test_a_stopped_run_goes_on_with_its_first_unfinished_window(shot: Shot, core: FakeCore) -> None:
    stop_at(core, 3.0)
    windows = ("windows.size=2", "windows.overlap=0")
    with pytest.raises(Interrupted, match=r"stopped with 2 of 3 frames finished.*same command"):
        run(shot, *windows)
    assert not list(shot.output.glob("*.usd*"))
    stop_no_more(core)
    result = run(shot, *windows)
    assert core.stylized == [3.0]
    assert len(shown_files(result.root_stage)) == 3


def test_frames_of_unfinished_windows_count_as_finished_once(
    tmp_path: Path, core: FakeCore
) -> None:
    shot = make_shot(tmp_path / "shot", n_frames=6)
    stop_at(core, 6.0)
    with pytest.raises(Interrupted, match=r"stopped with [2-5] of 6 frames finished"):
        run(shot, "windows.size=4", "windows.overlap=2")
    stop_no_more(core)


def test_a_damaged_record_of_a_run_is_named_and_replaced_with_force(
    shot: Shot, core: FakeCore
) -> None:
    stop_at(core, 2)
    with pytest.raises(Interrupted):
        run(shot)
    (record,) = shot.output.glob("vdb/*/run.json")
    record.write_text("{", encoding="utf-8")
    before = file_hashes(shot.output)
    with pytest.raises(LayerError, match=re.escape(str(record))):
        assemble(shot.output)
    with pytest.raises(OutputExists, match=re.escape(str(record))):
        run(shot)
    assert file_hashes(shot.output) == before
    stop_no_more(core)
    result = run(shot, force=True)
    assert len(core.stylized) == 3
    assert [path.name for path in shot.output.glob("vdb/*")] == [result.frames[0].parent.name]
    assert not record.exists()


def stopped_in_a_window(shot: Shot, core: FakeCore) -> Path:
    """Ctrl-C in the third of a window's four frames; its checkpoint."""
    stop_at(core, 3.0)
    with pytest.raises(Interrupted, match="0 of 1 windows"):
        run(shot)
    stop_no_more(core)
    (checkpoint,) = shot.output.glob("vdb/*/checkpoints/*")
    return checkpoint


def test_a_window_goes_on_behind_its_last_finished_frame(tmp_path: Path, core: FakeCore) -> None:
    shot = make_shot(tmp_path / "shot", n_frames=4)
    whole = contents(run(copied(shot, "whole")).root_stage)
    stopped_in_a_window(shot, core)
    result = run(shot)
    assert core.stylized == [3.0, 4.0]
    assert contents(result.root_stage) == whole
    temporal = [row.n_frames for row in result.error_budget.estimates if "temporal" in row.name]
    assert set(temporal) == {3}
    assert not list(result.frames[0].parent.glob("checkpoints"))


@pytest.mark.parametrize("change", ["checkpoint", "frame", "processor"])
def test_a_window_whose_checkpoint_is_of_no_use_is_done_again_and_told(
    shot: Shot, core: FakeCore, change: str
) -> None:
    checkpoint = stopped_in_a_window(shot, core)
    if change == "processor":
        core.processor = "another"
    else:
        changed = checkpoint
        if change == "frame":
            (changed,) = shot.output.glob("vdb/*/smoke.0001.vdb")
        changed.write_bytes(changed.read_bytes()[:-7])
    told: list[Finding] = []
    result = run(shot, progress=lambda state: told.extend(state.findings))
    assert core.stylized == [1.0, 2.0, 3.0]
    assert [item for item in told if "checkpoint of window 0" in item.cause]
    check_content(result.frames[0])


def test_a_finished_frame_that_was_damaged_since_is_done_again(shot: Shot, core: FakeCore) -> None:
    stop_at(core, 3.0)
    with pytest.raises(Interrupted):
        run(shot, "windows.size=1")
    (first,) = shot.output.glob("vdb/*/smoke.0001.vdb")
    first.write_bytes(first.read_bytes()[:-7])
    stop_no_more(core)
    result = run(shot, "windows.size=1")
    assert core.stylized == [1.0, 3.0]
    check_content(result.frames[0])


@pytest.mark.usefixtures("core")
@pytest.mark.parametrize(("frames", "advice"), [("2", "--force"), ("1-3", "--frames=2")])
def test_a_lost_frame_is_mended_as_the_refusal_says(shot: Shot, frames: str, advice: str) -> None:
    """Its own selection is no part of a result of one frame."""
    selected = [f"stage.frames={frames}", "windows.size=1"]
    done = run(shot, *selected)
    (lost,) = (file_path for file_path in done.frames if "0002" in file_path.name)
    lost.unlink()
    with pytest.raises(OutputExists, match=lost.name) as refusal:
        run(shot, *selected)
    assert advice in str(refusal.value)
    mended = run(shot, *selected, "stage.frames=2", force=advice == "--force")
    assert all(Path(file_path).is_file() for file_path in shown_files(mended.root_stage).values())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("setting", r"setting optimize\.seed was 0, now 5"),
        ("input", r"file cache/smoke\.0002\.vdb has other content, written 20\d\d-"),
        ("style", r"style image style\.png has other content"),
    ],
)
def test_an_unfinished_run_of_other_settings_or_inputs_is_not_mixed_with_this_one(
    shot: Shot, core: FakeCore, change: str, message: str
) -> None:
    stop_at(core, 2.0)
    with pytest.raises(Interrupted):
        run(shot, "windows.size=1")
    stop_no_more(core)
    settings = ("windows.size=1", *(["optimize.seed=5"] if change == "setting" else []))
    if change == "input":
        write_vdb(shot.stage.parent / "cache/smoke.0002.vdb", value=3.0)
    if change == "style":
        Image.new("RGB", (9, 9), "red").save(shot.style)
    with pytest.raises(OutputExists, match=message):
        run(shot, *settings)
    result = run(shot, *settings, force=True)
    assert len(list(shot.output.glob("vdb/*"))) == 1
    assert len(result.frames) == 3


def test_settings_that_do_not_change_the_result_do_not_hinder_going_on(
    shot: Shot, core: FakeCore
) -> None:
    stop_at(core, 3.0)
    with pytest.raises(Interrupted):
        run(shot, "windows.size=1")
    stop_no_more(core)
    run(shot, "windows.size=1", "optimize.memory_limit_gib=77", "grids.time_limit_s=77")
    assert core.stylized == [3.0]


def test_a_refusal_in_the_last_frame_leaves_nothing_behind(shot: Shot, core: FakeCore) -> None:
    write_nan(shot.stage.parent / "cache/smoke.0003.vdb")
    with pytest.raises(NonFiniteError, match=r"timeCode 3\) has 2 NaN"):
        run(shot)
    assert not shot.output.exists()
    assert core.stylized == []


def test_an_error_in_the_first_frame_leaves_no_folder(shot: Shot, core: FakeCore) -> None:
    def fail(time_code: float) -> None:
        raise NonFiniteError("the optimisation diverges")

    core.before_frame = fail
    with pytest.raises(NonFiniteError):
        run(shot)
    assert not shot.output.exists()


@pytest.mark.usefixtures("core")
def test_an_output_folder_that_was_there_stays_there(shot: Shot) -> None:
    shot.output.mkdir()
    write_text(shot.output / "notes.txt", "mine")
    write_nan(shot.stage.parent / "cache/smoke.0003.vdb")
    with pytest.raises(NonFiniteError):
        run(shot)
    assert [path.name for path in shot.output.iterdir()] == ["notes.txt"]


@pytest.mark.usefixtures("core")
def test_a_full_disk_at_any_moment_leaves_the_old_result_and_can_be_gone_on_from(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every renaming of a run fails once; each time the old result is what the stage shows."""
    old = run(shot)
    shown = shown_files(old.root_stage)
    original, calls = publish._sync, [0]
    for limit in random.Random(7).sample(range(1, 25), 5):
        calls[0] = 0

        def sync(file_path: Path, limit: int = limit) -> None:
            calls[0] += 1
            if calls[0] == limit:
                raise OSError(28, "No space left on device")
            original(file_path)

        monkeypatch.setattr(publish, "_sync", sync)
        try:
            run(shot, "optimize.seed=1", force=True)
        except WriteFailed as error:
            assert "No space left on device" in str(error)
        finally:
            monkeypatch.setattr(publish, "_sync", original)
        now = shown_files(old.root_stage)
        if now == shown:
            np.testing.assert_allclose(values_of(now[1.0], "emission")[..., 0], 0.3125)
        for file_path in now.values():
            check_content(file_path)
        assert not [path for path in shot.output.rglob(".*") if path.is_file()]
    new = run(shot, "optimize.seed=2", force=True)
    assert {path.parent.name for path in new.frames} == {
        path.name for path in shot.output.glob("vdb/*")
    }


def test_two_runs_do_not_write_to_one_folder(shot: Shot, core: FakeCore) -> None:
    def intrude(time_code: float) -> None:
        with pytest.raises(OutputExists, match="another usdsmoke"):
            run(shot)

    core.before_frame = intrude
    run(shot)


@pytest.mark.usefixtures("core")
def test_a_result_cannot_be_written_over_its_own_source(shot: Shot) -> None:
    result = run(shot)
    with pytest.raises(LayerError, match="an input"):
        stylize(result.root_stage, shot.style, shot.output, settings=RESTYLIZE, force=True)
    again = stylize(result.root_stage, shot.style, shot.folder / "second", settings=RESTYLIZE)
    np.testing.assert_allclose(values_of(again.frames[0]), 0.625 / 4)


@pytest.mark.usefixtures("core")
def test_the_result_may_stand_beside_its_source(shot: Shot) -> None:
    result = run(dataclasses.replace(shot, output=shot.stage.parent))
    assert result.root_stage.parent == shot.stage.parent
    assert len(shown_files(result.root_stage)) == 3


@pytest.mark.usefixtures("core")
def test_a_foreign_file_in_the_layers_place_counts_as_a_result(shot: Shot) -> None:
    write_text(shot.output / "look.usda", "#usda 1.0\n")
    with pytest.raises(OutputExists):
        run(shot)
    run(shot, force=True)


@pytest.mark.usefixtures("core")
def test_a_changed_layer_format_leaves_one_look(shot: Shot) -> None:
    run(shot)
    result = run(shot, "layer.format=usdc", force=True)
    assert [path.name for path in sorted(shot.output.glob("look.usd*"))] == ["look.usdc"]
    assert len(shown_files(result.root_stage)) == 3


@pytest.mark.usefixtures("core")
def test_a_moved_result_still_finds_its_files(shot: Shot) -> None:
    result = run(shot)
    moved = shot.folder.rename(shot.folder.with_name(f"{shot.folder.name}_elsewhere"))
    files = shown_files(moved / result.root_stage.relative_to(shot.folder))
    assert all(Path(file_path).is_file() for file_path in files.values())
    assert all("elsewhere" in file_path for file_path in files.values())

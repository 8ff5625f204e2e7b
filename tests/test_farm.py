"""Windows that are run one by one, anywhere and in any order: one result, whoever makes it."""

import json
import random
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.pipeline_fixtures import (
    PROJECT,
    FakeCore,
    Shot,
    contents,
    copied,
    make_shot,
    run,
    run_until,
    values_of,
)
from tests.usd_fixtures import write_vdb
from usdsmoke import assemble, run_coarse, run_window
from usdsmoke.cli import main
from usdsmoke.errors import ConfigError, LayerError, OutputExists

WINDOWS = ["windows.size=3", "windows.overlap=2"]  # 1-3 and on to 5, 4-6 and on to 7, 7
OPTIONS = [part for text in WINDOWS for part in ("--set", text)]
N_WINDOWS = 3

pytestmark = pytest.mark.usefixtures("core")


@pytest.fixture
def farm(tmp_path: Path) -> Shot:
    """Seven frames, three windows."""
    return make_shot(tmp_path / "shot", n_frames=7)


@pytest.fixture
def whole(farm: Shot) -> tuple[dict[float, object], str]:
    """What one process makes of the same shot."""
    return outcome(run(copied(farm, "whole"), *WINDOWS).root_stage)


def outcome(root_stage: Path) -> tuple[dict[float, object], str]:
    """Content hashes by timeCode, and the look layer's text without clock times and run id."""
    text = (root_stage.parent / "look.usda").read_text()
    run_id = re.search(r'string run = "([^"]+)"', text)
    assert run_id is not None
    for name in (run_id[1], run_id[1].replace("-", "")[:8]):
        text = text.replace(name, "RUN")
    text = re.sub(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", "TIME", text)
    return contents(root_stage), re.sub(r'"stylize=[\d.]+"', '"stylize=SECONDS"', text)


def windows_in(shot: Shot, order: Sequence[int]) -> None:
    for window in order:
        run_window(shot.stage, shot.style, shot.output, window, settings=WINDOWS)


def start(shot: Shot, *more: str) -> subprocess.Popen[str]:
    """A process of its own."""
    command = [sys.executable, "-m", "tests.run_to_be_killed", "0"]
    return subprocess.Popen(
        [*command, *shot.arguments(*OPTIONS, *more)],
        cwd=PROJECT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def run_folder(shot: Shot) -> Path:
    (record,) = shot.output.glob("vdb/*/run.json")
    return record.parent


def manifest(shot: Shot, window: int) -> dict[str, object]:
    values: dict[str, object] = json.loads(
        (run_folder(shot) / f"windows/{window:04d}.json").read_text()
    )
    return values


# The same bits, whoever does what when


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 1, 0], [1, 0, 2]], ids=str)
def test_windows_in_any_order_give_what_one_process_gives(
    farm: Shot, whole: tuple[dict[float, object], str], order: list[int]
) -> None:
    windows_in(farm, order)
    assert outcome(assemble(farm.output).root_stage) == whole


@pytest.mark.parametrize("windows", [[0, 1, 2], [1, 1, 1]], ids=["different", "same"])
def test_processes_at_once_give_what_one_process_gives(
    farm: Shot, whole: tuple[dict[float, object], str], windows: list[int], core: FakeCore
) -> None:
    at_once = [start(farm, "--window", str(window)) for window in windows]
    for process in at_once:
        _, err = process.communicate(timeout=60)
        assert process.returncode == 0, err
    assert len(list(farm.output.glob("vdb/*"))) == 1
    core.coarse.clear()
    windows_in(farm, sorted({0, 1, 2} - set(windows)))
    assert core.coarse == []  # it was done by one of them
    assert outcome(assemble(farm.output).root_stage) == whole


@pytest.mark.parametrize("part", [["--coarse"], ["--window", "1"]], ids=["coarse", "window"])
def test_killed_in_a_part_of_a_run_the_same_command_ends_in_the_same_bits(
    farm: Shot, whole: tuple[dict[float, object], str], part: list[str]
) -> None:
    code, steps = run_until(0, *copied(farm, "alive").arguments(*OPTIONS, *part))
    assert code == 0
    for number, step in enumerate(random.Random(4).sample(range(2, len(steps)), 2)):
        killed = copied(farm, f"killed{number}")
        assert run_until(step, *killed.arguments(*OPTIONS, *part))[0] == -9
        assert main(killed.arguments(*OPTIONS, *part)) == 0
        windows_in(killed, [2, 1, 0])
        assert outcome(assemble(killed.output).root_stage) == whole
        assert not [path for path in killed.output.rglob(".*") if path.is_file()]


def test_killed_while_assembling_there_is_no_result_or_a_whole_one(
    farm: Shot, whole: tuple[dict[float, object], str]
) -> None:
    windows_in(farm, [0, 1, 2])
    alive = copied(farm, "alive")
    code, steps = run_until(0, "assemble", str(alive.output))
    assert code == 0
    for number, step in enumerate(random.Random(5).sample(range(1, len(steps)), 3)):
        killed = copied(farm, f"killed{number}")
        assert run_until(step, "assemble", str(killed.output))[0] == -9
        if (killed.output / "shot_look.usda").exists():
            assert outcome(killed.output / "shot_look.usda") == whole
        assert outcome(assemble(killed.output).root_stage) == whole


def test_a_stopped_whole_run_goes_on_window_by_window_and_back(
    farm: Shot, whole: tuple[dict[float, object], str], core: FakeCore
) -> None:
    windows_in(farm, [1])
    core.stylized.clear()
    core.coarse.clear()
    result = run(farm, *WINDOWS)
    assert core.stylized == [1, 2, 3, 4, 5, 7] and core.coarse == []
    assert outcome(result.root_stage) == whole


# What stands in the folder


def test_a_manifest_tells_everything_about_its_window(farm: Shot) -> None:
    windows_in(farm, [1])
    told = manifest(farm, 1)
    frames = told["frames"]
    assert isinstance(frames, dict)
    record = json.loads((run_folder(farm) / "run.json").read_text())
    assert told["run_id"] == record["run_id"]
    assert (told["window"], told["volume"]) == (1, "/World/smoke")
    assert (told["time_codes"], told["beyond"]) == ([4, 5, 6], [7])
    parts = [f"parts/0001/smoke.{code:04d}.vdb" for code in (4, 5, 7)]
    assert sorted(frames) == sorted([*parts, "smoke.0006.vdb"])
    assert [name for name in sorted(frames) if frames[name]["part"]] == parts
    assert frames["smoke.0006.vdb"]["report"]["temporal error"]["colour"] == 0.5
    for name, frame in frames.items():
        assert (run_folder(farm) / name).is_file()
        assert len(frame["sha256"]) == len(frame["content_hash"]) == 64
        assert frame["source_hashes"]["density"] and frame["extent_min"]
    assert not (farm.output / "look.usda").exists()


def test_the_plan_lists_the_windows_of_all_volumes_by_number(
    farm: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(farm.arguments(*OPTIONS, "--dry-run", "--json")) == 0
    plan = json.loads(capsys.readouterr().out)
    told = [(w["index"], w["volume"], w["time_codes"], w["beyond"]) for w in plan["windows"]]
    assert told == [
        (0, "/World/smoke", [1, 2, 3], [4, 5]),
        (1, "/World/smoke", [4, 5, 6], [7]),
        (2, "/World/smoke", [7], []),
    ]
    assert any("coarse step over 7 frames" in sentence for sentence in plan["needed"])
    assert any("3 frames in two windows each" in sentence for sentence in plan["needed"])


def test_frames_of_an_overlap_are_the_blend_of_both_windows(farm: Shot) -> None:
    result = run(farm, *WINDOWS)
    folder = run_folder(farm)
    for code, windows, weight in [(4, "01", 2 / 3), (5, "01", 1 / 3), (7, "12", 1 / 2)]:
        name = f"smoke.{code:04d}.vdb"
        for grid in ("density", "emission"):
            tail, head = (values_of(folder / f"parts/000{k}/{name}", grid) for k in windows)
            assert not np.array_equal(tail, head)
            wanted = weight * tail.astype(float) + (1 - weight) * head.astype(float)
            np.testing.assert_allclose(values_of(folder / name, grid), wanted, rtol=1e-6)
    assert result.overlap_difference is not None
    assert 0 < result.overlap_difference["density"] < result.overlap_difference["emission"] < 1
    record = json.loads((folder / "run.json").read_text())
    assert record["frames"]["smoke.0005.vdb"]["report"]["overlap"]["windows"] == [0, 1]


def test_half_floats_are_rounded_once_after_blending(farm: Shot) -> None:
    result = run(farm, *WINDOWS, "grids.half=true")
    tail, head = (
        values_of(run_folder(farm) / f"parts/000{k}/smoke.0005.vdb", "emission") for k in (0, 1)
    )
    assert not np.array_equal(tail, tail.astype(np.float16))
    wanted = (head + (tail.astype(float) - head) / 3).astype(np.float32).astype(np.float16)
    np.testing.assert_array_equal(values_of(result.frames[4], "emission"), wanted)


def test_one_window_leaves_neither_parts_nor_coarse_files(farm: Shot, core: FakeCore) -> None:
    run(farm, "windows.size=7", "windows.overlap=0")
    assert core.coarse == []
    assert {path.name for path in run_folder(farm).iterdir() if path.is_dir()} == {"windows"}


def test_nothing_is_shared_across_a_cut(farm: Shot, core: FakeCore) -> None:
    run(farm, "windows.size=2", "stage.frames=1-3,6-7")
    assert core.coarse == [1, 2, 3]
    assert core.stylized == [1, 2, 3, 3, 6, 7]


def test_no_lock_is_left_with_a_result(farm: Shot) -> None:
    windows_in(farm, [0, 1, 2])
    assemble(farm.output)
    assert not list(farm.output.rglob("*.lock"))


# Once more, missing, changed, damaged


def test_what_is_done_is_done_and_assembling_twice_changes_nothing(
    farm: Shot, core: FakeCore
) -> None:
    windows_in(farm, [0, 1, 2])
    assemble(farm.output)
    before = {path: path.read_bytes() for path in farm.output.rglob("*") if path.is_file()}
    core.stylized.clear()
    for part in (["--window", "1"], ["--coarse"]):
        assert main(farm.arguments(*OPTIONS, *part)) == 0
    assert main(["assemble", str(farm.output)]) == 0
    after = {path: path.read_bytes() for path in farm.output.rglob("*") if path.is_file()}
    assert after == before and core.stylized == []


def test_missing_windows_are_listed(farm: Shot, capsys: pytest.CaptureFixture[str]) -> None:
    windows_in(farm, [1])
    with pytest.raises(LayerError, match=r"windows 0,2 of 3 \(counted from 0\) are not finished"):
        assemble(farm.output)
    assert main(["assemble", str(farm.output), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["error"]["type"] == "LayerError"
    assert not (farm.output / "look.usda").exists()


@pytest.mark.parametrize("window", [-1, 3, 99])
def test_a_window_that_is_not_there_is_refused_with_their_number(farm: Shot, window: int) -> None:
    message = rf"no window {window}: the plan has 3 windows, counted from 0 to 2"
    with pytest.raises(ConfigError, match=message):
        windows_in(farm, [window])
    assert main(farm.arguments(*OPTIONS, "--window", str(window))) == 1
    assert not farm.output.exists()


def test_a_window_of_other_settings_or_inputs_is_refused_by_what_has_changed(farm: Shot) -> None:
    windows_in(farm, [0])
    with pytest.raises(OutputExists, match=r"settings\.optimize\.seed was 0, now 5"):
        run_window(farm.stage, farm.style, farm.output, 1, settings=[*WINDOWS, "optimize.seed=5"])
    write_vdb(farm.stage.parent / "cache/smoke.0006.vdb", value=3.0)
    with pytest.raises(OutputExists, match=r"files\.cache/smoke\.0006\.vdb was .*, now "):
        windows_in(farm, [1])


def test_inputs_that_have_changed_are_not_assembled(farm: Shot) -> None:
    windows_in(farm, [0, 1, 2])
    write_vdb(farm.stage.parent / "cache/smoke.0006.vdb", value=3.0)
    with pytest.raises(OutputExists, match=r"no longer the same: files\.cache/smoke\.0006\.vdb"):
        assemble(farm.output)


@pytest.mark.parametrize("there", [False, True])
def test_a_folder_without_a_run_is_named(tmp_path: Path, there: bool) -> None:
    if there:
        (tmp_path / "out").mkdir()
    with pytest.raises(LayerError, match=r"there is no (run in|folder) .*out"):
        assemble(tmp_path / "out")
    assert (tmp_path / "out").exists() == there


def remove(file_path: Path) -> None:
    file_path.unlink()


def damage(file_path: Path) -> None:
    file_path.write_bytes(file_path.read_bytes()[:-9])


@pytest.mark.parametrize("harm", [remove, damage])
@pytest.mark.parametrize(
    "name", ["parts/0001/smoke.0004.vdb", "smoke.0006.vdb", "windows/0001.json"]
)
def test_a_window_whose_files_were_harmed_is_done_again(
    farm: Shot,
    whole: tuple[dict[float, object], str],
    core: FakeCore,
    name: str,
    harm: Callable[[Path], None],
) -> None:
    windows_in(farm, [0, 1, 2])
    harm(run_folder(farm) / name)
    with pytest.raises(LayerError, match="window 1 of 3"):
        assemble(farm.output)
    core.stylized.clear()
    windows_in(farm, [0, 1, 2])
    assert core.stylized == [4, 5, 6, 7]
    assert outcome(assemble(farm.output).root_stage) == whole


@pytest.mark.parametrize("harm", [remove, damage])
@pytest.mark.parametrize("name", ["coarse/smoke.0005.npz", "coarse.json"])
def test_coarse_files_that_were_harmed_are_made_again(
    farm: Shot,
    whole: tuple[dict[float, object], str],
    core: FakeCore,
    name: str,
    harm: Callable[[Path], None],
) -> None:
    windows_in(farm, [0])
    core.coarse.clear()
    harm(run_folder(farm) / name)
    windows_in(farm, [1, 2])
    assert core.coarse == [1, 2, 3, 4, 5, 6, 7]
    assert outcome(assemble(farm.output).root_stage) == whole


def test_what_a_run_that_was_removed_left_behind_is_not_taken(farm: Shot, core: FakeCore) -> None:
    windows_in(farm, [0, 1])
    (run_folder(farm) / "run.json").unlink()
    core.stylized.clear()
    windows_in(farm, [1])
    assert core.stylized == [4, 5, 6, 7]
    with pytest.raises(LayerError, match="windows 0,2 of 3"):
        assemble(farm.output)


def test_a_refused_first_window_leaves_nothing_and_a_later_one_what_was_there(
    farm: Shot, core: FakeCore
) -> None:
    def fail(time_code: float) -> None:
        raise KeyboardInterrupt

    core.before_coarse = fail
    assert main(farm.arguments(*OPTIONS, "--window", "2")) == 130
    assert not farm.output.exists()
    core.before_coarse = lambda time_code: None
    windows_in(farm, [2])
    core.before_frame = fail
    assert main(farm.arguments(*OPTIONS, "--window", "1")) == 130
    assert (run_folder(farm) / "windows/0002.json").is_file()


# Frames once more


def test_frames_of_a_finished_result_are_done_again_and_the_rest_stays(
    farm: Shot, whole: tuple[dict[float, object], str], core: FakeCore
) -> None:
    first = run(farm, *WINDOWS)
    kept = {path: path.read_bytes() for path in first.frames[:3]}
    before = first.frames[5].stat().st_mtime_ns
    core.stylized.clear()
    core.coarse.clear()
    assert main(farm.arguments(*OPTIONS, "--frames", "5-6")) == 0
    assert core.stylized == [4, 5, 6, 7] and core.coarse == []
    assert {path: path.read_bytes() for path in kept} == kept
    assert first.frames[5].stat().st_mtime_ns > before
    assert outcome(first.root_stage) == whole


def test_a_frame_that_has_vanished_from_a_result_comes_back(
    farm: Shot, whole: tuple[dict[float, object], str]
) -> None:
    first = run(farm, *WINDOWS)
    first.frames[4].unlink()
    run(farm, *WINDOWS, "stage.frames=5")
    assert outcome(first.root_stage) == whole


def test_frames_once_more_need_neither_parts_nor_coarse_files_that_were_cleared_away(
    farm: Shot, whole: tuple[dict[float, object], str], core: FakeCore
) -> None:
    first = run(farm, *WINDOWS)
    core.stylized.clear()
    for path in [*run_folder(farm).glob("parts/*/*"), *run_folder(farm).glob("coarse/*")]:
        path.unlink()
    run(farm, *WINDOWS, "stage.frames=2")
    assert core.stylized == [1, 2, 3, 4, 5, 4, 5, 6, 7, 7]
    assert outcome(first.root_stage) == whole


@pytest.mark.parametrize("settings", [["stage.frames=5-9"], ["stage.frames=5", "optimize.seed=1"]])
def test_frames_that_are_not_of_this_result_are_refused(farm: Shot, settings: list[str]) -> None:
    run(farm, *WINDOWS, "stage.frames=1-6")
    with pytest.raises(OutputExists, match="there is a result"):
        run(farm, *WINDOWS, *settings)


def test_killed_while_frames_are_done_again_the_stage_still_shows_the_result(
    farm: Shot, whole: tuple[dict[float, object], str]
) -> None:
    run(farm, *WINDOWS)
    again = (*OPTIONS, "--frames", "5")
    code, steps = run_until(0, *copied(farm, "alive").arguments(*again))
    assert code == 0
    for number, step in enumerate(random.Random(6).sample(range(1, len(steps)), 3)):
        killed = copied(farm, f"killed{number}")
        assert run_until(step, *killed.arguments(*again))[0] == -9
        assert outcome(killed.output / "shot_look.usda") == whole
        run(killed, *WINDOWS, "stage.frames=5")
        assert outcome(killed.output / "shot_look.usda") == whole


# Beside a result


def test_windows_replace_an_older_result_when_they_are_assembled(farm: Shot) -> None:
    old = run(farm, *WINDOWS, "optimize.seed=1")
    shown = contents(old.root_stage)
    with pytest.raises(OutputExists, match="there is a result"):
        windows_in(farm, [0])
    run_coarse(farm.stage, farm.style, farm.output, settings=WINDOWS, force=True)
    windows_in(farm, [2, 1, 0])
    assert contents(old.root_stage) == shown
    assert contents(assemble(farm.output).root_stage) != shown
    assert len(list(farm.output.glob("vdb/*"))) == 1


def test_a_whole_run_and_an_assembly_keep_out_of_a_worker_at_work(
    farm: Shot, core: FakeCore
) -> None:
    def intrude(time_code: float) -> None:
        core.before_frame = lambda time_code: None
        with pytest.raises(OutputExists, match="another usdsmoke is writing"):
            run(farm, *WINDOWS)
        with pytest.raises(OutputExists, match="another usdsmoke is writing"):
            assemble(farm.output)
        windows_in(farm, [2])  # another worker may come in

    core.before_frame = intrude
    windows_in(farm, [0])
    manifests = sorted(path.name for path in run_folder(farm).glob("windows/*.json"))
    assert manifests == ["0000.json", "0002.json"]

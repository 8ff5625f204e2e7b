"""Windows that are run one by one, anywhere and in any order: one result, whoever makes it."""

import json
import random

import numpy as np
import pytest

from tests.fixtures.farm_fixtures import OPTIONS, WINDOWS, Outcome, outcome, run_folder, windows_in
from tests.fixtures.forks import run_forks
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, copied, run, run_until, values_of
from usdsmoke.pipeline import assemble
from usdsmoke.ui.cli.main import main

# Weights of the earlier window in the two frames of an overlap: a smooth step down.
FIRST, SECOND = (1 - 3 * s**2 + 2 * s**3 for s in ((1 / 3) ** 1.2, (2 / 3) ** 1.2))


def manifest(shot: Shot, window: int) -> dict[str, object]:
    values: dict[str, object] = json.loads(
        (run_folder(shot) / f"windows/{window:04d}.json").read_text()
    )
    return values


# The same bits, whoever does what when


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 1, 0], [1, 0, 2]], ids=str)
def test_windows_in_any_order_give_what_one_process_gives(
    farm: Shot, whole: Outcome, order: list[int]
) -> None:
    windows_in(farm, order)
    assert outcome(assemble(farm.output).root_stage) == whole


@pytest.mark.parametrize("windows", [[0, 1, 2], [1, 1, 1]], ids=["different", "same"])
def test_processes_at_once_give_what_one_process_gives(
    farm: Shot, whole: Outcome, windows: list[int], core: FakeCore
) -> None:
    parts = [farm.arguments(*OPTIONS, "--window", str(window)) for window in windows]
    for code, told in run_forks([(0, part) for part in parts]):
        assert code == 0, told
    assert len(list(farm.output.glob("vdb/*/run.json"))) == 1
    core.coarse.clear()
    windows_in(farm, sorted({0, 1, 2} - set(windows)))
    assert core.coarse == []  # it was done by one of them
    assert outcome(assemble(farm.output).root_stage) == whole


@pytest.mark.parametrize("part", [["--coarse"], ["--window", "1"]], ids=["coarse", "window"])
def test_killed_in_a_part_of_a_run_the_same_command_ends_in_the_same_bits(
    farm: Shot, whole: Outcome, part: list[str]
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


def test_a_coarse_step_that_was_stopped_goes_on_with_its_first_unfinished_frame(
    farm: Shot, whole: Outcome, core: FakeCore
) -> None:
    def stop(time_code: float) -> None:
        if time_code == 5:
            raise KeyboardInterrupt

    core.before_coarse = stop
    assert main(farm.arguments(*OPTIONS, "--coarse")) == 130
    core.before_coarse = lambda time_code: None
    core.coarse.clear()
    windows_in(farm, [2, 0, 1])
    assert core.coarse == [5, 6, 7, 8]
    assert outcome(assemble(farm.output).root_stage) == whole


def test_killed_while_assembling_there_is_no_result_or_a_whole_one(
    farm: Shot, whole: Outcome
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
    farm: Shot, whole: Outcome, core: FakeCore
) -> None:
    windows_in(farm, [1])
    core.stylized.clear()
    core.coarse.clear()
    result = run(farm, *WINDOWS)
    assert core.stylized == [1, 2, 3, 4, 5, 7, 8] and core.coarse == []
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
    assert (told["time_codes"], told["overlap"]) == ([4, 5, 6], [7, 8])
    parts = [f"parts/0001/smoke.{code:04d}.vdb" for code in (4, 5, 7, 8)]
    assert sorted(frames) == sorted([*parts, "smoke.0006.vdb"])
    assert [name for name in sorted(frames) if frames[name]["part"]] == parts
    assert frames["smoke.0006.vdb"]["report"]["temporal"]["colour"] == 0.5
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
    told = [(w["index"], w["volume"], w["time_codes"], w["overlap"]) for w in plan["windows"]]
    assert told == [
        (0, "/World/smoke", [1, 2, 3], [4, 5]),
        (1, "/World/smoke", [4, 5, 6], [7, 8]),
        (2, "/World/smoke", [7, 8], []),
    ]
    assert any("coarse step over 8 frames" in sentence for sentence in plan["needed"])
    assert any("4 frames in two windows each" in sentence for sentence in plan["needed"])


def test_frames_of_an_overlap_are_the_blend_of_both_windows(farm: Shot) -> None:
    result = run(farm, *WINDOWS)
    folder = run_folder(farm)
    for code, windows, weight in [(4, "01", FIRST), (5, "01", SECOND), (8, "12", SECOND)]:
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
    wanted = (head + (tail.astype(float) - head) * SECOND).astype(np.float32).astype(np.float16)
    np.testing.assert_array_equal(values_of(result.frames[4], "emission"), wanted)


def test_one_window_leaves_neither_parts_nor_coarse_files(farm: Shot, core: FakeCore) -> None:
    run(farm, "windows.size=8", "windows.overlap=0")
    assert core.coarse == []
    assert {path.name for path in run_folder(farm).iterdir() if path.is_dir()} == {"windows"}


def test_nothing_is_shared_across_a_cut(farm: Shot, core: FakeCore) -> None:
    run(farm, "windows.size=2", "windows.overlap=1", "stage.frames=1-3,6-7")
    assert core.coarse == [1, 2, 3]
    assert core.stylized == [1, 2, 3, 3, 6, 7]


def test_no_lock_is_left_with_a_result_even_if_it_is_killed_in_its_last_step(farm: Shot) -> None:
    windows_in(farm, [0, 1, 2])
    assert list(farm.output.rglob("*.lock"))
    code, steps = run_until(0, "assemble", str(copied(farm, "alive").output))
    killed = copied(farm, "killed")
    assert run_until(len(steps), "assemble", str(killed.output))[0] == -9
    assert code == 0
    for shot in (farm, killed):
        assemble(shot.output)
        assert not list(shot.output.rglob("*.lock"))

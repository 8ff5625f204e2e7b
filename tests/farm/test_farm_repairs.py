"""Windows and frames once more: missing, changed, damaged, redone, replaced."""

import json
import random
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.fixtures.farm_fixtures import OPTIONS, WINDOWS, Outcome, outcome, run_folder, windows_in
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, contents, copied, run, run_until
from tests.fixtures.usd_fixtures import write_vdb
from usdsmoke.base import locks
from usdsmoke.base.errors import ConfigError, LayerError, OutputExists
from usdsmoke.pipeline import Request, assemble, run_coarse, run_window
from usdsmoke.ui.cli.main import main


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
    with pytest.raises(LayerError, match=r"windows 0,2 of 3 \(counted from 0\)"):
        assemble(farm.output)
    assert main(["assemble", str(farm.output), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["error"]["type"] == "LayerError"
    assert not (farm.output / "look.usda").exists()


@pytest.mark.parametrize("window", [-1, 3, 99])
def test_a_window_that_is_not_there_is_refused_with_their_number(farm: Shot, window: int) -> None:
    message = rf"no window {window}\..* 0 to 2"
    with pytest.raises(ConfigError, match=message):
        windows_in(farm, [window])
    assert main(farm.arguments(*OPTIONS, "--window", str(window))) == 1
    assert not farm.output.exists()


def test_a_window_of_other_settings_or_inputs_is_refused_by_what_has_changed(farm: Shot) -> None:
    windows_in(farm, [0])
    with pytest.raises(OutputExists, match=r"setting optimize\.seed was 0, now 5"):
        run_window(Request(farm.stage, farm.style, farm.output, [*WINDOWS, "optimize.seed=5"]), 1)
    write_vdb(farm.stage.parent / "cache/smoke.0006.vdb", value=3.0)
    with pytest.raises(OutputExists, match=r"file cache/smoke\.0006\.vdb has other"):
        windows_in(farm, [1])


def test_inputs_that_have_changed_are_not_assembled(farm: Shot) -> None:
    windows_in(farm, [0, 1, 2])
    write_vdb(farm.stage.parent / "cache/smoke.0006.vdb", value=3.0)
    with pytest.raises(OutputExists, match=r"inputs .*: the file cache/smoke\.0006\.vdb"):
        assemble(farm.output)


@pytest.mark.parametrize("there", [False, True])
def test_a_folder_without_a_run_is_named(tmp_path: Path, there: bool) -> None:
    if there:
        (tmp_path / "out").mkdir()
    with pytest.raises(LayerError, match=r"(run in|folder) .*out"):
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
    whole: Outcome,
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
    assert core.stylized == [4, 5, 6, 7, 8]
    assert outcome(assemble(farm.output).root_stage) == whole


@pytest.mark.parametrize("harm", [remove, damage])
@pytest.mark.parametrize(
    ("name", "again"),
    [("coarse/smoke.0005.npz", [5]), ("coarse.json", [1, 2, 3, 4, 5, 6, 7, 8])],
)
def test_coarse_files_that_were_harmed_are_made_again(
    farm: Shot,
    whole: Outcome,
    core: FakeCore,
    name: str,
    again: list[float],
    harm: Callable[[Path], None],
) -> None:
    windows_in(farm, [0])
    core.coarse.clear()
    harm(run_folder(farm) / name)
    windows_in(farm, [1, 2])
    assert core.coarse == again
    assert outcome(assemble(farm.output).root_stage) == whole


def test_what_a_run_that_was_removed_left_behind_is_not_taken(farm: Shot, core: FakeCore) -> None:
    windows_in(farm, [0, 1])
    (run_folder(farm) / "run.json").unlink()
    core.stylized.clear()
    windows_in(farm, [1])
    assert core.stylized == [4, 5, 6, 7, 8]
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
    farm: Shot, whole: Outcome, core: FakeCore
) -> None:
    first = run(farm, *WINDOWS)
    kept = {path: path.read_bytes() for path in first.frames[:3]}
    before = first.frames[5].stat().st_mtime_ns
    core.stylized.clear()
    core.coarse.clear()
    assert main(farm.arguments(*OPTIONS, "--frames", "5-6")) == 0
    assert core.stylized == [4, 5, 6, 7, 8] and core.coarse == []
    assert {path: path.read_bytes() for path in kept} == kept
    assert first.frames[5].stat().st_mtime_ns > before
    assert outcome(first.root_stage) == whole


def test_a_frame_that_has_vanished_from_a_result_comes_back(farm: Shot, whole: Outcome) -> None:
    first = run(farm, *WINDOWS)
    first.frames[4].unlink()
    run(farm, *WINDOWS, "stage.frames=5")
    assert outcome(first.root_stage) == whole


def test_frames_once_more_need_neither_parts_nor_coarse_files_that_were_cleared_away(
    farm: Shot, whole: Outcome, core: FakeCore
) -> None:
    first = run(farm, *WINDOWS)
    core.stylized.clear()
    for path in [*run_folder(farm).glob("parts/*/*"), *run_folder(farm).glob("coarse/*")]:
        path.unlink()
    run(farm, *WINDOWS, "stage.frames=2")
    assert core.stylized == [1, 2, 3, 4, 5, 4, 5, 6, 7, 8, 7, 8]
    assert outcome(first.root_stage) == whole


@pytest.mark.parametrize("settings", [["stage.frames=5-7"], ["stage.frames=5", "optimize.seed=1"]])
def test_frames_that_are_not_of_this_result_are_refused(farm: Shot, settings: list[str]) -> None:
    run(farm, *WINDOWS, "stage.frames=1-6")
    with pytest.raises(OutputExists, match="already holds"):
        run(farm, *WINDOWS, *settings)


def test_killed_while_frames_are_done_again_the_stage_still_shows_the_result(
    farm: Shot, whole: Outcome
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
    with pytest.raises(OutputExists, match="already holds"):
        windows_in(farm, [0])
    run_coarse(Request(farm.stage, farm.style, farm.output, WINDOWS, force=True))
    windows_in(farm, [2, 1, 0])
    assert contents(old.root_stage) == shown
    assert contents(assemble(farm.output).root_stage) != shown
    assert len(list(farm.output.glob("vdb/*"))) == 1


def test_a_whole_run_and_an_assembly_keep_out_of_a_worker_at_work(
    farm: Shot, core: FakeCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(locks, "_LONG_PATIENCE", 0.0)

    def intrude(time_code: float) -> None:
        core.before_frame = lambda time_code: None
        with pytest.raises(OutputExists, match="another usdsmoke"):
            run(farm, *WINDOWS)
        with pytest.raises(OutputExists, match="another usdsmoke"):
            assemble(farm.output)
        windows_in(farm, [2])  # another worker may come in

    core.before_frame = intrude
    windows_in(farm, [0])
    manifests = sorted(path.name for path in run_folder(farm).glob("windows/*.json"))
    assert manifests == ["0000.json", "0002.json"]


@pytest.mark.usefixtures("core")
def test_force_does_not_redo_a_finished_window_and_says_so(farm: Shot) -> None:
    windows_in(farm, [0])
    for force in (False, True):
        request = Request(farm.stage, farm.style, farm.output, WINDOWS, force=force)
        again = run_window(request, 0)
        assert again.was_done
        assert any("--force" in text for text in again.warnings) == force

"""A run's record: begun once, whoever comes first, and given back bit for bit."""

import json
from pathlib import Path

import pytest

from usdsmoke.runs.manifests import CoarseRecord, WindowRecord
from usdsmoke.runs.run import Run, find_runs

DESCRIPTION = {"settings": {"optimize": {"seed": 0}}, "features_hash": ""}
SCENES = [{"gamma_w": 0.1 + 0.2, "up_axis": "Z"}]


def make_run(folder: Path) -> Run:
    return Run(folder / "out/vdb/abc", DESCRIPTION)


def begin(run: Run, scenes: list[dict[str, object]] = SCENES) -> Run:  # type: ignore[assignment]
    run.begin({"windows": []}, {"stage": "../shot.usda"}, "kind")
    run.keep_scenes(scenes)
    return run


def test_of_two_that_begin_the_same_run_the_first_ones_record_counts(tmp_path: Path) -> None:
    first, second = make_run(tmp_path), make_run(tmp_path)
    assert first.run_id != second.run_id
    begin(first)
    begin(second, [{"gamma_w": 7.0}])
    assert (second.run_id, second.scenes) == (first.run_id, SCENES)
    assert len(list(find_runs(tmp_path / "out"))) == 1


def test_numbers_of_a_scene_come_back_bit_for_bit(tmp_path: Path) -> None:
    begin(make_run(tmp_path))
    (found,) = find_runs(tmp_path / "out")
    assert found.scenes[0]["gamma_w"].hex() == (0.1 + 0.2).hex()
    assert found.request == {"stage": "../shot.usda"}


@pytest.mark.parametrize("name", ["run.json", "scenes.json"])
def test_a_record_whose_values_were_changed_is_none(tmp_path: Path, name: str) -> None:
    run = begin(make_run(tmp_path))
    file_path = run.folder / name
    text = file_path.read_text(encoding="utf-8")
    file_path.write_text(text.replace("0.30000000000000004", '"x"').replace("kind", "sort"))
    runs = list(find_runs(tmp_path / "out"))
    assert not runs if name == "run.json" else not runs[0].scenes
    file_path.write_text(text, encoding="utf-8")
    (found,) = find_runs(tmp_path / "out")
    assert list(found.scenes) == SCENES


def window_of(run: Run, file_name: str, sha256: str) -> WindowRecord:
    frames = {file_name: {"sha256": sha256, "part": False}}
    return WindowRecord(run.run_id, 0, "/smoke", [1.0], [2.0], frames, 3.5)


def test_a_window_is_finished_as_long_as_its_files_are_unchanged(tmp_path: Path) -> None:
    run = begin(make_run(tmp_path))
    (run.folder / "windows").mkdir(exist_ok=True)
    (run.folder / "windows/.0001.tmp-0bbfd16a.json").write_text("{")  # killed while writing
    assert run.is_useless()
    (run.folder / "a.vdb").write_bytes(b"")
    empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    record = window_of(run, "a.vdb", empty)
    run.keep(record)
    assert run.window(0) == record and run.window(1) is None
    assert not run.is_useless()
    (run.folder / "a.vdb").write_bytes(b"x")
    assert run.window(0) is None


def test_manifests_of_other_runs_or_of_other_shapes_are_none(tmp_path: Path) -> None:
    run = begin(make_run(tmp_path))
    for values in ({"run_id": "another"}, {"run_id": run.run_id, "frames": 3}, [1], "text", None):
        run.manifest_path(0).parent.mkdir(exist_ok=True)
        run.manifest_path(0).write_text(json.dumps(values))
        assert run.window(0) is None
        (run.folder / "coarse.json").write_text(json.dumps(values))
        assert run.coarse().frames == {}


def test_only_coarse_frames_whose_files_stand_are_finished(tmp_path: Path) -> None:
    run = begin(make_run(tmp_path))
    empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    (run.folder / "coarse").mkdir()
    (run.folder / "coarse/a.npz").write_bytes(b"")
    frame = {"time_code": 1.0, "sha256": empty}
    run.keep(CoarseRecord(run.run_id, {"coarse/a.npz": frame, "coarse/b.npz": frame}))
    assert run.coarse().frames == {"coarse/a.npz": frame}

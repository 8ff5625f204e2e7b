"""What a window reads and needs, and what a refusal beside a result says."""

import os
import re
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from tests.fixtures.farm_fixtures import OPTIONS, WINDOWS, Outcome, outcome, run_folder, windows_in
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, run
from tests.fixtures.usd_fixtures import write_vdb
from usdsmoke.base.errors import OutputExists, PlanError
from usdsmoke.pipeline import Request, assemble, run_coarse
from usdsmoke.planning import frame_reader as pipeline_frames
from usdsmoke.planning import make_plan as plan_module
from usdsmoke.runs import identity as identity_module
from usdsmoke.runs import run as run_module
from usdsmoke.ui.cli.main import main


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often inputs and files of the run are hashed, and frames are read."""
    counts: Counter[str] = Counter()

    def count(module: Any, name: str, kind: str) -> None:
        function = getattr(module, name)

        def counted(*arguments: Any) -> Any:
            subject = arguments[0] if name == "hash_file" else arguments[1].time_code
            file_name = Path(subject).name if name == "hash_file" else f"{subject:g}"
            counts[f"{kind} {file_name}"] += 1
            return function(*arguments)

        monkeypatch.setattr(module, name, counted)

    count(identity_module, "hash_file", "input")
    count(run_module, "hash_file", "ours")
    count(pipeline_frames, "read_frame", "voxels")
    return counts


def test_a_window_reads_its_own_frames_and_coarse_files_alone_and_hashes_an_input_once_if_at_all(
    farm: Shot, core: FakeCore, opened: Counter[str]
) -> None:
    cache = farm.stage.parent / "cache"
    for file_path in cache.glob("*.vdb"):
        os.utime(file_path, (1_000_000_000, 1_000_000_000))
    run_coarse(Request(farm.stage, farm.style, farm.output, WINDOWS))
    opened.clear()
    own = (4, 5, 6, 7, 8)
    for code in (2, 5, 6):
        os.utime(cache / f"smoke.{code:04d}.vdb")
    windows_in(farm, [1])
    assert {n: k for n, k in opened.items() if n.startswith("input")} == {
        f"input smoke.{code:04d}.vdb": 1 for code in (5, 6)
    }
    assert {n for n in opened if n.startswith("voxels")} == {f"voxels {code}" for code in own}
    assert {n for n in opened if n.startswith("ours")} == {
        f"ours smoke.{code:04d}.npz" for code in own
    }


def test_a_window_does_not_mind_a_change_in_a_frame_that_it_does_not_read(
    farm: Shot, core: FakeCore
) -> None:
    run_coarse(Request(farm.stage, farm.style, farm.output, WINDOWS))
    write_vdb(farm.stage.parent / "cache/smoke.0007.vdb", value=3.0)
    windows_in(farm, [0])
    for again in (lambda: windows_in(farm, [1]), lambda: run(farm, *WINDOWS)):
        with pytest.raises(OutputExists, match=r"file cache/smoke\.0007\.vdb has other"):
            again()


def free_bytes(monkeypatch: pytest.MonkeyPatch, n_bytes: float) -> None:
    monkeypatch.setattr(plan_module, "free_disk_bytes", lambda folder: int(n_bytes))


def test_the_disk_must_hold_what_is_still_to_be_written(
    farm: Shot, whole: Outcome, core: FakeCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    free_bytes(monkeypatch, 64 * 2**20)
    with pytest.raises(PlanError, match=r" 67 MB, but"):
        windows_in(farm, [0])
    assert not farm.output.exists()
    free_bytes(monkeypatch, 66 * 2**20)
    windows_in(farm, [0])
    free_bytes(monkeypatch, 4.5 * 2**20)
    windows_in(farm, [1, 2])
    free_bytes(monkeypatch, 4 * 2**20)
    with pytest.raises(PlanError, match=r"about 0\.\d MB .* 4 MB, but"):
        run(farm, *WINDOWS)  # blended frames
    free_bytes(monkeypatch, 4.5 * 2**20)
    assert outcome(run(farm, *WINDOWS).root_stage) == whole


# What a refusal says


def edit_stage(shot: Shot) -> None:
    text = shot.stage.read_text(encoding="utf-8")
    shot.stage.write_text(text.replace("metersPerUnit = 0.5", "metersPerUnit = 2"))


CHANGES = {
    "file": (lambda shot: write_vdb(shot.stage.parent / "cache/smoke.0004.vdb", value=3.0), [],
             r"the file cache/smoke\.0004\.vdb has other content, written \d{4}-\d\d-\d\d"),
    "style": (lambda shot: Image.new("RGB", (9, 9), "red").save(shot.style), [],
              r"the style image style\.png has other content"),
    "setting": (lambda shot: None, ["--seed", "4"], r"the setting optimize\.seed was 0, now 4"),
    "stage": (edit_stage, [], r"the stage's metersPerUnit was 0\.5, now 2\.0"),
}  # fmt: skip


# one file that was written again is no refusal but for a part of the result
@pytest.mark.parametrize(("change", "way"), [
    ("file", ["--frames", "4"]),
    *((change, way) for change in ("style", "setting", "stage")
      for way in ([], ["--frames", "4"], ["--window", "1"])),
], ids=str)  # fmt: skip
def test_beside_a_result_the_refusal_names_what_has_changed(
    farm: Shot, core: FakeCore, change: str, way: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    run(farm, *WINDOWS)
    make, more, wanted = CHANGES[change]
    make(farm)
    assert main(farm.arguments(*OPTIONS, *way, *more)) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert re.search(rf"out .*result .*: {wanted}( \d\d:\d\d)?\. ", said), said
    assert len(re.findall(" was | has other", said)) == 1 and "--force" in said


def test_a_result_that_lacks_a_frame_says_which_one_and_how_it_is_made_again(
    farm: Shot, whole: Outcome, core: FakeCore, capsys: pytest.CaptureFixture[str]
) -> None:
    run(farm, *WINDOWS)
    for name in ("smoke.0006.vdb", "smoke.0002.vdb"):
        (run_folder(farm) / name).unlink()
    assert main(farm.arguments(*OPTIONS)) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "smoke.0002.vdb, smoke.0006.vdb are missing" in said
    (repair,) = re.findall(r"--frames=\S+", said)
    assert main(farm.arguments(*OPTIONS, repair, "--jobs", "1")) == 0
    assert outcome(farm.output / "shot_look.usda") == whole


def test_a_missing_frame_is_made_again_by_its_window_and_the_assembly_too(
    farm: Shot, whole: Outcome, core: FakeCore
) -> None:
    run(farm, *WINDOWS)
    (run_folder(farm) / "smoke.0006.vdb").unlink()
    windows_in(farm, [1])
    assert outcome(assemble(farm.output).root_stage) == whole

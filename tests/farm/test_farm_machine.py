"""What a run settles of the machine: windows elsewhere have the same bits, or it is told."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf

from tests.fixtures.farm_fixtures import OPTIONS, WINDOWS, outcome, run_folder, windows_in
from tests.fixtures.forks import run_forks
from tests.fixtures.grids_fixtures import raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import (
    PROJECT,
    FakeCore,
    Shot,
    contents,
    copied,
    make_shot,
    run,
)
from usdsmoke.audit import provenance
from usdsmoke.base.errors import OutputExists
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.pipeline import Request, assemble, run_coarse, run_window
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.ui.cli.main import main


def test_windows_of_one_run_may_have_different_numbers_of_threads(
    farm: Shot, core: FakeCore
) -> None:
    for number, threads in ((1, 3), (0, 1), (2, 0)):
        assert windows_in_with(farm, number, f"optimize.threads={threads}") == ()
    (record,) = provenance(assemble(farm.output).look_layer)
    machine = record.record.machine
    assert (machine.device, machine.processor) == ("cpu", "stand-in")


def test_another_device_is_refused_by_name(farm: Shot, core: FakeCore) -> None:
    windows_in(farm, [0])
    with pytest.raises(OutputExists, match=r'optimize\.device was "cpu", now "cuda"'):
        windows_in_with(farm, 1, "optimize.device=cuda:1")
    windows_in_with(farm, 1, "optimize.device=cpu")


def windows_in_with(shot: Shot, window: int, *settings: str) -> tuple[str, ...]:
    """One window; what the task says."""
    files = (shot.stage, shot.style, shot.output)
    return run_window(Request(*files, settings=[*WINDOWS, *settings]), window).warnings


def test_what_another_kind_of_processor_made_is_told(
    farm: Shot, core: FakeCore, capsys: pytest.CaptureFixture[str]
) -> None:
    run_coarse(Request(farm.stage, farm.style, farm.output, WINDOWS))
    assert windows_in_with(farm, 0) == ()
    core.processor = "older"
    (note,) = windows_in_with(farm, 2)
    assert "another kind of processor (older) than the run was begun on (stand-in)" in note
    told = json.loads((run_folder(farm) / "windows/0002.json").read_text())
    assert told["processor"] == "older"
    core.processor = "stand-in"
    windows_in_with(farm, 1)
    capsys.readouterr()
    assert main(["assemble", str(farm.output), "--json"]) == 0
    shown = capsys.readouterr()
    (warning,) = json.loads(shown.out)["warnings"]
    assert warning.startswith("window 2 ran on another kind of processor (older)")
    assert "window 2" in " ".join(shown.err.split())
    (record,) = provenance(farm.output)
    assert record.record.machine.others == {"window 2": "older"}


def test_a_run_of_other_settings_is_refused_as_soon_as_another_one_reads_its_first_frame(
    farm: Shot, core: FakeCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, refusals = FrameReader.read, []

    def read_while_another_begins(*arguments: Any) -> VolumeFrame:
        if not refusals:
            with pytest.raises(OutputExists) as caught:
                windows_in_with(farm, 0, "optimize.seed=5")
            refusals.append(str(caught.value))
        return read(*arguments)

    monkeypatch.setattr(FrameReader, "read", read_while_another_begins)
    windows_in(farm, [0, 1, 2])
    assert "optimize.seed was 0, now 5" in refusals[0]
    assert outcome(assemble(farm.output).root_stage)[0]


def test_of_two_different_runs_begun_at_once_one_is_refused_by_name(farm: Shot) -> None:
    seeds = [farm.arguments(*OPTIONS, "--window", "0", "--seed", seed) for seed in ("1", "5")]
    ends = sorted(run_forks([(0, arguments) for arguments in seeds]))
    assert [code for code, _ in ends] == [0, 1]
    refusal = ends[1][1]
    assert re.search(r"optimize\.seed was [15], now [15]", " ".join(refusal.split()))
    assert len(list(farm.output.glob("vdb/*/run.json"))) == 1


# What of two layers may differ: docs/farm.md
CLOCK = {f"usdsmoke:{key}" for key in ("created", "finished", "seconds", "figures", "error_budget")}
SEALS = {"usdsmoke:run", "usdsmoke:layerHash", "usdsmoke:recordHash"}


def authored(look_layer: Path) -> dict[tuple[str, str], Any]:
    """All values of a layer by path and field; the run's id reads RUN in paths and values."""
    layer, found = Sdf.Layer.FindOrOpen(str(look_layer)), {}
    run_id = layer.customLayerData["usdsmoke"]["run"]
    names = re.compile(f"{run_id}|{run_id[:8]}")

    def visit(path: Sdf.Path) -> None:
        if spec := layer.GetObjectAtPath(path):
            for key in spec.ListInfoKeys():
                value = spec.GetInfo(key)
                parts = [("", value)]
                if key == "customLayerData":
                    values = dict(value["usdsmoke"])
                    parts = [*json.loads(values.pop("record")).items(), *values.items()]
                for name, part in parts:
                    field = f"usdsmoke:{name}" if name else key
                    found[names.sub("RUN", str(path)), field] = names.sub("RUN", str(part))

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return found


def test_layers_of_a_farm_and_of_one_process_differ_in_clock_times_ids_and_seals_alone(
    farm: Shot, core: FakeCore
) -> None:
    one = authored(run(copied(farm, "one"), *WINDOWS).look_layer)
    windows_in(farm, [2, 0, 1])
    other = authored(assemble(farm.output).look_layer)
    assert one.keys() == other.keys() and len(one) > 80
    prim = "/World/smoke.authorship:usdsmoke_RUN"
    may_differ = {("/", key) for key in CLOCK | SEALS}
    may_differ |= {(f"{prim}:created", "default")}
    differ = {place for place in one if one[place] != other[place]}
    assert differ <= may_differ and {("/", key) for key in SEALS - {"usdsmoke:run"}} <= differ
    assert outcome(farm.output / "shot_look.usda") == outcome(
        farm.folder.parent / "one/out/shot_look.usda"
    )


def cloud(shift: float) -> np.ndarray:
    """Smoke large enough that threads share its sums, 16 x 24 x 16 voxels."""
    axes = [np.linspace(-1, 1, n) for n in (16, 24, 16)]
    place = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1) - [0, shift, 0]
    waves = 1 + 0.3 * np.sin(9 * place).prod(-1)
    return np.clip(1 - (place**2).sum(-1), 0, 1) * waves


def on_one_processor(*arguments: str) -> None:
    """The command in a process of its own that may use one processor only."""
    code = (
        "import os, sys; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}); "
        "from usdsmoke.ui.cli.main import main; sys.exit(main(sys.argv[1:]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=PROJECT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.usefixtures("quick_grids")
def test_the_real_core_gives_the_same_bits_on_one_processor_and_on_two(tmp_path: Path) -> None:
    shot = make_shot(tmp_path / "shot", n_frames=3)
    for code in (1, 2, 3):
        write_raw(shot.stage.parent / f"cache/smoke.{code:04d}.vdb", raw_grid(cloud(0.05 * code)))
    quick = [
        "features.layers=[oriented1, oriented2]", "optimize.iterations=3", "views.image_size=24",
        "views.pool=2", "windows.size=2", "windows.overlap=1", "optimize.error_budget=false",
    ]  # fmt: skip
    whole = run(copied(shot, "whole"), *quick)
    other = run(copied(shot, "other"), *quick, "optimize.threads=3")
    run_coarse(Request(shot.stage, shot.style, shot.output, quick))
    settings = [part for text in quick for part in ("--set", text)]
    on_one_processor(*shot.arguments(*settings, "--window", "0"))
    run_window(Request(shot.stage, shot.style, shot.output, quick), 1)
    result = assemble(shot.output)
    assert outcome(result.root_stage) == outcome(whole.root_stage)
    assert result.overlap_difference is not None
    assert 0 < result.overlap_difference["density"] < 1
    assert contents(other.root_stage) == contents(whole.root_stage)

"""A small simulated plume from end to end: what the plan foresees, the run tells of itself."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.pipeline_fixtures import PROJECT, make_style
from usdsmoke.base.frame_report import LEAST_MOVE
from usdsmoke.core.sequence.calibrate import calibrate
from usdsmoke.pipeline import StylizeResult, stylize
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.job import Job, Request, prepare_job
from usdsmoke.runs.budget import choose_settings
from usdsmoke.runs.run import find_runs

SETTINGS = (
    "stage.frames=2",
    "features.layers=[oriented1, oriented2]",
    "views.pool=4",
    "shape.iterations=[16, 16, 16]",
    "colour.iterations=[16, 16, 16]",
    "optimize.threads=1",
)
TIGHT, HOPELESS = 0.2, 1e-9


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Holds a plume of two frames, 24 voxels wide, and a style."""
    folder = tmp_path_factory.mktemp("plume")
    script = [sys.executable, str(PROJECT / "examples/plume/simulate.py"), str(folder)]
    subprocess.run([*script, "--frames", "2", "--resolution", "24"], check=True)
    make_style(folder / "style.png")
    return folder


@pytest.fixture(scope="module")
def results(folder: Path) -> dict[float | None, StylizeResult]:
    """With the defaults, and with tolerances."""
    return {target: run(folder, target) for target in (None, TIGHT, HOPELESS)}


def run(folder: Path, target: float | None) -> StylizeResult:
    """With as many iterations, so that the displacements are alike."""
    chosen = [] if target is None else [f"optimize.target_error={target}"]
    given = [text for text in SETTINGS if "pool" not in text] + ["optimize.iterations=48"]
    output = folder / f"out{target}"
    return stylize(folder / "plume.usda", folder / "style.png", output, settings=[*given, *chosen])


def job_of(folder: Path, *more: str) -> Job:
    settings = [*SETTINGS, *more]
    request = Request(folder / "plume.usda", folder / "style.png", folder / "none", settings)
    return prepare_job(request, fits=False)


def calibrated(job: Job) -> dict[str, Any]:
    (volume,) = job.plan.volumes
    frame = FrameReader(job.plan).read(volume, volume.frames[0])
    return calibrate(frame, job.pictures(volume), volume.config, "Y")


def rows(result: StylizeResult) -> dict[str, float]:
    assert result.error_budget is not None
    return {estimate.name: estimate.largest for estimate in result.error_budget.estimates}


def test_the_calibration_moves_the_smoke(folder: Path) -> None:
    """Or it would find a transport without any error."""
    assert calibrated(job_of(folder, "optimize.steps=[shape]"))["transport"]["moved"] > 0.5


@pytest.mark.parametrize("target", [TIGHT, HOPELESS])
def test_no_tolerance_gives_a_worse_transport_than_the_defaults(
    results: dict[float | None, StylizeResult], target: float
) -> None:
    assert results[target].plan.config.shape.interpolation == "cubic"
    assert rows(results[target])["transport"] < 1.1 * rows(results[None])["transport"]


def test_the_plan_foresees_transport_and_resolution(
    folder: Path, results: dict[float | None, StylizeResult]
) -> None:
    (kept,) = (folder / f"out{TIGHT}/vdb/calibration").glob("*.json")
    found, told = json.loads(kept.read_text()), rows(results[TIGHT])
    assert told["transport"] == pytest.approx(found["transport"]["cubic"], rel=0.5)
    foreseen = dict(found["image_sizes"])[results[TIGHT].plan.config.views.image_size]
    assert foreseen / 2 < told["resolution"] < 2 * foreseen


def test_every_row_that_is_not_kept_is_named_everywhere(
    results: dict[float | None, StylizeResult],
) -> None:
    result = results[HOPELESS]
    assert result.error_budget is not None and result.error_budget.tolerance is not None
    broken = result.error_budget.tolerance.broken
    assert {"resolution", "transport", "optimiser, shape"} <= {item.name for item in broken}
    for item in broken:
        assert any(f"is not kept: {item.name} is" in text for text in result.warnings)
    notes = result.plan.notes
    for name in ("resolution", "transport"):
        assert any("cannot be kept" in note and name in note for note in notes)
    (run,) = find_runs(result.look_layer.parent)
    assert run.error_budget["tolerance"] == result.error_budget.to_json()["tolerance"]


def test_a_run_without_a_tolerance_is_not_judged(
    results: dict[float | None, StylizeResult],
) -> None:
    budget = results[None].error_budget
    assert budget is not None and budget.tolerance is None
    assert not any("tolerance" in text for text in results[None].warnings)


def test_a_pilot_that_cannot_move_is_no_pilot_without_error(folder: Path) -> None:
    job = job_of(folder, "shape.learning_rate=1e-12", "optimize.steps=[shape]")
    found = calibrated(job)
    assert found["transport"]["moved"] < LEAST_MOVE
    assert found["transport"]["linear"] > 0.01 and "why" in found["steps"]["shape"]
    planned = {"shape": [16, 16, 16], "colour": [16, 16, 16]}
    choice = choose_settings(found, 0.1, planned, {})
    assert choice.settings["shape"] == {"interpolation": "cubic"}
    assert any(note.startswith("shape.iterations are unchanged") for note in choice.notes)
    assert any("hardly moved the smoke" in note for note in choice.notes)


def test_a_step_that_is_not_done_has_its_sentences(folder: Path) -> None:
    found = calibrated(job_of(folder, "optimize.steps=[colour]"))
    assert found["transport"] is None and set(found["steps"]) == {"colour"}
    choice = choose_settings(found, 0.1, {"shape": [16], "colour": [16]}, {})
    assert "shape.iterations are unchanged: there is no shape step" in choice.notes
    assert "shape.interpolation is unchanged: there is no shape step" in choice.notes

"""The job template run from end to end by the ``openjd`` command: the bits of a plain run."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.farm.test_farm import outcome
from tests.fixtures.grids_fixtures import raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import Shot, make_shot, run

PROJECT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
SETTINGS = {
    "optimize.iterations": 2,
    "views.image_size": 16,
    "views.pool": 2,
    "features.layers": "[oriented1]",
    "optimize.threads": 1,
    "optimize.error_budget": "false",
    "windows.size": 2,
    "windows.overlap": 1,
    "layer.look": "ember",
    "layer.mode": "reference",
}


@pytest.fixture(scope="module")
def shot(tmp_path_factory: pytest.TempPathFactory) -> Shot:
    """Three frames of a ball that rises, in a folder whose name has a space in it."""
    shot = make_shot(tmp_path_factory.mktemp("a shot"), n_frames=3)
    for code in (1, 2, 3):
        write_raw(shot.stage.parent / f"cache/smoke.{code:04d}.vdb", raw_grid(ball(0.1 * code)))
    return shot


def ball(shift: float) -> np.ndarray:
    """Smoke that thins out towards its border, 12 x 10 x 14 voxels."""
    axes = [np.linspace(-1, 1, n) for n in (12, 10, 14)]
    place = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1) - [0, 0, shift]
    return np.clip(1 - (place**2).sum(-1), 0, 1)


def call(*command: str | Path, folder: Path) -> str:
    """Run a command away from the project; what it printed."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(PROJECT)}
    done = subprocess.run(
        list(map(str, command)), cwd=folder, capture_output=True, text=True, env=environment
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def arguments(shot: Shot) -> list[str]:
    settings = [part for item in SETTINGS.items() for part in ("--set", "{}={}".format(*item))]
    return [str(shot.stage), "--style", str(shot.style), "-o", str(shot.output), *settings]


@pytest.mark.slow
def test_openjd_runs_the_template_to_the_bits_of_a_plain_run(shot: Shot) -> None:
    openjd, command = BIN / "openjd", BIN / "usdsmoke"
    if not openjd.exists() or not command.exists():
        pytest.skip(f"openjd-cli or usdsmoke is not installed in {BIN}")
    submit = [command, "submit", *arguments(shot), "--command", str(command), "--json"]
    job: dict[str, Any] = json.loads(call(*submit, folder=shot.folder))
    assert job["n_windows"] == 2
    values = [part for pair in job["parameters"].items() for part in ("-p", "=".join(pair))]
    told = call(openjd, "run", job["template"], *values, folder=shot.folder)
    assert "Session ended successfully" in told and "Chunks run: 4" in told

    plain = replace(shot, output=shot.folder / "plain")
    result = run(plain, *(f"{key}={value}" for key, value in SETTINGS.items()))
    assert len(result.frames) == 3
    assert result.root_stage.name == "shot_asset.usda"
    assert outcome(shot.output / result.root_stage.name) == outcome(result.root_stage)

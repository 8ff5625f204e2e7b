"""The real command with nothing replaced: two small frames, a handful of iterations."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import usdsmoke
from tests.fixtures.grids_fixtures import raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import Shot, make_shot
from tests.fixtures.usd_fixtures import file_hashes, needs_usd
from usdsmoke.base.volume import DenseField
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.core.smoke.thicken import Thickening
from usdsmoke.vdb.read import GridRequest, read_grids

PROJECT = Path(__file__).resolve().parents[2]
QUICK = [
    "optimize.iterations=6",
    "optics.thicken=5",
    "views.image_size=32",
    "views.pool=2",
    "optimize.threads=1",
]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Shot, dict[str, object]]:
    """A shot that was stylized, and what the command printed."""
    shot = make_shot(tmp_path_factory.mktemp("shot"), n_frames=2)
    for code in (1, 2):
        write_raw(shot.stage.parent / f"cache/smoke.{code:04d}.vdb", raw_grid(ball(0.1 * code)))
    before = file_hashes(shot.stage.parent)
    settings = [part for setting in QUICK for part in ("--set", setting)]
    done = subprocess.run(
        [sys.executable, "-m", "usdsmoke", *shot.arguments(*settings, "--json")],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    assert file_hashes(shot.stage.parent) == before
    return shot, json.loads(done.stdout)


def ball(shift: float) -> np.ndarray:
    """Smoke that thins out towards its border, 12 x 10 x 14 voxels."""
    axes = [np.linspace(-1, 1, n) for n in (12, 10, 14)]
    place = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1) - [shift, 0, 0]
    return np.clip(1 - (place**2).sum(-1), 0, 1)


def grids_of(file_path: str) -> tuple[DenseField, DenseField]:
    wanted = [GridRequest("density"), GridRequest("emission")]
    density, emission = read_grids(file_path, wanted, GridsConfig())
    return density, emission


@pytest.mark.slow
def test_the_files_hold_smoke_and_its_colours(finished: tuple[Shot, dict[str, object]]) -> None:
    shot, result = finished
    (found,) = usdsmoke.provenance(str(result["look_layer"]))
    (extinction,) = found.record.extinction.values()
    assert extinction.knee > 0
    curve = Thickening(extinction.thicken, extinction.knee)
    for number, file_path in enumerate(result["frames"], 1):  # type: ignore[arg-type, var-annotated]
        density, emission = grids_of(file_path)
        (source,) = read_grids(
            shot.stage.parent / f"cache/smoke.{number:04d}.vdb",
            [GridRequest("density")],
            GridsConfig(),
        )
        np.testing.assert_array_equal(density.index_to_world, source.index_to_world)
        np.testing.assert_array_equal(emission.index_to_world, source.index_to_world)
        assert density.values.sum() == pytest.approx(curve(source.values).sum(), rel=0.02)
        assert emission.values.min() >= 0 and emission.values.max() > 0
        assert np.ptp(emission.values, axis=-1).max() > 0  # colour, not grey
        low, high = np.array(density.ijk_min), np.add(density.ijk_min, density.values.shape)
        assert (np.array(emission.ijk_min) >= low).all()
        assert (np.add(emission.ijk_min, emission.values.shape[:3]) <= high).all()


@needs_usd(26, 5)
@pytest.mark.slow
def test_the_result_is_found_sound_by_every_validator(
    finished: tuple[Shot, dict[str, object]],
) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "usdsmoke", "validate", str(finished[1]["root_stage"]), "--json"],
        cwd=PROJECT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout
    assert json.loads(done.stdout)["errors"] == 0


@pytest.mark.usefixtures("quick_grids")
def test_fine_marks_are_enlarged_by_the_size_in_the_record(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, n_frames=1)
    write_raw(shot.stage.parent / "cache/smoke.0001.vdb", raw_grid(ball(0.0)))
    light = 0.5 + 0.5 * np.sin(np.linspace(0, 2 * np.pi * 7, 112))  # 2 to 3 voxels wide
    stripes = np.broadcast_to(light[:, None, None] * [250, 120, 20], (112, 112, 3))
    Image.fromarray(stripes.astype(np.uint8)).save(shot.style)

    told = {}

    def colours(name: str, *settings: str) -> tuple[float, np.ndarray]:
        made = usdsmoke.stylize(shot.stage, shot.style, tmp_path / name, [*QUICK, *settings])
        told[name] = [text for text in made.warnings if "times as large" in text]
        (found,) = usdsmoke.provenance(str(made.look_layer))
        (size,) = found.record.style_sizes.values()
        return size, grids_of(str(made.frames[0]))[1].values

    size, enlarged = colours("unset")
    assert size > 1
    np.testing.assert_array_equal(colours("set", f"style.size={size!r}")[1], enlarged)
    assert not np.array_equal(colours("one", "style.size=1")[1], enlarged)
    (words,) = told["unset"]
    assert f"{size:.3g} times" in words
    assert not told["set"] and not told["one"]

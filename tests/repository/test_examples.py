"""The examples run, and the plume's solver does what its docstrings say."""

import contextlib
import importlib
import io
import runpy
import subprocess
import sys
import threading
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pxr import Usd, UsdGeom, UsdRender, UsdVol

from usdsmoke.config.resolve import read_settings, resolve_config
from usdsmoke.ui.cli.main import main

PROJECT = Path(__file__).resolve().parents[2]
PLUME, STYLES = PROJECT / "examples" / "plume", PROJECT / "examples" / "styles"


def run_script(script: Path, *arguments: str | Path) -> str:
    """Run a script as ``python SCRIPT`` does, but in this process; what it prints."""
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        patch.syspath_prepend(str(script.parent))
        patch.setattr(sys, "argv", [str(script), *map(str, arguments)])
        runpy.run_path(str(script), run_name="__main__")
    return printed.getvalue()


def run_in_process(*command: str | Path) -> None:
    """Run a script in a process of its own."""
    done = subprocess.run([sys.executable, *map(str, command)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def plume(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A coarse plume of two frames: the stage's file."""
    folder = tmp_path_factory.mktemp("plume")
    run_script(PLUME / "simulate.py", folder, "--frames", "2", "--resolution", "12")
    return folder / "plume.usda"


@pytest.fixture
def solver(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(PLUME))
    return importlib.import_module("solver")


def read_grids(file_path: Path) -> dict[str, Any]:
    """OpenVDB's own grids by name."""
    name = next(m for m in ("openvdb", "pyopenvdb") if importlib.util.find_spec(m))
    grids, _ = importlib.import_module(name).readAll(str(file_path))
    return {grid.name: grid for grid in grids}


def whole(grid: Any) -> np.ndarray:
    """The voxels of a colour grid's active box."""
    first, last = np.array(grid.evalActiveVoxelBoundingBox())
    values = np.zeros((*np.maximum(last - first + 1, 1), 3), np.float32)
    grid.copyToArray(values, ijk=tuple(map(int, first)) if grid.activeVoxelCount() else (0, 0, 0))
    return values


def whole_box(grid: Any, *channels: int) -> np.ndarray:
    """All voxels of the coarse plume's box."""
    values = np.zeros((12, 20, 12, *channels), np.float32)
    grid.copyToArray(values)
    return values


def test_plume_stage_is_complete_and_its_files_resolve(plume: Path) -> None:
    stage = Usd.Stage.Open(str(plume))
    assert stage.GetDefaultPrim().GetPath() == "/plume"
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1.0, 2.0)
    volume = UsdVol.Volume.Get(stage, "/plume/smoke")
    assert volume.GetExtentAttr().HasAuthoredValue()
    assert UsdGeom.Camera.Get(stage, "/cameras/front")
    for name in ("density", "vel"):
        field = UsdVol.OpenVDBAsset.Get(stage, volume.GetFieldPath(name))
        assert field.GetFieldNameAttr().Get() == name
        for time_code in (1, 2):
            resolved = field.GetFilePathAttr().Get(time_code).resolvedPath
            assert resolved == str(plume.parent / f"plume.{time_code:04d}.vdb")
            assert Path(resolved).exists()


def test_plume_density_is_extinction_with_thick_columns_of_depth_four(plume: Path) -> None:
    depths = []
    for file_path in sorted(plume.parent.glob("plume.*.vdb")):
        grid = read_grids(file_path)["density"]
        depths.append(whole_box(grid).sum(axis=2) * grid.transform.voxelSize()[2])
    columns = np.stack(depths)
    thick = np.percentile(columns[columns > 0.01 * columns.max()], 90.0)
    assert thick == pytest.approx(4.0, rel=0.03)


def test_plume_rises_at_a_speed_that_fits_its_size(plume: Path) -> None:
    grids = read_grids(plume.parent / "plume.0001.vdb")
    density, velocity = whole_box(grids["density"]), whole_box(grids["vel"], 3)
    rising = (density * velocity[..., 1]).sum() / density.sum()
    assert 0.2 < rising < 5.0  # stage units per second, for a plume of two stage units
    assert abs((density * velocity[..., 0]).sum() / density.sum()) < rising


def test_plume_extent_holds_the_box_of_every_frame(plume: Path) -> None:
    stage = Usd.Stage.Open(str(plume))
    low, high = np.array(UsdVol.Volume.Get(stage, "/plume/smoke").GetExtentAttr().Get())
    for file_path in plume.parent.glob("plume.*.vdb"):
        for grid in read_grids(file_path).values():
            first, last = grid.evalActiveVoxelBoundingBox()
            for corner, sign in ((first, -0.5), (last, 0.5)):
                xyz = grid.transform.indexToWorld(tuple(float(i + sign) for i in corner))
                assert np.all(low - 1e-5 <= xyz) and np.all(xyz <= high + 1e-5)


def test_projection_leaves_a_flow_without_divergence_as_it_is(solver: ModuleType) -> None:
    """u = sin(x)cos(y), v = -cos(x)sin(y) on [0, pi]^3 has no divergence and obeys the walls."""
    centres = [np.pi * (np.arange(n) + 0.5) / n for n in (8, 12, 10)]
    x, y, z = np.meshgrid(*centres, indexing="ij")
    # The box is in index units, so the components scale with the voxels: 1/8 and 1/12 of pi.
    flow = np.stack([np.sin(x) * np.cos(y) * 8, -np.cos(x) * np.sin(y) * 12, 0 * z], axis=-1)
    np.testing.assert_allclose(solver.project(flow), flow, atol=1e-5)


def test_projection_removes_a_gradient_entirely(solver: ModuleType) -> None:
    centres = [np.pi * (np.arange(n) + 0.5) / n for n in (8, 12, 10)]
    x, y, z = np.meshgrid(*centres, indexing="ij")
    a, b, c = 2, 1, 3  # the potential is cos(a x) cos(b y) cos(c z)
    gradient = -np.stack(
        [
            a / 8 * np.sin(a * x) * np.cos(b * y) * np.cos(c * z),
            b / 12 * np.cos(a * x) * np.sin(b * y) * np.cos(c * z),
            c / 10 * np.cos(a * x) * np.cos(b * y) * np.sin(c * z),
        ],
        axis=-1,
    )
    assert np.abs(solver.project(gradient)).max() < 1e-6


def test_corner_samples_are_exact_on_a_linear_field(solver: ModuleType) -> None:
    ijk = np.stack(np.indices((4, 5, 6)), axis=-1).astype(np.float32)
    values = (ijk @ np.array([1.0, -2.0, 0.5], np.float32))[..., None]
    at = np.array([[0.3, 1.7, 2.25], [2.9, 3.5, 4.1]], np.float32)
    sampled, low, high = solver.corner_samples(values, at)
    np.testing.assert_allclose(sampled[:, 0], at @ np.array([1.0, -2.0, 0.5]), atol=1e-5)
    assert np.all(low <= sampled) and np.all(sampled <= high)


def test_corner_samples_are_the_same_in_one_chunk_and_in_many(
    solver: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = np.random.default_rng(1)
    values = source.random((6, 5, 4, 3), np.float32)
    positions = source.random((3, 7, 2, 3), np.float32) * 7 - 1  # beyond the box too
    one = solver.corner_samples(values, positions)
    monkeypatch.setattr(solver, "CHUNK", 5)
    many = solver.corner_samples(values, positions)
    assert [part.shape for part in many] == [(3, 7, 2, 3)] * 3
    assert all(map(np.array_equal, one, many))


def test_plume_is_the_same_every_time(solver: ModuleType) -> None:
    def density() -> np.ndarray:
        smoke = solver.SmokeSolver(10, solver.PlumeSettings())
        for _ in range(8):
            smoke.step(1.0 / 24.0)
        return smoke.density

    first = density()
    assert first.max() > 0.5
    np.testing.assert_array_equal(first, density())


def test_demo_settings_are_known_to_the_configuration() -> None:
    assert resolve_config(read_settings(PLUME / "config.yaml")).optimize.seed == 7


EXAMPLES = PROJECT / "examples"


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> tuple[str | Path, ...]:
    """A coarse plume of three frames and a small style, as options of the scripts."""
    folder = tmp_path_factory.mktemp("inputs")
    run_script(PLUME / "simulate.py", folder, "--frames", "3", "--resolution", "10")
    run_script(STYLES / "paint.py", folder, "--size", "48")
    return "--stage", folder / "plume.usda", "--style", folder / "waves.png"


def test_request_on_stage_fades_in(inputs: tuple[str | Path, ...], tmp_path: Path) -> None:
    # USD has to know the schema before the first stage is opened, hence the process
    run_in_process(EXAMPLES / "request_on_stage/author_request.py", *inputs, "--output", tmp_path)
    look = Usd.Stage.Open(str(tmp_path / "look/request_look.usda"))
    volume = UsdVol.Volume.Get(look, "/plume/smoke")
    field = UsdVol.OpenVDBAsset.Get(look, volume.GetFieldPath("density"))
    files = [field.GetFilePathAttr().Get(time_code).resolvedPath for time_code in (1, 3)]
    first, last = (read_grids(Path(file_path)) for file_path in files)
    assert 0 < whole(first["emission"]).max() < 0.01 * whole(last["emission"]).max()


def test_mask_paints_only_the_top(inputs: tuple[str | Path, ...], tmp_path: Path) -> None:
    run_in_process(
        EXAMPLES / "mask/mask_by_height.py", *inputs, "--output", tmp_path, "--frames", "3"
    )
    look = Usd.Stage.Open(str(tmp_path / "look/mask_look.usda"))
    volume = UsdVol.Volume.Get(look, "/plume/smoke")
    field = UsdVol.OpenVDBAsset.Get(look, volume.GetFieldPath("density"))
    emission = read_grids(Path(field.GetFilePathAttr().Get(3).resolvedPath))["emission"]
    values = np.zeros((12, 20, 12, 3), np.float32)
    emission.copyToArray(values)
    heights = np.argwhere(values.any(axis=-1))[:, 1]
    assert heights.min() > 0.25 * heights.max() > 0


def test_python_api_stylizes_two_frames(inputs: tuple[str | Path, ...], tmp_path: Path) -> None:
    script = EXAMPLES / "python_api/stylize_and_check.py"
    printed = run_script(script, *inputs, "--output", tmp_path)
    assert "/plume/smoke: 3 frames" in printed and "\n2 frames" in printed
    assert (tmp_path / "look.usda").exists()


def test_shot_camera_is_seen_through(inputs: tuple[str | Path, ...], tmp_path: Path) -> None:
    run_script(EXAMPLES / "shot_camera/orbit.py", *inputs, "--output", tmp_path)
    pixels = np.asarray(Image.open(tmp_path / "shot.png"))
    assert pixels.std(axis=(0, 1)).min() > 1.0
    stage = Usd.Stage.Open(str(tmp_path / "look/shot_look.usda"))
    assert UsdGeom.Camera.Get(stage, "/cameras/orbit")


def call_here(command: list[str], **options: Any) -> subprocess.CompletedProcess[str]:
    """``python -m usdsmoke`` without its process; one at a time, because stdout is caught."""
    assert command[:3] == [sys.executable, "-m", "usdsmoke"]
    printed = io.StringIO()
    with CALLS, contextlib.redirect_stdout(printed):
        code = main(command[3:])
    return subprocess.CompletedProcess(command, code, printed.getvalue())


CALLS = threading.Lock()


def test_farm_assembles_its_windows(
    inputs: tuple[str | Path, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The commands' own processes are those of the test of the job template."""
    monkeypatch.setattr(subprocess, "run", call_here)
    run_script(EXAMPLES / "farm/run_windows.py", *inputs, "--output", tmp_path)
    assert len(list(tmp_path.glob("vdb/*/windows/*.json"))) == 2
    assert (tmp_path / "plume_look.usda").exists()


def test_preview_writes_pictures(inputs: tuple[str | Path, ...], tmp_path: Path) -> None:
    stage = inputs[:2]
    run_script(EXAMPLES / "preview/draw_stage.py", *stage, "--output", tmp_path, "--width", "32")
    assert np.asarray(Image.open(tmp_path / "frame.png")).shape[1:] == (32, 4)
    assert (tmp_path / "sheet.png").exists() and (tmp_path / "layers.exr").exists()


def test_styles_are_painted_the_same_every_time_in_many_colours(
    inputs: tuple[str | Path, ...], tmp_path: Path
) -> None:
    first = Path(inputs[3]).parent
    run_script(STYLES / "paint.py", tmp_path, "--size", "48")
    names = {p.name for p in tmp_path.iterdir()}
    assert len(names) == 6 and {"strokes.png", "waves.png", "petals.png"} < names
    for name in names:
        pixels = np.asarray(Image.open(tmp_path / name))
        assert pixels.shape == (48, 48, 3)
        assert pixels.std(axis=(0, 1)).min() > 15.0  # no channel is flat
        np.testing.assert_array_equal(pixels, np.asarray(Image.open(first / name)))


def test_the_solaris_shot_composes_with_a_look_and_has_what_a_renderer_asks_for(
    tmp_path: Path,
) -> None:
    (tmp_path / "look").mkdir()
    look = Usd.Stage.CreateNew(str(tmp_path / "look/shot_look.usda"))
    UsdVol.Volume.Define(look, "/plume/smoke")
    look.Save()
    shot = tmp_path / "render_look.usda"
    shot.write_bytes((PROJECT / "examples/solaris/render_look.usda").read_bytes())
    stage = Usd.Stage.Open(str(shot))
    assert stage.GetPrimAtPath("/plume/smoke")
    settings = UsdRender.Settings.GetStageRenderSettings(stage)
    (product,) = settings.GetProductsRel().GetTargets()
    for prim in (settings.GetPrim(), stage.GetPrimAtPath(product)):
        (camera,) = prim.GetRelationship("camera").GetTargets()
        assert stage.GetPrimAtPath(camera).IsA(UsdGeom.Camera)
    (beauty,) = UsdRender.Product.Get(stage, product).GetOrderedVarsRel().GetTargets()
    assert stage.GetPrimAtPath(beauty).IsA(UsdRender.Var)

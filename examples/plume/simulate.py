"""Simulate a small plume and write it as VDB files and a stage that uses them.

    python examples/plume/simulate.py OUT_FOLDER [--frames 8] [--resolution 56]

Leaves in OUT_FOLDER:
    plume.usda        Volume /plume/smoke, camera /cameras/front, timeCodes 1..frames
    plume.####.vdb    density (fog volume) and vel (stage units per second, at voxel centres)

Density is written so that it can be used as extinction, 1/stage unit: the thick columns along the
camera's axis have an optical depth of about 4. The same arguments always give the same voxels.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol, Vt
from scipy import ndimage

from solver import HEIGHT, PlumeSettings, SmokeSolver

__all__ = ["main", "simulate"]

FRAMES_PER_SECOND = 24
WARM_UP_STEPS = 40  # until the plume fills about two thirds of the box's height
THICK_COLUMN_DEPTH = 4.0  # optical depth of the columns below
THICK_COLUMN_PERCENTILE = 90.0
THINNEST_SMOKE = 2e-3  # share of the greatest density below which a voxel counts as empty
VELOCITY_MARGIN = 3  # voxels around the smoke in which the velocity is kept


def import_openvdb() -> ModuleType:
    """OpenVDB's own Python module under either of its names."""
    try:
        import openvdb
    except ImportError:
        try:
            import pyopenvdb as openvdb
        except ImportError:
            sys.exit("OpenVDB's Python bindings are missing; run 'make env', which installs them")
    return openvdb


def run_solver(n_frames: int, resolution: int) -> tuple[list[np.ndarray], list[np.ndarray], float]:
    """Density [i j k] and velocity [i j k 3] of every frame, and the voxel size."""
    solver = SmokeSolver(resolution, PlumeSettings())
    densities, velocities = [], []
    n_steps = WARM_UP_STEPS + n_frames
    for step in range(n_steps):
        solver.step(1.0 / FRAMES_PER_SECOND)
        if step >= WARM_UP_STEPS:
            densities.append(solver.density.copy())
            velocities.append(solver.velocity.copy())
        if (step + 1) % 13 == 0 or step + 1 == n_steps:
            print(f"simulating: step {step + 1} of {n_steps}", file=sys.stderr, flush=True)
    return densities, velocities, solver.voxel_size


def extinction_scale(densities: Sequence[np.ndarray], voxel_size: float) -> float:
    """The one factor for all frames that gives the thick columns along Z their optical depth."""
    columns = np.stack([density.sum(axis=2) for density in densities]) * voxel_size
    smoky = columns[columns > 0.01 * columns.max()]
    return THICK_COLUMN_DEPTH / float(np.percentile(smoky, THICK_COLUMN_PERCENTILE))


def write_frame(
    file_path: Path, density: np.ndarray, velocity: np.ndarray, voxel_size: float
) -> np.ndarray:
    """Write one VDB file; the box of its active voxels, [2 3] in stage units, faces included."""
    openvdb = import_openvdb()
    n_i, _, n_k = density.shape
    first_centre = [
        (0.5 - 0.5 * n_i) * voxel_size,
        0.5 * voxel_size,
        (0.5 - 0.5 * n_k) * voxel_size,
    ]
    index_to_world = np.diag([voxel_size] * 3 + [1.0])
    index_to_world[3, :3] = first_centre
    near_smoke = ndimage.binary_dilation(density > 0.0, iterations=VELOCITY_MARGIN)
    velocity = np.where(near_smoke[..., None], velocity, 0.0)
    grids = []
    for name, kind, grid_class, values in (
        ("density", openvdb.FloatGrid, "fog volume", density),
        ("vel", openvdb.Vec3SGrid, "unknown", velocity),
    ):
        grid = kind()
        grid.copyFromArray(np.ascontiguousarray(values, dtype=np.float32))
        grid.name = name
        grid.gridClass = grid_class
        grid.transform = openvdb.createLinearTransform(index_to_world.tolist())
        grids.append(grid)
    grids[1].vectorType = "contravariant relative"  # a velocity turns with its volume
    openvdb.write(str(file_path), grids=grids, metadata={"creator": "usdsmoke examples/plume"})
    active = np.argwhere(near_smoke)
    corners = np.stack([active.min(axis=0) - 0.5, active.max(axis=0) + 0.5])
    return corners * voxel_size + first_centre


def author_stage(file_path: Path, frame_files: Sequence[Path], box: np.ndarray) -> None:
    """Write the stage: one Volume with two field prims, timeCode n showing the n-th file.

    Args:
        file_path: the stage to write, beside the VDB files.
        frame_files: one VDB file per frame.
        box: [2 3] stage units, around the smoke of all frames.
    """
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(FRAMES_PER_SECOND)
    stage.SetFramesPerSecond(FRAMES_PER_SECOND)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(len(frame_files))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/plume").GetPrim())
    volume = UsdVol.Volume.Define(stage, "/plume/smoke")
    volume.CreateExtentAttr(Vt.Vec3fArray([Gf.Vec3f(*map(float, corner)) for corner in box]))
    for name, data_type, field_class, role in (
        ("density", "float", "fogVolume", "None"),
        ("vel", "float3", "unknown", "Vector"),
    ):
        field = UsdVol.OpenVDBAsset.Define(stage, f"/plume/smoke/{name}")
        volume.CreateFieldRelationship(name, field.GetPath())
        field.CreateFieldNameAttr(name)
        field.CreateFieldDataTypeAttr(data_type)
        field.CreateFieldClassAttr(field_class)
        field.CreateVectorDataRoleHintAttr(role)
        # The default is for tools that never ask for a time.
        file_attribute = field.CreateFilePathAttr(Sdf.AssetPath(f"./{frame_files[0].name}"))
        for time_code, frame_file in enumerate(frame_files, start=1):
            file_attribute.Set(Sdf.AssetPath(f"./{frame_file.name}"), time_code)
    _author_camera(stage)
    stage.GetRootLayer().Export(str(file_path))


def _author_camera(stage: Usd.Stage) -> None:
    """A camera in front of the box, level with its middle, that sees all of it."""
    distance, margin = 5.0, 1.12
    UsdGeom.Xform.Define(stage, "/cameras")
    camera = UsdGeom.Camera.Define(stage, "/cameras/front")
    camera.AddTranslateOp().Set(Gf.Vec3d(0.0, 0.5 * HEIGHT, distance))
    aperture = 24.0
    camera.CreateHorizontalApertureAttr(aperture)
    camera.CreateVerticalApertureAttr(aperture)
    camera.CreateFocalLengthAttr(aperture * distance / (margin * HEIGHT))
    camera.CreateFocusDistanceAttr(distance)
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.1, 100.0))


def simulate(out_folder: Path, n_frames: int, resolution: int) -> Path:
    """Simulate, write everything into ``out_folder``, and return the stage's file."""
    out_folder.mkdir(parents=True, exist_ok=True)
    densities, velocities, voxel_size = run_solver(n_frames, resolution)
    scale = extinction_scale(densities, voxel_size)
    files, boxes = [], []
    for number, (density, velocity) in enumerate(zip(densities, velocities, strict=True), start=1):
        extinction = np.where(density > THINNEST_SMOKE * density.max(), scale * density, 0.0)
        files.append(out_folder / f"plume.{number:04d}.vdb")
        boxes.append(write_frame(files[-1], extinction, velocity, voxel_size))
    box = np.stack([np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]])
    stage_file = out_folder / "plume.usda"
    author_stage(stage_file, files, box)
    return stage_file


def main() -> None:
    """Read the command line, simulate, and print what was written."""
    parser = argparse.ArgumentParser(description="Simulate a small plume of smoke.")
    parser.add_argument("out_folder", type=Path)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--resolution", type=int, default=56, help="voxels along the box's width")
    options = parser.parse_args()
    if options.frames < 1 or options.resolution < 8:
        parser.error("--frames must be at least 1 and --resolution at least 8")
    import_openvdb()  # fail before the work, not after it
    started = time.perf_counter()
    stage_file = simulate(options.out_folder, options.frames, options.resolution)
    print(f"{stage_file}  ({options.frames} frames, {time.perf_counter() - started:.1f} s)")


if __name__ == "__main__":
    main()

"""Stages over real volumes that are not part of the repository.

    python -m benchmarks.stages [--data ../shared/data] [--out out/bench] [--coarser 2]

Writes a stage over the real plume (nothing of the data is copied, the stage refers to it by a
relative path) and prints the path of every stage to measure on, one a line, with its name. With
--coarser N it also writes the plume with voxels N times the size, and a stage over it.
"""

import argparse
import os
import sys
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol

from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.base.volume import DenseField
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb.header import GridHeader, read_header
from usdsmoke.vdb.read import GridRequest, read_grids
from usdsmoke.vdb.write import write_frame

__all__ = ["author_plume_stage", "find_stages", "main", "write_coarser"]

PLUME_FILE = "cortex/smoke.vdb"
HOUDINI_STAGE = "arnold-usd/test_2315.usda"
MARGIN = 1.08  # of the camera's picture around the plume's box
APERTURE = 24.0  # of the camera, in tenths of a stage unit


def find_stages(data_folder: Path, out_folder: Path) -> dict[str, Path]:
    """The benchmark stages by name; writes those that have to be written.

    Raises:
        FileNotFoundError: a data file is missing.
    """
    for wanted in (PLUME_FILE, HOUDINI_STAGE):
        if not (data_folder / wanted).is_file():
            raise FileNotFoundError(
                f"no {wanted} in {data_folder}; wanted real volumes there; name it with --data"
            )
    plume = author_plume_stage(data_folder / PLUME_FILE, out_folder / "real_plume.usda")
    return {"real_plume": plume, "houdini_grids": data_folder / HOUDINI_STAGE}


def author_plume_stage(vdb_file: Path, stage_file: Path) -> Path:
    """A Y-up stage: the Volume /plume/smoke over one file's ``density``, a camera before it.

    The camera /cameras/front looks along -Z at the middle of the active box, as a stylization's
    middle view does, through a long lens; its picture is square. (It is not orthographic, for
    Blender 5.0 takes an orthographic aperture for ten times what it is.)
    """
    grid = next(grid for grid in read_header(vdb_file).grids if grid.name == "density")
    low, high = _world_box(grid)
    stage_file.parent.mkdir(parents=True, exist_ok=True)
    stage_file.unlink(missing_ok=True)
    stage = Usd.Stage.CreateNew(str(stage_file))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/plume").GetPrim())
    volume = UsdVol.Volume.Define(stage, "/plume/smoke")
    volume.CreateExtentAttr([Gf.Vec3f(*low), Gf.Vec3f(*high)])
    asset = UsdVol.OpenVDBAsset.Define(stage, "/plume/smoke/density")
    relative = os.path.relpath(vdb_file.resolve(), stage_file.resolve().parent)
    asset.CreateFilePathAttr(Sdf.AssetPath(Path(relative).as_posix()))
    asset.CreateFieldNameAttr("density")
    asset.CreateFieldDataTypeAttr(UsdVol.Tokens.half if grid.half else UsdVol.Tokens.float_)
    asset.CreateFieldClassAttr(UsdVol.Tokens.fogVolume)
    volume.CreateFieldRelationship("density", asset.GetPath())
    _author_camera(stage, low, high)
    stage.GetRootLayer().Save()
    return stage_file


def write_coarser(vdb_file: Path, factor: int, out_folder: Path) -> Path:
    """A stage over the means of ``factor``³ voxels each of a file's density."""
    (density,) = read_grids(vdb_file, [GridRequest("density")], GridsConfig())
    values = np.pad(density.values, [(0, -size % factor) for size in density.values.shape])
    sizes = [size // factor for size in values.shape]
    values = values.reshape([n for size in sizes for n in (size, factor)]).mean(axis=(1, 3, 5))
    matrix = density.index_to_world.copy()
    first = np.array(density.ijk_min) + (factor - 1) / 2  # the middle of the first block
    matrix[3] = np.array([*first, 1.0]) @ matrix
    matrix[:3] *= factor
    field = DenseField("density", values.astype(np.float32), (0, 0, 0), matrix)
    out_folder.mkdir(parents=True, exist_ok=True)
    coarse_file = out_folder / f"plume_coarser_{factor}.vdb"
    write_frame(coarse_file, [field], {}, half=False)
    return author_plume_stage(coarse_file, coarse_file.with_suffix(".usda"))


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="real volumes")
    parser.add_argument("--out", type=Path, default=Path("out/bench"), help="folder to write into")
    parser.add_argument("--coarser", type=int, metavar="N", help="times the voxels' size")
    options = parser.parse_args(arguments)
    try:
        stages = find_stages(options.data, options.out)
        if options.coarser:
            plume = options.data / PLUME_FILE
            stages["coarser_plume"] = write_coarser(plume, options.coarser, options.out)
    except (FileNotFoundError, UsdSmokeError) as error:
        print(f"benchmarks.stages: {error}", file=sys.stderr)
        return 1
    for name, stage_file in stages.items():
        print(f"{name}\t{stage_file}")
    return 0


def _world_box(grid: GridHeader) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the active box in the grid's world space, voxels taken whole."""
    low, high = np.array(grid.bbox_min) - 0.5, np.array(grid.bbox_max) + 0.5
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), [1.0]), axis=-1).reshape(-1, 4)
    world = (corners @ grid.index_to_world)[:, :3]
    return world.min(axis=0), world.max(axis=0)


def _author_camera(stage: Usd.Stage, low: np.ndarray, high: np.ndarray) -> None:
    middle, size = (low + high) / 2, high - low
    distance = 6.0 * float(size.max())
    side = MARGIN * float(max(size[:2])) * (1.0 + size[2] / 2 / distance)  # the near face fits too
    UsdGeom.Scope.Define(stage, "/cameras")
    camera = UsdGeom.Camera.Define(stage, "/cameras/front")
    camera.CreateHorizontalApertureAttr(APERTURE)
    camera.CreateVerticalApertureAttr(APERTURE)
    camera.CreateFocalLengthAttr(APERTURE * distance / side)
    camera.CreateClippingRangeAttr(Gf.Vec2f(distance * 0.1, distance * 3.0))
    place = Gf.Vec3d(*(middle + np.array([0.0, 0.0, distance])))
    UsdGeom.XformCommonAPI(camera).SetTranslate(place)


if __name__ == "__main__":
    sys.exit(main())

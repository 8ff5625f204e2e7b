"""Paint only the top of a plume: write a mask that grows with height, and stylize with it.

    python examples/mask/mask_by_height.py

The mask is a grid of its own, in files of its own, which a layer over the stage adds to the Volume.
Below the mask smoke gets no colours. It would be black, so that a sun and a sky light it.
"""

import argparse
import importlib
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdVol

import usdsmoke

DEMO = Path("out/demo")
NAME = "top"
SETTINGS = {
    "stage.mask": NAME,
    "optics.sun": [0.5, 1.0, 0.3],
    "optics.sky": [0.4, 0.4, 0.4],
    "optics.albedo": 0.5,
}


def import_openvdb() -> ModuleType:
    """OpenVDB's Python module, under its new or its old name."""
    try:
        return importlib.import_module("openvdb")
    except ImportError:
        return importlib.import_module("pyopenvdb")


def write_masks(volume: UsdVol.Volume, folder: Path, begin: float, end: float) -> dict[float, Path]:
    """A file for each timeCode, with a grid that is 0 below and 1 above; the files by timeCode.

    Args:
        begin, end: shares of the height of the whole shot between which the mask grows.
    """
    openvdb = import_openvdb()
    density = UsdVol.OpenVDBAsset(volume.GetPrim().GetStage().GetPrimAtPath(density_path(volume)))
    axis = "XYZ".index(UsdGeom.GetStageUpAxis(volume.GetPrim().GetStage()))
    files = density.GetFilePathAttr()
    grids = {code: openvdb.read(files.Get(code).resolvedPath, "density") for code in codes(files)}
    heights = {code: heights_of(grid, axis) for code, grid in grids.items()}
    low = min(values.min() for values in heights.values())
    size = max(values.max() for values in heights.values()) - low
    written = {}
    for number, (code, grid) in enumerate(grids.items()):
        share = (heights[code] - low) / size
        mask = openvdb.FloatGrid()
        first, _ = grid.evalActiveVoxelBoundingBox()
        ramp = np.clip((share - begin) / (end - begin), 0.0, 1.0).astype(np.float32)
        mask.copyFromArray(ramp, ijk=first)
        mask.name, mask.transform, mask.gridClass = NAME, grid.transform, "fog volume"
        prim_name = volume.GetPrim().GetName()
        written[code] = folder / f"{NAME}_{prim_name}.{number:04d}.vdb"
        openvdb.write(str(written[code]), grids=[mask])
    return written


def heights_of(grid: Any, axis: int) -> np.ndarray:
    """The height of each voxel in the grid's active box, in the file's world space."""
    first, last = grid.evalActiveVoxelBoundingBox()
    beside = [tuple(n + (axis == step) for axis, n in enumerate(first)) for step in range(3)]
    origin, *ends = (grid.transform.indexToWorld(place)[axis] for place in (first, *beside))
    steps = np.subtract(ends, origin)
    return origin + np.tensordot(steps, np.indices(np.subtract(last, first) + 1), axes=1)


def density_path(volume: UsdVol.Volume) -> Sdf.Path:
    """The density's field prim."""
    return volume.GetFieldPaths()["density"]


def codes(files: Usd.Attribute) -> list[float]:
    """The timeCodes that have a file of their own."""
    return files.GetTimeSamples() or [0.0]


def author_masks(stage_file: Path, mask_file: Path, begin: float, end: float) -> None:
    """Write a stage over ``stage_file`` in which each Volume has the mask as a field."""
    mask_file.parent.mkdir(parents=True, exist_ok=True)
    source = Usd.Stage.Open(str(stage_file))
    stage = Usd.Stage.CreateNew(str(mask_file))
    stage.GetRootLayer().TransferContent(source.GetRootLayer())
    stage.GetRootLayer().subLayerPaths = [str(stage_file.resolve())]
    for root in list(stage.GetRootLayer().rootPrims):
        del stage.GetRootLayer().rootPrims[root.name]
    for prim in list(stage.Traverse()):
        if prim.IsA(UsdVol.Volume):
            volume = UsdVol.Volume(prim)
            path = density_path(volume).GetParentPath().AppendChild(f"{NAME}_{prim.GetName()}")
            field = UsdVol.OpenVDBAsset.Define(stage, path)
            field.CreateFieldNameAttr(NAME)
            field.CreateFieldDataTypeAttr("float")
            for code, file in write_masks(volume, mask_file.parent, begin, end).items():
                field.CreateFilePathAttr().Set(f"./{file.name}", code)
            volume.CreateFieldRelationship(NAME, path)
    stage.Save()


def main() -> None:
    """Read the command line, write the masks, stylize."""
    parser = argparse.ArgumentParser(description="Paint only the top of the smoke.")
    parser.add_argument("--stage", type=Path, default=DEMO / "source/plume.usda")
    parser.add_argument("--style", type=Path, default=DEMO / "styles/strokes.png")
    parser.add_argument("--output", type=Path, default=Path("out/mask"))
    parser.add_argument("--begin", type=float, default=0.4, help="share of the height")
    parser.add_argument("--end", type=float, default=0.6, help="share of the height")
    parser.add_argument("--frames", default="7", help="timeCodes to stylize, such as 1-12")
    options = parser.parse_args()
    mask_file = options.output / "mask.usda"
    author_masks(options.stage, mask_file, options.begin, options.end)
    settings = {**SETTINGS, "stage.frames": options.frames}
    result = usdsmoke.stylize(mask_file, options.style, options.output / "look", settings)
    print(f"open {result.root_stage}")


if __name__ == "__main__":
    main()

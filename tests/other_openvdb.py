"""Open VDB files with the OpenVDB of Blender's Python module, and write them once more with it.

    python tests/other_openvdb.py IN OUT

For every IN/NAME.vdb, OUT/NAME.npz says what OpenVDB found in it, and OUT/NAME.vdb holds the same
grids, made anew from arrays. Runs in an environment with bpy, of which nothing but OpenVDB is
loaded: neither usdsmoke nor USD, as bpy brings a USD of its own. Prints OpenVDB's version.
"""

import importlib.util
import json
import sys
from glob import glob
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np


def find_openvdb() -> ModuleType:
    """The ``openvdb`` inside the bpy wheel; bpy itself is not imported."""
    spec = importlib.util.find_spec("bpy")
    if spec is None or spec.origin is None:
        sys.exit(f"{sys.executable} has no bpy; python -m pip install bpy")
    pattern = f"{Path(spec.origin).parent}/*/python/lib/python3*/site-packages"
    sys.path.extend(glob(pattern))
    import openvdb

    module: ModuleType = openvdb
    return module


def describe(grid: Any) -> tuple[dict[str, Any], np.ndarray]:
    """A grid's facts as JSON can say them, and its active box."""
    low, high = grid.evalActiveVoxelBoundingBox()
    shape = [high[axis] - low[axis] + 1 for axis in range(3)]
    is_vector = isinstance(grid.background, (tuple, list))
    if grid.activeVoxelCount() == 0:
        low, shape = (0, 0, 0), [0, 0, 0]
    values = np.zeros((*shape, 3) if is_vector else tuple(shape), np.float32)
    if values.size:
        grid.copyToArray(values, ijk=tuple(int(index) for index in low))
    origin = grid.transform.indexToWorld((0, 0, 0))
    axes = [grid.transform.indexToWorld(np.eye(3, dtype=int)[axis].tolist()) for axis in range(3)]
    facts = {
        "name": grid.name,
        "class": grid.gridClass,
        "vector_type": grid.vectorType,
        "half": grid.saveFloatAsHalf,
        "background": np.atleast_1d(grid.background).tolist(),
        "active": int(grid.activeVoxelCount()),
        "ijk_min": [int(index) for index in low],
        "origin": list(origin),
        "axes": [list(axis) for axis in axes],
    }
    return facts, values


def make_again(openvdb: ModuleType, facts: dict[str, Any], values: np.ndarray) -> Any:
    """A new grid of the same facts and values."""
    background = facts["background"]
    if values.ndim == 4:
        grid = openvdb.Vec3SGrid(tuple(background))
    else:
        grid = openvdb.FloatGrid(background[0])
    if values.size:
        grid.copyFromArray(values, ijk=tuple(facts["ijk_min"]))
    matrix = np.eye(4)
    matrix[:3, :3] = np.subtract(facts["axes"], facts["origin"])
    matrix[3, :3] = facts["origin"]
    grid.transform = openvdb.createLinearTransform(matrix.tolist())
    grid.name, grid.gridClass = facts["name"], facts["class"]
    grid.vectorType, grid.saveFloatAsHalf = facts["vector_type"], facts["half"]
    return grid


def main(source: Path, target: Path) -> None:
    """Go over all files of a folder."""
    openvdb = find_openvdb()
    for file_path in sorted(source.glob("*.vdb")):
        grids, metadata = openvdb.readAll(str(file_path))
        described = [describe(grid) for grid in grids]
        again = [make_again(openvdb, facts, values) for facts, values in described]
        arrays = {facts["name"]: values for facts, values in described}
        np.savez(target / f"{file_path.stem}.npz", **arrays)
        texts = {key: value for key, value in metadata.items() if isinstance(value, str)}
        record = {"grids": [facts for facts, _ in described], "metadata": texts}
        (target / f"{file_path.stem}.json").write_text(json.dumps(record))
        openvdb.write(str(target / file_path.name), grids=again, metadata=texts)
    print(json.dumps(list(openvdb.LIBRARY_VERSION)))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))

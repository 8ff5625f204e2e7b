"""Small stages and VDB files for the tests of everything that touches USD."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyopenvdb

HEADER = """#usda 1.0
(
    defaultPrim = "World"
    endTimeCode = 4
    framesPerSecond = 25
    metersPerUnit = 0.5
    startTimeCode = 1
    timeCodesPerSecond = 25
    upAxis = "Z"
)
"""


def write_vdb(
    file_path: Path,
    names: Sequence[str] = ("density",),
    value: float = 1.0,
    voxel_size: float = 0.5,
    grid_class: str = "fog volume",
    metadata: Mapping[str, object] | None = None,
) -> Path:
    """A VDB of 4 x 3 x 2 voxels; names such as emission and vel make Vec3 grids."""
    grids = []
    for name in names:
        is_vector = name in ("emission", "vel", "Cd")
        grid = pyopenvdb.Vec3SGrid() if is_vector else pyopenvdb.FloatGrid()
        grid.copyFromArray(np.full((4, 3, 2, 3) if is_vector else (4, 3, 2), value, np.float32))
        grid.transform = pyopenvdb.createLinearTransform(voxelSize=voxel_size)
        grid.name = name
        if grid_class:
            grid.gridClass = "unknown" if is_vector else grid_class
        grids.append(grid)
    file_path.parent.mkdir(parents=True, exist_ok=True)
    pyopenvdb.write(str(file_path), grids=grids, metadata=dict(metadata or {}))
    return file_path


def write_text(file_path: Path, text: str) -> Path:
    """``text`` as a file, its folder made."""
    file_path.parent.mkdir(parents=True, exist_ok=True)
    file_path.write_text(text, encoding="utf-8")
    return file_path


def samples(values: Mapping[float, str]) -> str:
    """The body of a ``.timeSamples`` block."""
    return "{ " + ", ".join(f"{code}: {value}" for code, value in values.items()) + " }"


def density_prim(files: str, name: str = "density", extra: str = "") -> str:
    """An OpenVDBAsset; ``files`` is the text of its filePath opinions."""
    return f"""
        def OpenVDBAsset "{name}"
        {{
            token fieldClass = "fogVolume"
            token fieldDataType = "float"
            token fieldName = "density"
            {files}
            {extra}
        }}
"""


def volume_prim(body: str, name: str = "smoke", relations: str | None = None) -> str:
    """A Volume below /World with a density relationship unless ``relations`` says otherwise."""
    if relations is None:
        relations = f"rel field:density = </World/{name}/density>"
    return f"""
    def Volume "{name}"
    {{
        {relations}
        {body}
    }}
"""


def world(body: str, header: str = HEADER) -> str:
    """A whole layer with ``body`` below /World."""
    return f'{header}\ndef Xform "World"\n{{{body}\n}}\n'


def sequence(time_codes: Sequence[float], pattern: str = "./cache/smoke.{:04d}.vdb") -> str:
    """filePath time samples, one file for each timeCode."""
    files = {code: f"@{pattern.format(int(code))}@" for code in time_codes}
    return f"asset filePath.timeSamples = {samples(files)}"


def write_sequence(folder: Path, time_codes: Sequence[float], **settings: object) -> None:
    """The files that ``sequence`` names."""
    for code in time_codes:
        write_vdb(folder / f"cache/smoke.{int(code):04d}.vdb", **settings)  # type: ignore[arg-type]


def plume_stage(folder: Path, time_codes: Sequence[float] = (1, 2, 3, 4)) -> Path:
    """A stage with one animated Volume, /World/smoke, its extent and its files."""
    write_sequence(folder, time_codes)
    body = "float3[] extent = [(-9, -9, -9), (9, 9, 9)]\n" + density_prim(sequence(time_codes))
    return write_text(folder / "shot.usda", world(volume_prim(body)))


def file_hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every file below ``folder`` by its relative path."""
    return {
        str(item.relative_to(folder)): hashlib.sha256(item.read_bytes()).hexdigest()
        for item in sorted(folder.rglob("*"))
        if item.is_file()
    }

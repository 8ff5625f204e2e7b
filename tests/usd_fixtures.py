"""Small stages and VDB files for the tests of everything that touches USD."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd

from usdsmoke.base.naming import relative_asset_path
from usdsmoke.base.record_format import RECORD_FORMAT, RunRecord, StyleRecord
from usdsmoke.base.sections import LayerConfig, StageConfig
from usdsmoke.base.volume import DenseField, WrittenFrame
from usdsmoke.usd.look import LookFiles, StylizedVolume, author_look, result_hashes
from usdsmoke.usd.stage import find_volumes, open_stage
from usdsmoke.usd.values import value_at
from usdsmoke.vdb.binding import find_binding
from usdsmoke.vdb.write import write_frame

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
    openvdb = find_binding()
    grids = []
    for name in names:
        is_vector = name in ("emission", "vel", "velocity", "Cd", "color")
        grid = openvdb.Vec3SGrid() if is_vector else openvdb.FloatGrid()
        grid.copyFromArray(np.full((4, 3, 2, 3) if is_vector else (4, 3, 2), value, np.float32))
        grid.transform = openvdb.createLinearTransform(voxelSize=voxel_size)
        grid.name = name
        if grid_class:
            grid.gridClass = "unknown" if is_vector else grid_class
        grids.append(grid)
    file_path.parent.mkdir(parents=True, exist_ok=True)
    openvdb.write(str(file_path), grids=grids, metadata=dict(metadata or {}))
    return file_path


def write_text(file_path: Path, text: str) -> Path:
    """``text`` as a file, its folder made."""
    file_path.parent.mkdir(parents=True, exist_ok=True)
    file_path.write_text(text, encoding="utf-8")
    return file_path


def samples(values: Mapping[float, str]) -> str:
    """The body of a ``.timeSamples`` block."""
    return "{ " + ", ".join(f"{code}: {value}" for code, value in values.items()) + " }"


def sampled(attribute: str, values: Mapping[float, str]) -> str:
    """Time samples of an attribute that is given with its type."""
    return f"{attribute}.timeSamples = {samples(values)}"


def density_prim(
    files: str,
    name: str = "density",
    extra: str = "",
    grid: str = 'token fieldName = "density"',
) -> str:
    """An OpenVDBAsset; ``files`` and ``grid`` are its filePath and fieldName opinions."""
    return f"""
        def OpenVDBAsset "{name}"
        {{
            token fieldClass = "fogVolume"
            token fieldDataType = "float"
            {grid}
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


def dense_field(name: str, value: float = 1.0) -> DenseField:
    """What ``write_vdb`` makes, for our own writer."""
    shape = (4, 3, 2, 3) if name in ("emission", "vel", "Cd", "color") else (4, 3, 2)
    return DenseField(
        name=name,
        values=np.full(shape, value, np.float32),
        ijk_min=(0, 0, 0),
        index_to_world=np.diag([0.5, 0.5, 0.5, 1.0]),
        background=(0.0, 0.0, 0.0) if len(shape) == 4 else 0.0,
        grid_class="unknown" if len(shape) == 4 else "fog volume",
    )


def finish_frame(
    file_path: Path, time_code: float, ours: bool, names: Sequence[str]
) -> WrittenFrame:
    """A result's file, by our own writer or quickly without a hash, and the record of it."""
    file_path.parent.mkdir(parents=True, exist_ok=True)
    digest = "0" * 64
    if ours:
        digest = write_frame(file_path, [dense_field(name) for name in names], {}, False)
    else:
        write_vdb(file_path, names)
    return WrittenFrame(
        time_code, str(file_path), digest, (-0.25, -0.25, -0.25), (1.75, 1.25, 0.75)
    )


def make_look(
    stage_file: Path,
    output: Path,
    frames: str = "",
    prims: Sequence[str] = (),
    layer_format: str = "usda",
    ours: bool = False,
    names: Sequence[str] = ("density", "emission"),
    empty: bool = False,
    run_id: str = "3f2b8c1e-0a4d-4c57-9d0e-5b7a1f6c2d34",
    look: str = "stylized",
    mode: str = "sublayer",
) -> LookFiles:
    """The look of a stage, with files of little boxes in place of stylized smoke.

    Its times are fixed, so that two looks made a second apart differ in nothing.
    """
    stage = open_stage(stage_file)
    source = find_volumes(stage, StageConfig(frames=frames, prims=list(prims)))
    results = []
    for volume in source.volumes:
        stem = volume.prim_path.rsplit("/", 1)[-1]
        written = [
            finish_frame(
                output / f"vdb/{stem}.{int(f.time_code):04d}.vdb", f.time_code, ours, names
            )
            for f in volume.frames
        ]
        grids = {name: name for name in names}
        empty_file = output / f"vdb/{stem}.none.vdb"
        if empty:
            write_empty(empty_file)
        results.append(
            StylizedVolume(volume, written, 0.5, grids, str(empty_file) if empty else "")
        )
    made = "2026-01-31T12:00:00Z"
    config = LayerConfig(format=layer_format, look=look, mode=mode)
    record = RunRecord(
        format=RECORD_FORMAT,
        run=run_id,
        version="1.2.3",
        created=made,
        finished=made,
        look=look,
        stage=relative_asset_path(source.file_path, output),
        seed=7,
        settings={"a": {"b": 1}},
        style_request=("x.png",),
        styles=(StyleRecord("x.png", "ff"),),
        results=result_hashes(results, output),
    )
    return author_look(stage, source, results, output, config, record)


def write_empty(file_path: Path) -> None:
    """A file whose emission grid has no voxel."""
    openvdb = find_binding()
    grid = openvdb.Vec3SGrid()
    grid.name = "emission"
    openvdb.write(str(file_path), grids=[grid])


def needs_usd(year: int, month: int) -> pytest.MarkDecorator:
    """Marks a test of what OpenUSD has since a release."""
    return pytest.mark.skipif(
        Usd.GetVersion()[1:] < (year, month), reason=f"needs OpenUSD {year}.{month:02}"
    )


def shown_file(stage: Usd.Stage, prim_path: str, time_code: float) -> str | None:
    """The resolved file of a field prim at a time; None when it is blocked."""
    asset = value_at(stage.GetPrimAtPath(prim_path).GetAttribute("filePath"), time_code)
    return None if asset is None else str(asset.resolvedPath)

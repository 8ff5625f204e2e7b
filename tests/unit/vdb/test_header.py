"""The header of a VDB file, read by hand: what it says about the grids."""

import struct
from pathlib import Path

import numpy as np
import pytest

from tests.fixtures.grids_fixtures import (
    openvdb,
    raw_grid,
    rotated,
    shared_file,
    uniform,
    write_raw,
)
from tests.fixtures.vdb_bytes import SCALE, entry, metadata, vdb
from usdsmoke.vdb.header import read_header


def test_houdini_plume_is_described_as_vdb_print_does() -> None:
    header = read_header(shared_file("cortex/smoke.vdb"))
    assert header.version == 222
    assert header.library_version == (1, 1)
    assert header.metadata == {"creator": "Houdini/SOP_OpenVDB_Write"}
    (grid,) = header.grids
    assert (grid.name, grid.index, grid.value_type, grid.half) == ("density", 0, "float", True)
    assert grid.grid_class == "fog volume"
    assert grid.active_voxels == 1_049_275
    assert (grid.bbox_min, grid.bbox_max) == ((1, 2, 1), (111, 223, 112))
    assert grid.box_shape == (111, 222, 112)
    assert grid.metadata["roiMax"] == (112, 224, 113)
    assert grid.transform_type == "UniformScaleTranslateMap"
    assert grid.index_to_world is not None
    assert np.allclose(np.diag(grid.index_to_world), [1 / 2.1, 1 / 2.1, 1 / 2.1, 1])


def test_grids_of_one_name_are_counted_in_the_files_order() -> None:
    header = read_header(shared_file("arnold-usd/grids.vdb"))
    assert [(grid.name, grid.index, grid.active_voxels) for grid in header.grids] == [
        ("density", 0, 491),
        ("density", 1, 2222),
        ("density", 2, 803),
    ]
    assert [grid.stored_name for grid in header.grids] == [f"density\x1e{n}" for n in range(3)]
    assert [grid.label for grid in header.grids] == ["density", "density[1]", "density[2]"]


def test_level_set_and_vector_grids_are_told_by_class_and_type() -> None:
    assert read_header(shared_file("cortex/sphere.vdb")).grids[0].grid_class == "level set"
    assert read_header(shared_file("openimageio/sphereCd.vdb")).grids[0].value_type == "vec3s"


@pytest.mark.parametrize(
    "matrix",
    [np.eye(4), uniform(0.3), uniform(0.3, (1e3, -2.5, 0.1)), rotated()],
    ids=["identity", "scale", "scale and translation", "affine"],
)
def test_transform_is_the_one_openvdb_applies(tmp_path: Path, matrix: np.ndarray) -> None:
    grid = raw_grid(np.ones((2, 2, 2)), matrix=matrix)
    header = read_header(write_raw(tmp_path / "a.vdb", grid)).grids[0]
    assert header.index_to_world is not None
    for point in [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (-3.0, 7.0, 0.5)]:
        wanted = grid.transform.indexToWorld(point)
        assert np.allclose([*point, 1.0] @ header.index_to_world, [*wanted, 1.0], rtol=1e-12)


def test_frustum_has_no_matrix(tmp_path: Path) -> None:
    grid = raw_grid(np.ones((2, 2, 2)))
    grid.transform = openvdb().createFrustumTransform((0, 0, 0), (8, 8, 8), 0.5, 2.0, 0.1)
    header = read_header(write_raw(tmp_path / "a.vdb", grid)).grids[0]
    assert header.transform_type == "NonlinearFrustumMap"
    assert header.index_to_world is None


def test_empty_grid_has_no_box(tmp_path: Path) -> None:
    grid = openvdb().FloatGrid()
    grid.name = "density"
    header = read_header(write_raw(tmp_path / "a.vdb", grid)).grids[0]
    assert (header.active_voxels, header.bbox_min, header.box_shape) == (0, None, None)


@pytest.mark.parametrize(
    ("grid_type", "value_type", "half", "levels"),
    [
        ("Tree_float_5_4_3", "float", False, "5_4_3"),
        ("Tree_vec3s_5_4_3_HalfFloat", "vec3s", True, "5_4_3"),
        ("Tree_int32_5_4_3", "int32", False, "5_4_3"),
        ("Tree_double_4_3", "double", False, "4_3"),
        ("Tree_bool_5_4_3", "bool", False, "5_4_3"),
        ("Tree_ptdataidx32_5_4_3", "points", False, "5_4_3"),
        ("Tree_ptidx32_5_4_3", "points", False, "5_4_3"),
    ],
)
def test_type_is_taken_apart(
    tmp_path: Path, grid_type: str, value_type: str, half: bool, levels: str
) -> None:
    (tmp_path / "a.vdb").write_bytes(vdb(("a", grid_type, metadata() + SCALE)))
    (grid,) = read_header(tmp_path / "a.vdb").grids
    assert (grid.value_type, grid.half, grid.tree_levels) == (value_type, half, levels)
    assert grid.grid_class == "unknown"
    assert grid.active_voxels is None
    assert np.array_equal(np.diag(grid.index_to_world), [0.25, 0.25, 0.25, 1.0])


def test_files_before_the_flags_moved_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.vdb").write_bytes(
        vdb(("a", "Tree_float_5_4_3", metadata() + SCALE), version=220)
    )
    assert read_header(tmp_path / "a.vdb").grids[0].name == "a"


def test_metadata_values_keep_their_types(tmp_path: Path) -> None:
    entries = metadata(
        entry("s", "string", "é".encode()),
        entry("i", "int32", struct.pack("<i", -5)),
        entry("l", "int64", struct.pack("<q", 2**40)),
        entry("f", "float", struct.pack("<f", 0.5)),
        entry("d", "double", struct.pack("<d", 0.1)),
        entry("b", "bool", b"\1"),
        entry("v", "vec3s", struct.pack("<3f", 1, 2, 3)),
        entry("table", "__delayedload", bytes(1000)),
    )
    (tmp_path / "a.vdb").write_bytes(vdb(file_metadata=entries))
    found = read_header(tmp_path / "a.vdb").metadata
    assert found == {
        "s": "é", "i": -5, "l": 2**40, "f": 0.5, "d": 0.1, "b": True, "v": (1.0, 2.0, 3.0),
    }  # fmt: skip
    assert type(found["b"]) is bool

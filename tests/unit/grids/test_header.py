"""The header of a VDB file, read by hand: what it says, and that no file can harm the reader."""

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.grids_fixtures import (
    make_field,
    make_vectors,
    openvdb,
    raw_grid,
    rotated,
    shared_file,
    uniform,
    write_raw,
)
from usdsmoke.errors import AssetNotResolved, DamagedFile, GridError, UnsupportedGrid
from usdsmoke.grids.header import read_header
from usdsmoke.grids.write import write_frame


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


def entry(name: str, type_name: str, value: bytes) -> bytes:
    return text(name) + text(type_name) + struct.pack("<I", len(value)) + value


def metadata(*entries: bytes) -> bytes:
    return struct.pack("<I", len(entries)) + b"".join(entries)


def vdb(
    *grids: tuple[str, str, bytes],
    version: int = 224,
    has_offsets: int = 1,
    file_metadata: bytes = metadata(),
) -> bytes:
    """A VDB file by the published layout, without trees: grids are (name, type, description)."""
    packed = b" BDV\0\0\0\0" + struct.pack("<IIIB", version, 11, 0, has_offsets)
    if version < 222:
        packed += b"\1"
    packed += b"0" * 36 + file_metadata + struct.pack("<I", len(grids))
    for name, grid_type, description in grids:
        packed += text(name) + text(grid_type) + text("")
        start = len(packed) + 24
        flags = b"" if version < 222 else struct.pack("<I", 2)
        end = start + len(flags) + len(description)
        packed += struct.pack("<qqq", start, end, end) + flags + description
    return packed


SCALE = text("UniformScaleMap") + struct.pack("<15d", *[0.25] * 15)


@pytest.fixture(scope="module")
def small_file(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    file_path = tmp_path_factory.mktemp("header") / "small.vdb"
    fields = [make_field(metadata={"note": "hello"}), make_vectors(index_to_world=rotated())]
    write_frame(file_path, fields, {"creator": "a test"}, half=False)
    return file_path.read_bytes()


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


FAULTS = {
    "an empty file": (b"", "mark"),
    "a text file": (b"density = 1\nvelocity = 2\n", "mark of VDB files"),
    "a version from the future": (vdb(version=2**31), "version 2147483648"),
    "a version before the first release": (vdb(version=100), "version 100"),
    "a billion metadata entries": (
        vdb(file_metadata=struct.pack("<I", 2**30)),
        "1073741824 metadata entries",
    ),
    "a name of four gigabytes": (
        vdb(file_metadata=struct.pack("<II", 1, 2**32 - 1) + bytes(100)),
        "4294967295 bytes",
    ),
    "a value beyond the end": (
        vdb(
            file_metadata=struct.pack("<I", 1) + text("a") + text("string") + struct.pack("<I", 999)
        ),
        "999 bytes",
    ),
    "a value of another size than its type's": (
        vdb(file_metadata=metadata(entry("a", "int32", bytes(5)))),
        "type int32 has 5 bytes",
    ),
    "a type that is no tree": (vdb(("a", "Grid_float", metadata() + SCALE)), "Grid_float"),
    "a transform that is not finite": (
        vdb(
            (
                "a",
                "Tree_float_5_4_3",
                metadata() + text("TranslationMap") + struct.pack("<3d", 0, float("nan"), 0),
            )
        ),
        "not finite",
    ),
    "a transform that nobody knows": (
        vdb(("a", "Tree_float_5_4_3", metadata() + text("MoebiusMap"))),
        "MoebiusMap",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_damage_is_named_with_the_file(tmp_path: Path, fault: str) -> None:
    packed, words = FAULTS[fault]
    file_path = tmp_path / "broken.vdb"
    file_path.write_bytes(packed)
    with pytest.raises(DamagedFile, match=words) as caught:
        read_header(file_path)
    assert str(file_path) in str(caught.value)
    assert "again" in str(caught.value)


def test_offsets_that_do_not_rise_are_damage(tmp_path: Path, small_file: bytes) -> None:
    place = small_file.index(b"Tree_float_5_4_3") + len(b"Tree_float_5_4_3") + 4
    broken = small_file[:place] + struct.pack("<q", 8) + small_file[place + 8 :]
    (tmp_path / "a.vdb").write_bytes(broken)
    with pytest.raises(DamagedFile, match=r'grid "density" are 8, .* wanted them to rise'):
        read_header(tmp_path / "a.vdb")


def test_grid_without_offsets_is_refused_with_the_way_out(tmp_path: Path) -> None:
    grid = ("a", "Tree_float_5_4_3", metadata() + SCALE)
    (tmp_path / "a.vdb").write_bytes(vdb(grid, has_offsets=0))
    with pytest.raises(UnsupportedGrid, match="written as a stream"):
        read_header(tmp_path / "a.vdb")


def test_missing_file_and_folder_are_not_resolved(tmp_path: Path) -> None:
    with pytest.raises(AssetNotResolved, match=r"no file .*none\.vdb"):
        read_header(tmp_path / "none.vdb")
    with pytest.raises(AssetNotResolved, match="Is a directory"):
        read_header(tmp_path)


def test_every_truncation_is_named(tmp_path: Path, small_file: bytes) -> None:
    file_path = tmp_path / "cut.vdb"
    for length in [*range(0, 1200, 7), *range(1200, len(small_file), 997), len(small_file) - 1]:
        file_path.write_bytes(small_file[:length])
        with pytest.raises(DamagedFile):
            read_header(file_path)


def test_no_byte_of_the_header_can_make_the_reader_take_memory(
    tmp_path: Path, small_file: bytes
) -> None:
    file_path = tmp_path / "broken.vdb"
    tracemalloc.start()
    try:
        for place in range(0, 1000, 3):
            packed = bytearray(small_file)
            packed[place : place + 40] = b"\xff" * 40
            file_path.write_bytes(packed)
            try:
                read_header(file_path)
            except GridError:
                pass
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 8 * len(small_file) + 4_000_000


@settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    changes=st.lists(
        st.tuples(st.integers(0, 2400), st.binary(min_size=1, max_size=9)), min_size=1, max_size=4
    ),
    cut=st.none() | st.integers(0, 3000),
)
def test_changed_bytes_give_a_header_or_a_named_error(
    tmp_path: Path,
    small_file: bytes,
    changes: list[tuple[int, bytes]],
    cut: int | None,
) -> None:
    packed = bytearray(small_file)
    for place, replacement in changes:
        packed[place : place + len(replacement)] = replacement
    file_path = tmp_path / "fuzzed.vdb"
    file_path.write_bytes(packed[:cut])
    try:
        header = read_header(file_path)
    except (DamagedFile, UnsupportedGrid):
        return
    for grid in header.grids:
        assert grid.index_to_world is None or np.isfinite(grid.index_to_world).all()

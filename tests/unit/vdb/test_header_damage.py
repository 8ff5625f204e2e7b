"""No VDB file, however damaged, can harm the reader of headers: it names the damage."""

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fixtures.grids_fixtures import make_field, make_vectors, rotated
from tests.fixtures.vdb_bytes import SCALE, entry, metadata, text, vdb
from usdsmoke.base.errors import AssetNotResolved, DamagedFile, GridError, UnsupportedGrid
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.write import write_frame


@pytest.fixture(scope="module")
def small_file(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    file_path = tmp_path_factory.mktemp("header") / "small.vdb"
    fields = [make_field(metadata={"note": "hello"}), make_vectors(index_to_world=rotated())]
    write_frame(file_path, fields, {"creator": "a test"}, half=False)
    return file_path.read_bytes()


FAULTS = {
    "an empty file": (b"", "0 bytes"),
    "a text file": (b"density = 1\nvelocity = 2\n", "wrong bytes"),
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
    with pytest.raises(DamagedFile, match=r'"density" are 8, '):
        read_header(tmp_path / "a.vdb")


def test_grid_without_offsets_is_refused_with_the_way_out(tmp_path: Path) -> None:
    grid = ("a", "Tree_float_5_4_3", metadata() + SCALE)
    (tmp_path / "a.vdb").write_bytes(vdb(grid, has_offsets=0))
    with pytest.raises(UnsupportedGrid, match="a stream"):
        read_header(tmp_path / "a.vdb")


def test_missing_file_and_folder_are_not_resolved(tmp_path: Path) -> None:
    with pytest.raises(AssetNotResolved, match=r"no file .*none\.vdb"):
        read_header(tmp_path / "none.vdb")
    with pytest.raises(AssetNotResolved, match="a directory"):
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

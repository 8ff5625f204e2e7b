"""Grids that were read are kept: the same bits, from disk once, for as long as the file is."""

import os
from pathlib import Path

import numpy as np
import pytest

from tests.fixtures.counters import Reads, unnamed_files
from tests.fixtures.grids_fixtures import TIGHT, make_field, make_vectors, raw_grid, write_raw
from usdsmoke.base.errors import NonFiniteError, UnsupportedGrid
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb.read import GridRequest, read_grids
from usdsmoke.vdb.store import GridStore
from usdsmoke.vdb.write import write_frame

BOTH = [GridRequest("density"), GridRequest("vel", components=3)]


@pytest.fixture
def file_path(tmp_path: Path) -> Path:
    write_frame(tmp_path / "a.vdb", [make_field(), make_vectors("vel")], {}, half=False)
    return tmp_path / "a.vdb"


@pytest.fixture
def reads(file_path: Path, monkeypatch: pytest.MonkeyPatch) -> Reads:
    return Reads(monkeypatch)


def test_a_file_is_opened_once_and_gives_the_same_bits(file_path: Path, reads: Reads) -> None:
    store = GridStore()
    for _ in range(3):
        for found, wanted in zip(
            store.read(file_path, BOTH, TIGHT), read_grids(file_path, BOTH, TIGHT), strict=True
        ):
            assert found.values.tobytes() == wanted.values.tobytes()
            assert found.values.shape == wanted.values.shape
            assert found.metadata == wanted.metadata and found.ijk_min == wanted.ijk_min
    assert len(reads.grids) == 2 + 3 * 2


def test_a_file_that_has_changed_is_read_again(file_path: Path) -> None:
    store = GridStore()
    store.read(file_path, BOTH, TIGHT)
    write_frame(file_path, [make_field(seed=8), make_vectors("vel")], {}, half=False)
    density, _ = store.read(file_path, BOTH, TIGHT)
    assert np.array_equal(density.values, make_field(seed=8).values)


def test_what_somebody_writes_into_an_array_is_not_kept(file_path: Path) -> None:
    store = GridStore()
    for _ in range(3):
        density, _ = store.read(file_path, BOTH, TIGHT)
        assert np.array_equal(density.values, make_field().values)
        density.values[:] = 7


@pytest.mark.parametrize("why", ["free", "error"])
def test_where_the_disk_is_short_grids_are_read_again(
    file_path: Path, reads: Reads, monkeypatch: pytest.MonkeyPatch, why: str
) -> None:
    if why == "free":
        store = GridStore(2**62)
    else:
        store = GridStore()
        monkeypatch.setattr("usdsmoke.vdb.store._folder", lambda: Path("/nowhere/at/all"))
    for _ in range(2):
        density, _ = store.read(file_path, BOTH, TIGHT)
        assert np.array_equal(density.values, make_field().values)
    assert len(reads.grids) == 4


def test_nothing_is_left_in_the_folder(
    file_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr("usdsmoke.vdb.store._folder", lambda: folder)
    store = GridStore()
    store.read(file_path, BOTH, TIGHT)
    assert os.listdir(folder) == []
    del store


def test_what_was_repaired_or_refused_is_no_answer_to_another_question(tmp_path: Path) -> None:
    values = np.ones((3, 3, 3), np.float32)
    values[1, 1, 1] = np.nan
    file_path = write_raw(tmp_path / "nan.vdb", raw_grid(values))
    store, wanted = GridStore(), [GridRequest("density")]
    (field,) = store.read(file_path, wanted, GridsConfig(repair_nan=0.0))
    assert field.values[1, 1, 1] == 0
    with pytest.raises(NonFiniteError):
        store.read(file_path, wanted, TIGHT)
    with pytest.raises(UnsupportedGrid):
        store.read(file_path, [GridRequest("density", components=3)], GridsConfig(repair_nan=0.0))


def test_empty_grids_are_kept_as_well(tmp_path: Path) -> None:
    nothing = np.zeros((0, 0, 0), np.float32)
    fields = [make_field(), make_vectors("vel", shape=(1, 1, 1))]
    fields[0] = type(fields[0])("density", nothing, (0, 0, 0), np.eye(4))
    write_frame(tmp_path / "a.vdb", fields, {}, half=False)
    store = GridStore()
    for _ in range(2):
        density, _ = store.read(tmp_path / "a.vdb", BOTH, TIGHT)
        assert density.is_empty


def test_released_files_give_their_disk_space_back_and_are_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("usdsmoke.vdb.store._FILE_BYTES", 1)  # a file for each grid
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    paths = [str(tmp_path / f"{number}.vdb") for number in range(3)]
    for path in paths:
        write_frame(path, [make_field(), make_vectors("vel")], {}, half=False)
    store, reads = GridStore(), Reads(monkeypatch)
    for path in paths:
        store.read(path, BOTH, TIGHT)
    assert len(unnamed_files(tmp_path)) == 6
    density, _ = store.read(paths[0], BOTH, TIGHT)
    store.release(paths[:2])
    assert np.array_equal(density.values, make_field().values)
    del density, _
    assert len(unnamed_files(tmp_path)) == 2
    for path in paths:
        store.read(path, BOTH, TIGHT)
    assert len(reads.grids) == (3 + 2) * 2

"""What became of a file that usdsmoke wrote, compared with a record."""

import shutil
import struct
from pathlib import Path

import numpy as np
import pytest

from tests.fixtures.grids_fixtures import make_field
from usdsmoke.base.errors import BindingMissing, DamagedFile, GridTooLarge
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb import written
from usdsmoke.vdb.write import write_frame
from usdsmoke.vdb.written import State, compare_written


@pytest.fixture
def ours(tmp_path: Path) -> tuple[Path, str]:
    """A file of usdsmoke, and the hash of its grids."""
    file_path = tmp_path / "ours.vdb"
    return file_path, write_frame(file_path, [make_field()], {}, half=False)


def test_a_file_is_intact_until_it_is_gone(ours: tuple[Path, str]) -> None:
    file_path, recorded = ours
    assert compare_written(file_path, recorded).state == State.INTACT
    assert compare_written(file_path, "0" * 64).state == State.OTHER
    file_path.unlink()
    assert compare_written(file_path, recorded).state == State.MISSING


def test_a_change_of_its_grids_is_noticed(ours: tuple[Path, str]) -> None:
    file_path, recorded = ours
    packed, map_name = file_path.read_bytes(), b"UniformScaleTranslateMap"
    place = packed.index(map_name) + len(map_name)  # the translation
    file_path.write_bytes(packed[:place] + struct.pack("<d", 1.0) + packed[place + 8 :])
    assert compare_written(file_path, recorded).state == State.CHANGED
    file_path.write_bytes(packed[: len(packed) // 2])
    assert compare_written(file_path, recorded).state == State.UNREADABLE


def test_a_file_without_a_promise_is_of_another_program(ours: tuple[Path, str]) -> None:
    file_path, recorded = ours
    file_path.write_bytes(file_path.read_bytes().replace(b"usdsmoke:content", b"anything:content"))
    assert compare_written(file_path, recorded).state == State.FOREIGN


def out_of_memory() -> DamagedFile:
    error = DamagedFile("it needs more")
    error.lacks_memory = True
    return error


@pytest.mark.parametrize(
    "error", [BindingMissing("no OpenVDB"), GridTooLarge("too large"), out_of_memory()]
)
def test_what_this_machine_cannot_read_is_not_called_damaged(
    error: Exception, ours: tuple[Path, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(path: str, config: GridsConfig) -> str:
        raise error

    file_path = shutil.copy(ours[0], ours[0].with_name("copy.vdb"))
    monkeypatch.setattr(written, "hash_vdb_file", fail)
    found = compare_written(file_path, ours[1])
    assert found.state == State.UNCHECKED
    if isinstance(error, BindingMissing):
        assert found.found == str(error)
    else:
        assert "memory" in found.found and "grids." not in found.found


def test_all_memory_of_the_machine_may_be_used(
    ours: tuple[Path, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run that wrote the file may have raised ``grids.memory_limit_gib``."""
    limits = []

    def note(path: str, config: GridsConfig) -> str:
        limits.append(config.memory_limit_gib)
        return ours[1]

    monkeypatch.setattr(written, "hash_vdb_file", note)
    for memory in (100.0, 1.0, np.inf):
        monkeypatch.setattr(written, "available_memory_gib", lambda memory=memory: memory)
        file_path = shutil.copy(ours[0], ours[0].with_name(f"{memory}.vdb"))
        assert compare_written(file_path, ours[1]).state == State.INTACT
    assert limits[0] == 100 and limits[1] == GridsConfig().memory_limit_gib
    assert np.isfinite(limits[2]) and limits[2] > 100

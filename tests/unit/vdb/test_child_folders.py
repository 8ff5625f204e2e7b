"""Folders for temporary files: gone when they are left, and swept away after a killed process."""

import fcntl
import os
import time
from pathlib import Path

import pytest

from usdsmoke.vdb.child import _HELD, _PREFIX, _STALE, _private_folder, _sweep


@pytest.fixture()
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    _sweep.cache_clear()
    return tmp_path


def make_folder(parent: Path, name: str, age: float) -> Path:
    folder = parent / f"{_PREFIX}{name}"
    folder.mkdir()
    (folder / "in0.npy").write_bytes(b"voxels")
    (folder / _HELD).touch()
    then = time.time() - age
    os.utime(folder / _HELD, (then, then))
    return folder


def test_a_folder_goes_when_it_is_left(temporary: Path) -> None:
    with _private_folder() as folder:
        assert Path(folder).parent == temporary
    assert not list(temporary.iterdir())


def test_what_a_killed_process_left_is_swept_away(temporary: Path) -> None:
    folder = make_folder(temporary, "killed", 2 * _STALE)
    _sweep(str(temporary))
    assert not folder.exists()


def test_a_folder_that_a_process_holds_stays_however_old(temporary: Path) -> None:
    folder = make_folder(temporary, "held", 2 * _STALE)
    with open(folder / _HELD, "rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        _sweep(str(temporary))
    assert (folder / "in0.npy").exists()


def test_a_young_folder_and_other_peoples_folders_stay(temporary: Path) -> None:
    young = make_folder(temporary, "young", 1.0)
    other = temporary / "other-1"
    other.mkdir()
    (other / _HELD).touch()
    os.utime(other / _HELD, (0, 0))
    _sweep(str(temporary))
    assert young.exists() and other.exists()

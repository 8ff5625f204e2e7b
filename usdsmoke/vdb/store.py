"""Grids that were read, kept on disk: no file is decoded twice, and memory does not grow."""

import dataclasses
import errno
import os
import tempfile
import threading
import weakref
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from usdsmoke.base.machine import free_disk_bytes
from usdsmoke.base.volume import DenseField
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb.read import GridRequest, read_grids

_DISK_TMP = Path("/var/tmp")  # on disk, where /tmp may be in memory
_RESERVE = 2**30  # bytes of the disk that stay free for other programs
_ALIGNED = 64  # bytes that an array in a file begins at a multiple of
_FILE_BYTES = 2**28  # a file with this much in it is followed by another one,
_MOST_FILES = 200  # unless this many are open: systems limit their number
_Key = tuple[object, ...]


@dataclass(frozen=True)
class _Kept:
    """A field on disk."""

    bare: DenseField  # without its values
    shape: tuple[int, ...]
    file: IO[bytes]
    start: int  # byte in the file

    def mapped(self) -> DenseField:
        if 0 in self.shape:
            return self.bare
        # "c": private, because torch warns about read-only arrays
        values = np.memmap(self.file, np.float32, mode="c", offset=self.start, shape=self.shape)
        return dataclasses.replace(self.bare, values=np.asarray(values))


class GridStore:
    """Reads grids and keeps them, decoded and checked, in unnamed files.

    The files are in TMPDIR, or else in /var/tmp or the system's folder for temporary files. The
    system removes them when the process ends, even if it is killed. If the disk is nearly full,
    grids are not kept but read again: the store never takes the space that results need.

    Args:
        spare_bytes: of the disk, reserved for the files that the run still writes.
    """

    def __init__(self, spare_bytes: int = 0) -> None:
        self._spare = spare_bytes + _RESERVE
        self._files: list[IO[bytes]] = []  # grids are added to the last one
        self._kept: dict[_Key, list[_Kept]] = {}
        self._turn = threading.Lock()
        weakref.finalize(self, _close, self._files)

    def read(
        self,
        file_path: str | os.PathLike[str],
        requests: Sequence[GridRequest],
        config: GridsConfig,
    ) -> list[DenseField]:
        """What ``read_grids`` returns; memory-mapped from the second time on. Threads take turns.

        A file that has changed since is read again. Changes to the arrays are not kept.

        Raises:
            GridError, NonFiniteError: see ``read_grids``.
        """
        with self._turn:
            key = _key(file_path, requests, config)
            kept = self._kept.get(key, []) if key is not None else []
            if kept and all(map(_fits, kept, requests)):
                return [field.mapped() for field in kept]
            fields = read_grids(file_path, requests, config)
            if key is not None and _key(file_path, requests, config) == key:  # not changed since
                self._keep(key, fields)
            return fields

    def release(self, file_paths: Collection[str]) -> None:
        """Forget the grids of files; disk space becomes free in pieces of about 256 MiB.

        Arrays that were returned stay valid.
        """
        paths = {os.path.abspath(file_path) for file_path in file_paths}
        with self._turn:
            self._kept = {key: kept for key, kept in self._kept.items() if key[0] not in paths}
            used = {id(kept.file) for entries in self._kept.values() for kept in entries}
            unused = [file for file in self._files if id(file) not in used]
            self._files[:] = [file for file in self._files if id(file) in used]
            _close(unused)

    def _keep(self, key: _Key, fields: Sequence[DenseField]) -> None:
        needed = self._spare + sum(field.values.nbytes for field in fields)
        try:
            if free_disk_bytes(_folder()) >= needed:
                self._kept[key] = [_write(self._file(), field) for field in fields]
        except OSError:
            return  # the disk is full after all: they are read again

    def _file(self) -> IO[bytes]:
        """The file that the next field is added to."""
        is_full = self._files and self._files[-1].seek(0, os.SEEK_END) >= _FILE_BYTES
        if not self._files or (is_full and len(self._files) < _MOST_FILES):
            self._files.append(tempfile.TemporaryFile(dir=_folder(), buffering=0))
        return self._files[-1]


def _fits(kept: _Kept, request: GridRequest) -> bool:
    """Whether the field has as many components as are asked for; else ``read_grids`` says so."""
    return request.components in (None, 3 if len(kept.shape) == 4 else 1)


def _write(file: IO[bytes], field: DenseField) -> _Kept:
    start = -(-file.seek(0, os.SEEK_END) // _ALIGNED) * _ALIGNED
    file.seek(start)
    field.values.tofile(file)
    if file.seek(0, os.SEEK_END) < start + field.values.nbytes:  # a full disk, or a limit
        raise OSError(errno.ENOSPC, "the file was cut short")
    nothing = np.zeros((0, 0, 0, *field.values.shape[3:]), np.float32)
    return _Kept(dataclasses.replace(field, values=nothing), field.values.shape, file, start)


def _close(files: list[IO[bytes]]) -> None:
    for file in files:
        file.close()


def _key(
    file_path: str | os.PathLike[str], requests: Sequence[GridRequest], config: GridsConfig
) -> _Key | None:
    """What determines the fields; None if the file's status cannot be read."""
    try:
        status = os.stat(file_path)
    except OSError:
        return None  # ``read_grids`` reports the error
    # a name alone means its first grid
    grids = tuple((r.name, r.index or 0 if r.name else r.index) for r in requests)
    identity = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
    return (os.path.abspath(file_path), identity, grids, config.repair_nan)


def _folder() -> Path:
    """Where large temporary files go."""
    if any(name in os.environ for name in ("TMPDIR", "TEMP", "TMP")):
        return Path(tempfile.gettempdir())
    return _DISK_TMP if os.access(_DISK_TMP, os.W_OK | os.X_OK) else Path(tempfile.gettempdir())

"""Grids that were read, kept on disk: no file is decoded twice, and memory does not grow."""

import dataclasses
import os
import tempfile
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import IO

import numpy as np

from usdsmoke.base.machine import free_disk_bytes
from usdsmoke.base.sections import GridsConfig
from usdsmoke.base.volume import DenseField
from usdsmoke.vdb.read import GridRequest, read_grids

__all__ = ["GridStore"]

_DISK_TMP = Path("/var/tmp")  # on disk, where /tmp may be in memory
_RESERVE = 2**30  # bytes of the disk that stay free for other programs
_ALIGNED = 64  # bytes that an array in the file begins at a multiple of
_Key = tuple[object, ...]


class GridStore:
    """Reads grids and keeps them, decoded and checked, in one unnamed file.

    The file is in TMPDIR, or else in /var/tmp or the system's folder for temporary files. The
    system removes it when the process ends, even if it is killed. If the disk is nearly full, grids
    are not kept but read again.

    Args:
        spare_bytes: of the disk, reserved for the files that the run still writes.
    """

    def __init__(self, spare_bytes: int = 0) -> None:
        self._spare = spare_bytes + _RESERVE
        self._file: IO[bytes] | None = None
        self._kept: dict[_Key, list[tuple[DenseField, tuple[int, ...], int]]] = {}

    def read(
        self,
        file_path: str | os.PathLike[str],
        requests: Sequence[GridRequest],
        config: GridsConfig,
    ) -> list[DenseField]:
        """What ``read_grids`` returns; memory-mapped from the second time on.

        A file that has changed since is read again. Changes to the arrays are not kept.

        Raises:
            GridError, NonFiniteError: see ``read_grids``.
        """
        key = _key(file_path, requests, config)
        if key is not None and key in self._kept:
            return [self._mapped(*entry) for entry in self._kept[key]]
        fields = read_grids(file_path, requests, config)
        if key is not None and _key(file_path, requests, config) == key:  # not changed meanwhile
            self._keep(key, fields)
        return fields

    def _keep(self, key: _Key, fields: Sequence[DenseField]) -> None:
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(dir=_folder(), buffering=0)
                weakref.finalize(self, self._file.close)
            entries = [self._written(self._file, field) for field in fields]
        except OSError:
            return  # the disk is nearly full: they are read again
        if None not in entries:
            self._kept[key] = [entry for entry in entries if entry is not None]

    def _written(
        self, file: IO[bytes], field: DenseField
    ) -> tuple[DenseField, tuple[int, ...], int] | None:
        """The field without its values, their shape and place; None if the disk is nearly full."""
        if free_disk_bytes(_folder()) < self._spare + field.values.nbytes:
            return None
        start = -(-file.seek(0, os.SEEK_END) // _ALIGNED) * _ALIGNED
        file.seek(start)
        field.values.tofile(file)  # raises OSError when it is cut short
        return dataclasses.replace(field, values=_nothing(field)), field.values.shape, start

    def _mapped(self, bare: DenseField, shape: tuple[int, ...], start: int) -> DenseField:
        assert self._file is not None
        if 0 in shape:
            return bare
        # "c": private, because torch warns about read-only arrays
        values = np.memmap(self._file, np.float32, mode="c", offset=start, shape=shape)
        return dataclasses.replace(bare, values=np.asarray(values))


def _key(
    file_path: str | os.PathLike[str], requests: Sequence[GridRequest], config: GridsConfig
) -> _Key | None:
    """What determines the fields; None if the file's status cannot be read."""
    try:
        status = os.stat(file_path)
    except OSError:
        return None  # ``read_grids`` reports the error
    grids = tuple((request.name, request.index, request.components) for request in requests)
    identity = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
    return (os.path.abspath(file_path), identity, grids, config.repair_nan)


def _nothing(field: DenseField) -> np.ndarray:
    return np.zeros((0, 0, 0, *field.values.shape[3:]), np.float32)


def _folder() -> Path:
    """Where large temporary files go."""
    if any(name in os.environ for name in ("TMPDIR", "TEMP", "TMP")):
        return Path(tempfile.gettempdir())
    return _DISK_TMP if os.access(_DISK_TMP, os.W_OK | os.X_OK) else Path(tempfile.gettempdir())

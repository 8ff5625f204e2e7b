"""Locks: one process alone in an output folder, or several on parts of a run.

Locks are ``flock`` on open files: the system releases them when a process ends, even if it is
killed. On a file system without locks nothing is locked. Files are still published whole, and equal
work gives equal bits, so only time is lost.
"""

import fcntl
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from usdsmoke.base.errors import OutputExists, WriteFailed
from usdsmoke.base.publish import make_folders, remove_empty

_PATIENCE = 1.0  # seconds: another process may lock the folder briefly to clean up when it ends
_LONG_PATIENCE = 300.0  # for tasks of a queue, which may be started twice, or a little early


class OutputLock:
    """The lock that this process holds on an output folder.

    Args:
        alone: True if no other process may hold it at the same time.
        real: True if the file system has locks.
    """

    def __init__(self, handle: int, alone: bool, real: bool = True) -> None:
        self._handle = handle
        self._alone = alone
        self._real = real

    @property
    def excludes_others(self) -> bool:
        """True if certainly no other process is working in the folder."""
        return self._alone and self._real

    def is_alone(self) -> bool:
        """True if certainly no other process is working in the folder; from then on none can begin.

        Call it when the work is over: the call may lose a shared lock.
        """
        self._alone = self._alone or _take(self._handle, alone=True) is True
        return self.excludes_others


@contextmanager
def lock_output(
    output: Path, alone: bool = True, waits: Callable[[], None] | None = None
) -> Iterator[OutputLock]:
    """Lock an output folder; it is made if missing, and removed if left empty.

    Args:
        alone: keep every other process out; otherwise others that share it may enter.
        waits: if given, wait some minutes for other processes; called once when the wait begins.

    Raises:
        OutputExists: another process is writing there.
        WriteFailed: the folder cannot be made or opened.
    """
    made = make_folders(output)
    handle, real = _open_and_take(output, alone, waits)
    lock = OutputLock(handle, alone, real)
    try:
        yield lock
    finally:
        if made and (lock.is_alone() or not real):
            remove_empty(made)
        os.close(handle)


@contextmanager
def hold_file(lock_path: Path) -> Iterator[None]:
    """Wait until no other process locks a lock file, and lock it.

    Args:
        lock_path: made if missing, with its folder; it is not removed.

    Raises:
        WriteFailed: the file cannot be made.
    """
    make_folders(lock_path.parent)
    try:
        handle = os.open(lock_path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise WriteFailed(
            f"cannot make the lock file {lock_path}: {error.strerror or error}. "
            "Choose a writable output folder."
        ) from None
    try:
        _take(handle, alone=True, waits=True)
        yield
    finally:
        os.close(handle)


def _open_and_take(output: Path, alone: bool, waits: Callable[[], None] | None) -> tuple[int, bool]:
    """The open and locked folder, and whether the file system has locks."""
    patience = _LONG_PATIENCE if waits is not None else 0.0 if alone else _PATIENCE
    began, told = time.monotonic(), False
    while True:
        make_folders(output)  # another process that ends may have removed it as empty
        try:
            handle = os.open(output, os.O_RDONLY)
        except FileNotFoundError:
            continue  # it was removed at this moment
        except OSError as error:
            raise WriteFailed(
                f"cannot open the folder {output}: {error.strerror or error}. Change its "
                "permissions (read, write and search), or choose another output folder."
            ) from None
        taken = _take(handle, alone)
        if taken is not False and _is_same(handle, output):
            return handle, taken is True
        os.close(handle)
        waited = time.monotonic() - began
        if waited >= patience:
            raise OutputExists(
                f"another usdsmoke is writing to {output}. Wait for it, or choose another folder."
            )
        if waits is not None and waited >= _PATIENCE and not told:
            waits()
            told = True
        time.sleep(0.05)


def _is_same(handle: int, output: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.stat(output))
    except FileNotFoundError:
        return False


def _take(handle: int, alone: bool, waits: bool = False) -> bool | None:
    """True if the lock was acquired; None if there are no locks."""
    kind = fcntl.LOCK_EX if alone else fcntl.LOCK_SH
    try:
        fcntl.flock(handle, kind if waits else kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None  # a file system without locks
    return True

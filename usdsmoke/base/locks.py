"""Who may write where: one process alone in an output folder, or several on pieces of a run.

Locks are ``flock`` on open files: the system releases them when a process ends, however rudely. On
a file system without them nothing is held. Files are still published whole, and equal work gives
equal bits, so only time is lost.
"""

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from usdsmoke.base.errors import OutputExists, WriteFailed
from usdsmoke.base.publish import make_folders, remove_empty

try:
    import fcntl
except ImportError:  # Windows: nothing keeps a second process out there
    pass

__all__ = ["OutputLock", "hold_file", "lock_output"]

_PATIENCE = 1.0  # seconds: another process may hold the folder just to tidy up when it ends
_LONG_PATIENCE = 300.0  # of tasks of a queue, which may be started twice, or a little early


class OutputLock:
    """The lock that this process holds on an output folder.

    Args:
        handle: the open folder.
        alone: whether no other process may hold it at the same time.
        real: whether the file system has locks.
    """

    def __init__(self, handle: int, alone: bool, real: bool = True) -> None:
        self._handle = handle
        self._alone = alone
        self._real = real

    @property
    def excludes_others(self) -> bool:
        """Whether it is certain that no other process is at work in the folder."""
        return self._alone and self._real

    def is_alone(self) -> bool:
        """Whether no other process is at work in the folder; then none can begin any more.

        Ask when the work is over: a shared lock may be lost by asking.
        """
        self._alone = self._alone or _take(self._handle, alone=True) is not False
        return self._alone


@contextmanager
def lock_output(
    output: Path, alone: bool = True, waits: Callable[[], None] | None = None
) -> Iterator[OutputLock]:
    """Hold an output folder; it is made if missing, and removed if left empty.

    Args:
        output: the folder.
        alone: keep every other process out; otherwise others that share it may enter.
        waits: for a process that waits some minutes for others; called once when it begins to.

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
        if made and lock.is_alone():
            remove_empty(made)
        os.close(handle)


@contextmanager
def hold_file(lock_path: Path) -> Iterator[None]:
    """Wait until no other process holds a lock file, and hold it.

    Args:
        lock_path: made if missing, with its folder; it stays.

    Raises:
        WriteFailed: the file cannot be made.
    """
    make_folders(lock_path.parent)
    try:
        handle = os.open(lock_path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise WriteFailed(
            f"cannot make the lock file {lock_path}: {error.strerror or error}. "
            "Choose an output folder that may be written to."
        ) from None
    try:
        _take(handle, alone=True, waits=True)
        yield
    finally:
        os.close(handle)


def _open_and_take(output: Path, alone: bool, waits: Callable[[], None] | None) -> tuple[int, bool]:
    """The open folder, held, and whether the file system has locks."""
    patience = _LONG_PATIENCE if waits is not None else 0.0 if alone else _PATIENCE
    began, told = time.monotonic(), False
    while True:
        make_folders(output)  # another process that ends may have removed it as empty
        try:
            handle = os.open(output, os.O_RDONLY)
        except FileNotFoundError:
            continue  # it was removed this very moment
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
    """Whether the lock was to be had; None where there are no locks."""
    if "fcntl" not in sys.modules:
        return None
    kind = fcntl.LOCK_EX if alone else fcntl.LOCK_SH
    try:
        fcntl.flock(handle, kind if waits else kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None  # a file system without locks
    return True

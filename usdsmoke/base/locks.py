"""Who may write where: one process alone in an output folder, or several on its windows.

Locks belong to open files: the system lets go of them when a process ends, however rudely. Where a
file system knows no locks nothing is held; files are still published whole, and equal work gives
equal bits, so that only time is lost.
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
    """

    def __init__(self, handle: int, alone: bool) -> None:
        self._handle = handle
        self._alone = alone

    def is_alone(self) -> bool:
        """Whether no other process is at work in the folder; then none can begin any more.

        To be asked when the work is over: a lock that was shared may be lost by asking.
        """
        self._alone = self._alone or _take(self._handle, alone=True)
        return self._alone


@contextmanager
def lock_output(
    output: Path, alone: bool = True, waits: Callable[[], None] | None = None
) -> Iterator[OutputLock]:
    """Hold an output folder; it is made if missing, and removed if left empty.

    Args:
        output: the folder.
        alone: keep every other process out; otherwise those that do not want it alone may enter.
        waits: for a process that waits some minutes for others; called once when it begins to.

    Raises:
        OutputExists: another process is writing there.
        WriteFailed: the folder cannot be made or opened.
    """
    made = make_folders(output)
    handle = _open_and_take(output, alone, waits)
    lock = OutputLock(handle, alone)
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
        lock_path: made if missing, in a folder that exists; it stays.

    Raises:
        WriteFailed: the file cannot be made.
    """
    try:
        handle = os.open(lock_path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise WriteFailed(
            f"cannot make the lock file {lock_path}: {error.strerror or error}; "
            "choose an output folder that may be written to"
        ) from None
    try:
        if "fcntl" in sys.modules:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX)
            except OSError:
                pass  # a file system without locks
        yield
    finally:
        os.close(handle)


def _open_and_take(output: Path, alone: bool, waits: Callable[[], None] | None) -> int:
    """The open folder, held."""
    patience = _LONG_PATIENCE if waits is not None else 0.0 if alone else _PATIENCE
    began, told = time.monotonic(), False
    while True:
        make_folders(output)  # one that ends may have removed it, as it left it empty
        try:
            handle = os.open(output, os.O_RDONLY)
        except FileNotFoundError:
            continue  # it was removed this very moment
        except OSError as error:
            raise WriteFailed(
                f"cannot open the folder {output}: {error.strerror or error}; change its "
                "permissions (read, write and search), or choose another output folder"
            ) from None
        if _take(handle, alone) and _is_same(handle, output):
            return handle
        os.close(handle)
        waited = time.monotonic() - began
        if waited >= patience:
            raise OutputExists(
                f"another usdsmoke is writing to {output}; wait for it or choose another folder"
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


def _take(handle: int, alone: bool) -> bool:
    """Whether the lock was to be had, without waiting."""
    if "fcntl" not in sys.modules:
        return True
    try:
        fcntl.flock(handle, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True  # a file system without locks
    return True

"""Putting a finished file in its place in one step: no reader ever meets a half-written one.

The file is written under a hidden temporary name in the folder of the target, synced to the disk,
checked, renamed over the target, and the folder is synced. Whatever happens before the rename, the
target keeps what it had; a process that is killed leaves a temporary behind, which
``remove_leftovers`` clears away when its process is gone.
"""

import errno
import os
import re
import socket
import time
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

from usdsmoke.base.errors import WriteFailed

__all__ = ["make_folders", "publish_file", "publish_new", "remove_empty", "remove_leftovers"]

_LEFTOVER = re.compile(r"\..+\.tmp-([0-9a-f]{8})-(\d+)(\.[^.]*)?")

_ADVICE = {
    errno.ENOSPC: "free some space or choose another output folder",
    errno.EDQUOT: "free some of the disk quota or choose another output folder",
    errno.EFBIG: "raise the file size limit (ulimit -f) or choose another output folder",
    errno.EACCES: "choose an output folder that may be written to, or change its permissions",
    errno.EPERM: "choose an output folder that may be written to, or change its permissions",
    errno.EROFS: "choose an output folder on a file system that is mounted for writing",
    errno.ENOENT: "make the folder first",
    errno.ENOTDIR: "choose a folder; a part of this path is a file",
    errno.EISDIR: "choose another name; there is a folder of this name",
    errno.ENAMETOOLONG: "choose a shorter name",
}

# What tells a machine from others, beside its name: containers may share that, and number their
# processes by themselves.
_BOOT = Path("/proc/sys/kernel/random/boot_id")
_PROCESS_SPACE = Path("/proc/self/ns/pid")
_STALE_S = 24 * 3600.0  # after which a temporary of somewhere else is nobody's any more

# Answers of file systems that cannot sync a folder; the rename itself has succeeded by then.
_FOLDER_SYNC_UNSUPPORTED = (errno.EINVAL, errno.ENOTSUP, errno.EBADF, errno.EACCES)

# Answers of file systems without hard links.
_LINK_UNSUPPORTED = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK)


def publish_file(
    target: Path,
    write: Callable[[Path], None],
    check: Callable[[Path], None] | None = None,
) -> None:
    """Write a file so that ``target`` is either what it was before or complete and checked.

    Args:
        target: where the file shall stand; its folder must exist. An old file is replaced.
        write: called with the temporary's path, which has the target's suffix; makes the file.
        check: called with the temporary's path after it was synced; re-opens and compares it, and
            raises when it is not what was meant.

    Raises:
        WriteFailed: the operating system refused (full disk, read-only folder, no permission).
        Exception: whatever ``write`` or ``check`` raise of their own; the temporary is gone then.
    """
    target = Path(target)
    temporary = _temporary_path(target)
    try:
        write(temporary)
        _sync(temporary)
        if check is not None:
            check(temporary)
        os.replace(temporary, target)
        _sync_folder(target.parent)
    except OSError as error:
        raise WriteFailed(_refusal(target, error)) from error
    finally:
        _remove_quietly(temporary)


def publish_new(target: Path, write: Callable[[Path], None]) -> bool:
    """Write a file unless there is one already; of several processes at once one succeeds.

    Args:
        target: where the file shall stand; its folder must exist. An old file stays as it is.
        write: called with the temporary's path; makes the file.

    Returns:
        Whether this call put the file there.

    Raises:
        WriteFailed: the operating system refused.
    """
    target = Path(target)
    temporary = _temporary_path(target)
    try:
        write(temporary)
        _sync(temporary)
        try:
            os.link(temporary, target)
        except FileExistsError:
            return False
        except OSError as error:
            if error.errno not in _LINK_UNSUPPORTED or target.exists():
                raise
            os.replace(temporary, target)
        _sync_folder(target.parent)
        return True
    except OSError as error:
        raise WriteFailed(_refusal(target, error)) from error
    finally:
        _remove_quietly(temporary)


def make_folders(folder: Path) -> list[Path]:
    """Make a folder and its parents; those that were missing, the innermost first.

    Raises:
        WriteFailed: the operating system refused.
    """
    missing = [f for f in (folder, *folder.parents) if not f.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        remove_empty(missing)
        raise WriteFailed(
            f"cannot make the folder {folder}: {error.strerror or error}; "
            "choose an output folder that may be written to"
        ) from None
    return missing


def remove_empty(folders: Sequence[Path]) -> None:
    """Remove those of some folders that are empty, in the order given."""
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            continue  # not empty, or never made


def remove_leftovers(folder: Path) -> list[Path]:
    """Remove the temporaries of processes that are no longer running.

    Whether a process of another machine or container lives cannot be known here: its temporaries
    are left alone for a day, far longer than anything takes to be written.

    Args:
        folder: the folder to look in, not below it; a folder that does not exist has none.

    Returns:
        What was removed, sorted.
    """
    removed = []
    try:
        names = sorted(os.listdir(folder))
    except OSError:
        return []
    for name in names:
        match = _LEFTOVER.fullmatch(name)
        leftover = Path(folder) / name
        if match and _is_abandoned(leftover, match[1], int(match[2])) and _remove_quietly(leftover):
            removed.append(leftover)
    return removed


def _temporary_path(target: Path) -> Path:
    mark = f"tmp-{_host_mark()}-{os.getpid()}"
    return target.with_name(f".{target.stem}.{mark}{target.suffix}")


def _host_mark() -> str:
    """Eight hexadecimal digits for the space in which process ids mean something: this machine
    since it was started, or a container on it."""
    try:
        boot, space = _BOOT.read_text(encoding="utf-8"), _PROCESS_SPACE.stat().st_ino
    except OSError:  # not Linux
        boot, space = "", 0
    return f"{zlib.crc32(f'{socket.gethostname()} {space} {boot}'.encode()):08x}"


def _is_abandoned(leftover: Path, mark: str, process_id: int) -> bool:
    if mark == _host_mark():
        return not _is_running(process_id)
    try:
        return time.time() - leftover.stat().st_mtime > _STALE_S
    except OSError:
        return False  # gone meanwhile


def _is_running(process_id: int) -> bool:
    try:
        os.kill(process_id, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True  # it lives, and belongs to somebody else
    return True


def _sync(file_path: Path) -> None:
    handle = os.open(file_path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _sync_folder(folder: Path) -> None:
    try:
        _sync(folder)
    except OSError as error:
        if error.errno not in _FOLDER_SYNC_UNSUPPORTED:
            raise


def _remove_quietly(file_path: Path) -> bool:
    try:
        file_path.unlink()
    except OSError:
        return False  # never made, renamed already, or not ours to remove
    return True


def _refusal(target: Path, error: OSError) -> str:
    reason = error.strerror or str(error)
    advice = _ADVICE.get(error.errno or 0, "check the output folder and its disk")
    return f"cannot write {target.name} in {target.parent}: {reason}; {advice}"

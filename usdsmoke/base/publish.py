"""Publishing a finished file in one step: no reader ever sees a half-written one.

The file is written under a hidden temporary name in the folder of the target, synced to the disk,
checked, renamed over the target, and the folder is synced. If anything fails before the rename, the
target is unchanged. A killed process leaves its temporary file behind: a process that is alone in
the folder removes it with ``remove_leftovers``, any other one after a day.
"""

import errno
import os
import re
import secrets
import shutil
import time
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from usdsmoke.base.errors import WriteFailed

_LEFTOVER = re.compile(r"\.(.+)\.tmp-[0-9a-f]{8}(\.[^.]*)?")

_ADVICE = {
    errno.ENOSPC: "Free some space or choose another output folder",
    errno.EDQUOT: "Free some of the disk quota or choose another output folder",
    errno.EFBIG: "Raise the file size limit (ulimit -f) or choose another output folder",
    errno.EACCES: "Choose an output folder that may be written to, or change its permissions",
    errno.EPERM: "Choose an output folder that may be written to, or change its permissions",
    errno.EROFS: "Choose an output folder on a file system that is mounted for writing",
    errno.ENOENT: "Create the folder first",
    errno.ENOTDIR: "Choose another folder: a part of this path is a file",
    errno.EISDIR: "Choose another name: a folder has this name",
    errno.ENAMETOOLONG: "Choose a shorter name",
}

_STALE_S = 24 * 3600.0  # age of an abandoned temporary: far longer than any writing takes

# Answers of file systems that cannot sync a folder; the rename itself has succeeded by then.
_FOLDER_SYNC_UNSUPPORTED = (errno.EINVAL, errno.ENOTSUP, errno.EBADF, errno.EACCES)

# Answers of file systems without hard links.
_LINK_UNSUPPORTED = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK)


Content = str | bytes | Callable[[Path], object]  # of a file, or what writes it to a path


def publish_file(
    target: Path, content: Content, check: Callable[[Path], None] | None = None
) -> None:
    """Write a file so that ``target`` is either unchanged or complete and checked.

    Args:
        target: path of the file; its folder must exist. An old file is replaced.
        content: text, written as UTF-8, or bytes; or a function that makes the file and is called
            with the temporary's path, which has the target's suffix.
        check: called with the temporary's path after it was synced; re-opens and compares it, and
            raises if it is not as intended.

    Raises:
        WriteFailed: the operating system refused (full disk, read-only folder, no permission).
        Exception: any error of ``content`` or ``check``; the temporary is removed first.
    """
    _publish(target, content, check, _replace)


def publish_new(target: Path, content: Content) -> bool:
    """Write a file unless it exists already; of several processes at once one succeeds.

    Args:
        target: path of the file; its folder must exist. An old file is kept.
        content: as in ``publish_file``.

    Returns:
        True if this call wrote the file.

    Raises:
        WriteFailed: the operating system refused.
    """
    return _publish(target, content, None, _link)


def _publish(
    target: Path,
    content: Content,
    check: Callable[[Path], None] | None,
    place: Callable[[Path, Path], bool],
) -> bool:
    target = Path(target)
    temporary = _temporary_path(target)
    try:
        if callable(content):
            content(temporary)
        else:
            temporary.write_bytes(content.encode() if isinstance(content, str) else content)
        _sync(temporary)
        if check is not None:
            check(temporary)
        is_placed = place(temporary, target)
        _sync_folder(target.parent)
        return is_placed
    except OSError as error:
        raise WriteFailed(_refusal(target, error)) from error
    finally:
        _remove_quietly(temporary)


def _replace(temporary: Path, target: Path) -> bool:
    os.replace(temporary, target)
    return True


def _link(temporary: Path, target: Path) -> bool:
    """Give the temporary the target's name unless that exists; whether it got it."""
    try:
        os.link(temporary, target)
    except FileExistsError:
        return False
    except OSError as error:
        if error.errno not in _LINK_UNSUPPORTED or target.exists():
            raise
        os.replace(temporary, target)
    return True


def share_file(source: Path, target: Path) -> None:
    """One file in two folders, for files that are replaced and never written to.

    Where the file system has no hard links it is copied. An old ``target`` is replaced.

    Raises:
        WriteFailed: the operating system refused.
    """
    make_folders(target.parent)

    def link(temporary: Path) -> None:
        try:
            os.link(source, temporary)
        except OSError:
            shutil.copyfile(source, temporary)

    if not (target.exists() and source.samefile(target)):
        publish_file(target, link)


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
            f"cannot make the folder {folder}: {error.strerror or error}. "
            "Choose a writable output folder."
        ) from None
    return missing


def remove_empty(folders: Sequence[Path]) -> None:
    """Remove those of some folders that are empty, in the order given."""
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            continue  # not empty, or never made


def remove_leftovers(folder: Path, alone: bool = False, of: Collection[str] = ()) -> None:
    """Remove the temporaries of killed processes.

    Args:
        folder: the folder to look in, not below it; a folder that does not exist has none.
        alone: True if no other process can be writing there. Otherwise only temporaries older than
            a day are removed, because the process of a newer one may still be running.
        of: file names that no other process writes: their temporaries are always removed.
    """
    stems = {Path(name).stem for name in of}
    try:
        found = [match for name in os.listdir(folder) if (match := _LEFTOVER.fullmatch(name))]
    except OSError:
        return
    for match in found:
        leftover = Path(folder) / match[0]
        if alone or match[1] in stems or _is_stale(leftover):
            _remove_quietly(leftover)


def _temporary_path(target: Path) -> Path:
    return target.with_name(f".{target.stem}.tmp-{secrets.token_hex(4)}{target.suffix}")


def _is_stale(leftover: Path) -> bool:
    try:
        return time.time() - leftover.stat().st_mtime > _STALE_S
    except OSError:
        return False  # already removed


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


def _remove_quietly(file_path: Path) -> None:
    try:
        file_path.unlink()
    except OSError:
        return  # never made, renamed already, or not ours to remove


def _refusal(target: Path, error: OSError) -> str:
    reason = error.strerror or str(error)
    advice = _ADVICE.get(error.errno or 0, "Check the output folder and its disk")
    return f"cannot write {target.name} in {target.parent}: {reason}. {advice}."

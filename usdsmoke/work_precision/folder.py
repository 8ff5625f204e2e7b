"""The folder of a report: tried before anything is measured, and replaced as a whole."""

import json
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from usdsmoke.base.errors import Interrupted, OutputExists, WriteFailed
from usdsmoke.base.publish import make_folders, publish_file, remove_empty

__all__ = ["DATA", "PAGE", "TABLE", "ReportFolder", "report_folder"]

PAGE, TABLE, DATA = "report.html", "report.csv", "report.json"


class ReportFolder:
    """A folder that can be written to, and in which no file of somebody else is in the way."""

    def __init__(self, target: Path, old: Sequence[str]) -> None:
        self._target, self._old = target, tuple(old)

    def write(
        self, files: Mapping[str, bytes], data: Callable[[Sequence[str]], str]
    ) -> tuple[Path, ...]:
        """Write a report in the place of the old one, whose other files go away.

        Until all is done ``DATA`` lists the files of both, so that nothing is left behind for good
        by a process that is killed.

        Args:
            files: bytes by name; ``DATA`` comes beside them.
            data: the text of ``DATA``, from the list of the report's files.

        Returns:
            All files, ``DATA`` last.

        Raises:
            WriteFailed: the operating system refused.
            Interrupted: by Ctrl-C.
        """
        try:
            return self._write(files, data)
        except KeyboardInterrupt:
            raise Interrupted(
                f"stopped while the report was written; {self._target} holds a part of it, which "
                "the next report replaces"
            ) from None

    def _write(
        self, files: Mapping[str, bytes], data: Callable[[Sequence[str]], str]
    ) -> tuple[Path, ...]:
        names = [*files, DATA]
        both = list(dict.fromkeys([*names, *self._old]))
        self._put(DATA, data(both).encode("utf-8"))
        for name, content in files.items():
            self._put(name, content)
        for name in set(self._old) - set(names):
            (self._target / name).unlink(missing_ok=True)
        self._put(DATA, data(names).encode("utf-8"))
        return tuple(self._target / name for name in names)

    def _put(self, name: str, content: bytes) -> None:
        publish_file(self._target / name, partial(_save, content))


@contextmanager
def report_folder(target: Path, names: Collection[str]) -> Iterator[ReportFolder]:
    """Make sure of a folder for a report; after a failure one that was made for it is removed.

    Args:
        target: absolute; need not exist.
        names: of all files that a report may have.

    Raises:
        WriteFailed: it is a file, or cannot be made or written to.
        OutputExists: files of these names stand there that are not those of an earlier report.
    """
    if target.exists() and not target.is_dir():
        raise WriteFailed(f"cannot write a report to {target}: it is a file; name a folder")
    old = _files_of(target)
    strange = sorted(name for name in names if (target / name).exists() and name not in old)
    if strange:
        raise OutputExists(
            f"{target} holds {', '.join(strange)}, which no report of usdsmoke has left there; "
            "move it away or name another folder"
        )
    made = make_folders(target)
    try:
        _try_writing(target)
        yield ReportFolder(target, old)
    except BaseException:
        remove_empty(made)
        raise


def _files_of(target: Path) -> list[str]:
    """The files that the report in a folder says are its own; none where there is no report."""
    try:
        names = json.loads((target / DATA).read_text(encoding="utf-8"))["files"]
    except (OSError, ValueError, KeyError, TypeError):
        return []
    if not isinstance(names, list):
        return []
    return [name for name in names if isinstance(name, str) and Path(name).name == name]


def _try_writing(target: Path) -> None:
    try:
        with tempfile.TemporaryFile(dir=target) as stream:
            stream.write(b"0")
    except OSError as error:
        raise WriteFailed(
            f"cannot write to the folder {target}: {error.strerror or error}; choose another one, "
            "or change its permissions"
        ) from None


def _save(content: bytes, file_path: Path) -> None:
    file_path.write_bytes(content)

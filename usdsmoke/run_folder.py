"""The folder of one run inside an output folder: what is finished, continued or replaced.

    OUT/vdb/<key>/run.json          what the run is made of, and its finished frames
    OUT/vdb/<key>/NAME.####.vdb     the frames

``<key>`` is a digest of settings and inputs, so a run that was stopped is found again by the same
command, and a result that is being replaced keeps its files until the look layer, which is written
last, points to the new ones. Whatever no layer points to is not a result.
"""

import hashlib
import json
import os
import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from usdsmoke.errors import OutputExists, WriteFailed
from usdsmoke.provenance import hash_file, new_run_id, utc_now
from usdsmoke.publish import publish_file, remove_leftovers

try:
    import fcntl
except ImportError:  # Windows: nothing keeps a second process out there
    pass

__all__ = ["RunFolder", "find_runs", "list_changes", "lock_output", "open_run"]

_RECORD = "run.json"
_KEY_LENGTH = 12
_MOST_CHANGES = 6  # that a message names


@dataclass
class RunFolder:
    """One run's folder and record; nothing is on disk before ``begin``."""

    folder: Path
    description: Mapping[str, Any]  # settings and inputs, JSON values
    run_id: str = field(default_factory=new_run_id)
    created: str = field(default_factory=utc_now)
    frames: dict[str, dict[str, Any]] = field(default_factory=dict)  # file name: record
    files: list[str] = field(default_factory=list)  # outside this folder, relative to the output
    complete: bool = False  # the look points here and nothing is left to do
    plan: Mapping[str, Any] = field(default_factory=dict)  # what was planned, for the record
    _made: list[Path] = field(default_factory=list)

    @property
    def output(self) -> Path:
        """The output folder."""
        return self.folder.parent.parent

    @property
    def settings_hash(self) -> str:
        """SHA-256 of the settings that decide the result."""
        return _digest(self.description["settings"])

    def begin(self, plan: Mapping[str, Any]) -> None:
        """Make the folders that are missing and write the record.

        Args:
            plan: JSON values to keep in the record.

        Raises:
            WriteFailed: the operating system refused.
        """
        self.plan = plan
        self._made = _make_folders(self.folder)
        remove_leftovers(self.folder)
        self._save()

    def finish_frame(self, file_name: str, record: Mapping[str, Any]) -> None:
        """Note that a frame stands in this folder as it should.

        Args:
            file_name: of the VDB file.
            record: JSON values to keep with it; the file's own digest is added.
        """
        self.frames[file_name] = {**record, "sha256": hash_file(self.folder / file_name)}
        self._save()

    def finished(self, file_name: str) -> dict[str, Any] | None:
        """The record of a frame that is finished and unchanged since; None for any other."""
        record = self.frames.get(file_name)
        file_path = self.folder / file_name
        if record is None or not file_path.is_file() or hash_file(file_path) != record["sha256"]:
            return None
        return record

    def finish(self, files: Sequence[Path]) -> None:
        """Mark the run as complete; what earlier results left behind goes away.

        Args:
            files: that belong to the result and stand outside the run's folder.
        """
        self.files = sorted(os.path.relpath(file_path, self.output) for file_path in files)
        for run in find_runs(self.output):
            if run.run_id != self.run_id:
                for name in set(run.files) - set(self.files):
                    (self.output / name).unlink(missing_ok=True)
                run.remove()
        remove_leftovers(self.output)
        self.complete = True
        self._save()

    def discard_if_useless(self) -> None:
        """Remove what ``begin`` made when no frame was finished: a refusal leaves nothing."""
        if not self.frames:
            (self.folder / _RECORD).unlink(missing_ok=True)
            _remove_empty([self.folder, *self._made])

    def remove(self) -> None:
        """Remove the whole run: the record first, so that half of it cannot pass for a run."""
        (self.folder / _RECORD).unlink(missing_ok=True)
        shutil.rmtree(self.folder, ignore_errors=True)

    def _save(self) -> None:
        record = {
            "run_id": self.run_id,
            "created": self.created,
            "description": self.description,
            "frames": self.frames,
            "files": self.files,
            "complete": self.complete,
            "plan": self.plan,
        }
        text = json.dumps(record, indent=1, sort_keys=True, ensure_ascii=False)
        publish_file(self.folder / _RECORD, lambda path: _write_text(path, text))


@contextmanager
def lock_output(output: Path) -> Iterator[None]:
    """Hold an output folder for one process; it is made if missing, and removed if left empty.

    Where the file system knows no locks, nothing is held.

    Raises:
        OutputExists: another process is writing there.
        WriteFailed: the folder cannot be made.
    """
    made = _make_folders(output)
    handle = os.open(output, os.O_RDONLY)
    try:
        _lock(handle, output)
        yield
    finally:
        os.close(handle)
        _remove_empty(made)


def find_runs(output: Path) -> Iterator[RunFolder]:
    """The runs that left a record in an output folder, finished or not, in the order of names."""
    for record_path in sorted(output.glob(f"vdb/*/{_RECORD}")):
        try:
            record = json.loads(record_path.read_text(encoding="utf-8"))
            yield RunFolder(
                folder=record_path.parent,
                description=record["description"],
                run_id=record["run_id"],
                created=record["created"],
                frames=record["frames"],
                files=record["files"],
                complete=record["complete"],
                plan=record["plan"],
            )
        except (OSError, ValueError, TypeError, KeyError):
            continue  # not a record of ours


def open_run(
    output: Path, description: Mapping[str, Any], published: Set[str], force: bool
) -> RunFolder:
    """The run to begin or to continue; with ``force``, runs that never became a result go away.

    A look layer may point to a run that was stopped before its last step; such a run is continued
    like any other.

    Args:
        output: the output folder; need not exist.
        description: settings and inputs, JSON values.
        published: run ids that the look layers in the folder name; "" for one that names none.
        force: replace a result, and give up unfinished runs of other settings.

    Raises:
        OutputExists: there is a result or an unfinished run of other settings, without ``force``.
    """
    description = json.loads(json.dumps(description))  # as it comes back from a record
    runs = {run.run_id: run for run in find_runs(output)}
    results = {run_id for run_id in published if run_id not in runs or runs[run_id].complete}
    unfinished = [run for run_id, run in runs.items() if run_id not in results]
    others = [run for run in unfinished if run.description != description]
    if results and not force:
        raise OutputExists(
            f"there is a result in {output} already; choose another output folder, "
            "or replace it with --force"
        )
    if others and not force:
        changes = list_changes(others[0].description, description)
        raise OutputExists(
            f"{output} holds an unfinished run of other settings or inputs: {changes}; run it "
            "again as it was to finish it, choose another output folder, or give it up with --force"
        )
    for run in others:
        if run.run_id not in published:
            run.remove()
    for run in unfinished:
        if run.description == description:
            run.complete = False
            return run
    return RunFolder(_free_folder(output, _digest(description)[:_KEY_LENGTH]), description)


def list_changes(earlier: Mapping[str, Any], later: Mapping[str, Any]) -> str:
    """What differs between two descriptions, in words.

    >>> list_changes({"optimize": {"seed": 0}}, {"optimize": {"seed": 1}})
    'optimize.seed was 0, now 1'
    """
    before, after = dict(_flatten(earlier)), dict(_flatten(later))
    changes = [
        f"{name} was {_shown(before, name)}, now {_shown(after, name)}"
        for name in sorted({*before, *after})
        if before.get(name) != after.get(name)
    ]
    more = len(changes) - _MOST_CHANGES
    return ", ".join(changes[:_MOST_CHANGES]) + (f" and {more} more" if more > 0 else "")


def _lock(handle: int, output: Path) -> None:
    if "fcntl" not in sys.modules:
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise OutputExists(
            f"another usdsmoke is writing to {output}; wait for it or choose another folder"
        ) from None
    except OSError:
        return  # a file system without locks


def _make_folders(folder: Path) -> list[Path]:
    """Make a folder and its parents; those that were missing, the innermost first."""
    missing = [f for f in (folder, *folder.parents) if not f.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        _remove_empty(missing)
        raise WriteFailed(
            f"cannot make the folder {folder}: {error.strerror or error}; "
            "choose an output folder that may be written to"
        ) from None
    return missing


def _remove_empty(folders: Sequence[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            continue  # not empty, or never made


def _digest(description: Mapping[str, Any]) -> str:
    text = json.dumps(description, sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _free_folder(output: Path, key: str) -> Path:
    """The key's folder, or the next one when the result that is being replaced has the same key."""
    folder, number = output / "vdb" / key, 2
    while folder.exists():
        folder, number = output / "vdb" / f"{key}-{number}", number + 1
    return folder


def _flatten(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping) and value:
            yield from _flatten(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _shown(values: Mapping[str, Any], name: str) -> str:
    if name not in values:
        return "absent"
    text = json.dumps(values[name], ensure_ascii=False)
    return text if len(text) <= 40 else f"{text[:12]}..."


def _write_text(file_path: Path, text: str) -> None:
    with open(file_path, "w", encoding="utf-8") as stream:
        stream.write(text)
        stream.flush()
        os.fsync(stream.fileno())

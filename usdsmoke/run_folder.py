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
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from usdsmoke.errors import OutputExists, WriteFailed
from usdsmoke.provenance import hash_file, new_run_id, utc_now
from usdsmoke.publish import publish_file, remove_leftovers

__all__ = ["RunFolder", "find_runs", "list_changes", "open_run"]

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
    _made: list[Path] = field(default_factory=list)

    @property
    def output(self) -> Path:
        """The output folder."""
        return self.folder.parent.parent

    def begin(self) -> None:
        """Make the folders that are missing and write the record.

        Raises:
            WriteFailed: the operating system refused.
        """
        try:
            for folder in (self.output, self.folder.parent, self.folder):
                missing = [f for f in (folder, *folder.parents) if not f.exists()]
                folder.mkdir(parents=True, exist_ok=True)
                self._made += reversed(missing)
        except OSError as error:
            self.discard_if_useless()
            raise WriteFailed(
                f"cannot make the output folder {self.folder}: {error.strerror or error}; "
                "choose one that may be written to"
            ) from None
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

    def discard_if_useless(self) -> None:
        """Remove what ``begin`` made when no frame was finished: a refusal leaves nothing."""
        if self.frames:
            return
        (self.folder / _RECORD).unlink(missing_ok=True)
        for folder in [self.folder, *reversed(self._made)]:
            try:
                folder.rmdir()
            except OSError:
                continue  # not empty, not there, or not ours

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
        }
        text = json.dumps(record, indent=1, sort_keys=True, ensure_ascii=False)
        publish_file(self.folder / _RECORD, lambda path: _write_text(path, text))


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
            )
        except (OSError, ValueError, TypeError, KeyError):
            continue  # not a record of ours


def open_run(
    output: Path, description: Mapping[str, Any], published: str | None, force: bool
) -> RunFolder:
    """The run to begin or to continue; with ``force``, runs that never became a result go away.

    Args:
        output: the output folder; need not exist.
        description: settings and inputs, JSON values.
        published: run id of the result that stands there, "" when it has none, None without one.
        force: replace a result, and give up unfinished runs of other settings.

    Raises:
        OutputExists: there is a result or an unfinished run of other settings, without ``force``.
    """
    description = json.loads(json.dumps(description))  # as it comes back from a record
    runs = [run for run in find_runs(output) if run.run_id != published]
    same = [run for run in runs if run.description == description]
    others = [run for run in runs if run.description != description]
    if published is not None and not force:
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
        run.remove()
    if same:
        return same[0]
    return RunFolder(_free_folder(output, _digest(description)), description)


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


def _digest(description: Mapping[str, Any]) -> str:
    text = json.dumps(description, sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()[:_KEY_LENGTH]


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

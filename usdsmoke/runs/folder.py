"""The folder of one run inside an output folder: what it is made of, continued or replaced.

    OUT/vdb/<key>/run.json             settings, inputs, plan; scenes and frames when complete
    OUT/vdb/<key>/scenes.json          what was measured once for all windows, until then
    OUT/vdb/<key>/NAME.####.vdb        the frames
    OUT/vdb/<key>/windows/KKKK.json    what a finished window has written: see ``run_windows``
    OUT/vdb/<key>/parts/KKKK/          one window's versions of frames that two windows compute
    OUT/vdb/<key>/coarse/, coarse.json what windows start from, where there are several

``<key>`` is a digest of settings and inputs, so a run that was stopped is found again by the same
command, and a result that is being replaced keeps its files until the look layer, which is written
last, points to the new ones. Whatever no layer points to is not a result.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from usdsmoke.base.frame_report import FrameReport
from usdsmoke.base.naming import DEFAULT_LOOK, RUN_RECORD, run_record_files
from usdsmoke.base.publish import (
    make_folders,
    publish_file,
    publish_new,
    remove_empty,
    remove_leftovers,
)
from usdsmoke.base.record_format import hash_file, new_run_id, utc_now

__all__ = ["RunFolder", "find_runs", "new_run", "write_json"]

_SCENES = "scenes.json"
_KEPT = ("run_id", "created", "description", "frames", "files", "complete", "plan")
_KEPT_TOO = ("request", "scenes", "error_budget", "seconds", "processor")
_KEY_LENGTH = 12


@dataclass
class RunFolder:
    """One run's folder and record; nothing is on disk before ``begin``."""

    folder: Path
    description: Mapping[str, Any]  # settings and inputs, JSON values
    run_id: str = field(default_factory=new_run_id)
    created: str = field(default_factory=utc_now)
    frames: dict[str, dict[str, Any]] = field(default_factory=dict)  # of the result, by file name
    files: list[str] = field(default_factory=list)  # outside this folder, relative to the output
    complete: bool = False  # the look points here and nothing is left to do
    plan: Mapping[str, Any] = field(default_factory=dict)  # what was planned, for the record
    request: Mapping[str, Any] = field(default_factory=dict)  # what it takes to make the job again
    scenes: Sequence[Mapping[str, Any]] = ()  # measured once, one for each Volume; empty: not yet
    processor: str = ""  # kind of that which the run was begun on
    error_budget: Mapping[str, Any] = field(default_factory=dict)  # when complete
    seconds: Mapping[str, float] = field(default_factory=dict)  # by part of the work, likewise
    _made: list[Path] = field(default_factory=list)
    _digests: dict[tuple[str, int, int, int], str] = field(default_factory=dict)

    @property
    def output(self) -> Path:
        """The output folder."""
        return self.folder.parent.parent

    @property
    def look(self) -> str:
        """The name of the look that the run makes; runs of different looks know nothing of each
        other."""
        return _look_of(self.description)

    @property
    def reports(self) -> dict[str, FrameReport]:
        """The reports of the result's frames by file name, in the order of names: a sum's last
        bits must not depend on who ran which window."""
        return {n: FrameReport.from_json(self.frames[n]["report"]) for n in sorted(self.frames)}

    @property
    def settings_hash(self) -> str:
        """SHA-256 of the settings that decide the result."""
        return _digest(self.description["settings"])

    @property
    def has_begun(self) -> bool:
        """Whether there is a record on the disk."""
        return bool(self.request)

    def begin(
        self, plan: Mapping[str, Any], request: Mapping[str, Any], processor: str = ""
    ) -> None:
        """Make the folders that are missing and the record, all in JSON values.

        Where another process has begun the same run meanwhile, its record counts.

        Args:
            plan: to keep in the record.
            request: what it takes to make the job again.
            processor: the kind of this machine's.

        Raises:
            WriteFailed: the operating system refused.
        """
        self.plan, self.request, self.processor = plan, request, processor
        self._made = make_folders(self.folder)
        text = self._as_text()
        if not publish_new(self.folder / RUN_RECORD, lambda path: _write_text(path, text)):
            if not self.adopt():
                self.save()

    def keep_scenes(self, scenes: Sequence[Mapping[str, Any]]) -> None:
        """Note what was measured; what another process has noted meanwhile counts.

        Args:
            scenes: one for each Volume, JSON values.

        Raises:
            WriteFailed: the operating system refused.
        """
        kept = {"run_id": self.run_id, "scenes": scenes}
        text = _json_text(kept)
        if not publish_new(self.folder / _SCENES, lambda path: _write_text(path, text)):
            if not _read_scenes(self.folder, self.run_id):  # left by a run that was removed
                write_json(self.folder / _SCENES, kept)
        self.scenes = _read_scenes(self.folder, self.run_id) or scenes

    def adopt(self) -> bool:
        """Take up the record of this run that is on the disk; whether there is one."""
        for run in find_runs(self.output):
            if run.folder == self.folder and run.description == self.description:
                for name in (*_KEPT, *_KEPT_TOO):
                    setattr(self, name, getattr(run, name))
                return True
        return False

    def tidy(self) -> None:
        """Remove what processes that were killed have left half-written."""
        remove_leftovers(self.folder)
        for folder in self.folder.rglob("*/"):
            remove_leftovers(folder)

    def is_unchanged(self, file_name: str, digest: str) -> bool:
        """Whether a file of this folder has this SHA-256.

        Args:
            file_name: relative to the run's folder.
            digest: 64 hexadecimal digits.
        """
        file_path = self.folder / file_name
        if not file_path.is_file():
            return False
        status = file_path.stat()
        key = (file_name, status.st_ino, status.st_size, status.st_mtime_ns)
        if key not in self._digests:
            self._digests[key] = hash_file(file_path)
        return self._digests[key] == digest

    def finish_frame(self, file_name: str, record: Mapping[str, Any]) -> None:
        """Note that a frame of the result stands in this folder as it should.

        Args:
            file_name: of the VDB file.
            record: JSON values to keep with it; the file's own digest is added.
        """
        self.frames[file_name] = {**record, "sha256": hash_file(self.folder / file_name)}
        self.save()

    def finished(self, file_name: str) -> dict[str, Any] | None:
        """The record of a frame of the result that is unchanged since; None for any other."""
        record = self.frames.get(file_name)
        if record is None or not self.is_unchanged(file_name, record["sha256"]):
            return None
        return record

    def finish(self, files: Sequence[Path]) -> None:
        """Mark the run as complete; what earlier results of this look left behind goes away.

        Args:
            files: that belong to the result and stand outside the run's folder.
        """
        self.files = sorted(os.path.relpath(file_path, self.output) for file_path in files)
        others = [run for run in find_runs(self.output) if run.run_id != self.run_id]
        kept = {name for run in others if run.look != self.look for name in run.files}
        for run in others:
            if run.look == self.look:
                for name in set(run.files) - set(self.files) - kept:
                    (self.output / name).unlink(missing_ok=True)
                run.remove()
        remove_leftovers(self.output)
        self.tidy()
        if (self.folder / _SCENES).exists():
            self.save()  # scenes and all
            (self.folder / _SCENES).unlink()
        self.complete = True
        self.save()

    def remove(self) -> None:
        """Remove the whole run: the record first, so that half of it cannot pass for a run."""
        (self.folder / RUN_RECORD).unlink(missing_ok=True)
        shutil.rmtree(self.folder, ignore_errors=True)
        remove_empty([*self._made, self.folder.parent])

    def save(self) -> None:
        """Write the record; only a process that is alone in the output folder may.

        Raises:
            WriteFailed: the operating system refused.
        """
        text = self._as_text()
        publish_file(self.folder / RUN_RECORD, lambda path: _write_text(path, text))

    def _as_text(self) -> str:
        names = (*_KEPT, *_KEPT_TOO)
        return _json_text({name: getattr(self, name) for name in names})


def write_json(target: Path, value: Any) -> None:
    """Put JSON values into a file in one step, in a folder that is made if missing.

    Raises:
        WriteFailed: the operating system refused.
    """
    make_folders(target.parent)
    publish_file(target, lambda path: _write_text(path, _json_text(value)))


def find_runs(output: Path) -> Iterator[RunFolder]:
    """The runs that left a record in an output folder, finished or not, in the order of names."""
    for record_path in run_record_files(output):
        try:
            record = json.loads(record_path.read_text(encoding="utf-8"))
            kept = {name: record[name] for name in _KEPT}
            later = {name: record[name] for name in _KEPT_TOO if name in record}
            later["scenes"] = later.get("scenes") or _read_scenes(
                record_path.parent, record["run_id"]
            )
            yield RunFolder(folder=record_path.parent, **kept, **later)
        except (OSError, ValueError, TypeError, KeyError):
            continue  # not a record of ours


def new_run(output: Path, description: Mapping[str, Any]) -> RunFolder:
    """A run that has not begun, in a folder of its own.

    Args:
        output: the output folder; need not exist.
        description: settings and inputs, JSON values.
    """
    description = json.loads(json.dumps(description))  # as it comes back from a record
    return RunFolder(_free_folder(output, _digest(description)[:_KEY_LENGTH]), description)


def _read_scenes(folder: Path, run_id: str) -> Sequence[Mapping[str, Any]]:
    """What was measured for this run; nothing where there is no such file."""
    try:
        kept = json.loads((folder / _SCENES).read_text(encoding="utf-8"))
        return list(kept["scenes"]) if kept["run_id"] == run_id else ()
    except (OSError, ValueError, TypeError, KeyError):
        return ()


def _look_of(description: Mapping[str, Any]) -> str:
    look: str = description["settings"].get("layer", {}).get("look", DEFAULT_LOOK)
    return look


def _digest(description: Mapping[str, Any]) -> str:
    text = json.dumps(description, sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _free_folder(output: Path, key: str) -> Path:
    """The key's folder, or the next one when the result that is being replaced has the same key."""
    folder, number = output / "vdb" / key, 2
    while (folder / RUN_RECORD).exists():
        folder, number = output / "vdb" / f"{key}-{number}", number + 1
    return folder


def _json_text(value: Any) -> str:
    return json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False)


def _write_text(file_path: Path, text: str) -> None:
    with open(file_path, "w", encoding="utf-8") as stream:
        stream.write(text)
        stream.flush()
        os.fsync(stream.fileno())

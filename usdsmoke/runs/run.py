"""One run on disk: its folder, its record, the manifests of its tasks, and who is at which.

    OUT/vdb/<key>/run.json             settings, inputs, plan; scenes and frames when complete
    OUT/vdb/<key>/scenes.json          what was measured once for all windows, until then
    OUT/vdb/<key>/NAME.####.vdb        the frames; ``delivery`` gives them other paths too
    OUT/vdb/<key>/windows/KKKK.json    the manifest of a finished window: see ``manifests``
    OUT/vdb/<key>/checkpoints/KKKK.npz what an unfinished window goes on with
    OUT/vdb/<key>/parts/KKKK/          one window's versions of frames that two windows compute
    OUT/vdb/<key>/coarse/, coarse.json what windows start from, where there are several
    OUT/vdb/<key>/networks/            what the run has trained (optimize.start=network)
    *.lock                             held by the process that computes a task

``<key>`` is a digest of settings and inputs, so a run that was stopped is found again by the same
command, and a result that is being replaced keeps its files until the look layer, which is written
last, points to the new ones. Whatever no layer points to is not a result.
"""

import errno
import json
import os
import shutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeVar

from usdsmoke.base.errors import FileUnreadable
from usdsmoke.base.frame_report import FrameReport
from usdsmoke.base.json_records import read_json
from usdsmoke.base.locks import hold_file
from usdsmoke.base.naming import DEFAULT_LOOK, RUN_RECORD, RUNS_FOLDER, find_run_files
from usdsmoke.base.publish import (
    make_folders,
    publish_file,
    publish_new,
    remove_empty,
    remove_leftovers,
)
from usdsmoke.base.record_format import hash_file, hash_values, new_run_id, utc_now
from usdsmoke.runs.manifests import CoarseRecord, WindowRecord

_SCENES = "scenes.json"
# errors that say nothing of a file's content: it must not pass for a damaged one
_PASSING = {errno.EACCES, errno.EPERM, errno.EIO, errno.ESTALE, errno.ETIMEDOUT}
_DIGEST = "sha256"  # of the other values of a file
_COARSE = "coarse.json"
_CHECKPOINTS = "checkpoints"
_KEY_LENGTH = 12

_Manifest = TypeVar("_Manifest", WindowRecord, CoarseRecord)


@dataclass
class Run:
    """One run's folder and record; nothing is on disk before ``begin``.

    Methods that write raise WriteFailed where the operating system refuses.
    """

    folder: Path
    description: Mapping[str, Any]  # settings and inputs, JSON values
    # Size and time of writing (ns) of ``files`` in the description, as they were read: one that has
    # the same is taken to be the same.
    stamps: Mapping[str, Sequence[int]] = field(default_factory=dict)
    run_id: str = field(default_factory=new_run_id)
    created: str = field(default_factory=utc_now)
    frames: dict[str, dict[str, Any]] = field(default_factory=dict)  # of the result, by file name
    files: list[str] = field(default_factory=list)  # outside this folder, relative to the output
    complete: bool = False  # the look points here and nothing is left to do
    grown_from: Sequence[str] = ()  # ids of the runs that it went on from
    plan: Mapping[str, Any] = field(default_factory=dict)  # what was planned, for the record
    request: Mapping[str, Any] = field(default_factory=dict)  # what it takes to make the job again
    scenes: Sequence[Mapping[str, Any]] = ()  # measured once, one for each Volume; empty: not yet
    processor: str = ""  # the kind of processor that the run was begun on
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
        """The look that the run makes; runs of different looks are independent."""
        look: str = self.description["settings"].get("layer", {}).get("look", DEFAULT_LOOK)
        return look

    @property
    def reports(self) -> dict[str, FrameReport]:
        """The reports of the result's frames by file name, in the order of names: a sum's last
        bits must not depend on which process ran which window."""
        return {n: FrameReport.from_json(self.frames[n]["report"]) for n in sorted(self.frames)}

    @property
    def has_begun(self) -> bool:
        """Whether there is a record on disk."""
        return bool(self.request)

    # The record

    def begin(
        self, plan: Mapping[str, Any], request: Mapping[str, Any], processor: str = ""
    ) -> None:
        """Make the folders that are missing and the record, all in JSON values.

        If another process has begun the same run meanwhile, its record is used.
        """
        self.plan, self.request, self.processor = plan, request, processor
        self._made = make_folders(self.folder)
        if not _publish_json(self.folder / RUN_RECORD, self._record(), new=True):
            if not self.adopt():
                self.save()

    def adopt(self) -> bool:
        """Use the record of this run that is on disk; whether there is one."""
        for run in find_runs(self.output):
            if run.folder == self.folder and run.description == self.description:
                vars(self).update(run._record())
                return True
        return False

    def save(self) -> None:
        """Write the record; only a process that is alone in the output folder may."""
        _publish_json(self.folder / RUN_RECORD, self._record())

    def keep_scenes(self, scenes: Sequence[Mapping[str, Any]]) -> None:
        """Note what was measured, unless another process has noted it meanwhile."""
        kept = {"run_id": self.run_id, "scenes": scenes}
        if not _publish_json(self.folder / _SCENES, kept, new=True):
            if not _read_scenes(self.folder, self.run_id):  # left by a run that was removed
                _publish_json(self.folder / _SCENES, kept)
        self.scenes = _read_scenes(self.folder, self.run_id) or scenes

    def finish_frame(self, file_name: str, record: Mapping[str, Any]) -> None:
        """Note that a frame of the result is in this folder as it should be.

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

    def finish(self, files: Sequence[Path], alone: bool = False) -> None:
        """Mark the run as complete, and remove what earlier results of this look left behind.

        Only a process that is alone in the output folder may.

        Args:
            files: that belong to the result and are outside the run's folder.
        """
        self.files = sorted(os.path.relpath(file_path, self.output) for file_path in files)
        others = [run for run in find_runs(self.output) if run.run_id != self.run_id]
        kept = {name for run in others if run.look != self.look for name in run.files}
        for run in others:
            if run.look == self.look:
                for name in set(run.files) - set(self.files) - kept:
                    (self.output / name).unlink(missing_ok=True)
                    above = [f for f in (self.output / name).parents if self.output in f.parents]
                    remove_empty(above)
                run.remove()
        for record_path in self.damaged():
            shutil.rmtree(record_path.parent, ignore_errors=True)
        for folder in {(self.output / name).parent for name in self.files}:
            remove_leftovers(folder, of=self.files)
        self.tidy(alone)
        shutil.rmtree(self.folder / _CHECKPOINTS, ignore_errors=True)
        if (self.folder / _SCENES).exists():
            self.save()  # scenes and all
            (self.folder / _SCENES).unlink()
        self.complete = True
        self.save()

    def damaged(self) -> list[Path]:
        """Records of the same settings and inputs, and so of this look, that cannot be read."""
        key = self.folder.name.partition("-")[0]
        paths = damaged_records(self.output)
        return [path for path in paths if path.parent.name.partition("-")[0] == key]

    def remove(self) -> None:
        """Remove the whole run: the record first, so that half of it cannot pass for a run."""
        (self.folder / RUN_RECORD).unlink(missing_ok=True)
        shutil.rmtree(self.folder, ignore_errors=True)
        remove_empty([*self._made, self.folder.parent])

    def tidy(self, alone: bool = False) -> None:
        """Remove temporaries of killed processes."""
        for folder in (self.folder, *self.folder.rglob("*/")):
            remove_leftovers(folder, alone)

    # The tasks: the coarse step, and windows by their number

    @contextmanager
    def claim(self, window: int | None = None) -> Iterator[None]:
        """Keep other processes from a window, or without a number from the coarse step, meanwhile.

        A second process waits here, and finds the task finished when it enters.

        Raises:
            WriteFailed: the lock file cannot be made.
        """
        name = "coarse.lock" if window is None else f"windows/{window:04d}.lock"
        with hold_file(self.folder / name):
            yield

    def remove_locks(self) -> None:
        """Remove the lock files; only a process that is alone in the output folder may."""
        for lock_path in (*self.folder.rglob("*.lock"), *self.folder.parent.glob("*.lock")):
            lock_path.unlink(missing_ok=True)

    def manifest_path(self, window: int | None = None) -> Path:
        """Where the manifest of a window, or without a number of the coarse step, belongs."""
        return self.folder / (_COARSE if window is None else f"windows/{window:04d}.json")

    def checkpoint_path(self, window: int) -> Path:
        """Where the state of an unfinished window belongs, until it is finished."""
        return self.folder / _CHECKPOINTS / f"{window:04d}.npz"

    @property
    def has_checkpoints(self) -> bool:
        """Whether a window was stopped behind a finished frame."""
        return any((self.folder / _CHECKPOINTS).glob("[0-9]*.npz"))  # not temporaries

    def keep(self, manifest: WindowRecord | CoarseRecord) -> None:
        """Write a manifest, after its files."""
        window = manifest.window if isinstance(manifest, WindowRecord) else None
        target = self.manifest_path(window)
        make_folders(target.parent)
        _publish_json(target, asdict(manifest))

    def window(self, number: int) -> WindowRecord | None:
        """The manifest of a window whose files are all unchanged; None for any other."""
        record = self._manifest(WindowRecord, number)
        unchanged = record is not None and len(self._unchanged(record)) == len(record.frames)
        return record if unchanged else None

    def coarse(self, names: Collection[str] | None = None) -> CoarseRecord:
        """The coarse step's manifest with those frames whose files are unchanged; maybe none.

        Args:
            names: the files that are asked for; no other is read. None: all.
        """
        record = self._manifest(CoarseRecord) or CoarseRecord(self.run_id, {})
        return replace(record, frames=self._unchanged(record, names))

    def made_on(self) -> dict[int | None, str]:
        """The kind of processor by window, None for the coarse step, from the manifests alone."""
        windows = [int(p.stem) for p in sorted((self.folder / "windows").glob("[0-9]*.json"))]
        found: dict[int | None, str] = {}
        if coarse := self._manifest(CoarseRecord):
            found[None] = coarse.processor
        for number in windows:
            if window := self._manifest(WindowRecord, number):
                found[number] = window.processor
        return found

    def is_useless(self) -> bool:
        """Whether nothing is finished: not a frame, and not a frame of the coarse step."""
        manifests = any((self.folder / "windows").glob("[0-9]*.json"))  # not temporaries
        is_begun = manifests or self.has_checkpoints or self.manifest_path().is_file()
        return not (self.frames or is_begun)

    def is_unchanged(self, file_name: str, digest: str) -> bool:
        """Whether a file of this folder has this SHA-256."""
        file_path = self.folder / file_name
        if not file_path.is_file():
            return False
        status = file_path.stat()
        key = (file_name, status.st_ino, status.st_size, status.st_mtime_ns)
        if key not in self._digests:
            self._digests[key] = hash_file(file_path)
        return self._digests[key] == digest

    def _unchanged(
        self, record: WindowRecord | CoarseRecord, names: Collection[str] | None = None
    ) -> dict[str, dict[str, Any]]:
        return {
            name: frame
            for name, frame in record.frames.items()
            if (names is None or name in names) and self.is_unchanged(name, frame["sha256"])
        }

    def _manifest(self, kind: type[_Manifest], window: int | None = None) -> _Manifest | None:
        """A manifest of this run as it was written; None where there is none."""
        try:
            record = kind(**_read_json(self.manifest_path(window)))
            digests = [str(frame["sha256"]) for frame in record.frames.values()]
            is_ours = record.run_id == self.run_id and all(digests)
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            return None  # not a manifest of ours
        return record if is_ours else None

    def _record(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in _record_names()}


def find_runs(output: Path) -> Iterator[Run]:
    """The runs that left a record in an output folder, finished or not, in the order of names."""
    for record_path in find_run_files(output):
        if run := _read_run(record_path):
            yield run


def damaged_records(output: Path) -> list[Path]:
    """The records of runs in an output folder that cannot be read, in the order of names."""
    return [path for path in find_run_files(output) if _read_run(path) is None]


def _read_run(record_path: Path) -> Run | None:
    """The run that left a record; None for what is no record of ours."""
    try:
        record = _read_json(record_path)
        known = {name: record[name] for name in _record_names() if name in record}
        run = Run(folder=record_path.parent, **{"run_id": record["run_id"], **known})
        run.scenes = run.scenes or _read_scenes(run.folder, run.run_id)
        return run
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def new_run(
    output: Path, description: Mapping[str, Any], stamps: Mapping[str, Sequence[int]]
) -> Run:
    """A run that has not begun, in a folder of its own."""
    key = hash_values(description)[:_KEY_LENGTH]
    folder, number = output / RUNS_FOLDER / key, 2
    while (folder / RUN_RECORD).exists():  # a result with the same key is being replaced
        folder, number = output / RUNS_FOLDER / f"{key}-{number}", number + 1
    return Run(folder, description, stamps)


def _record_names() -> list[str]:
    """What ``run.json`` holds: all public fields but the folder."""
    names = [item.name for item in fields(Run) if not item.name.startswith("_")]
    return [name for name in names if name != "folder"]


def _read_scenes(folder: Path, run_id: str) -> Sequence[Mapping[str, Any]]:
    """What was measured for this run; nothing where there is no such file."""
    try:
        kept = _read_json(folder / _SCENES)
        return list(kept["scenes"]) if kept["run_id"] == run_id else ()
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return ()


def _read_json(file_path: Path) -> dict[str, Any]:
    """The values that ``_publish_json`` wrote.

    Raises:
        ValueError: the file was damaged or edited since.
        FileUnreadable: it may not be read, or the disk or its server failed.
    """
    try:
        text = file_path.read_text(encoding="utf-8")
    except OSError as error:
        if error.errno not in _PASSING:
            raise
        raise FileUnreadable(
            f"cannot read {file_path}: {error.strerror}. Check its permissions and its disk."
        ) from None
    values = read_json(text)
    digest = values.pop(_DIGEST)
    if digest != hash_values(values):
        raise ValueError(f"{file_path} is damaged")
    return dict(values)


def _publish_json(target: Path, values: Mapping[str, Any], new: bool = False) -> bool:
    """Put JSON values into a file in one step; with ``new`` only if it is not there: whether."""
    plain = json.loads(json.dumps(values))  # as they are read: keys are text, tuples are lists
    signed = {**plain, _DIGEST: hash_values(plain)}
    text = json.dumps(signed, indent=1, sort_keys=True, ensure_ascii=False)
    if new:
        return publish_new(target, text)
    publish_file(target, text)
    return True

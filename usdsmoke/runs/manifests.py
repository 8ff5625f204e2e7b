"""What the windows and the coarse step of a run have left in its folder: one manifest for each.

A manifest is written when all its files stand; without it, or with a file that has changed since,
the work counts as not done. It names its run, so that what a removed run left behind is not taken.
"""

import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from usdsmoke.base.frame_report import FrameReport
from usdsmoke.base.locks import hold_file
from usdsmoke.base.publish import make_folders, remove_empty
from usdsmoke.runs.folder import RunFolder, write_json

__all__ = [
    "CoarseRecord",
    "WindowRecord",
    "coarse_file_name",
    "finish_coarse",
    "finish_window",
    "finished_coarse",
    "finished_window",
    "forget_beginning",
    "hold_beginning",
    "hold_work",
    "is_useless",
    "made_on",
    "manifest_path",
    "part_file_name",
    "remove_locks",
]

_BEGINNING = "vdb/begin.lock"


@dataclass(frozen=True)
class WindowRecord:
    """The manifest of a finished window."""

    run_id: str
    window: int
    volume: str  # prim path
    time_codes: list[float]  # its own
    beyond: list[float]  # those of the next window that it computes too
    frames: dict[str, dict[str, Any]]  # by file, relative to the run's folder; see write_result
    seconds: float
    timings: dict[str, float] = field(default_factory=dict)  # of these: reading, writing
    processor: str = ""  # kind of that which made it

    @property
    def reports(self) -> dict[str, FrameReport]:
        """The reports of its frames, by file."""
        return {name: FrameReport.from_json(f["report"]) for name, f in self.frames.items()}


@dataclass(frozen=True)
class CoarseRecord:
    """The manifest of the coarse step, as far as it is done."""

    run_id: str
    frames: dict[str, dict[str, Any]]  # by file, relative to the run's folder: time_code, sha256
    seconds: float = 0.0
    processor: str = ""  # kind of that which made the last of them


def manifest_path(run: RunFolder, window: int) -> Path:
    """Where a window's manifest stands."""
    return run.folder / "windows" / f"{window:04d}.json"


def part_file_name(window: int, file_name: str) -> str:
    """Where a window's version of a frame stands that two windows compute."""
    return f"parts/{window:04d}/{file_name}"


def coarse_file_name(file_name: str) -> str:
    """Where the coarse start of a frame stands, by the name of the frame's file."""
    return f"coarse/{file_name.removesuffix('.vdb')}.npz"


def finish_window(run: RunFolder, record: WindowRecord) -> None:
    """Write a window's manifest, after its files.

    Raises:
        WriteFailed: the operating system refused.
    """
    write_json(manifest_path(run, record.window), asdict(record))


def finished_window(run: RunFolder, window: int) -> WindowRecord | None:
    """The manifest of a window whose files all stand unchanged; None for any other."""
    values = _read(manifest_path(run, window), run)
    try:
        record = WindowRecord(**values) if values else None
        return record if record and _is_whole(run, record.frames) else None
    except (TypeError, KeyError, AttributeError):
        return None  # not a manifest of ours


def finish_coarse(run: RunFolder, record: CoarseRecord) -> None:
    """Write the coarse step's manifest, after its files.

    Raises:
        WriteFailed: the operating system refused.
    """
    write_json(run.folder / "coarse.json", asdict(record))


def finished_coarse(run: RunFolder, names: Collection[str] | None = None) -> CoarseRecord:
    """The coarse step's manifest with those frames whose files stand unchanged; maybe none.

    Args:
        run: with its folder.
        names: the files that are asked for; no other is read. None: all.
    """
    values = _read(run.folder / "coarse.json", run)
    try:
        record = CoarseRecord(**values) if values else CoarseRecord(run.run_id, {})
        whole = {
            name: frame
            for name, frame in record.frames.items()
            if (names is None or name in names) and run.is_unchanged(name, frame["sha256"])
        }
        return replace(record, frames=whole, seconds=float(record.seconds))
    except (TypeError, KeyError, AttributeError, ValueError):
        return CoarseRecord(run.run_id, {})


def made_on(run: RunFolder) -> dict[int | None, str]:
    """The kind of processor by window, None for the coarse step, from the manifests alone."""
    files: dict[int | None, Path] = {None: run.folder / "coarse.json"}
    files |= {int(p.stem): p for p in sorted((run.folder / "windows").glob("[0-9]*.json"))}
    return {
        window: str(values.get("processor", ""))
        for window, file_path in files.items()
        if (values := _read(file_path, run))
    }


def is_useless(run: RunFolder) -> bool:
    """Whether nothing of a run is finished: neither a window nor a coarse frame nor a result."""
    manifests = any((run.folder / "windows").glob("[0-9]*.json"))  # none that is half-written
    return not (run.frames or manifests or (run.folder / "coarse.json").is_file())


@contextmanager
def hold_beginning(output: Path) -> Iterator[None]:
    """Keep other processes from beginning a run in an output folder meanwhile; they wait.

    Raises:
        WriteFailed: the lock file cannot be made.
    """
    make_folders(output / "vdb")
    with hold_file(output / _BEGINNING):
        yield


@contextmanager
def hold_work(run: RunFolder, window: int | None = None) -> Iterator[None]:
    """Keep other processes from a window, or without a number from the coarse step, meanwhile.

    A second process waits here, and finds the work done when it comes in.

    Raises:
        WriteFailed: the lock file cannot be made.
    """
    name = "coarse.lock" if window is None else f"windows/{window:04d}.lock"
    make_folders((run.folder / name).parent)
    with hold_file(run.folder / name):
        yield


def remove_locks(run: RunFolder) -> None:
    """Remove the lock files of a run; only a process that is alone in the output folder may."""
    for lock_path in run.folder.rglob("*.lock"):
        lock_path.unlink(missing_ok=True)
    (run.output / _BEGINNING).unlink(missing_ok=True)


def forget_beginning(output: Path) -> None:
    """Remove what ``hold_beginning`` has left; only a process that is alone there may."""
    (output / _BEGINNING).unlink(missing_ok=True)
    remove_empty([output / "vdb"])


def _read(file_path: Path, run: RunFolder) -> dict[str, Any]:
    """A manifest of this run; empty when there is none."""
    try:
        values = json.loads(file_path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    is_ours = isinstance(values, dict) and values.get("run_id") == run.run_id
    return values if is_ours else {}


def _is_whole(run: RunFolder, frames: Mapping[str, Mapping[str, Any]]) -> bool:
    return all(run.is_unchanged(name, frame["sha256"]) for name, frame in frames.items())

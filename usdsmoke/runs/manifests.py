"""Manifests: what a finished window, or the coarse step so far, has left in the run's folder.

A manifest is written when all files of its task are in place. Without it, or with a file that has
changed since, the task is not finished. It names its run, so files of a removed run are not taken.
"""

from dataclasses import dataclass, field
from typing import Any

from usdsmoke.base.frame_report import FrameReport


@dataclass(frozen=True)
class WindowRecord:
    """The manifest of a finished window."""

    run_id: str
    window: int
    volume: str  # prim path
    time_codes: list[float]  # its own
    overlap: list[float]  # those of the next window that it computes too
    frames: dict[str, dict[str, Any]]  # by file, relative to the run's folder; see write_result
    seconds: float
    timings: dict[str, float] = field(default_factory=dict)  # see TimedWindow
    processor: str = ""  # the kind of processor that computed it

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
    processor: str = ""  # the kind of processor; of several, one that the run was not begun on


def part_file_name(window: int, file_name: str) -> str:
    """Where a window's version of a frame belongs that two windows compute."""
    return f"parts/{window:04d}/{file_name}"


def coarse_file_name(file_name: str) -> str:
    """Where the coarse start of a frame belongs, by the name of the frame's file."""
    return f"coarse/{file_name.removesuffix('.vdb')}.npz"


def network_file_name(volume_number: int) -> str:
    """Where the network belongs that a run trains for a Volume."""
    return f"networks/{volume_number:02d}.safetensors"

"""What a run will cost in memory, time and disk, from voxel counts and settings alone.

All formulae stand here, with their constants in one place. With N active voxels and B voxels of the
box (both after refinement), P pixels of a picture, V pictures an iteration, L views in the pool,
S style images, s an octave's linear resolution as a share of the full one:

    memory  = BASE + BOX_BYTES B + N (VOXEL_BYTES + L VIEW_BYTES) + PIXEL_BYTES P V
    seconds = START + sum over frames of (FRAME + sum over steps and octaves of
                  n (ITERATION + V (S PIXEL_TIME P s^2 + VOXEL_TIME N s^3)) + L VIEW_TIME N s^3)
    bytes   = sum over frames of (FILE_BYTES + N bytes per value x values per voxel x TREE)

Memory is the largest frame's; frames are held one at a time. Times are for one CPU thread, divided
by the gain of several. They are estimates: a factor of two either way is normal, and the memory is
meant to be an upper bound.
"""

import math
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from usdsmoke.config import Config, ViewsConfig
from usdsmoke.core.schedule import OCTAVE_SCALE, octave_iterations, warm_iterations

__all__ = [
    "Estimate",
    "FrameSize",
    "available_memory_gib",
    "estimate_run",
    "free_disk_bytes",
    "n_different_views",
    "usable_cpus",
]

GIB = 2**30

BASE = 0.7 * GIB  # the interpreter with USD and torch loaded, and frames that are remembered
BOX_BYTES = 48  # density before and after, displacement, RGB, and one array in the making
VOXEL_BYTES = 240  # positions, colours, their gradients and Adam's moments, octaves
VIEW_BYTES = 96  # four pixels and weights, in two orders
PIXEL_BYTES = 12_000  # feature maps and what is kept of them for the gradient

START = 4.0  # loading torch, learning the filters
FRAME = 1.5  # reading, checking, writing and re-opening the files
ITERATION = 0.006
PIXEL_TIME = 5.0e-6
VOXEL_TIME = 2.5e-7
VIEW_TIME = 6.0e-7
GAIN = 0.8  # n threads are n ** GAIN times as quick

FILE_BYTES = 60_000  # header and tree of a file with little in it
TREE = 1.3  # masks and nodes beside the values


@dataclass(frozen=True)
class FrameSize:
    """How large one frame is, as far as its file's header tells."""

    active_voxels: int
    box: tuple[int, int, int]  # voxels along i, j, k; (0, 0, 0) when empty
    window_start: bool = True  # False: it starts from its neighbour's result


@dataclass(frozen=True)
class Estimate:
    """Costs of a run."""

    memory_gib: float  # peak
    seconds: float
    bytes_written: int


def estimate_run(
    frames: Sequence[FrameSize], config: Config, n_styles: int = 1, threads: int | None = None
) -> Estimate:
    """Peak memory, time and bytes written, by the formulae at the top of this file.

    Args:
        frames: of all volumes; empty frames cost their file only.
        config: the resolved settings.
        n_styles: style images.
        threads: None takes the configured number, or all of the machine.
    """
    threads = threads or config.optimize.threads or usable_cpus()
    seconds = START + sum(_frame_seconds(frame, config, n_styles) for frame in frames)
    return Estimate(
        memory_gib=max((_frame_memory(frame, config) for frame in frames), default=BASE) / GIB,
        seconds=seconds / threads**GAIN,
        bytes_written=sum(_frame_bytes(frame, config) for frame in frames),
    )


def n_different_views(views: ViewsConfig) -> int:
    """Views that a run draws from: one when both ranges are zero, whatever was asked for."""
    return 1 if views.azimuth == 0 and views.elevation == 0 else max(views.pool, views.count)


def usable_cpus() -> int:
    """Processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return max(1, os.cpu_count() or 1)


def available_memory_gib() -> float:
    """Memory that can still be had, GiB: the machine's or the control group's, whichever is less.

    Infinite where the system does not tell.
    """
    candidates = [math.inf]
    for line in _lines("/proc/meminfo"):
        if line.startswith("MemAvailable:"):
            candidates.append(float(line.split()[1]) * 1024)
    limit, used = _lines("/sys/fs/cgroup/memory.max"), _lines("/sys/fs/cgroup/memory.current")
    if limit and used and limit[0].strip().isdigit():
        candidates.append(float(limit[0]) - float(used[0]))
    return min(candidates) / GIB


def free_disk_bytes(folder: Path) -> int:
    """Free bytes on the disk that ``folder`` is on, or will be on once it is made."""
    folder = Path(folder).absolute()
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return shutil.disk_usage(folder).free


def _lines(file_path: str) -> list[str]:
    try:
        return Path(file_path).read_text(encoding="ascii").splitlines()
    except OSError:
        return []


def _refined(frame: FrameSize, config: Config) -> tuple[int, int]:
    """Active voxels and voxels of the box after subdivision."""
    finer: int = config.grids.refine**3
    return frame.active_voxels * finer, math.prod(frame.box) * finer


def _picture_pixels(frame: FrameSize, config: Config) -> float:
    *_, middle, longest = sorted(frame.box)
    return config.views.image_size**2 * min(1.0, middle / max(longest, 1))


def _frame_memory(frame: FrameSize, config: Config) -> float:
    active, box = _refined(frame, config)
    per_voxel = VOXEL_BYTES + n_different_views(config.views) * VIEW_BYTES
    pictures = PIXEL_BYTES * _picture_pixels(frame, config) * config.views.count
    return BASE + BOX_BYTES * box + active * per_voxel + pictures


def _frame_seconds(frame: FrameSize, config: Config, n_styles: int) -> float:
    active, _ = _refined(frame, config)
    if active == 0 or config.optimize.strength == 0:
        return FRAME
    pixels = n_styles * PIXEL_TIME * _picture_pixels(frame, config)
    n_views = n_different_views(config.views)
    total = FRAME
    for step in config.optimize.steps:
        per_octave = getattr(config, step).iterations
        octaves = octave_iterations(per_octave, config.optimize.iterations)
        if not frame.window_start:
            octaves = warm_iterations(octaves, config.windows.warm_iterations)
        for number, n_iterations in enumerate(octaves):
            if n_iterations == 0:
                continue
            scale = float(OCTAVE_SCALE) ** -(len(octaves) - 1 - number)
            picture = pixels * scale**2 + VOXEL_TIME * active * scale**3
            total += n_iterations * (ITERATION + config.views.count * picture)
            total += n_views * VIEW_TIME * active * scale**3
    return total


def _frame_bytes(frame: FrameSize, config: Config) -> int:
    active, _ = _refined(frame, config)
    values = (
        1 + 3 * ("colour" in config.optimize.steps) + 3 * (config.layer.copy_velocity is not False)
    )
    return round(FILE_BYTES + active * (2 if config.grids.half else 4) * values * TREE)

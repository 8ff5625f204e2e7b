"""The plan of a run: Volumes, frames, windows, what is needed and left out, and what it costs."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from usdsmoke.base.errors import ConfigError, PlanError, count_text
from usdsmoke.base.time_codes import parse_frames, select_frames
from usdsmoke.base.volume import FrameSource, StageSource, VolumeSource
from usdsmoke.config.settings import Config
from usdsmoke.planning.copied import CopiedGrid
from usdsmoke.planning.estimate import CostEstimate, FrameSize, training_seconds
from usdsmoke.planning.frames import MaskSource, VelocitySource
from usdsmoke.planning.windows import Window
from usdsmoke.vdb.header import GridHeader


@dataclass(frozen=True)
class Omission:
    """Something that is not read, computed or written."""

    what: str
    reason: str
    expected: bool = False  # nothing that somebody asked for or has to know


@dataclass(frozen=True)
class FramePlan:
    """One frame that will be written."""

    source: FrameSource
    size: FrameSize
    grid: GridHeader
    velocity: VelocitySource | None  # None: there is none, or the core does not need it
    copied: VelocitySource | None  # None: it is not copied to the result's file
    mask: MaskSource | None  # None: none is configured, or there is no effect to scale
    file_name: str  # of the result
    others: tuple[CopiedGrid, ...] = ()  # other grids that are copied (layer.copy_fields)

    @property
    def is_empty(self) -> bool:
        """True when the header says that no voxel is active."""
        return self.size.active_voxels == 0

    @property
    def files(self) -> set[str]:
        """The VDB files that it is read from."""
        return {field.file_path for field in self.source.fields.values()}


@dataclass(frozen=True)
class VolumePlan:
    """One Volume with its frames and windows."""

    source: VolumeSource
    stem: str
    frames: tuple[FramePlan, ...]
    windows: tuple[Window, ...]
    config: Config  # its own: the run's settings with those that the prim requests
    styles: tuple[int, ...]  # indices of its images among the run's
    coarse_runs: tuple[tuple[float, ...], ...] = ()  # timeCodes that share a coarse step
    cuts: tuple[tuple[float, float], ...] = ()  # pairs of timeCodes with a cut between them
    not_copied: Mapping[str, str] = field(default_factory=dict)  # fields by name: why not
    beside: tuple[str, ...] = ()  # grids of the density's file without a relationship, not used
    # By timeCode, selected or not: where a frame's file goes in the output folder (layer.files);
    # empty: files stay in the run's folder.
    places: Mapping[float, str] = field(default_factory=dict)
    chose_refine: bool = False  # grids.refine was unset

    @property
    def request_text(self) -> str:
        """What the prim requests itself, as a sentence; "" for nothing."""
        request = self.source.request
        names = sorted(f"{section}.{key}" for section, v in request.settings.items() for key in v)
        found = [*(["style images"] if request.styles else []), *names]
        return f"the request of <{self.source.prim_path}>: {', '.join(found)}" if found else ""

    @property
    def sizes(self) -> list[FrameSize]:
        """Of the frames."""
        return [frame.size for frame in self.frames]

    @property
    def training_seconds(self) -> float:
        """Of the network that its run trains; 0 where it trains none."""
        return training_seconds(self.sizes, self.config, len(self.styles))

    @property
    def filled(self) -> list[FramePlan]:
        """The frames that hold smoke."""
        return [frame for frame in self.frames if not frame.is_empty]

    @property
    def with_all_weights(self) -> Config:
        """The settings, with the greatest weight that each style image has in any frame."""
        style = self.config.style
        own = tuple(style.weights) or (1.0,) * len(self.styles)
        found = {frame.source.controls.style_weights or own for frame in self.frames}
        greatest = [max(weights) for weights in zip(*found, strict=True)]
        return self.config.replace(style=style.replace(weights=greatest))

    @property
    def moves_fields(self) -> bool:
        """Whether copied fields move with the density."""
        return self.config.layer.move_fields and "shape" in self.config.optimize.steps

    def file_of(self, frame: FramePlan) -> str:
        """The frame's file, relative to the output folder; without ``layer.files`` the run's."""
        return self.places.get(frame.source.time_code, frame.file_name)

    @property
    def starts_from_network(self) -> bool:
        """Whether a network starts all that is done: windows then share no coarse step."""
        optimize = self.config.optimize
        return bool(optimize.start) and "shape" not in optimize.steps

    @property
    def coarse_frames(self) -> tuple[FramePlan, ...]:
        """The frames of the shared coarse step: none if no window follows another."""
        if self.starts_from_network:
            return ()
        codes = {code for run in self.coarse_runs for code in run}
        return tuple(frame for frame in self.frames if frame.source.time_code in codes)

    @property
    def overlap_frames(self) -> tuple[FramePlan, ...]:
        """The frames that two windows compute, and whose versions are blended."""
        codes = {code for window in self.windows for code in window.overlap}
        return tuple(frame for frame in self.frames if frame.source.time_code in codes)


@dataclass(frozen=True)
class WindowTask:
    """One window with the frames that it computes."""

    window: Window
    volume_number: int
    volume: VolumePlan
    frames: tuple[FramePlan, ...]  # its own, then those of the overlap

    @property
    def number(self) -> int:
        """The window's, from 0 over all Volumes."""
        return self.window.index

    def is_part(self, frame: FramePlan) -> bool:
        """True if another window computes the frame too, and both versions are blended."""
        return any(frame is other for other in self.volume.overlap_frames)


@dataclass(frozen=True)
class Plan:
    """All decisions that are made before the run."""

    source: StageSource
    config: Config  # the run's; a Volume's own is in its plan
    volumes: tuple[VolumePlan, ...]
    needed: tuple[str, ...]
    omitted: tuple[Omission, ...]
    estimate: CostEstimate
    notes: tuple[str, ...] = ()  # what may surprise at the end, a sentence each
    # what keeps the result from being seen as it is, with the remedy
    warnings: tuple[str, ...] = ()

    def __str__(self) -> str:
        paths = ", ".join(f"<{volume.source.prim_path}>" for volume in self.volumes)
        frames, windows = count_text(self.n_frames, "frame"), count_text(len(self.tasks), "window")
        cost = f"{self.estimate.seconds:.0f} s, {self.estimate.memory_gib:.1f} GiB of memory"
        return "\n".join(
            (f"{paths}: {frames} in {windows}, about {cost}", *self.warnings, *self.notes)
        )

    @property
    def n_frames(self) -> int:
        """Of all Volumes."""
        return sum(len(volume.frames) for volume in self.volumes)

    @property
    def training_seconds(self) -> float:
        """Of all networks that the run trains."""
        return sum(volume.training_seconds for volume in self.volumes)

    @property
    def tasks(self) -> list[WindowTask]:
        """The windows of all Volumes, in the order of their numbers."""
        tasks = []
        for number, volume in enumerate(self.volumes):
            frames = {frame.source.time_code: frame for frame in volume.frames}
            for window in volume.windows:
                members = tuple(frames[code] for code in (*window.time_codes, *window.overlap))
                tasks.append(WindowTask(window, number, volume, members))
        return tasks

    def largest_volume(self) -> tuple[VolumePlan, list[FramePlan]]:
        """The Volume whose largest frame has most voxels, and its frames that hold smoke.

        Raises:
            PlanError: there is no smoke in any frame.
        """
        filled = [(volume, frames) for volume in self.volumes if (frames := volume.filled)]
        if not filled:
            raise PlanError(
                f"no selected frame of {self.source.file_path} holds smoke. Choose other frames "
                "with --frames, or another Volume with --prim."
            )
        return max(filled, key=lambda item: max(f.size.active_voxels for f in item[1]))

    def task(self, window: int) -> WindowTask:
        """The window of this number.

        Raises:
            ConfigError: there is none; the message says how many there are.
        """
        tasks = self.tasks
        if not 0 <= window < len(tasks):
            known = f"Give a number from 0 to {len(tasks) - 1}."
            known = "The only window is 0." if len(tasks) == 1 else known
            raise ConfigError(f"there is no window {window}. {known}")
        return tasks[window]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON: volumes, frames, windows, needed, omitted, estimate."""
        return {
            "stage": self.source.file_path,
            "volumes": [_volume_dict(volume) for volume in self.volumes],
            "frames": [
                _frame_dict(volume, frame) for volume in self.volumes for frame in volume.frames
            ],
            "windows": [
                {"volume": volume.source.prim_path, **asdict(window)}
                for volume in self.volumes
                for window in volume.windows
            ],
            "needed": list(self.needed),
            "omitted": [asdict(omission) for omission in self.omitted],
            "notes": list(self.notes),
            "warnings": list(self.warnings),
            "estimate": asdict(self.estimate),
        }


def _volume_dict(volume: VolumePlan) -> dict[str, Any]:
    first = volume.frames[0]
    fields: Mapping[str, Any] = first.source.fields
    request = volume.source.request
    return {
        "prim_path": volume.source.prim_path,
        "stem": volume.stem,
        "animated": volume.source.animated,
        "fields": sorted(fields),
        "density_prim": fields[volume.source.density].prim_path,
        "grid": first.grid.label,
        "time_codes": [frame.source.time_code for frame in volume.frames],
        "largest_box": list(max((frame.size.box for frame in volume.frames), key=math.prod)),
        "most_active_voxels": max(frame.size.active_voxels for frame in volume.frames),
        "request": {
            "settings": {key: dict(values) for key, values in request.settings.items()},
            "styles": [Path(name).name for name in request.styles],
        },
    }


def _frame_dict(volume: VolumePlan, frame: FramePlan) -> dict[str, Any]:
    window = next(
        window.index for window in volume.windows if frame.source.time_code in window.time_codes
    )
    return {
        "volume": volume.source.prim_path,
        "time_code": frame.source.time_code,
        "window": window,
        "source_file": frame.source.fields[volume.source.density].file_path,
        "grid": frame.grid.label,
        "active_voxels": frame.grid.active_voxels,
        "box": list(frame.size.box),
        "velocity": [grid.label for grid in frame.velocity.grids] if frame.velocity else [],
        "mask": frame.mask.grid.label if frame.mask else "",
        "empty": frame.is_empty,
        "output_file": volume.file_of(frame),
    }


def decisive_frames(volume: VolumePlan) -> list[FramePlan]:
    """The frames that decide what is the same in all: those with visible smoke that
    ``optics.frames`` names; else all that have some; else all."""
    seen = [frame for frame in volume.filled if frame.size.visible > 0]
    named = {frame.source.time_code for frame in named_frames(volume)}
    chosen = [frame for frame in seen if frame.source.time_code in named]
    return chosen or seen or list(volume.frames)


def named_frames(volume: VolumePlan) -> list[FramePlan]:
    """The frames that ``optics.frames`` names; none where it names none of this Volume's."""
    ranges = parse_frames(volume.config.optics.frames)
    codes, _ = select_frames(ranges, (frame.source.time_code for frame in volume.frames))
    return [frame for frame in volume.frames if frame.source.time_code in codes]

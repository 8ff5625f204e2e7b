"""The scene of a report: one frame, and a smaller copy of it for trials."""

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from usdsmoke.base.errors import PlanError
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.config.settings import Config
from usdsmoke.planning.frame_reader import FrameReader, read_frame
from usdsmoke.planning.frames import find_frame_velocity
from usdsmoke.planning.job import Job
from usdsmoke.planning.plan import FramePlan, VolumePlan
from usdsmoke.vdb.header import read_header

if TYPE_CHECKING:
    import torch

    from usdsmoke.core.smoke.active import ActiveSmoke
    from usdsmoke.core.smoke.thicken import Thickening
    from usdsmoke.core.views.scene import Scene

_SHORTEST = 24  # voxels along the longest side of the small copy: less shows no style


@dataclass
class Case:
    """What sweeps measure.

    ``scene`` and ``frame`` are those of a run, with the density refined and thickened. ``small`` is
    the same frame with its voxels merged in blocks until its longest side has at most ``longest``.
    ``small_scene`` has pictures to match and the same extinction.
    """

    job: Job
    volume: VolumePlan
    reader: FrameReader
    plan: FramePlan  # of the frame
    frame: VolumeFrame
    scene: "Scene"
    longest: int  # voxels along the longest side of the small copy, at most
    seconds: float  # that the whole report may take
    thickening: "Thickening | None" = None  # of all frames that are read
    allowed: float = math.inf  # seconds that the current sweep may take, set by the engine
    cache: dict[Hashable, Any] = field(default_factory=dict)  # what several sweeps share

    @property
    def config(self) -> Config:
        """The Volume's settings."""
        return self.volume.config

    @property
    def steps(self) -> Sequence[str]:
        """The configured steps."""
        return self.config.optimize.steps

    @cached_property
    def styles(self) -> list[np.ndarray]:
        """The Volume's style images, display-encoded [H W 3]."""
        return self.job.pictures(self.volume)

    @cached_property
    def device(self) -> "torch.device":
        """Where the core computes."""
        from usdsmoke.core.smoke.device import choose_device

        return choose_device(self.config.optimize)

    @property
    def on_gpu(self) -> bool:
        """Whether the core runs on a GPU, where CPU time says nothing."""
        return self.device.type != "cpu"

    @cached_property
    def smoke(self) -> "ActiveSmoke":
        """The frame's active voxels."""
        from usdsmoke.core.smoke.active import activate

        return activate(self.frame.density, self.frame.density_to_stage, self.device)

    @cached_property
    def small(self) -> VolumeFrame:
        """The smaller copy."""
        return self.shrunk(self.frame)

    @cached_property
    def small_smoke(self) -> "ActiveSmoke":
        """Its active voxels."""
        from usdsmoke.core.smoke.active import activate

        return activate(self.small.density, self.small.density_to_stage, self.device)

    @cached_property
    def small_scene(self) -> "Scene":
        """Pictures with the small copy's voxels as pixels, or coarser ones where configured."""
        scene, voxel = self.scene, self.small_smoke.voxel_size
        pixel = voxel * max(1, round(scene.pixel_size / voxel))
        image_size = max(16, round(scene.image_size * scene.pixel_size / pixel))
        return replace(
            scene, pixel_size=pixel, image_size=image_size, camera=self.frame.camera,
            most_voxels=len(self.small_smoke.ijk),
        )  # fmt: skip

    @property
    def can_shrink(self) -> bool:
        """Whether the small copy can be made smaller."""
        low, high = self.small_smoke.box
        return self.longest // 2 >= _SHORTEST and int((high - low + 1).max()) > self.longest // 2

    def shrink(self, longest: int) -> None:
        """Change the size of the small copy and forget what was made from it."""
        self.longest = longest
        for name in ("small", "small_smoke", "small_scene", "halvings"):
            self.__dict__.pop(name, None)

    @cached_property
    def halvings(self) -> int:
        """How many times the small copy's voxels were merged."""
        return _halvings(self.smoke, self.longest)

    def shrunk(self, frame: VolumeFrame) -> VolumeFrame:
        """A frame with its density as coarse as the small copy's; without its mask."""
        from usdsmoke.core.smoke.active import activate, coarsen

        smoke = activate(frame.density, frame.density_to_stage, self.device)
        for _ in range(self.halvings):
            smoke = coarsen(smoke)
        return replace(
            frame, density=_field_of(smoke, frame.density), density_to_stage=np.eye(4),
            mask=None, mask_to_stage=None,
        )  # fmt: skip

    def neighbours(self, n_frames: int) -> list[FramePlan]:
        """The frame with those around it, in order, without empty ones: so many at most."""
        frames = self.volume.filled
        place = next(n for n, frame in enumerate(frames) if frame is self.plan)
        first = max(0, min(place - n_frames // 2, len(frames) - n_frames))
        return frames[first : first + n_frames]

    def read_with_velocity(self, frame: FramePlan) -> VolumeFrame:
        """A frame with its velocity, where it has one, even if the configured run reads none."""
        return _as_computed(self._read_with_velocity(frame), self.config, self.thickening)

    def _read_with_velocity(self, frame: FramePlan) -> VolumeFrame:
        volume, config = self.volume, self.config
        if frame.velocity is not None or config.stage.motion == "estimate":
            return self.reader.read(volume, frame)
        files = {source.file_path for source in frame.source.fields.values()}
        headers = {file_path: read_header(file_path) for file_path in files}
        found = find_frame_velocity(volume.source, frame.source, headers, config)
        if found is None:
            return self.reader.read(volume, frame)
        rate = self.job.plan.source.time_codes_per_second
        return read_frame(volume.source, frame.source, config, found, rate, None)


def open_case(job: Job, longest: int, seconds: float) -> Case:
    """The frame of a job that a report is made on: the middle one of the largest Volume.

    Args:
        longest: voxels along the longest side of the small copy, at most.

    Raises:
        PlanError: there is no smoke in any frame.
        GridError, NonFiniteError: a file cannot be used.
    """
    from usdsmoke.core.views.scene import Scene
    from usdsmoke.runs.coarse import measure_scenes

    volume, frames = job.plan.largest_volume()
    chosen, reader = frames[len(frames) // 2], FrameReader(job.plan)
    place = next(n for n, other in enumerate(job.plan.volumes) if other is volume)
    scene = Scene(**measure_scenes(reader, job)[place])
    frame = reader.read(volume, chosen)
    curve = scene.thickening
    frame = _as_computed(frame, volume.config, curve)
    scene = replace(scene.without_thickening(), camera=frame.camera)
    case = Case(job, volume, reader, chosen, frame, scene, longest, seconds, thickening=curve)
    if len(case.smoke.ijk) == 0:
        raise PlanError(
            f"timeCode {frame.time_code:g} of <{volume.source.prim_path}> holds no positive "
            "density. Choose other frames with --frames."
        )
    return case


def _as_computed(
    frame: VolumeFrame, config: Config, thickening: "Thickening | None"
) -> VolumeFrame:
    """The frame with the voxels and the density that a run computes with."""
    from usdsmoke.core.fields.resample import refine_field

    frame = replace(frame, density=refine_field(frame.density, config.grids.parts))
    return frame if thickening is None else thickening.of_frame(frame)


def _halvings(smoke: "ActiveSmoke", longest: int) -> int:
    low, high = smoke.box
    side, count = int((high - low + 1).max()), 0
    while side > longest:
        side, count = (side + 1) // 2, count + 1
    return count


def _field_of(smoke: "ActiveSmoke", like: DenseField) -> DenseField:
    """Smoke as a dense field whose grid world is stage space."""
    from usdsmoke.core.smoke.active import densify

    if len(smoke.ijk) == 0:
        return replace(like, values=np.zeros((0, 0, 0), np.float32))
    low, high = smoke.box
    shape = tuple(int(n) for n in high - low + 1)
    values = densify(smoke.ijk, smoke.density[:, None], smoke.ijk.amin(0), shape)[..., 0]
    return DenseField(
        like.name, values.cpu().numpy(), (int(low[0]), int(low[1]), int(low[2])),
        smoke.index_to_stage,
    )  # fmt: skip

"""A shot to stylize, and quick stand-ins for the core and for OpenVDB's process.

The stand-ins can be put in place of the real modules before those are imported, so that a process
that is only there to be killed starts without torch.
"""

import shutil
import sys
import tempfile
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image
from pxr import Usd, UsdVol

from tests.forks import run_forks
from tests.grids_fixtures import check_content, raw_grid, write_raw
from tests.usd_fixtures import density_prim, sequence, volume_prim, world, write_text, write_vdb
from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.base.frame_report import FrameReport, Progress, TemporalErrors
from usdsmoke.base.sections import GridsConfig
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.pipeline import StylizeResult, stylize
from usdsmoke.vdb import worker
from usdsmoke.vdb.child import ChildFailure
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.read import GridRequest, read_grids

if TYPE_CHECKING:  # the processes that are killed do without
    import pytest

PROJECT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Shot:
    """Where a test's inputs and outputs are."""

    folder: Path
    stage: Path
    style: Path
    output: Path

    def arguments(self, *more: str) -> list[str]:
        """Of ``usdsmoke stylize``."""
        files = [str(self.stage), "--style", str(self.style), "-o", str(self.output)]
        return ["stylize", *files, *more]


def make_shot(folder: Path, n_frames: int = 3, names: Sequence[str] = ("density",)) -> Shot:
    """A stage with one Volume, /World/smoke, whose density is another number in every frame."""
    time_codes = range(1, n_frames + 1)
    for code in time_codes:
        write_vdb(folder / f"in/cache/smoke.{code:04d}.vdb", names, value=0.5 + code / 8)
    stage = write_text(
        folder / "in/shot.usda", world(volume_prim(density_prim(sequence(time_codes))))
    )
    return Shot(folder, stage, make_style(folder / "in/style.png"), folder / "out")


def make_style(file_path: Path) -> Path:
    """A small picture with some colour in it."""
    ramp = np.linspace(0, 255, 24 * 16 * 3).reshape(16, 24, 3).astype(np.uint8)
    file_path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(ramp).save(file_path)
    return file_path


@dataclass(frozen=True)
class FakeStylized:
    """The same attributes as the core's frames."""

    time_code: float
    density: DenseField
    emission: DenseField | None
    report: FrameReport = field(default_factory=FrameReport)


@dataclass(frozen=True)
class FakeScene:
    """The same attributes as the core's scenes, as far as they are asked for."""

    gamma_w: float = 2.0
    gamma_w_shape: float = 1.0
    up_axis: str = "Z"
    reference_voxel_size: float = 0.5  # stage units


@dataclass(frozen=True)
class FakeStart:
    """A coarse start: a number that depends on every frame before."""

    time_code: float
    number: float


class FakeCore:
    """Halves the density, so that a result can be told from its source; colours it by the seed.

    What a frame becomes depends on the coarse start of its window and on its place in it a little:
    two windows' versions of a frame differ, and whoever forgets a start is found out.
    """

    def __init__(self) -> None:
        self.coarse: list[float] = []  # timeCodes of the coarse step
        self.stylized: list[float] = []  # timeCodes, in the order in which they were done
        self.velocities: list[bool] = []
        self.masks: list[bool] = []
        self.processor = "stand-in"
        self.before_frame: Callable[[float], None] = lambda time_code: None
        self.before_coarse: Callable[[float], None] = lambda time_code: None

    def describe_machine(self, config: Any) -> types.SimpleNamespace:
        device = "cpu" if config.device == "auto" else config.device
        return types.SimpleNamespace(device=device, processor=self.processor)

    def measure_scene(
        self, frames: Sequence[VolumeFrame], views: Any, optics: Any, up_axis: str, refine: int
    ) -> FakeScene:
        return FakeScene(up_axis=up_axis)

    def stylize_window(
        self,
        frames: Iterable[VolumeFrame],
        styles: Sequence[np.ndarray],
        scene: FakeScene,
        config: Any,
        progress: Callable[[Progress], None] | None = None,
        time_codes_per_second: float = 24.0,
        starts: Callable[[float], FakeStart | None] | None = None,
    ) -> Iterator[FakeStylized]:
        carried = 0.0
        for number, frame in enumerate(frames):
            start = starts(frame.time_code) if starts is not None else None
            if start is not None:
                assert start.time_code == frame.time_code
                carried = 0.5 * carried + start.number
            self.before_frame(frame.time_code)
            self.stylized.append(frame.time_code)
            self.velocities.append(frame.velocity is not None)
            self.masks.append(frame.mask is not None)
            for step in config.optimize.steps:
                if progress is not None:
                    progress(Progress(step, frame.time_code, number, 0, 2, 3, 0, 1, 0.5))
            errors = {"displacement": 0.25, "colour": 0.5} if number else None
            yield self._stylize(frame, config, carried, errors)

    def coarse_frames(
        self,
        frames: Iterable[VolumeFrame],
        styles: Sequence[np.ndarray],
        scene: FakeScene,
        config: Any,
        progress: Callable[[Progress], None] | None = None,
        time_codes_per_second: float = 24.0,
        known: FakeStart | None = None,
    ) -> Iterator[FakeStart]:
        carried = 0.0
        for number, frame in enumerate(frames):
            if known is not None and known.time_code == frame.time_code:
                carried = known.number
                yield known
                continue
            self.before_coarse(frame.time_code)
            self.coarse.append(frame.time_code)
            carried = 0.3 * carried + float(frame.density.values.max(initial=0.0)) / 7
            if progress is not None:
                progress(Progress("shape", frame.time_code, number, 0, 0, 1, 0, 1, 0.5))
            yield FakeStart(frame.time_code, carried)

    def save_start(self, start: FakeStart, file_path: Path) -> None:
        np.savez(file_path, numbers=np.array([start.time_code, start.number]))

    def load_start(self, file_path: Path) -> FakeStart:
        with np.load(file_path) as arrays:
            return FakeStart(*arrays["numbers"].tolist())

    def march(self, media: Sequence[Any], view: Any) -> Any:
        """A plain picture as opaque as the smoke is dense."""
        level = max((min(float(item.values[..., 0].max()), 1.0) for item in media), default=0.0)
        alpha = np.full((view.height, view.width), level, np.float32)
        return types.SimpleNamespace(alpha=alpha, rgba=np.repeat(alpha[..., None], 4, axis=-1))

    # what the next frame takes from a start is all of it
    load_carried = load_start

    def _stylize(
        self, frame: VolumeFrame, config: Any, carried: float, errors: dict[str, float] | None
    ) -> FakeStylized:
        density, emission = frame.density, None
        if "shape" in config.optimize.steps:
            factor = np.float32(0.5 + carried / 100)
            density = replace(density, values=density.values * factor)
        if "colour" in config.optimize.steps:
            colour = np.array([1.0, 0.5, 0.25], np.float32) * (1 + config.optimize.seed)
            colour *= np.float32(1 + carried / 10)
            values = density.values[..., None] * colour
            background = (0.0, 0.0, 0.0)
            emission = replace(
                density, name="emission", values=values, background=background,
                grid_class="unknown",
            )  # fmt: skip
        temporal = None if errors is None else TemporalErrors(**errors)
        report = FrameReport(temporal=temporal)
        return FakeStylized(frame.time_code, density, emission, report)

    def modules(self) -> dict[str, types.ModuleType]:
        """Modules that can stand in ``sys.modules`` for the core's."""
        homes = {
            "usdsmoke.core.sequence.stylize": ("stylize_window",),
            "usdsmoke.core.sequence.coarse": (
                "coarse_frames",
                "save_start",
                "load_start",
                "load_carried",
            ),
            "usdsmoke.core.smoke.device": ("describe_machine",),
            "usdsmoke.core.views.scene": ("measure_scene",),
            "usdsmoke.core.views.march": ("march",),
        }
        modules = {}
        for home, names in homes.items():
            modules[home] = types.ModuleType(home)
            for name in names:
                setattr(modules[home], name, getattr(self, name))
        vars(modules["usdsmoke.core.views.scene"])["Scene"] = FakeScene
        return modules


def run_here(
    request: Mapping[str, Any], arrays: Sequence[np.ndarray], config: Any
) -> tuple[Any, list[np.ndarray]]:
    """What ``vdb.child.run_child`` does, without another process and its limits."""
    with tempfile.TemporaryDirectory() as folder:
        for n, array in enumerate(arrays):
            np.save(Path(folder) / f"in{n}.npy", array)
        try:
            answer, n_arrays = worker.find_action(request["action"])(request, Path(folder))
        except UsdSmokeError:
            raise
        except worker._BINDING_ERRORS as error:
            raise ChildFailure(str(error)) from None
        return answer, [np.load(Path(folder) / f"out{n}.npy") for n in range(n_arrays)]


def stand_in(patch: "pytest.MonkeyPatch") -> FakeCore:
    """The stand-ins for the core and for OpenVDB's process, in place until the patch is undone."""
    core = FakeCore()
    patch.setattr("usdsmoke.vdb.child.run_child", run_here)
    for name, module in core.modules().items():
        patch.setitem(sys.modules, name, module)
    return core


def pose(core: FakeCore) -> None:
    """Put the stand-ins in place for the rest of this process."""
    import usdsmoke.vdb.child

    sys.modules.update(core.modules())
    usdsmoke.vdb.child.run_child = run_here


def run(shot: Shot, *settings: str, **options: Any) -> StylizeResult:
    """Stylize a shot; settings are texts such as ``windows.size=3``."""
    return stylize(shot.stage, shot.style, shot.output, settings=settings, **options)


def shown_files(root_stage: Path, field: str = "density") -> dict[float, str]:
    """Resolved file by timeCode, through the stage that a user opens."""
    stage = Usd.Stage.Open(str(root_stage))
    volume = UsdVol.Volume(stage.GetPrimAtPath("/World/smoke"))
    attribute = stage.GetPrimAtPath(volume.GetFieldPath(field)).GetAttribute("filePath")
    return {code: attribute.Get(code).resolvedPath for code in attribute.GetTimeSamples()}


def contents(root_stage: Path) -> dict[float, object]:
    """The hash of what every timeCode shows, each checked against what the file really holds."""
    files = shown_files(root_stage)
    for file_path in files.values():
        check_content(file_path)
    return {
        code: read_header(file_path).metadata["usdsmoke:content_sha256"]
        for code, file_path in files.items()
    }


def copied(shot: Shot, name: str | Path) -> Shot:
    """The whole folder once more, beside it or elsewhere."""
    folder = shutil.copytree(shot.folder, shot.folder.parent / name)
    return Shot(folder, folder / "in/shot.usda", folder / "in/style.png", folder / "out")


def run_until(step: int, *arguments: str) -> tuple[int, list[str]]:
    """A command with stand-ins, killed at a step; its exit code and, when it lives, its steps."""
    ((code, told),) = run_forks([(step, arguments)])
    return code, told.splitlines()[-1].split() if code == 0 else []


def values_of(file_path: str | Path, grid: str = "density") -> np.ndarray:
    """The voxels of one grid of a file."""
    return read_grids(file_path, [GridRequest(grid)], GridsConfig())[0].values


def write_nan(file_path: Path) -> None:
    """A density with one NaN and one infinite voxel."""
    values = np.ones((4, 3, 2), np.float32)
    values[1, 2, 1], values[3, 0, 0] = np.nan, np.inf
    write_raw(file_path, raw_grid(values))

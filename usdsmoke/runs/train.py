"""``usdsmoke train``: a network for the colours of a shot, from its stage to a file."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from usdsmoke import __version__
from usdsmoke.base.errors import ConfigError, Interrupted, count_text
from usdsmoke.base.machine import prepare_torch_environment
from usdsmoke.base.publish import publish_file
from usdsmoke.base.resolve import FilePath, Settings, Styles
from usdsmoke.base.time_codes import format_time_codes
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.job import Job, Request, prepare_job
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan
from usdsmoke.runs.coarse import measure_scenes
from usdsmoke.runs.progress import RunProgress, RunProgressCallback, ignore_progress
from usdsmoke.usd.stage import StageOrFile

if TYPE_CHECKING:
    from usdsmoke.core.training.train import Trained, TrainState

N_ITERATIONS = 1200
_N_FRAMES = 7  # that are read; one of them is held out


@dataclass(frozen=True)
class TrainResult:
    """What was written, and how good it is."""

    file: Path
    prim: str  # path of the Volume
    time_codes: tuple[float, ...]  # of the frames that it was trained on
    held_out: float  # timeCode of the frame that it was judged by
    loss: float  # the style loss there
    cold_loss: float  # that of a few iterations from noise
    cold_iterations: int  # how many
    n_iterations: int  # of the training, that were done
    seconds: float

    def __str__(self) -> str:
        frames = count_text(len(self.time_codes), "frame")
        return (
            f"{self.file}: trained on {frames}, style loss {self.loss:.3g} at timeCode "
            f"{self.held_out:g}, {self.cold_loss:.3g} after {self.cold_iterations} iterations "
            "from noise"
        )


def train(
    stage: StageOrFile,
    style: Styles,
    output: FilePath,
    settings: Settings = None,
    iterations: int | None = None,
    progress: RunProgressCallback | None = None,
) -> TrainResult:
    """Train a network on the largest Volume of a stage, for ``optimize.start``.

    Args:
        stage, style, settings: as in ``usdsmoke.stylize``. What decides the pictures and their
            losses should be as in the runs that use the network.
        output: the safetensors file to write; an old one is replaced.
        iterations: at most; None takes ``N_ITERATIONS``. Training ends early when a frame that is
            held out no longer improves.
        progress: called after every iteration.

    Raises:
        ConfigError: ``output`` has another suffix.
        PlanError: there is no smoke in any frame.
        UsdSmokeError: see ``usdsmoke.base.errors``; no file is written then.
        Interrupted: by Ctrl-C; likewise.
    """
    prepare_torch_environment()
    started, target, tell = time.monotonic(), Path(output).absolute(), progress or ignore_progress
    if target.suffix != ".safetensors":
        raise ConfigError(f"a network is a .safetensors file, not {target.name}. Rename it.")
    # the folder is not made; only the checks of a run's inputs are wanted
    request = Request(stage, style, target.with_name(f"{target.name}.run"), settings)
    job = prepare_job(request, fits=False)
    volume, trained_on, held_out = _choose(job.plan)
    try:
        found = _train(job, volume, [*trained_on, held_out], iterations or N_ITERATIONS, tell)
    except KeyboardInterrupt:
        raise Interrupted(f"stopped. {target} is unchanged.") from None
    codes = [frame.source.time_code for frame in trained_on]
    notes = {
        "version": __version__,
        "styles": ", ".join(job.styles[place].name for place in volume.styles),
        "frames": format_time_codes(codes),
        "loss": f"{found.loss:.6g}",
        "cold_loss": f"{found.cold_loss:.6g}",
        "iterations": str(found.n_iterations),
    }
    publish_file(target, found.generator.to_bytes(notes))
    return TrainResult(
        target, volume.source.prim_path, tuple(codes), held_out.source.time_code, found.loss,
        found.cold_loss, found.n_cold, found.n_iterations, time.monotonic() - started,
    )  # fmt: skip


def _train(
    job: Job,
    volume: VolumePlan,
    frames: Sequence[FramePlan],
    n_iterations: int,
    tell: RunProgressCallback,
) -> "Trained":
    """On frames of a Volume, of which the last one is held out."""
    from usdsmoke.core.training.frames import train_on_frames
    from usdsmoke.core.views.scene import Scene

    def report(state: "TrainState") -> None:
        share = (state.iteration + 1) / n_iterations
        tell(RunProgress("train", 0.0, state.iteration, n_iterations, share, loss=state.loss))

    reader = FrameReader(job.plan)
    scene = measure_scenes(reader, job.plan)[job.plan.volumes.index(volume)]
    read = [reader.read(volume, frame) for frame in frames]
    pictures = job.pictures(volume)
    return train_on_frames(read, pictures, Scene(**scene), volume.config, n_iterations, report)


def _choose(plan: Plan) -> tuple[VolumePlan, Sequence[FramePlan], FramePlan]:
    """The largest Volume, frames spread over it, and one between them that is held out; with a
    single frame that one itself."""
    volume, frames = plan.largest_volume()
    n, last = min(_N_FRAMES, len(frames)), len(frames) - 1
    spread = [frames[round(place * last / max(n - 1, 1))] for place in range(n)]
    held_out = spread[n // 2]
    return volume, [frame for frame in spread if frame is not held_out] or [held_out], held_out

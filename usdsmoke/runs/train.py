"""Networks that frames start from: trained for a file, or in a run, and tried before one.

A run trains its networks beside measuring the scenes, before the first window: they are a part of
what all windows share.
"""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from usdsmoke import __version__
from usdsmoke.base.errors import (
    ConfigError,
    FeatureError,
    Interrupted,
    PlanError,
    WriteFailed,
    count_text,
)
from usdsmoke.base.machine import prepare_torch_environment
from usdsmoke.base.publish import make_folders, publish_file
from usdsmoke.base.record_format import hash_file, hash_values
from usdsmoke.base.time_codes import format_time_codes, spread
from usdsmoke.config.resolve import FilePath, Settings, Styles
from usdsmoke.config.run_sections import OWN_NETWORK
from usdsmoke.core.generator.definition import N_ITERATIONS
from usdsmoke.core.generator.weights import read_notes
from usdsmoke.core.sequence.controls import network_alone
from usdsmoke.planning.estimate import START, estimate_run, training_cost
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.job import Job, Request, prepare_job
from usdsmoke.planning.make_plan import check_plan
from usdsmoke.planning.output_folder import check_writable
from usdsmoke.planning.plan import FramePlan, VolumePlan, named_frames
from usdsmoke.runs.coarse import measure_scenes, measured_frames
from usdsmoke.runs.manifests import network_file_name
from usdsmoke.runs.opened import OpenRun
from usdsmoke.runs.progress import RunProgress, RunProgressCallback, ignore_progress, share_of
from usdsmoke.runs.provenance_record import used_style_size
from usdsmoke.usd.stage import StageOrFile

if TYPE_CHECKING:
    from usdsmoke.core.training.frames import TrainedOnFrames
    from usdsmoke.core.training.train import TrainState

_N_FRAMES = 7  # that are read; one of them is held out
_BASIS = "basis"  # note in a network's file, see ``_basis``
_OF_LOSSES = ("views", "optics", "style", "features", "losses")  # sections of the settings
_ALIKE = 1.05  # times a loss, of frames of one shot


@dataclass(frozen=True)
class TrainPlan:
    """What a training learns from, and what it takes."""

    prim: str  # path of the Volume
    time_codes: tuple[float, ...]  # of the frames to train on
    held_out: float  # timeCode of the frame to judge by
    n_iterations: int  # at most
    seconds: float  # of all iterations, and of loading torch
    memory_gib: float  # peak


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


@dataclass(frozen=True)
class _Training:
    """A training that has been prepared."""

    target: Path
    job: Job
    volume: VolumePlan
    frames: Sequence[FramePlan]  # the last one is held out
    n_iterations: int  # as for small frames, see ``training_parts``
    plan: TrainPlan


def plan_training(
    stage: StageOrFile,
    style: Styles,
    output: FilePath,
    settings: Settings = None,
    iterations: int | None = None,
) -> TrainPlan:
    """What ``train`` would do, and what it takes, without reading a voxel.

    Args:
        stage, style, output, settings, iterations: as of ``train``.

    Raises:
        UsdSmokeError: as ``train`` does before it reads a frame.
    """
    return _prepare(stage, style, output, settings, iterations).plan


def train(
    stage: StageOrFile,
    style: Styles,
    output: FilePath,
    settings: Settings = None,
    iterations: int | None = None,
    progress: RunProgressCallback | None = None,
    planned: Callable[[TrainPlan], None] | None = None,
) -> TrainResult:
    """Train a network on the largest Volume of a stage, for ``optimize.start``.

    Args:
        stage, style, settings: as in ``usdsmoke.stylize``. What decides the pictures and their
            losses should be as in the runs that use the network.
        output: the safetensors file to write; an old one is replaced.
        iterations: at most; None takes ``N_ITERATIONS``. Training ends early when a frame that is
            held out no longer improves.
        progress: called after every iteration.
        planned: called once with the plan, before a frame is read.

    Raises:
        ConfigError: ``output`` has another suffix.
        FeatureError: the network does not suit the smoke: frames would start from noise.
        PlanError: there is no smoke in any frame, or too little memory.
        UsdSmokeError: see ``usdsmoke.base.errors``; no file is written then.
        Interrupted: by Ctrl-C; likewise.
    """
    started, tell = time.monotonic(), progress or ignore_progress
    training = _prepare(stage, style, output, settings, iterations)
    if planned is not None:
        planned(training.plan)
    target, job, volume = training.target, training.job, training.volume

    reader = FrameReader(job.plan)
    try:
        scene = measure_scenes(reader, job)[job.plan.volumes.index(volume)]
        found = _train(job, reader, (volume, training.frames, scene), training.n_iterations, tell)
    except KeyboardInterrupt:
        was = f"{target} is unchanged" if target.exists() else "No file was written"
        raise Interrupted(f"stopped. {was}.") from None
    trained = found.trained
    if trained.misfit:
        raise FeatureError(
            f"the network does not suit the smoke after {trained.n_iterations} iterations: "
            f"{trained.misfit}. No file was written. Train longer (--iterations), or on fewer "
            "frames (--frames)."
        )
    publish_file(target, _to_bytes(job, (volume, scene), found))
    return TrainResult(
        target, volume.source.prim_path, found.time_codes, found.held_out, trained.loss,
        trained.cold_loss, trained.n_cold, trained.n_iterations, time.monotonic() - started,
    )  # fmt: skip


def _prepare(
    stage: StageOrFile,
    style: Styles,
    output: FilePath,
    settings: Settings,
    iterations: int | None,
) -> _Training:
    prepare_torch_environment()
    target = Path(output).absolute()
    if target.suffix != ".safetensors":
        raise ConfigError(f"a network is a .safetensors file, not {target.name}. Rename it.")
    if target.is_dir():
        raise WriteFailed(f"cannot write {target}: a folder has this name. Choose another name.")
    if not target.parent.is_dir():
        raise WriteFailed(f"cannot write {target}: there is no such folder. Create it first.")
    check_writable(target.parent)
    # the folder is not made; only the checks of a run's inputs are wanted
    request = Request(stage, style, target.with_name(f"{target.name}.run"), settings)
    job = prepare_job(request, fits=False)
    volume, filled = job.plan.largest_volume()
    frames, n_iterations = _choose(filled), iterations or N_ITERATIONS
    sizes, config = [frame.size for frame in frames], volume.config
    config = config.with_values({"optimize.start": OWN_NETWORK})
    # frames too large for this machine, or for optimize.memory_limit_gib, are refused
    estimate = estimate_run(sizes, config, len(volume.styles))
    check_plan(dataclasses.replace(job.plan, estimate=estimate))
    codes = [frame.source.time_code for frame in frames]
    n_most, work = training_cost(sizes, config, len(volume.styles), n_iterations)
    seconds = START + work
    plan = TrainPlan(
        volume.source.prim_path, tuple(sorted(codes[:-1] or codes)), codes[-1],
        n_most, seconds, estimate.memory_gib,
    )  # fmt: skip
    return _Training(target, job, volume, frames, n_iterations, plan)


def record_scenes(opened: OpenRun, tell: RunProgressCallback) -> RunProgressCallback:
    """Measure the scenes of a run that has begun, and train or try the networks that its frames
    start from, if no process has.

    A second process waits for the first one's networks.

    Args:
        tell: called after every iteration of a training.

    Returns:
        what is called during the rest of the run: what is done of it counts behind the training.

    Raises:
        ConfigError: frames without iterations would be what a network paints that does not suit.
        GridError, NonFiniteError: see ``FrameReader.read``.
        WriteFailed: the operating system refused.
    """
    run, plan = opened.run, opened.plan
    if run.scenes:
        return tell
    if not any(volume.config.optimize.trains for volume in plan.volumes):
        run.keep_scenes(_find_scenes(opened, tell))
        return tell
    part = plan.training_seconds / plan.estimate.seconds
    with run.claim():
        run.adopt()
        if not run.scenes:
            run.keep_scenes(_find_scenes(opened, share_of(tell, 0.0, part)))
            return share_of(tell, part, 1.0)
    return tell


def _find_scenes(opened: OpenRun, tell: RunProgressCallback) -> list[dict[str, Any]]:
    known, volumes = [dict(scene) for scene in opened.job.scenes], opened.plan.volumes
    scenes = known or measure_scenes(opened.reader, opened.job)
    learners = [n for n, volume in enumerate(volumes) if volume.config.optimize.trains]
    for number, (volume, scene) in enumerate(zip(volumes, scenes, strict=True)):
        if number in learners:
            turn, n_turns = learners.index(number), len(learners)
            own = share_of(tell, turn / n_turns, (turn + 1) / n_turns)
            scene |= _train_own(opened, number, scene, own)
        elif not known and (words := _try_network(opened, volume, scene)):
            scene["misfit"] = words
        if not known and scene.get("misfit"):
            _refuse_alone(volume, scene["misfit"])
    return scenes


def _refuse_alone(volume: VolumePlan, misfit: str) -> None:
    """Raise where frames would be what an unsuitable network paints: with iterations from noise
    instead, they would take many times as long as planned, and flicker."""
    if network_alone(volume.config):
        raise ConfigError(
            f"{network_text(volume)} does not suit <{volume.source.prim_path}>, and "
            f"there are no iterations to make up for it (optimize.iterations=0): {misfit}. Train "
            "one on this shot with 'usdsmoke train', or leave optimize.iterations out; frames then "
            "start from noise."
        )


def network_text(volume: VolumePlan) -> str:
    """What a Volume's frames start from, in words."""
    file = volume.config.optimize.start_file
    return f"the network {Path(file).name}" if file else "the network that was trained on them"


def _train_own(
    opened: OpenRun, number: int, scene: Mapping[str, Any], tell: RunProgressCallback
) -> dict[str, str]:
    """The network of a Volume, in the run's folder: what its scene says of it."""
    volume, run = opened.plan.volumes[number], opened.run
    filled = [frame for frame in named_frames(volume) or volume.frames if not frame.is_empty]
    none = {"misfit": "", "network": ""}
    if not filled:
        return none

    work = volume, _choose(filled), {**scene, **none}
    try:
        found = _train(opened.job, opened.reader, work, N_ITERATIONS, tell)
    except PlanError:  # there is nothing to paint in any frame
        return none
    if found.trained.misfit:
        return {**none, "misfit": found.trained.misfit}
    target = run.folder / network_file_name(number)
    make_folders(target.parent)
    publish_file(target, _to_bytes(opened.job, (volume, scene), found))
    return {**none, "network": hash_file(target)}


def _try_network(opened: OpenRun, volume: VolumePlan, scene: Mapping[str, Any]) -> str:
    """Why the network that frames should start from does not suit a Volume; "" where it does."""
    config, frames = volume.config, measured_frames(volume)
    if not (config.optimize.paints and frames):
        return ""
    from usdsmoke.core.training.frames import find_misfit
    from usdsmoke.core.views.scene import Scene

    frame = opened.reader.read(volume, frames[len(frames) // 2])
    good = _known_loss(opened.job, volume, scene)
    return find_misfit(frame, opened.job.pictures(volume), Scene(**scene), config, good)


def _known_loss(job: Job, volume: VolumePlan, scene: Mapping[str, Any]) -> float:
    """A loss that says without a cold start that a network from a file suits a Volume; 0: none.

    It is little more than that of the frame that was held out when the network was trained, if
    losses were measured as the Volume's are.
    """
    notes = read_notes(Path(volume.config.optimize.start_file))
    if notes.get(_BASIS) != _basis(job, volume, scene):
        return 0.0
    try:
        loss, cold = float(notes["loss"]), float(notes["cold_loss"])
    except (KeyError, ValueError):  # notes are not under the file's digest
        return 0.0
    return min(_ALIKE * loss, cold) if loss <= cold else 0.0


def _basis(job: Job, volume: VolumePlan, scene: Mapping[str, Any]) -> str:
    """SHA-256 of what losses depend on beside the smoke: the styles and their size, and the
    settings of pictures and losses."""
    config = volume.config
    settings = config.model_dump(include=set(_OF_LOSSES))
    chosen = {"refine": config.grids.parts, "target": config.colour.target, **settings}
    styles = [job.styles[place].sha256 for place in volume.styles]
    return hash_values([__version__, styles, used_style_size(volume, scene), chosen])


def _train(
    job: Job,
    reader: FrameReader,
    work: tuple[VolumePlan, Sequence[FramePlan], Mapping[str, Any]],
    n_iterations: int,
    tell: RunProgressCallback,
) -> "TrainedOnFrames":
    """A network for a Volume.

    Args:
        work: the Volume, the frames to train on, of which the last one is held out, and its scene.
        tell: called after every iteration.
    """
    from usdsmoke.core.training.frames import train_on_frames
    from usdsmoke.core.views.scene import Scene

    volume, frames, scene = work
    read = [reader.read(volume, frame) for frame in frames]
    pictures = job.pictures(volume)

    def report(state: "TrainState") -> None:
        n, share = state.n_iterations, state.share
        tell(RunProgress("train", 0.0, state.iteration, n, share, loss=state.loss))

    return train_on_frames(read, pictures, Scene(**scene), volume.config, n_iterations, report)


def _choose(frames: Sequence[FramePlan]) -> Sequence[FramePlan]:
    """Frames spread over those of a Volume, one from between them at the end: it is held out."""
    chosen = spread(frames, _N_FRAMES)
    held_out = chosen[len(chosen) // 2]
    return [*(frame for frame in chosen if frame is not held_out), held_out]


def _to_bytes(
    job: Job, of: tuple[VolumePlan, Mapping[str, Any]], found: "TrainedOnFrames"
) -> bytes:
    """The file of a network, with what people want to know of it."""
    trained, (volume, scene) = found.trained, of
    notes = {
        "version": __version__,
        "styles": ", ".join(job.styles[place].name for place in volume.styles),
        "frames": format_time_codes(found.time_codes),
        "loss": f"{trained.loss:.6g}",
        "cold_loss": f"{trained.cold_loss:.6g}",
        "iterations": str(trained.n_iterations),
        _BASIS: _basis(job, volume, scene),
    }
    return trained.generator.to_bytes(notes)

"""One window of frames in, the same frames stylized out: shape step, then colour step."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from torch import Tensor

from usdsmoke.base.errors import NonFiniteError
from usdsmoke.base.frame_report import FrameReport
from usdsmoke.base.progress import Progress, ProgressCallback
from usdsmoke.base.settings import Config
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.fields.resample import refine_field
from usdsmoke.core.sequence.controls import frame_config
from usdsmoke.core.sequence.error_estimates import frame_errors
from usdsmoke.core.sequence.frame_loop import run_chain
from usdsmoke.core.sequence.frame_state import Job, Link, Watch
from usdsmoke.core.sequence.start import CoarseStart
from usdsmoke.core.smoke.active import ActiveSmoke, activate
from usdsmoke.core.smoke.device import choose_device
from usdsmoke.core.smoke.srgb import decode_srgb
from usdsmoke.core.steps.optimize import Minimum
from usdsmoke.core.steps.shape import longest_move
from usdsmoke.core.style.targets import StyleTargets
from usdsmoke.core.views.scene import Scene, frame_scene
from usdsmoke.core.views.visibility import EffectMask, Visibility, effect_mask, frame_visibility

__all__ = ["StylizedFrame", "finished_frame", "make_job", "open_frame", "stylize_window"]


@dataclass(frozen=True)
class StylizedFrame:
    """One finished frame: what is written, and what it took."""

    time_code: float
    density: DenseField
    emission: DenseField | None  # None without a colour step
    report: FrameReport = field(default_factory=FrameReport)


def stylize_window(
    frames: Iterable[VolumeFrame],
    styles: Sequence[np.ndarray],
    scene: Scene,
    config: Config,
    progress: ProgressCallback | None = None,
    time_codes_per_second: float = 24.0,
    starts: Callable[[float], CoarseStart | None] | None = None,
) -> Iterator[StylizedFrame]:
    """The stylized frames of one window, one by one: memory is a few frames' and not the shot's.

    The first frame starts from the shared coarse step or, without one, from noise; each later one
    starts from its neighbour's result, carried along by the velocity, with
    ``windows.warm_iterations`` of the iterations. Equal inputs and settings give equal bits on the
    same machine; on a GPU sums may differ in their last digits.

    A frame's own ``controls`` stand in place of the settings. One of strength 0 is the source bit
    for bit; it is computed all the same when the one before or after it takes effect, so that a
    fade has a start (``controls.is_computed``).

    Args:
        frames: ascending time_code; pulled one at a time, two ahead of what is yielded, three where
            one has strength 0.
        styles: display-encoded style images [H W 3] in [0, 1].
        scene: see ``scene.measure_scene``; the same for every window of the shot.
        progress: called after every iteration.
        time_codes_per_second: of the stage, for the velocity.
        starts: the shared coarse step's result by timeCode, see ``coarse.coarse_frames``.

    Raises:
        NonFiniteError: a frame holds NaN or infinity, or the optimisation diverges beyond rescue.
        FeatureError, ConfigError: see ``StyleTargets``; a frame's controls are out of range.
    """
    n_frames = len(frames) if isinstance(frames, Sequence) else 0
    job = make_job(styles, scene, config, progress, time_codes_per_second, starts, n_frames)
    for link in run_chain(frames, job, open_frame):
        yield finished_frame(link, job)


def make_job(
    styles: Sequence[np.ndarray],
    scene: Scene,
    config: Config,
    progress: ProgressCallback | None,
    time_codes_per_second: float,
    starts: Callable[[float], CoarseStart | None] | None,
    n_frames: int,
) -> Job:
    """What the frames of a window share; arguments as of ``stylize_window``."""
    device = choose_device(config.optimize)
    return Job(
        StyleTargets(styles, scene, config, device),
        scene,
        config,
        device,
        time_codes_per_second,
        starts or (lambda time_code: None),
        partial(_watcher, progress, n_frames, []),
    )


def _watcher(
    progress: ProgressCallback | None, n_frames: int, seen: list[float], time_code: float
) -> Watch:
    """Turns the optimiser's states of a step into progress records; numbers frames as they come."""
    if time_code not in seen:
        seen.append(time_code)
    frame = seen.index(time_code)

    def of_step(step: str, iterations: Sequence[int]) -> Callable[[int, Minimum], None]:
        def report(octave: int, state: Minimum) -> None:
            if progress is not None:
                done = sum(iterations[:octave]) + state.iteration
                progress(
                    Progress(
                        step, time_code, frame, n_frames, octave, len(iterations), done,
                        sum(iterations), state.smoothed,
                    )
                )  # fmt: skip

        return report

    return of_step


def open_frame(frame: VolumeFrame, job: Job) -> Link:
    """A frame as the first link of its chain.

    Raises:
        NonFiniteError: it holds NaN or infinity.
        ConfigError: its controls are out of range.
    """
    _check_finite(frame)
    config = frame_config(job.config, frame.controls, frame.time_code, job.targets.n_styles)
    density = refine_field(frame.density, job.config.grids.refine)
    source = activate(density, frame.density_to_stage, job.device)
    longest = longest_move(source, job.config) if len(source.ijk) else 0.0
    visibility = frame_visibility(frame, source, longest, job.config.views.camera_margin)
    mask = effect_mask(frame, visibility)
    report = FrameReport(voxels=len(source.ijk))
    if visibility is not None:
        n_outside = int((visibility.at(source.positions) == 0).sum())
        report = replace(report, voxels_outside_camera=n_outside)
    if mask is not None and mask.n_clamped:
        report = replace(report, warnings=(_clamped_text(frame, mask),))
    left_out = _why_left_out(source, mask, visibility, config)
    report = replace(report, left_out=left_out)
    smoke, scene, targets = source, job.scene, job.targets
    if visibility is not None and not left_out:
        source, smoke = visibility.padded(source), visibility.visible(source)
    if config is not job.config:
        scene, targets = frame_scene(scene, config.optics.gamma), targets.weighted(config.style)
        report = replace(report, extinction=scene.gamma_w)
    scene = replace(scene, camera=frame.camera)
    return Link(
        frame, density, source, smoke, mask, left_out, job.starts(frame.time_code), config, scene,
        targets, visibility, report=report,
    )  # fmt: skip


def finished_frame(link: Link, job: Job) -> StylizedFrame:
    """What is written of a frame at the end of its chain, with its errors in the report."""
    emission = None
    if "colour" in job.config.optimize.steps:
        emission = _empty_emission(link.density)
        if link.painted is not None and link.colours is not None:
            strength: float | Tensor = link.config.optimize.strength
            if link.mask is not None:
                strength = strength * link.mask.at(link.painted.positions)
            _emit(emission, link.painted, link.colours, link.scene, strength)
    report = replace(link.report, errors=frame_errors(link))
    return StylizedFrame(link.frame.time_code, link.density, emission, report)


def _why_left_out(
    source: ActiveSmoke, mask: EffectMask | None, visibility: Visibility | None, config: Config
) -> str:
    """Why there is nothing to do for a frame; "" when there may be, if its strength is not 0."""
    if len(source.ijk) == 0:
        return "empty frame"
    if visibility is not None and not bool(visibility.at(source.positions).any()):
        return "outside the camera's frustum"
    if mask is not None and not bool(mask.at(source.positions).any()):
        where = "the camera sees smoke" if visibility is not None else "there is smoke"
        return f"the mask is 0 wherever {where}"
    return "losses.style is 0" if config.losses.style == 0 else ""


def _check_finite(frame: VolumeFrame) -> None:
    for item in (frame.density, frame.velocity, frame.mask):
        if item is None:
            continue
        count = sum(int((~np.isfinite(part)).sum()) for part in (item.values, item.background))
        if count:
            raise NonFiniteError(
                f'{count} values of grid "{item.name}" at timeCode {frame.time_code:g} are NaN or '
                "infinite; set grids.repair_nan to the value that shall replace them"
            )


def _clamped_text(frame: VolumeFrame, mask: EffectMask) -> str:
    name = frame.mask.name if frame.mask is not None else ""
    return (
        f'{mask.n_clamped} values of the mask "{name}" at timeCode {frame.time_code:g} are not '
        "between 0 and 1 and were clamped"
    )


def _empty_emission(density: DenseField) -> DenseField:
    values = np.zeros((*density.values.shape, 3), np.float32)
    return DenseField(
        "emission",
        values,
        density.ijk_min,
        density.index_to_world,
        (0.0, 0.0, 0.0),
        "unknown",
        density.half,
    )


def _emit(
    emission: DenseField,
    painted: ActiveSmoke,
    colours: Tensor,
    scene: Scene,
    strength: float | Tensor,
) -> None:
    """Fill in C x sigma in 1/stage unit, scene-linear; it stays zero where there is no paint.

    So the guidance mask is applied once more to the result, as the paper asks for: whatever the
    network saw beyond the smoke, nothing is left of it. ``strength`` may be one number a voxel.
    """
    light = decode_srgb(colours) * (scene.gamma_w * strength * painted.density)[:, None]
    index = painted.ijk.cpu().numpy() - np.asarray(emission.ijk_min)
    emission.values[tuple(index.T)] = light.cpu().numpy()

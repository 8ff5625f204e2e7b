"""One window of frames in, the same frames stylized out: shape step, then colour step."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.frame_report import FrameReport, ProgressCallback
from usdsmoke.base.naming import EMISSION, SCATTERING
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.config.settings import Config
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.sequence.error_estimates import (
    depth_by_side,
    frame_errors,
    gamma_is_set,
    thick_depth,
)
from usdsmoke.core.sequence.frame_loop import run_frames
from usdsmoke.core.sequence.frame_state import PaintedFrame, WindowContext, make_context
from usdsmoke.core.sequence.start import Carried, CoarseStart, on_device
from usdsmoke.core.smoke.active import ActiveSmoke, activate
from usdsmoke.core.smoke.srgb import decode_srgb, encode_srgb
from usdsmoke.core.views.dark_areas import OF_STYLE, lift_dark_areas
from usdsmoke.core.views.grazing import smooth_grazing
from usdsmoke.core.views.joined import join_smoke
from usdsmoke.core.views.occlusion import find_relief, shaded
from usdsmoke.core.views.scene import Scene

FORWARD = np.array([0.0, 0.0, -1.0])  # any: smoke that scatters to all sides looks alike from all


@dataclass(frozen=True)
class StylizedFrame:
    """One finished frame: what is written, and what it took."""

    time_code: float
    density: DenseField
    # Of the colour step, by ``Config.painted``, [i j k 3] in 1/stage unit: emission and scattering;
    # that is the extinction times the albedo.
    painted: tuple[DenseField, ...] = ()
    report: FrameReport = field(default_factory=FrameReport)

    @property
    def emission(self) -> DenseField | None:
        """None without a colour step, or where it paints the albedo alone."""
        return next((field for field in self.painted if field.name == EMISSION), None)

    @property
    def scattering(self) -> DenseField | None:
        """None where the colour step does not paint the albedo."""
        return next((field for field in self.painted if field.name == SCATTERING), None)

    moved_by: Displacement | None = None  # what moved the density; None where it stays
    carried: Carried | None = None  # see ``PaintedFrame.checkpoint``


@dataclass(frozen=True)
class WindowStart:
    """What a window starts from."""

    coarse: Callable[[float], CoarseStart | None] | None = None  # by timeCode
    carried: Carried | None = None  # of a frame that is finished: the window goes on behind it


def stylize_window(
    frames: Iterable[VolumeFrame],
    styles: Sequence[np.ndarray],
    scene: Scene,
    config: Config,
    progress: ProgressCallback | None = None,
    time_codes_per_second: float = 24.0,
    start: WindowStart | None = None,
) -> Iterator[StylizedFrame]:
    """The stylized frames of one window, one by one, with a few of them in memory.

    The first frame starts from the shared coarse step or, without one, from noise; each later one
    starts from its neighbour's result, carried along by the velocity, with
    ``windows.warm_iterations`` of the iterations. Equal inputs and settings give equal bits on the
    same machine.

    A frame's own ``controls`` replace the settings. A frame of strength 0 is the source bit for
    bit; it is computed nevertheless if the frame before or after it takes effect, so that a fade
    has a start (``controls.is_computed``).

    Args:
        frames: ascending time_code; pulled one at a time, two ahead of what is yielded, three where
            one has strength 0.
        styles: display-encoded style images [H W 3] in [0, 1].
        scene: see ``scene.measure_scene``; the same for every window of the shot.
        progress: called after every iteration.
        time_codes_per_second: of the stage, for the velocity.
        start: the shared coarse step's results, see ``coarse.coarse_frames``; and, in a window that
            was cut, the ``carried`` of the first of these frames. It is not optimised again, and
            the results begin behind it, with the bits of a window that was not cut.

    Raises:
        NonFiniteError: a frame holds NaN or infinity, or the optimisation diverges beyond rescue.
        FeatureError, ConfigError: see ``make_targets``; a frame's controls are out of range.
    """
    n_frames = len(frames) if isinstance(frames, Sequence) else 0
    start = start or WindowStart()
    context = make_context(
        styles, scene, config, progress, time_codes_per_second, start.coarse, n_frames
    )
    known = on_device(start.carried, context.device)
    context = replace(context, known=known)
    for frame in run_frames(frames, context):
        if known is None or frame.time_code != known.time_code:
            yield stylized_frame(frame, context)


def stylized_frame(frame: PaintedFrame, context: WindowContext) -> StylizedFrame:
    """What is written of a finished frame, with its errors in the report."""
    frame = _finished(frame)
    # without an effect it is the source, in the source's voxels
    density = frame.density if frame.in_effect else frame.frame.density
    painted = tuple(_empty(density, name) for name in context.config.painted)
    if frame.in_effect and frame.painted is not None and frame.colours is not None:
        strength: float | Tensor = frame.config.optimize.strength
        if frame.mask is not None:
            strength = strength * frame.mask.at(frame.painted.positions)
        extinction = frame.scene.gamma_w * strength * frame.painted.density
        for field in painted:
            _fill(field, frame.painted, _per_extinction(frame, field.name), extinction)
    n_voxels, depth = frame.report.voxels, thick_depth(frame)
    if not frame.in_effect:
        n_voxels = len(activate(density, frame.frame.density_to_stage, context.device).ijk)
    report = replace(
        frame.report, voxels=n_voxels, errors=frame_errors(frame), depth=depth,
        gamma_is_set=gamma_is_set(frame),
        gamma_is_own=frame.paint is not None and frame.frame.controls.gamma is not None,
        depth_by_side=depth_by_side(frame, depth),
    )  # fmt: skip
    return StylizedFrame(
        frame.time_code, density, painted, report, frame.moved_by, frame.checkpoint
    )  # fmt: skip


def _finished(frame: PaintedFrame) -> PaintedFrame:
    """The frame with smooth grooves, ambient occlusion and lifted dark areas in its colours.

    Albedos, whose light is hidden itself, and flat smoke stay as they are.
    """
    config, paint = frame.config.colour, frame.paint
    if config.target == "albedo" or not (config.grazing or config.occlusion or config.lift):
        return frame
    if paint is None or not frame.in_effect or frame.smoke.thin_axis is not None:
        return frame
    started, (painted, colours), report = time.perf_counter(), paint, frame.report
    joined = join_smoke(frame.whole_smoke(), frame.scene)
    if config.grazing:
        colours = smooth_grazing(colours, painted, joined, frame.scene.gamma_w, config.grazing)
    if config.occlusion:
        colours = shaded(colours, find_relief(joined, painted.positions), config.occlusion)
    if level := min(config.lift, OF_STYLE * frame.targets.value):
        hue = frame.targets.hue_at(level)
        light = None if config.target == "both" else _scattered(frame)
        if light is None:
            colours = lift_dark_areas(colours, painted, joined, level, hue)
        else:  # the area is as bright as both kinds of light together
            total = encode_srgb(decode_srgb(colours) + light)
            total = lift_dark_areas(total, painted, joined, level, hue)
            colours = torch.maximum(encode_srgb(decode_srgb(total) - light), colours)
    if (step := report.colour) is not None:
        seconds = step.seconds + time.perf_counter() - started
        report = replace(report, colour=replace(step, seconds=seconds))
    return replace(frame, colours=colours, report=report)


def _per_extinction(frame: PaintedFrame, name: str) -> Tensor:
    """Linear colours or albedos [N 3] of the painted voxels; with both, the colours are split.

    As much of a colour as the light can give is given by the light, the rest is emitted.
    """
    if frame.painted is None or frame.colours is None:
        raise ValueError("a frame without colours")
    linear, config = decode_srgb(frame.colours), frame.config
    given = torch.zeros_like(linear)
    if config.colour.target == "albedo":
        return config.albedo * linear
    if config.colour.target == "both" and (light := _scattered(frame)) is not None:
        given = torch.minimum(linear, light)
        if name == SCATTERING:
            tiny = torch.finfo(light.dtype).tiny
            return config.albedo * given / light.clamp_min(tiny)
    return (linear - given) * 2.0**-frame.scene.stops if name == EMISSION else given


def _scattered(frame: PaintedFrame) -> Tensor | None:
    """Linear light [N 3] that the painted voxels scatter; None where there is none."""
    if frame.painted is None or (lighting := frame.all_light()) is None:
        return None
    return lighting.on(frame.painted.positions).scattered(FORWARD)


def _empty(density: DenseField, name: str) -> DenseField:
    values = np.zeros((*density.values.shape, 3), np.float32)
    return DenseField(
        name,
        values,
        density.ijk_min,
        density.index_to_world,
        (0.0, 0.0, 0.0),
        "unknown",
        density.half,
    )


def _fill(field: DenseField, painted: ActiveSmoke, linear: Tensor, extinction: Tensor) -> None:
    """Fill in linear x sigma in 1/stage unit; it stays zero where there is no paint.

    So the guidance mask is applied to the result too, as in the paper: nothing is left of what the
    network saw beyond the smoke.
    """
    index = painted.ijk.cpu().numpy() - np.asarray(field.ijk_min)
    field.values[tuple(index.T)] = (linear * extinction[:, None]).cpu().numpy()

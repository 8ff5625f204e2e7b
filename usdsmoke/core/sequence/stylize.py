"""One window of frames in, the same frames stylized out: shape step, then colour step."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from torch import Tensor

from usdsmoke.base.frame_report import FrameReport, ProgressCallback
from usdsmoke.base.settings import Config
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.sequence.error_estimates import frame_errors
from usdsmoke.core.sequence.frame_loop import run_frames
from usdsmoke.core.sequence.frame_state import PaintedFrame, WindowContext, make_context
from usdsmoke.core.sequence.start import CoarseStart
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.srgb import decode_srgb
from usdsmoke.core.views.scene import Scene


@dataclass(frozen=True)
class StylizedFrame:
    """One finished frame: what is written, and what it took."""

    time_code: float
    density: DenseField
    emission: DenseField | None  # None without a colour step
    report: FrameReport = field(default_factory=FrameReport)
    moved_by: Displacement | None = None  # what moved the density; None where it stays


def stylize_window(
    frames: Iterable[VolumeFrame],
    styles: Sequence[np.ndarray],
    scene: Scene,
    config: Config,
    progress: ProgressCallback | None = None,
    time_codes_per_second: float = 24.0,
    starts: Callable[[float], CoarseStart | None] | None = None,
) -> Iterator[StylizedFrame]:
    """The stylized frames of one window, one by one, with a few of them in memory.

    The first frame starts from the shared coarse step or, without one, from noise; each later one
    starts from its neighbour's result, carried along by the velocity, with
    ``windows.warm_iterations`` of the iterations. Equal inputs and settings give equal bits on the
    same machine; on a GPU sums may differ in their last digits.

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
        starts: the shared coarse step's result by timeCode, see ``coarse.coarse_frames``.

    Raises:
        NonFiniteError: a frame holds NaN or infinity, or the optimisation diverges beyond rescue.
        FeatureError, ConfigError: see ``make_targets``; a frame's controls are out of range.
    """
    n_frames = len(frames) if isinstance(frames, Sequence) else 0
    context = make_context(styles, scene, config, progress, time_codes_per_second, starts, n_frames)
    for frame in run_frames(frames, context):
        yield stylized_frame(frame, context)


def stylized_frame(frame: PaintedFrame, context: WindowContext) -> StylizedFrame:
    """What is written of a finished frame, with its errors in the report."""
    emission = None
    if "colour" in context.config.optimize.steps:
        emission = _empty_emission(frame.density)
        if frame.painted is not None and frame.colours is not None:
            strength: float | Tensor = frame.config.optimize.strength
            if frame.mask is not None:
                strength = strength * frame.mask.at(frame.painted.positions)
            _emit(emission, frame.painted, frame.colours, frame.scene, strength)
    report = replace(frame.report, errors=frame_errors(frame))
    return StylizedFrame(frame.time_code, frame.density, emission, report, frame.moved_by)


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
    """Fill in C x sigma / 2^stops in 1/stage unit, scene-linear; it stays zero without paint.

    So the guidance mask is applied to the result too, as in the paper: nothing is left of what the
    network saw beyond the smoke. ``strength`` may be one number for each voxel.
    """
    brightness = scene.gamma_w * 2.0**-scene.stops * strength * painted.density
    light = decode_srgb(colours) * brightness[:, None]
    index = painted.ijk.cpu().numpy() - np.asarray(emission.ijk_min)
    emission.values[tuple(index.T)] = light.cpu().numpy()

"""Frames of a shot for a generator: it is trained on some, and tried on one before a run."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from usdsmoke.base.errors import PlanError
from usdsmoke.base.time_codes import name_time_codes
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.config.settings import Config
from usdsmoke.core.sequence.controls import without_network
from usdsmoke.core.sequence.frame_state import make_context, open_frame
from usdsmoke.core.training.canvas import misfit
from usdsmoke.core.training.train import Trained, TrainState, train_generator
from usdsmoke.core.views.scene import Scene


@dataclass(frozen=True)
class TrainedOnFrames:
    """A generator, and the frames that it was made with."""

    trained: Trained
    time_codes: tuple[float, ...]  # that it was trained on
    held_out: float  # timeCode of the frame that it was judged by


def train_on_frames(
    frames: Sequence[VolumeFrame],
    styles: Sequence[np.ndarray],
    scene: Scene,
    config: Config,
    n_iterations: int,
    tell: Callable[[TrainState], None],
) -> TrainedOnFrames:
    """A generator for the colours of a shot, trained on its smoke, which is not moved.

    Args:
        frames: the last one is held out where there are several; those with nothing to paint are
            left out.
        styles, scene, config: as of ``stylize_window``.
        n_iterations, tell: as of ``train_generator``.

    Raises:
        PlanError: no frame has anything to paint.
        UsdSmokeError: see ``stylize_window``.
    """
    context = make_context(styles, scene, without_network(config), None, 24.0, None, 0)
    opened = [open_frame(frame, context) for frame in frames]
    found = [frame for frame in opened if not frame.left_out]
    if not found:
        where, why = name_time_codes(frame.time_code for frame in frames), opened[-1].left_out
        raise PlanError(f"{where}: nothing to paint ({why}). Choose other frames with --frames.")
    *seen, held_out = found
    problems = [frame.colour_problem() for frame in seen or found]
    trained = train_generator(problems, held_out.colour_problem(), n_iterations, tell)
    codes = tuple(frame.time_code for frame in seen or found)
    return TrainedOnFrames(trained, codes, held_out.time_code)


def find_misfit(
    frame: VolumeFrame,
    styles: Sequence[np.ndarray],
    scene: Scene,
    config: Config,
    good: float = 0.0,
) -> str:
    """Why the network of ``optimize.start`` does not suit a frame; "" where it does, or where the
    frame has nothing to paint.

    Args:
        styles, scene, config: as of ``stylize_window``.
        good: a loss that needs no comparison with a cold start, see ``canvas.misfit``.

    Raises:
        FeatureError: see ``Generator.from_file``.
        UsdSmokeError: see ``stylize_window``.
    """
    context = make_context(styles, scene, config, None, 24.0, None, 0)
    opened = open_frame(frame, context)
    if opened.left_out or context.generator is None:
        return ""
    return misfit(context.generator, opened.colour_problem(), good)

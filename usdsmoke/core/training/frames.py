"""Frames of a shot for a generator: it is trained on some, and tried on one before a run."""

from collections.abc import Callable, Sequence

import numpy as np

from usdsmoke.base.errors import PlanError
from usdsmoke.base.settings import Config
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.core.sequence.controls import without_network
from usdsmoke.core.sequence.frame_state import WindowContext, make_context, open_frame
from usdsmoke.core.steps.targets import StepProblem
from usdsmoke.core.training.canvas import misfit
from usdsmoke.core.training.train import Trained, TrainState, train_generator
from usdsmoke.core.views.scene import Scene


def train_on_frames(
    frames: Sequence[VolumeFrame],
    styles: Sequence[np.ndarray],
    scene: Scene,
    config: Config,
    n_iterations: int,
    tell: Callable[[TrainState], None],
) -> Trained:
    """A generator for the colours of a shot, trained on its smoke as it is in the files.

    Args:
        frames: the last one is held out where there are several.
        styles, scene, config: as of ``stylize_window``.
        n_iterations, tell: as of ``train_generator``.

    Raises:
        PlanError: a frame has nothing to paint.
        UsdSmokeError: see ``stylize_window``.
    """
    context = make_context(styles, scene, without_network(config), None, 24.0, None, 0)
    problems = [_problem(frame, context) for frame in frames]
    return train_generator(problems[:-1] or problems, problems[-1], n_iterations, tell)


def find_misfit(
    frame: VolumeFrame, styles: Sequence[np.ndarray], scene: Scene, config: Config
) -> str:
    """Why the network of ``optimize.start`` does not suit a frame; "" where it does, or where the
    frame has nothing to paint.

    Args:
        styles, scene, config: as of ``stylize_window``.

    Raises:
        FeatureError: see ``Generator.from_file``.
        UsdSmokeError: see ``stylize_window``.
    """
    context = make_context(styles, scene, config, None, 24.0, None, 0)
    opened = open_frame(frame, context)
    if opened.left_out or context.generator is None:
        return ""
    return misfit(context.generator, opened.colour_problem())


def _problem(frame: VolumeFrame, context: WindowContext) -> StepProblem:
    """What the colour step would work on if the shape step moved nothing.

    Raises:
        PlanError: there is nothing to paint.
    """
    opened = open_frame(frame, context)
    if opened.left_out:
        raise PlanError(
            f"timeCode {frame.time_code:g} has nothing to paint ({opened.left_out}). Choose other "
            "frames with --frames."
        )
    return opened.colour_problem()

"""Training of a generator on a few frames, by the pictures and losses of the colour step itself.

Each iteration paints one of the frames, or one of the crops of a large one, from new noise, and
draws it from views of its pool. Kept is a running mean of the parameters, from the iteration where
it paints a held-out frame best.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from usdsmoke.core.generator.definition import N_VIEWS
from usdsmoke.core.generator.network import Generator
from usdsmoke.core.smoke.srgb import encode_srgb
from usdsmoke.core.steps.optimize import Descent, minimize
from usdsmoke.core.steps.targets import StepProblem
from usdsmoke.core.training.canvas import (
    HELD_OUT,
    Canvas,
    cold_iterations,
    cold_loss,
    crop,
    judge,
    misfit_text,
)
from usdsmoke.core.training.orthogonal import Orthogonal

RATE = 3e-3  # of Adam, in units of parameters; of convolutions see ``Orthogonal``
MEAN_SHARE = 0.995  # of the mean of the parameters that an iteration keeps; less at the start
N_CROPS = 4  # of a frame that is too large
CHECK_EVERY = 50  # iterations between two looks at the held-out frame
PATIENCE = 0.4  # share of the iterations without a better look after which training ends


@dataclass(frozen=True)
class TrainState:
    """How far a training is."""

    iteration: int  # from 0
    n_iterations: int
    loss: float  # running mean over the training frames
    held_out: float  # the least on the held-out frame so far; infinite before the first look


@dataclass(frozen=True)
class Trained:
    """A generator, and what it reaches on the held-out frame."""

    generator: Generator
    loss: float
    cold_loss: float  # of a few cold iterations, see ``canvas.cold_loss``
    n_cold: int  # how many
    n_iterations: int  # that were done

    @property
    def misfit(self) -> str:
        """Why frames should start without it, as a part of a sentence; "" where they should not."""
        return misfit_text(self.loss, self.cold_loss, self.n_cold)


def train_generator(
    problems: Sequence[StepProblem],
    held_out: StepProblem,
    n_iterations: int,
    tell: Callable[[TrainState], None],
) -> Trained:
    """A generator for one style, on frames of a shot.

    Args:
        problems: of the frames that it is trained on, with smoke.
        held_out: of another frame, or of the same if there is one alone.
        n_iterations: at most; at least 1.
        tell: called after every iteration.

    Raises:
        NonFiniteError: see ``minimize``.
    """
    config = held_out.config
    seed, part = config.optimize.seed, crop(held_out, N_CROPS)
    canvases, judging = _canvases(problems), judge(part)
    generator = Generator.new(encode_srgb(held_out.targets.background), seed)
    leaves = [values.requires_grad_() for values in generator.parameters.values()]
    mean = generator.copy()

    def objective(iteration: int) -> Tensor:
        turn, place = divmod(iteration, len(canvases))
        canvas = canvases[place]
        return canvas.loss(canvas.paint(generator, seed + 1 + iteration), turn)

    def look() -> float:
        with torch.no_grad():
            return float(judging.loss(judging.paint(mean, seed + HELD_OUT), 0))

    best, best_at, kept = float("inf"), 0, mean.copy()
    state = None
    for state in minimize(objective, leaves, Descent(RATE, n_iterations), adam=Orthogonal()):
        done = state.iteration + 1
        _add_to_mean(mean, generator, state.iteration)
        if done % CHECK_EVERY == 0 or state.reason:  # the last has a reason
            found = look()
            if found < best:
                best, best_at, kept = found, done, mean.copy()
        tell(TrainState(state.iteration, n_iterations, state.smoothed, best))
        if done - best_at > max(PATIENCE * n_iterations, CHECK_EVERY):
            break
    assert state is not None
    n_cold = sum(cold_iterations(part))
    return Trained(kept, best, cold_loss(part, judging), n_cold, state.iteration + 1)


def _add_to_mean(mean: Generator, generator: Generator, iteration: int) -> None:
    """Bring the running mean of the parameters up to an iteration. [Polyak1992]

    Steps follow the views and the noise of their iterations, which the mean evens out.
    """
    share = min(MEAN_SHARE, (1 + iteration) / (10 + iteration))
    for name, values in mean.parameters.items():
        values.lerp_(generator.parameters[name].detach(), 1 - share)


def _canvases(problems: Sequence[StepProblem]) -> list[Canvas]:
    """What is painted in turn; crops share the views of a frame among them."""
    found = []
    for problem in problems:
        parts = [crop(problem, number) for number in range(N_CROPS)]
        if parts[0] is problem:
            found.append(Canvas(problem, problem.config.optimize.seed, N_VIEWS))
            continue
        views = problem.config.views
        config = problem.config.replace(views=views.replace(pool=max(1, views.pool // N_CROPS)))
        for number, part in enumerate(parts):
            seed = problem.config.optimize.seed + number
            found.append(Canvas(replace(part, config=config), seed, N_VIEWS))
    return found

"""Training of a generator on a few frames, by the pictures and losses of the colour step itself.

Each iteration paints one of the frames from new noise, and draws it from views of its pool. Frames
with much smoke are learned from crops first, in which an iteration is cheap, and then as a whole,
as they will be seen. Kept is a running mean of the parameters, from the iteration where it paints a
held-out frame best.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from usdsmoke.core.generator.definition import (
    N_VIEWS,
    USUAL_VOXELS,
    TrainingPart,
    octaves_for,
    training_parts,
)
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
LATER = 0.5  # of the rate, where whole frames follow crops
N_CROPS = 6  # at most, of all frames
MOST_AT_ONCE = 2_400_000  # voxels of all that is painted in turn: it stays in memory
CHECK_EVERY = 50  # iterations between two looks at the held-out frame; fewer of large ones
LEAST_CHECK = 10
PATIENCE = 0.4  # share of the iterations without a better look after which training ends


@dataclass(frozen=True)
class TrainState:
    """How far a training is."""

    iteration: int  # from 0
    n_iterations: int
    share: float  # of the work that is done: iterations on whole frames take longer
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
        n_iterations: at most, for small frames; at least 1. Large ones have fewer, see
            ``training_parts``.
        tell: called after every iteration.

    Raises:
        NonFiniteError: see ``minimize``.
    """
    seed = held_out.config.optimize.seed
    smokes = [problem.smoke for problem in (*problems, held_out)]
    largest = max(len(smoke.ijk) for smoke in smokes)
    n_octaves = octaves_for(max(smoke.extent / smoke.voxel_size for smoke in smokes))
    found = Generator.new(encode_srgb(held_out.targets.background), seed, n_octaves)
    parts, done, best = training_parts(largest, n_iterations), 0, float("inf")
    whole = sum(part.iterations for part in parts)
    works = [part.iterations * part.voxels for part in parts]
    for number, part in enumerate(parts):
        before, own = (work / sum(works) for work in (sum(works[:number]), works[number]))

        def report(state: TrainState, before: float = before, own: float = own) -> None:
            tell(replace(state, n_iterations=whole, share=before + own * state.share))

        canvases = _canvases(problems, part)
        seen = crop(held_out, N_CROPS, part.voxels)
        lesson = _Lesson(canvases, judge(seen, held_out), seed, done)
        descent = Descent(RATE * (LATER if number else 1.0), part.iterations)
        check = max(LEAST_CHECK, round(CHECK_EVERY * min(1, USUAL_VOXELS / part.voxels)))
        found, best, n_done = lesson.learn(found, descent, check, report)
        done += n_done
        judging = lesson.judging
        del canvases, lesson  # before the next part takes as much memory
    n_cold = sum(cold_iterations(seen))
    return Trained(found, best, cold_loss(seen, judging), n_cold, done)


@dataclass(frozen=True)
class _Lesson:
    """What a part of a training paints in turn, and what judges it."""

    canvases: Sequence[Canvas]
    judging: Canvas
    seed: int
    before: int  # iterations that were done

    def learn(
        self,
        begun: Generator,
        descent: Descent,
        check: int,
        tell: Callable[[TrainState], None],
    ) -> tuple[Generator, float, int]:
        """The generator at its best, its loss on the held-out frame, and iterations done.

        Args:
            check: iterations between two looks at the held-out frame.
        """
        generator = begun.copy()
        leaves = [values.requires_grad_() for values in generator.parameters.values()]
        mean, n = generator.copy(), descent.n_iterations
        first = self.seed + 1 + self.before

        def objective(iteration: int) -> Tensor:
            turn, place = divmod(iteration, len(self.canvases))
            canvas = self.canvases[place]
            return canvas.loss(canvas.paint(generator, first + iteration), turn)

        best, best_at, kept = float("inf"), 0, mean.copy()
        state = None
        for state in minimize(objective, leaves, descent, adam=Orthogonal()):
            done = state.iteration + 1
            _add_to_mean(mean, generator, state.iteration)
            if done % check == 0 or state.reason:  # the last has a reason
                found = self._look(mean)
                if found < best:
                    best, best_at, kept = found, done, mean.copy()
            tell(TrainState(self.before + state.iteration, n, done / n, state.smoothed, best))
            if done - best_at > max(PATIENCE * n, check):
                break
        assert state is not None
        return kept, best, state.iteration + 1

    def _look(self, generator: Generator) -> float:
        with torch.no_grad():
            painted = self.judging.paint(generator, self.seed + HELD_OUT)
            return float(self.judging.loss(painted, 0))


def _add_to_mean(mean: Generator, generator: Generator, iteration: int) -> None:
    """Bring the running mean of the parameters up to an iteration. [Polyak1992]

    Steps follow the views and the noise of their iterations, which the mean evens out.
    """
    share = min(MEAN_SHARE, (1 + iteration) / (10 + iteration))
    for name, values in mean.parameters.items():
        values.lerp_(generator.parameters[name].detach(), 1 - share)


def _canvases(problems: Sequence[StepProblem], part: TrainingPart) -> list[Canvas]:
    """What is painted in turn; where that is much, it shares the views of a frame."""
    size = min(part.voxels, max(len(problem.smoke.ijk) for problem in problems))
    if size <= USUAL_VOXELS:
        return [Canvas(problem, problem.config.optimize.seed, part.views) for problem in problems]
    n_all = max(1, MOST_AT_ONCE // size)
    chosen = problems[:: -(-len(problems) // n_all)]
    n_crops = max(1, min(N_CROPS, n_all) // len(chosen))
    pieces = []
    for place, problem in enumerate(chosen):
        numbers = range(place * n_crops, (place + 1) * n_crops)
        crops = [crop(problem, number, part.voxels) for number in numbers]
        pieces += [(piece, problem) for piece in ([problem] if crops[0] is problem else crops)]
    canvases = []
    for number, (piece, whole) in enumerate(pieces):
        views = piece.config.views
        shared = views.replace(pool=max(N_VIEWS, views.pool // len(pieces)))
        own = replace(piece, config=piece.config.replace(views=shared))
        seed = piece.config.optimize.seed + number
        canvases.append(Canvas(own, seed, part.views, None if piece is whole else whole))
    return canvases

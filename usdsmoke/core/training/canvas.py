"""Smoke that a generator paints, the loss of its pictures, and whether the generator suits it."""

from dataclasses import replace

import torch
from torch import Tensor

from usdsmoke.core.generator.definition import MOST_VOXELS, N_LEVELS
from usdsmoke.core.generator.levels import make_levels
from usdsmoke.core.generator.network import Generator
from usdsmoke.core.smoke.noise import white_noise
from usdsmoke.core.steps.colour import colour_pool, painted_part, pictures_loss, run_colour_step
from usdsmoke.core.steps.targets import StepProblem

HELD_OUT = 0x5EED_0000  # between a run's seed and that of views and noise which judge
N_JUDGES = 4  # views that judge
COLD = 15  # iterations of each octave, see ``cold_iterations``


class Canvas:
    """The painted voxels of a frame or crop at full resolution.

    Args:
        seed: of the views.
        n_drawn: views whose mean is a loss.
    """

    def __init__(self, problem: StepProblem, seed: int, n_drawn: int) -> None:
        self._problem = problem
        self._levels = make_levels(painted_part(problem), N_LEVELS)
        self._pool = replace(colour_pool(problem, 1, seed), n_drawn=n_drawn)

    def paint(self, generator: Generator, seed: int) -> Tensor:
        """Display-encoded colours [N 3] from the noise of a seed."""
        return generator(self._levels, self._problem.scene.gamma_w, seed)

    def loss(self, colours: Tensor, iteration: int) -> Tensor:
        """Of display-encoded colours [N 3] in the views of an iteration."""
        targets = self._problem.targets
        return pictures_loss(self._pool, colours, targets.at(1), targets.background, iteration)


def judge(problem: StepProblem) -> Canvas:
    """Of all of a problem's smoke, in views that neither training nor the colour step has."""
    seed = problem.config.optimize.seed + HELD_OUT
    views = problem.config.views.replace(pool=N_JUDGES)
    judged = replace(problem, config=problem.config.replace(views=views))
    return Canvas(judged, seed, N_JUDGES)


def crop(problem: StepProblem, number: int) -> StepProblem:
    """A cube of the smoke around a painted voxel, at most ``MOST_VOXELS``; all where it is small.

    Args:
        number: which; others are elsewhere.
    """
    smoke, seed = problem.smoke, problem.config.optimize.seed
    if len(smoke.ijk) <= MOST_VOXELS:
        return problem
    painted = painted_part(problem).ijk
    middle = painted[int(white_noise(painted, 1, seed + HELD_OUT + number)[:, 0].argmax())]
    away = (smoke.ijk - middle).abs().amax(dim=1)
    kept = away < away.kthvalue(MOST_VOXELS).values
    if 2 * int(kept.sum()) < MOST_VOXELS:  # much smoke is equally far: a sheet, or all of the rest
        kept = torch.zeros_like(kept)
        kept[away.argsort(stable=True)[:MOST_VOXELS]] = True
    return replace(problem, smoke=smoke.take(kept))


def cold_loss(problem: StepProblem, canvas: Canvas) -> float:
    """What a few cold iterations of the colour step reach, judged by a canvas of the problem."""
    colours, _ = run_colour_step(problem, cold_iterations(problem))
    with torch.no_grad():
        return float(canvas.loss(colours, 0))


def cold_iterations(problem: StepProblem) -> list[int]:
    """Of a cold start that a generator must not be worse than, per octave."""
    return [COLD] * len(problem.config.colour.iterations)


def misfit(generator: Generator, problem: StepProblem) -> str:
    """Why a generator does not suit a frame, as a part of a sentence; "" where it does.

    Its loss on a crop of the frame, in views of their own, must not exceed that of cold iterations.
    """
    part = crop(problem, 0)
    canvas = judge(part)
    with torch.no_grad():
        found = float(canvas.loss(canvas.paint(generator, problem.config.optimize.seed), 0))
    cold, n = cold_loss(part, canvas), sum(cold_iterations(part))
    return misfit_text(found, cold, n)


def misfit_text(loss: float, cold: float, n_iterations: int) -> str:
    """See ``misfit``.

    Args:
        loss: of what a generator paints.
        cold: after that many iterations from noise.
    """
    if loss <= cold:
        return ""
    return (
        f"its style loss is {loss:.3g}, and {n_iterations} iterations from noise reach {cold:.3g}"
    )

"""Smoke that a generator paints, the loss of its pictures, and whether the generator suits it."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from usdsmoke.core.generator.definition import WHOLE_VOXELS
from usdsmoke.core.generator.levels import Level, make_levels
from usdsmoke.core.generator.network import Generator
from usdsmoke.core.smoke.active import ActiveSmoke, flat_key
from usdsmoke.core.smoke.noise import white_noise
from usdsmoke.core.smoke.schedule import view_ranges
from usdsmoke.core.steps.colour import colour_pool, painted_part, pictures_loss, run_colour_step
from usdsmoke.core.steps.targets import StepProblem

HELD_OUT = 0x5EED_0000  # between a run's seed and that of views and noise which judge
N_JUDGES = 4  # views that judge
MOST_AROUND = 2  # times a crop's voxels at full resolution, computed with them
COLD_VIEWS = 5  # of an octave of these: with more, their maps take half of the time (decision 056)
COLD = 15  # iterations of each octave, see ``cold_iterations``


class Canvas:
    """The painted voxels of a frame or crop at full resolution.

    A crop is painted as the frame is, and drawn alone.

    Args:
        seed: of the views.
        n_drawn: views whose mean is a loss.
        whole: of the frame, where ``problem`` is a crop of it.
    """

    def __init__(
        self, problem: StepProblem, seed: int, n_drawn: int, whole: StepProblem | None = None
    ) -> None:
        self._problem, self._whole = problem, whole
        self._painted: tuple[Sequence[Level], Tensor | None] | None = None  # see ``_levels``
        self._pool = replace(colour_pool(problem, 1, seed), n_drawn=n_drawn)

    def paint(self, generator: Generator, seed: int) -> Tensor:
        """Display-encoded colours [N 3] from the noise of a seed.

        All generators that paint here have as many octaves.
        """
        if self._painted is None:
            part = painted_part(self._problem)
            self._painted = _levels(part, self._whole, generator.n_octaves)
        levels, shown = self._painted
        colours = generator(levels, self._problem.scene.gamma_w, seed)
        return colours if shown is None else colours[shown]

    def loss(self, colours: Tensor, iteration: int) -> Tensor:
        """Of display-encoded colours [N 3] in the views of an iteration."""
        targets = self._problem.targets
        return pictures_loss(self._pool, colours, targets.at(1), targets.background, iteration)


def _levels(
    painted: ActiveSmoke, whole: StepProblem | None, n: int
) -> tuple[Sequence[Level], Tensor | None]:
    """The ``n`` octaves that painted voxels depend on, and which of the finest one's they are [N]
    bool; None: all.
    """
    if whole is not None:
        smoke = painted_part(whole)
        levels = make_levels(smoke, n, _among(painted, smoke))
        finest = levels[-1].smoke
        if len(finest.ijk) <= MOST_AROUND * len(painted.ijk):  # else voxels lie far apart
            return levels, _among(painted, finest)
    return make_levels(painted, n), None


def _among(some: ActiveSmoke, smoke: ActiveSmoke) -> Tensor:
    """Which voxels of smoke are among some of them, [N] bool."""
    low = smoke.ijk.amin(0)
    shape = smoke.ijk.amax(0) - low + 1
    keys, known = (flat_key(of.ijk, low, shape) for of in (smoke, some))
    return torch.isin(keys, known, assume_unique=True)


def judge(problem: StepProblem, whole: StepProblem) -> Canvas:
    """Of all of a problem's smoke, in views that neither training nor the colour step has.

    Args:
        whole: the problem itself, or that of which it is a crop.
    """
    seed = problem.config.optimize.seed + HELD_OUT
    views = problem.config.views
    # a set range leaves out the sides that a camera does not see, whose views all pools share
    views = views.replace(pool=N_JUDGES, azimuth=view_ranges(views)[0])
    judged = replace(problem, config=problem.config.replace(views=views))
    return Canvas(judged, seed, N_JUDGES, None if whole is problem else whole)


def crop(problem: StepProblem, number: int, most: int) -> StepProblem:
    """A cube of the smoke around a painted voxel; all of the smoke where it is small.

    Args:
        number: which; others are elsewhere.
        most: voxels at most.
    """
    smoke, seed = problem.smoke, problem.config.optimize.seed
    if len(smoke.ijk) <= most:
        return problem
    painted = painted_part(problem).ijk
    middle = painted[int(white_noise(painted, 1, seed + HELD_OUT + number)[:, 0].argmax())]
    away = (smoke.ijk - middle).abs().amax(dim=1)
    kept = away < away.kthvalue(most).values
    if 2 * int(kept.sum()) < most:  # much smoke is equally far: a sheet, or all of the rest
        kept = torch.zeros_like(kept)
        kept[away.argsort(stable=True)[:most]] = True
    return replace(problem, smoke=smoke.take(kept))


def cold_loss(problem: StepProblem, canvas: Canvas) -> float:
    """What a few cold iterations of the colour step reach, judged by a canvas of the problem."""
    views = problem.config.views
    few = views.replace(pool=min(views.pool, max(COLD_VIEWS, views.count)))
    problem = replace(problem, config=problem.config.replace(views=few))
    colours, _ = run_colour_step(problem, cold_iterations(problem))
    with torch.no_grad():
        return float(canvas.loss(colours, 0))


def cold_iterations(problem: StepProblem) -> list[int]:
    """Of a cold start that a generator must not be worse than, per octave."""
    return [COLD] * len(problem.config.colour.iterations)


def misfit(generator: Generator, problem: StepProblem, good: float = 0.0) -> str:
    """Why a generator does not suit a frame, as a part of a sentence; "" where it does.

    Its loss on the frame, in views of their own, must not exceed that of cold iterations. Crops
    would not do: smoke that the frame hides is seen there, and pixels have less smoke behind them.

    Args:
        good: a loss up to which cold iterations are not asked for.
    """
    part = crop(problem, 0, WHOLE_VOXELS)
    canvas = judge(part, problem)
    with torch.no_grad():
        found = float(canvas.loss(canvas.paint(generator, problem.config.optimize.seed), 0))
    if found <= good:
        return ""
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

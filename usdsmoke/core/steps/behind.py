"""Iterations of the colour step behind what a network has painted."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from torch import Tensor

from usdsmoke.core.smoke.schedule import network_views, pool_size
from usdsmoke.core.steps.colour import Look, run_colour_step
from usdsmoke.core.steps.optimize import Minimum
from usdsmoke.core.steps.targets import StepProblem


def refine_painted(
    problem: StepProblem,
    iterations: Sequence[int],
    painted: Tensor,
    watch: Callable[[int, Minimum], None] | None = None,
    look: Look | None = None,
) -> tuple[Tensor, list[Minimum], int]:
    """Colours of one frame that start from those of a network, one octave after the other.

    What an octave changes is added to the colours: what is finer stays. Where there are several
    octaves, much is left to change, and steps are of the whole rate.

    Args:
        problem, watch, look: as of ``run_colour_step``.
        iterations: see ``network_iterations``.
        painted: display-encoded colours [N 3] of the painted voxels.

    Returns:
        Display-encoded colours [N 3], how each octave ended, and the views that the last one had.
    """
    config, ends = problem.config, list[Minimum]()
    n_views = pool_size(config.views)
    if sum(map(bool, iterations)) > 1:
        config = config.replace(colour=config.colour.replace(warm_rate=1.0))
    for number, n in enumerate(iterations):
        if n == 0:
            continue
        n_views = network_views(config.views, n)
        own = replace(problem, config=config.replace(views=config.views.replace(pool=n_views)))
        octave = [n if place == number else 0 for place in range(len(iterations))]
        painted, found = run_colour_step(own, octave, painted, watch, True, look, carried=True)
        ends += found
    return painted, ends, n_views

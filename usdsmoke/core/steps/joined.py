"""Iterations of a cold frame's last octave that are one step, of all their views (decision 048).

Two threads share a picture less evenly than two pictures. With as much larger steps colours end as
near to the style, if there are enough of them. A neighbour's result is followed in steps of its
own.
"""

from collections.abc import Callable
from dataclasses import replace

from usdsmoke.core.steps.optimize import Descent, Minimum
from usdsmoke.core.steps.pictures import AnyView, ViewPool

VIEWS = 2  # of a step, at least
FEWEST = 200  # iterations: with 80 and 120, two plumes ended 5 and 2 % farther from the style


def joined_iterations(n_iterations: int, n_drawn: int, n_pool: int, apart: bool) -> int:
    """How many iterations of the last octave are one step.

    Args:
        n_iterations: of the octave.
        n_drawn: views of an iteration.
        n_pool: different ones.
        apart: each iteration is a step.
    """
    if apart or n_iterations < FEWEST:
        return 1
    return max(1, min(VIEWS, n_pool) // n_drawn)


def join(
    pool: ViewPool[AnyView], descent: Descent, apart: bool
) -> tuple[ViewPool[AnyView], Descent, int]:
    """A pool and a descent with joined iterations, and how many are one step.

    Args:
        apart: each iteration is a step.
    """
    n_iterations = descent.n_iterations
    n_joined = joined_iterations(n_iterations, pool.n_drawn, len(pool.views), apart)
    n_steps = -(-n_iterations // n_joined)
    descent = replace(descent, rate=n_joined * descent.rate, n_iterations=n_steps)
    return replace(pool, n_drawn=n_joined * pool.n_drawn), descent, n_joined


def counted(state: Minimum, n_joined: int, n_iterations: int) -> Minimum:
    """A state with the iterations that its steps are, out of ``n_iterations``."""
    iteration = min((state.iteration + 1) * n_joined, n_iterations) - 1
    return replace(state, iteration=iteration, n_joined=n_joined)


def tell(
    watch: Callable[[int, Minimum], None],
    octave: int,
    n_joined: int,
    n_iterations: int,
    state: Minimum,
) -> None:
    """Tell a state of an octave; see ``counted``."""
    watch(octave, counted(state, n_joined, n_iterations))

"""How many iterations each octave gets."""

from collections.abc import Sequence

from usdsmoke.config import Config

__all__ = ["octave_iterations"]


def octave_iterations(iterations: Sequence[int], config: Config, warm: bool) -> list[int]:
    """Iterations per octave, coarse to fine.

    ``optimize.iterations`` rescales the list to that total. A frame that starts from its neighbour only
    runs its finest octave, ``windows.warm_iterations`` of the way: the coarse structure has come with the start.

    Args:
        iterations: the step's own list.
        warm: the frame starts from its neighbour's result.
    """
    plan = list(iterations)
    total = config.optimize.iterations
    if total is not None and sum(plan):
        scaled = [n * total / sum(plan) for n in plan]
        plan = [round(sum(scaled[: k + 1])) - round(sum(scaled[:k])) for k in range(len(plan))]
    if warm:
        finest = max((k for k, n in enumerate(plan) if n), default=None)
        share = config.windows.warm_iterations
        plan = [max(1, round(n * share)) if k == finest else 0 for k, n in enumerate(plan)]
    return plan

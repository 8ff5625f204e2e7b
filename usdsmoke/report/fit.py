"""Orders of convergence, and where a curve has a given error."""

import itertools
import math
from collections.abc import Sequence

import numpy as np

__all__ = ["cost_at", "fitted_order"]

_LEAST_POINTS = 3
_ROUND_OFF = 1e-13  # relative errors below this say nothing about a method


def fitted_order(settings: Sequence[float], errors: Sequence[float]) -> float | None:
    """The power p of error ~ setting^p, fitted to the logarithms by least squares.

    >>> round(fitted_order([1.0, 0.5, 0.25], [0.1, 0.025, 0.00625]), 6)
    2.0

    Args:
        settings: a step's length or a number, > 0.
        errors: relative; those at round-off are left out.

    Returns:
        None where fewer than three points are left, or all have one setting.
    """
    pairs = [(h, e) for h, e in zip(settings, errors, strict=True) if h > 0 and e > _ROUND_OFF]
    if len(pairs) < _LEAST_POINTS or len({h for h, _ in pairs}) < _LEAST_POINTS:
        return None
    x, y = np.log(np.array(pairs)).T
    return float(np.polyfit(x, y, 1)[0])


def cost_at(error: float, errors: Sequence[float], costs: Sequence[float]) -> float | None:
    """What a curve costs at an error, between its points straight in the logarithms.

    Args:
        error: > 0.
        errors, costs: of the curve's points, in any order, > 0.

    Returns:
        The least such cost; None where the error does not lie between two points of the curve.
    """
    pairs = sorted((e, c) for e, c in zip(errors, costs, strict=True) if e > 0 and c > 0)
    found = []
    for (e0, c0), (e1, c1) in itertools.pairwise(pairs):
        if e0 <= error <= e1:
            part = 0.0 if e0 == e1 else math.log(error / e0) / math.log(e1 / e0)
            found.append(c0 * (c1 / c0) ** part)
    return min(found, default=None)

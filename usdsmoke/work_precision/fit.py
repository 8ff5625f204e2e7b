"""Orders of convergence, and where a curve has a given error."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Crossing", "crossing", "fitted_order"]

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


@dataclass(frozen=True)
class Crossing:
    """Where a curve passes an error between two of its points."""

    cost: float  # straight in the logarithms between them
    finer: int  # place of the point with less error, which costs more
    rougher: int


def crossing(error: float, errors: Sequence[float], costs: Sequence[float]) -> Crossing | None:
    """The least cost at which a curve has an error between two neighbouring points.

    >>> crossing(0.1, [1.0, 0.01], [1.0, 100.0])
    Crossing(cost=10.0, finer=1, rougher=0)

    Args:
        error: > 0.
        errors, costs: of the curve's points, in any order, > 0.

    Returns:
        None where the error does not lie between two points, or the finer one costs no more than
        the rougher: then it is the better one, and nothing lies between that is worth a word; also
        where a point of less error costs less than what lies between.
    """
    places = sorted(
        (place for place, (e, c) in enumerate(zip(errors, costs, strict=True)) if e > 0 and c > 0),
        key=lambda place: errors[place],
    )
    for fine, rough in itertools.pairwise(places):
        if not errors[fine] < error < errors[rough] or costs[fine] <= costs[rough]:
            continue
        part = math.log(error / errors[fine]) / math.log(errors[rough] / errors[fine])
        cost = costs[fine] * (costs[rough] / costs[fine]) ** part
        finer = [costs[place] for place in places if errors[place] <= errors[fine]]
        return Crossing(cost, fine, rough) if min(finer) > cost else None
    return None

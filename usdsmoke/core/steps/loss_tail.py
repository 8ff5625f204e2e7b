"""Estimates from the history of a loss: how far it would still fall, and how much views differ.

Plain numbers, no tensors: a few milliseconds for hundreds of iterations.
"""

import math
from collections.abc import Sequence

import numpy as np

__all__ = ["FEWEST", "remaining_decrease", "spread_of_mean"]

FEWEST = 10  # iterations from which a tail can be fitted
_DECAYS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)  # T, as shares of the fitted part's way
_SEPARABLE = 48  # iterations that separate a tail from the steps' own part
_BOWL = 0.1  # weight of an exponential beside a tail of the other kind
_HALVINGS = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0)  # a, as shares of the whole way
_SHORTEST = 8  # iterations that separate a spread from a slope


def remaining_decrease(losses: Sequence[float], rates: Sequence[float]) -> float:
    """How far the loss would still fall with infinitely many iterations, in its unit.

    Tails L + A / (1 + s / a) + B r and L + A exp(-s / T) + B r with A, B >= 0 are fitted by least
    squares to all but the first third of the history for several a and T. Here s is the length of
    all steps so far: the optimiser's rate r falls towards the end, and counted in iterations any
    loss would seem to converge. B r is what the steps add to the loss by their own size. Tails
    with B = 0 count as well, and alone where the losses are too few to tell the two apart.

    Style losses fall like the first kind, a quadratic bowl like the second. What each tail leaves
    above L at the end is averaged with the weights w exp(-(S - S_least) / 2 v), S the sum of
    squares, v = S_least / (n - 3), w = 1 for the first kind and 0.1 for the second: a clean history
    is taken at its word, and a noisy one gets the mean of all tails that it allows.

    Args:
        losses: one an iteration, in order.
        rates: the step that followed each, > 0.

    Returns:
        >= 0; NaN with fewer than ``FEWEST`` numbers, or with one that is not finite.
    """
    values, ways = np.asarray(losses, float), np.cumsum(np.asarray(rates, float))
    if len(values) < FEWEST or not np.isfinite(values).all():
        return math.nan
    ways = np.concatenate([[0.0], ways[:-1]])  # before each of the losses
    first = len(values) // 3
    here, whole, tail = ways[first:], ways[-1], values[first:]
    shapes = [(1 + 1 / half) / (1 + here / (half * whole)) for half in _HALVINGS]
    shapes += [np.exp((whole - here) / ((whole - here[0]) * decay)) for decay in _DECAYS]
    prior = np.repeat([1.0, _BOWL], [len(_HALVINGS), len(_DECAYS)])
    found = [_fit(shape, tail, None) for shape in shapes]
    if len(values) >= _SEPARABLE:
        sizes = np.asarray(rates, float)[first:]
        found += [_fit(shape, tail, sizes) for shape in shapes]
        prior = np.concatenate([prior, prior])
    least = min(squares for _, squares in found)
    variance = max(least / max(len(tail) - 3, 1), (1e-12 * float(np.abs(tail).max())) ** 2)
    if variance == 0:
        return 0.0
    weights = prior * np.exp([(least - squares) / (2 * variance) for _, squares in found])
    return float(weights @ [height for height, _ in found] / weights.sum())


def spread_of_mean(losses: Sequence[float], pool: int, count: int = 1) -> float:
    """Standard error of the mean loss over a pool of views, relative to that mean.

    From the last pass through the pool, or eight iterations. Every iteration draws other views, and
    the loss changes little meanwhile: a straight line is subtracted.

    Args:
        losses: one an iteration, each the mean over ``count`` views.
        pool: how many views there are.
        count: views an iteration.

    Returns:
        >= 0; 0 for a pool of one view; NaN where fewer than two iterations are known.
    """
    if pool == 1:
        return 0.0
    passage = np.asarray(losses[-max(math.ceil(pool / count), _SHORTEST) :], float)
    if len(passage) < 2 or not np.isfinite(passage).all() or passage.mean() == 0:
        return math.nan
    views = min(len(passage) * count, pool)
    # an iteration's mean over `count` views varies sqrt(count) times less than a view
    deviation = _detrended(passage) * math.sqrt(min(count, pool))
    return deviation / math.sqrt(views) / abs(float(passage.mean()))


def _fit(shape: np.ndarray, tail: np.ndarray, sizes: np.ndarray | None) -> tuple[float, float]:
    """The tail's height above its limit at the end, and the sum of squares that is left.

    Of the fits with the shape alone, with the steps' sizes alone and with both the best one without
    a negative factor is taken.
    """
    centred, around = shape - shape.mean(), tail - tail.mean()
    height, squares = 0.0, float(around @ around)
    candidates = [[centred]]
    if sizes is not None:
        steps = (sizes - sizes.mean()) / sizes.max()
        candidates += [[steps], [centred, steps]]
    for columns in candidates:
        matrix = np.stack(columns, axis=1)
        factors = np.linalg.lstsq(matrix, around, rcond=None)[0]
        rest = float(((around - matrix @ factors) ** 2).sum())
        if (factors >= 0).all() and rest < squares:
            height, squares = (float(factors[0]) if columns[0] is centred else 0.0), rest
    if tail.mean() > 0:
        height = min(height, float(tail.mean() / shape.mean()))  # no style loss falls below 0
    return height * float(shape[-1]), squares


def _detrended(values: np.ndarray) -> float:
    """Standard deviation around a straight line, or around the mean of few numbers."""
    n = len(values)
    if n < _SHORTEST:
        return float(values.std(ddof=1))
    slope, start = np.polyfit(np.arange(n), values, 1)
    rest = values - start - slope * np.arange(n)
    return math.sqrt(float((rest**2).sum()) / (n - 2))

"""Estimates from the history of a loss: how far it would still fall, and how much views differ.

Plain numbers, no tensors: a few milliseconds for hundreds of iterations.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

FEWEST = 30  # iterations from which a tail shows: 24 told a third of what was left
LONGER = 4.0  # times as long: the run that a loss is compared with
_HALVINGS = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0)  # a, as shares of the whole way
_DECAYS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)  # T, as shares of the fitted part's way
_BOWL = 0.03  # weight of an exponential beside a tail of the other kind
_ALIKE = 4  # iterations that count as one: the same views come again
_LEAST = 1e-3  # of the largest prediction; what a mean of logarithms takes for 0
_SHORTEST = 8  # iterations that separate a spread from a slope


def remaining_decrease(losses: Sequence[float], rates: Sequence[float]) -> float:
    """By how much a run with four times as many iterations would end lower, in the loss's unit.

    Tails L + A / (1 + s / a) and L + A exp(-s / T) with A >= 0 are fitted by least squares to all
    but the first quarter of the history for several a and T, and followed to four times the length.
    Here s is the length of all steps so far: the optimiser's rate r falls towards the end, and
    counted in iterations any loss would seem to converge.

    Style losses fall like the first kind, a quadratic bowl like the second. What they predict is
    averaged, in logarithms, with the weights w exp(-(S - S_least) / 2 v), S the sum of squares,
    v = 8 S_least / (n - 3), w = 1 for the first kind and 0.03 for the second: a clean history is
    taken at its word, and a noisy one gets the mean of all tails that it allows, never 0.

    Args:
        losses: one an iteration, in order.
        rates: the step that followed each, > 0.

    Returns:
        >= 0; NaN with fewer than ``FEWEST`` numbers, or with one that is not finite.
    """
    values, ways = np.asarray(losses, float), np.cumsum(np.asarray(rates, float))
    if len(values) < FEWEST or not np.isfinite(values).all():
        return math.nan
    first, whole = len(values) // 4, ways[-1]
    ways = np.concatenate([[0.0], ways[:-1]])  # before each of the losses
    here, tail = ways[first:] / whole, values[first:]
    left = 1 - here[0]
    shapes = [(1 / (1 + here / a), 1 / (1 + 1 / a) - 1 / (1 + LONGER / a)) for a in _HALVINGS]
    for decay in _DECAYS:
        t = decay * left
        shapes.append((np.exp((1 - here) / t), -math.expm1((1 - LONGER) / t)))
    fits = [_fit(shape, tail) for shape, _ in shapes]
    least = min(fit.squares for fit in fits)
    variance = max(least / max(len(tail) - 3, 1), (1e-12 * float(np.abs(tail).max())) ** 2)
    variance *= _ALIKE
    if variance == 0:
        return 0.0
    pairs = list(zip(shapes, fits, strict=True))
    falls = np.array([gain * fit.height(variance / _ALIKE) for (_, gain), fit in pairs])
    weights = np.repeat([1.0, _BOWL], [len(_HALVINGS), len(_DECAYS)])
    weights *= [math.exp((least - fit.squares) / (2 * variance)) for fit in fits]
    logarithms = np.log(np.maximum(falls, _LEAST * falls.max()))
    return float(np.exp(weights @ logarithms / weights.sum()))


def spread_of_mean(losses: Sequence[float], pool: int, count: int = 1) -> float:
    """Standard error of the mean loss over a pool of views, relative to that mean.

    From the last pass through the pool, or eight iterations. Every iteration draws other views, and
    the loss changes little meanwhile: a straight line is subtracted.

    Args:
        losses: one an iteration, each the mean over ``count`` views.
        pool: how many views there are.
        count: views an iteration.

    Returns:
        >= 0; NaN for a pool of one view, and where fewer than two iterations are known.
    """
    if pool == 1:
        return math.nan
    passage = np.asarray(losses[-max(math.ceil(pool / count), _SHORTEST) :], float)
    if len(passage) < 2 or not np.isfinite(passage).all() or passage.mean() == 0:
        return math.nan
    views = min(len(passage) * count, pool)
    # an iteration's mean over `count` views varies sqrt(count) times less than a view
    deviation = _detrended(passage) * math.sqrt(min(count, pool))
    return deviation / math.sqrt(views) / abs(float(passage.mean()))


@dataclass(frozen=True)
class _Fit:
    """Of the tail L + A shape."""

    factor: float  # A, of either sign
    weight: float  # sum of the squares of the shape around its mean
    squares: float  # sum of squares that is left with A >= 0
    most: float  # of A: no style loss falls below 0

    def height(self, variance: float) -> float:
        """Mean of A, known to be >= 0, if the losses scatter so: small, not 0, where they rise."""
        spread = math.sqrt(variance / self.weight)
        z = self.factor / spread
        below = math.erfc(-z / math.sqrt(2)) / 2
        if below > 1e-200:
            mean = self.factor + spread * math.exp(-z * z / 2) / math.sqrt(2 * math.pi) / below
        else:
            mean = -spread / z
        return min(mean, self.most)


def _fit(shape: np.ndarray, tail: np.ndarray) -> _Fit:
    """By least squares."""
    centred, around = shape - shape.mean(), tail - tail.mean()
    weight = float(centred @ centred)
    factor = float(centred @ around) / weight
    squares = float(((around - max(factor, 0.0) * centred) ** 2).sum())
    most = float(tail.mean() / shape.mean()) if tail.mean() > 0 else math.inf
    return _Fit(factor, weight, squares, most)


def _detrended(values: np.ndarray) -> float:
    """Standard deviation around a straight line, or around the mean of few numbers."""
    n = len(values)
    if n < _SHORTEST:
        return float(values.std(ddof=1))
    slope, start = np.polyfit(np.arange(n), values, 1)
    rest = values - start - slope * np.arange(n)
    return math.sqrt(float((rest**2).sum()) / (n - 2))

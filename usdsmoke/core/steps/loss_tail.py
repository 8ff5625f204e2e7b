"""Estimates from losses: how far one would still fall, and how much views differ.

Plain numbers, no tensors: a few milliseconds for hundreds of iterations.
"""

import math
from collections.abc import Sequence

import numpy as np

FEWEST = 30  # iterations from which a tail shows: 24 told a third of what was left
LONGER = 4.0  # times as long: the run that a loss is compared with
_HALVINGS = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0)  # a, as shares of the whole way
_DECAYS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)  # T, as shares of the fitted part's way
_BOWL = 0.03  # weight of an exponential beside a tail of the other kind
_GAINS, _N_GAINS = (1e-5, 1.0), 60  # of the loss: what is looked for
_SPREAD = 0.5  # of the logarithm of what other runs had left
_MOST_USUAL = 0.5  # of the loss
_FALL = 0.7  # power of the way by which runs of 30 to 160 iterations had less left
_SHORTEST = 8  # iterations that separate a spread from a slope


def remaining_decrease(losses: Sequence[float], rates: Sequence[float], usual: float) -> float:
    """By how much a run with four times as many iterations would end lower, in the loss's unit.

    The tails L + B r + A / (1 + s / a) and L + B r + A exp(-s / T) with B >= 0 are fitted by least
    squares to all but the first quarter of the history, for several a, T and A > 0. s is the length
    of all steps so far. B r is what the optimiser's rate r keeps the loss from its floor: it goes
    as the rate falls, in a longer run as well, so nothing of it is left.

    What the tails predict is averaged, in logarithms. A tail's weight is w p exp(-(S - S_least) /
    2 v), with S the sum of squares and v = S_least / (n - 4). Style losses fall like the first
    kind, with w = 1, a quadratic bowl like the second, with w = 0.03. p is what other runs had
    left: a logarithmic normal distribution around ``usual`` / s^0.7 of the loss, at most a half.
    So a clean history is taken at its word, and one that scatters more than it falls is told as
    usual.

    Args:
        losses: one an iteration, in order.
        rates: the step that followed each, > 0.
        usual: share of the loss that other runs had left where their rates add up to 1.

    Returns:
        >= 0; NaN with fewer than ``FEWEST`` iterations, or with a number that is not finite.
    """
    values, ways = np.asarray(losses, float), np.cumsum(np.asarray(rates, float))
    if len(values) < FEWEST or not np.isfinite(values).all():
        return math.nan
    first, whole = len(values) // 4, ways[-1]
    tail = values[first:]
    if not np.ptp(tail) > 1e-12 * np.abs(tail).max():
        return 0.0
    here = np.concatenate([[0.0], ways[:-1]])[first:] / whole  # before each of the losses
    rate = np.asarray(rates, float)[first:] / max(rates)
    gains = np.geomspace(*_GAINS, _N_GAINS) * tail.mean()
    squares = np.stack([_squares(shape, gain, gains, rate, tail) for shape, gain in _tails(here)])
    least = float(squares.min())
    variance = max(least / max(len(tail) - 4, 1), (1e-12 * float(np.abs(tail).max())) ** 2)
    kinds = np.repeat([1.0, _BOWL], [len(_HALVINGS), len(_DECAYS)])
    middle = min(usual / whole**_FALL, _MOST_USUAL) * tail.mean()
    odds = -0.5 * (np.log(gains / middle) / _SPREAD) ** 2 + np.log(kinds)[:, None]
    odds -= (squares - least) / (2 * variance)
    weights = np.exp(odds - odds.max())
    return float(np.exp((weights * np.log(gains)).sum() / weights.sum()))


def _tails(here: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Shapes of tails at ways, and how far each falls from here to ``LONGER`` times the way."""
    shapes = [(1 / (1 + here / a), 1 / (1 + 1 / a) - 1 / (1 + LONGER / a)) for a in _HALVINGS]
    for decay in _DECAYS:
        t = decay * (1 - here[0])
        shapes.append((np.exp((1 - here) / t), -math.expm1((1 - LONGER) / t)))
    return shapes


def _squares(
    shape: np.ndarray, gain: float, gains: np.ndarray, rate: np.ndarray, tail: np.ndarray
) -> np.ndarray:
    """Sums of the squares that tails of one shape leave, with the best L and B, by their gain."""
    shape, rate, tail = (values - values.mean() for values in (shape, rate, tail))
    rest = tail - (gains / gain)[:, None] * shape
    weight = float(rate @ rate)
    if weight > 0:
        rest = rest - np.maximum(rest @ rate / weight, 0.0)[:, None] * rate
    found: np.ndarray = np.square(rest).sum(axis=1)
    return found


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


def likely_difference(ours: Sequence[float], others: Sequence[float]) -> float:
    """How far apart the means are of what two sets of losses were drawn from, over the first's.

    The difference d of few numbers has a standard error s, by how much ``ours`` scatter. Before
    they are known, the sets are taken to differ by 0 with a deviation of s, as losses of other
    views do; then they differ by d / 2 with a deviation of s / sqrt 2. This is its root mean
    square, so that it tells s / sqrt 2 where d happens to be 0.

    Args:
        ours, others: at least one each, of the same kind.

    Returns:
        >= 0; |d| where ``ours`` is one number, 0 where the mean is 0.
    """
    mean = math.fsum(ours) / len(ours)
    if not mean > 0:
        return 0.0
    difference = math.fsum(others) / len(others) - mean
    if len(ours) == 1:
        return abs(difference) / mean
    variance = float(np.var(ours, ddof=1)) * (1 / len(ours) + 1 / len(others))
    return math.sqrt(difference**2 / 4 + variance / 2) / mean


def _detrended(values: np.ndarray) -> float:
    """Standard deviation around a straight line, or around the mean of few numbers."""
    n = len(values)
    if n < _SHORTEST:
        return float(values.std(ddof=1))
    slope, start = np.polyfit(np.arange(n), values, 1)
    rest = values - start - slope * np.arange(n)
    return math.sqrt(float((rest**2).sum()) / (n - 2))

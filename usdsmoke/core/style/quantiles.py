r"""One-dimensional optimal transport between the features of a picture and of a style.

On a line the optimal transport between two distributions maps equal quantiles to each other, so
the squared 2-Wasserstein distance is the mean of (x - q(F(x)))^2, with F the distribution function
of the picture and q the quantile function of the style. Taken channel by channel it is the
histogram loss [Risser2017]; taken along many directions in the space of the channels it is the
sliced Wasserstein distance [Heitz2021; Pitie2005], which misses no correlation of the channels:

    directions = random_directions(n_channels, 32, seed, maps)
    distance = quantile_distance(directions @ maps, weights, quantile_table(directions @ style))

Deviations from both: pixels are weighted by where the smoke is, and the style is held as a table of
quantiles, so that pictures and styles of any two sizes compare.
"""

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.errors import ShapeError

HALVES = (torch.float16, torch.bfloat16)
MANY_TIMES = 16  # as many numbers as are drawn, of which hardly any is drawn twice
MANY = 1024  # samples of float32 from which on a table rounds them
STEPS = 2**16 - 1  # of a row's range


def quantile_table(values: Tensor, n: int = 256) -> Tensor:
    """Quantiles at (k + 1/2) / n, k = 0 ... n - 1, of each channel; [C n], float32 or wider.

    Linear between the sorted samples, of which the j-th of P is the quantile at (j + 1/2) / P; the
    outermost samples hold beyond them. Ascending along each row, blind to the order of samples.
    On a CPU, ``MANY`` samples of float32 or more are rounded to a ``STEPS``-th of a row's range.

    Args:
        values: samples [C P], P >= 1.
        n: quantiles per channel, >= 1.

    Gradients: none.

    Raises:
        ShapeError: ``values`` is not [C P] with P >= 1, or n < 1.
    """
    if values.ndim != 2 or values.shape[1] < 1 or n < 1:
        raise ShapeError(
            f"quantile_table: values are {list(values.shape)} and n is {n}. "
            "Give [C P] with P >= 1, and n >= 1."
        )
    ascending = _ascending(at_least_single(values.detach()))
    return quantiles_at(ascending, _middles(n, ascending))


def quantile_distance(values: Tensor, weights: Tensor | None, table: Tensor) -> Tensor:
    """Mean over channels of sum_p w_p (x_p - q(F(x_p)))^2 / sum_p w_p; scalar, >= 0.

    F is the share of the weight below the middle of the sample's own, equal samples in some fixed
    order; q is linear in the table and constant beyond it. 0 where the sorted samples are the
    table, and exactly 0 where no weight is left. Without weights and with n = P samples this is the
    squared 2-Wasserstein distance; otherwise it lacks the spread of q within the share of one
    sample, and q lacks what lies beyond the table's outermost quantiles, both small for many.

    Args:
        values: samples [C P].
        weights: [P], >= 0; samples of weight 0 have no influence. None means 1 everywhere.
        table: of the same channels, from ``quantile_table``.

    Gradients: through ``values``; the match q(F(x)) is held constant [Risser2017], which gives the
    slope of the distance itself, as the best match does not change to first order.

    Raises:
        ShapeError: the shapes are not as above.
    """
    _check_shapes(values, weights, table)
    if weights is not None and weights.device.type == "cpu":  # on a GPU nothing waits for a number
        kept = (weights > 0).nonzero().squeeze(1)
        if kept.numel() < weights.numel():
            values, weights = values.index_select(1, kept), weights.index_select(0, kept)
    values = at_least_single(values)
    if values.shape[1] == 0:
        return values.sum()  # of nothing: 0, and its gradient is 0
    with torch.no_grad():
        order = _ascending_order(values)
        share = None if weights is None else weight_share(weights, values)
        match = _match(order, share, table.to(values))
    error = (values - match).square()
    per_channel = error.mean(dim=1) if share is None else error @ share
    return per_channel.mean()


def random_directions(n_channels: int, n: int, seed: int, like: Tensor) -> Tensor:
    """Unit vectors [n C] in all directions alike, for projecting features on.

    Orthonormal within each block of C (the last block may be shorter), which covers the space more
    evenly than independent draws. Made on the CPU in float64: the same seed gives the same
    directions on every device, to rounding.

    Args:
        n_channels: C, >= 1.
        n: number of directions, >= 1.
        seed: of the draw.
        like: gives the device and the dtype, float32 at least.
    """
    generator = torch.Generator().manual_seed(seed)
    blocks = []
    for first in range(0, n, n_channels):
        size = (n_channels, min(n_channels, n - first))
        normal = torch.randn(size, generator=generator, dtype=torch.float64)
        basis, triangle = torch.linalg.qr(normal)
        # QR leaves the signs to the library; a positive diagonal makes the result unique.
        blocks.append((basis * triangle.diagonal().sign()).T)
    return torch.cat(blocks).to(at_least_single(like.detach().new_zeros(())))


def _match(order: Tensor, share: Tensor | None, table: Tensor) -> Tensor:
    """What each sample is matched with, [C P] in the order of the samples.

    Args:
        order: samples in ascending order, [C P].
        share: the share of the weight that each sample has, [P]; None means equal shares.
        table: [C n].
    """
    if share is None:
        matched = quantiles_at(table, _middles(order.shape[1], table))
    else:
        ordered = share[order]
        below = torch.cumsum(ordered, dim=1).sub_(ordered, alpha=0.5)
        matched = quantiles_at(table, below)
    return torch.empty_like(matched).scatter_(1, order, matched)


def quantiles_at(quantiles: Tensor, share: Tensor) -> Tensor:
    """Rows [C n] of quantiles at (k + 1/2) / n, read linearly at shares [P] or [C P]; [C P]."""
    n = quantiles.shape[1]
    position = (share * n - 0.5).clamp_(0, n - 1)
    lower = position.long().clamp_(max=max(n - 2, 0))
    upper = (lower + 1).clamp_(max=n - 1)
    fraction = (position - lower).to(quantiles.dtype)
    if share.ndim == 1:
        return torch.lerp(quantiles[:, lower], quantiles[:, upper], fraction)
    return torch.lerp(quantiles.gather(1, lower), quantiles.gather(1, upper), fraction)


def _middles(n: int, like: Tensor) -> Tensor:
    """(k + 1/2) / n; in float64, so that tables of the same n are read at their very entries."""
    return ((torch.arange(n, dtype=torch.float64) + 0.5) / n).to(like.device)


def weight_share(weights: Tensor, like: Tensor) -> Tensor:
    """Weights >= 0 by their sum, [P]; scaled first, so that no size of them is lost.

    All are 0 where no weight is left.
    """
    least = torch.finfo(weights.dtype).tiny
    scaled = (weights.detach() / weights.max().clamp_min(least)).to(like)
    return scaled / scaled.sum().clamp_min(torch.finfo(like.dtype).tiny)


def _ascending(values: Tensor) -> Tensor:
    """Samples [C P], each row sorted; on a CPU NumPy sorts several times as fast as torch.

    Many samples are rounded, see ``quantile_table``. NumPy sorts whole numbers of 16 bits by radix,
    which takes a seventh of the time of floats without AVX-512.
    """
    if values.device.type != "cpu":
        return torch.sort(values, dim=1).values
    samples = values.detach().numpy()
    if samples.dtype == np.float32 and samples.shape[1] >= MANY:
        low, high = samples.min(axis=1, keepdims=True), samples.max(axis=1, keepdims=True)
        step = np.maximum((high - low) / np.float32(STEPS), np.finfo(np.float32).tiny)
        if np.isfinite(step).all():
            place = samples - low
            place /= step
            place += 0.5  # to the nearest step
            whole = np.sort(place.astype(np.uint16), axis=1, kind="stable")
            return torch.from_numpy(whole * step + low)
    return torch.from_numpy(np.sort(samples, axis=1))


def _ascending_order(values: Tensor) -> Tensor:
    """Sample numbers [C P], by value, on the same grounds."""
    if values.device.type == "cpu":
        return torch.from_numpy(np.argsort(values.detach().numpy(), axis=1))
    return torch.argsort(values, dim=1)


def at_least_single(values: Tensor) -> Tensor:
    """At least float32, as sums of halves lose the small ones."""
    return values.float() if values.dtype in HALVES else values


def _check_shapes(values: Tensor, weights: Tensor | None, table: Tensor) -> None:
    fits = values.ndim == table.ndim == 2 and values.shape[0] == table.shape[0]
    if not fits or table.shape[1] < 1:
        raise ShapeError(
            f"quantile_distance: values are {list(values.shape)} and the table is "
            f"{list(table.shape)}. Give [C P] and [C n] of the same channels, n >= 1."
        )
    check_weights("quantile_distance", values, weights)


def check_weights(caller: str, values: Tensor, weights: Tensor | None) -> None:
    """Raise ShapeError unless weights are None or have one number for each of [C P] samples."""
    if weights is not None and weights.shape != values.shape[1:]:
        raise ShapeError(
            f"{caller}: weights are {list(weights.shape)} for {values.shape[1]} samples. Give one "
            "weight for each sample."
        )


def some_of(n: int, most: int, seed: int) -> Tensor:
    """At most so many of n numbers from 0 on, drawn at random, on the CPU."""
    generator = torch.Generator().manual_seed(seed)
    if n > MANY_TIMES * most:  # a shuffle would take longer than all that it is for
        return torch.randint(n, (most,), generator=generator)
    return torch.randperm(n, generator=generator)[:most]

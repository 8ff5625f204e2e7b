r"""Distance of distributions along directions, by counting instead of sorting.

Samples are projected on unit vectors. Along each one, the distribution function of the samples is
counted in bins, matched with the style's quantiles at the edges of the bins, and interpolated
linearly between them. [Heitz2021, eq. 2; there by sorting]
"""

from typing import Any, cast

import torch
from torch import Tensor

from usdsmoke.base.errors import ShapeError
from usdsmoke.core.style.quantiles import (
    at_least_single,
    check_weights,
    quantile_distance,
    quantiles_at,
    weight_share,
)

N_BINS = 512  # of a direction, over the range of its samples
WHOLE = 2**40  # parts of all weight, of which each sample has a whole number on a GPU
FEWEST_PER_BIN = 4  # samples; fewer are sorted, which is as fast, as bins would blur their ranks


def sliced_distance(
    values: Tensor, weights: Tensor | None, axes: Tensor, table: Tensor, n_bins: int = N_BINS
) -> Tensor:
    """Mean over directions of sum_p w_p (x_p - q(F(x_p)))^2 / sum_p w_p; scalar, >= 0.

    x = axes . values are the samples along a direction, F is their distribution function and q the
    style's quantile function. F is counted at the edges of ``n_bins`` bins from the least to the
    largest sample, and q(F) is linear in between. With 512 bins the distance differs from that of
    ``quantile_distance``, which sorts, by less than 0.5 %. Few samples are sorted. Exactly 0 where
    no weight is left.

    Args:
        values: features [C P].
        weights: [P], >= 0; samples of weight 0 have no influence. None means 1 everywhere.
        axes: unit vectors [D C].
        table: the style's quantiles along them, [D n], from ``quantile_table``.
        n_bins: >= 1.

    Gradients: through ``values``; the match q(F(x)) is held constant [Risser2017], which gives the
    slope of the distance itself, as the best match does not change to first order. On a GPU nothing
    waits for a number, and samples of weight 0 are looked up too.

    Raises:
        ShapeError: the shapes are not as above.
    """
    n_channels = axes.shape[1]
    fits = values.ndim == 2 and len(values) == n_channels and table.shape[:1] == axes.shape[:1]
    if not fits or table.shape[1] < 1 or n_bins < 1:
        raise ShapeError(
            f"sliced_distance: values are {list(values.shape)}, axes {list(axes.shape)}, the table "
            f"{list(table.shape)}, and there are {n_bins} bins. Give [C P], [D C] and [D n]."
        )
    check_weights("sliced_distance", values, weights)
    values = at_least_single(values)
    axes, table = axes.to(values), table.to(values)
    if values.shape[1] < FEWEST_PER_BIN * n_bins:
        return quantile_distance(axes @ values, weights, table)
    return cast(Tensor, _Sliced.apply(values, weights, axes, table, n_bins))


class _Sliced(torch.autograd.Function):
    """The distance with its gradient in one pass: what is kept is x - q(F(x)), weighted."""

    @staticmethod
    def forward(
        ctx: Any, values: Tensor, weights: Tensor | None, axes: Tensor, table: Tensor, n_bins: int
    ) -> Tensor:
        kept, share = _shares(values, weights)
        ctx.kept, ctx.n_samples = kept, values.shape[1]
        # samples by channels, as the maps lie in memory
        samples = axes @ (values if kept is None else values.T.index_select(0, kept).T)
        if values.device.type != "cpu":  # those of weight 0 lie within the others
            middle = torch.where(share > 0, samples, 0) @ share
            samples = torch.where(share > 0, samples, middle[:, None])
        if samples.numel() == 0:
            ctx.save_for_backward(axes, samples)
            return values.new_zeros(())
        error = samples - _match(samples, share, table, n_bins)
        pull = error * (share / len(axes))
        ctx.save_for_backward(axes, pull)
        return (pull * error).sum()

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None, None, None]:
        axes, pull = ctx.saved_tensors
        slopes = pull.T @ ((2 * upstream) * axes)
        if ctx.kept is not None:
            slopes = slopes.new_zeros(ctx.n_samples, axes.shape[1]).index_copy_(0, ctx.kept, slopes)
        return slopes.T, None, None, None, None


def _shares(values: Tensor, weights: Tensor | None) -> tuple[Tensor | None, Tensor]:
    """The samples that have a weight (None: all), and the share of each in its sum, [P]."""
    if weights is None:
        n = values.shape[1]
        return None, values.new_full((n,), 1 / max(n, 1))
    if weights.device.type != "cpu":
        return None, weight_share(weights, values)
    kept = (weights > 0).nonzero().squeeze(1)
    if len(kept) == 0:
        return kept, values.new_empty(0)
    share = weight_share(weights.index_select(0, kept), values)
    return (kept if len(kept) < len(weights) else None), share


def _match(samples: Tensor, share: Tensor, table: Tensor, n_bins: int) -> Tensor:
    """What each sample [D P] is matched with, q(F(x))."""
    # ten times as fast as ``aminmax`` along an axis
    low, high = samples.amin(dim=1, keepdim=True), samples.amax(dim=1, keepdim=True)
    width = (high - low).clamp_min(torch.finfo(samples.dtype).tiny) / n_bins
    place = (samples - low).div_(width)
    number = place.to(torch.int32).clamp_(0, n_bins - 1)  # whatever NaN becomes
    fraction = place.sub_(number.to(place.dtype))
    first = torch.arange(len(samples), device=samples.device, dtype=torch.int32)[:, None]
    counted = _count(number.add(first * n_bins).view(-1), share, len(samples) * n_bins)
    edges = torch.zeros(len(samples), n_bins + 1, dtype=samples.dtype, device=samples.device)
    edges[:, 1:] = counted.view(len(samples), n_bins).double().cumsum(dim=1)
    matched = quantiles_at(table, edges)
    near = number.add_(first * (n_bins + 1)).view(-1)
    flat, rise = matched.view(-1), torch.zeros_like(matched)
    rise[:, :-1] = matched.diff(dim=1)
    found = rise.view(-1).index_select(0, near).view_as(samples).mul_(fraction)
    return found.add_(flat.index_select(0, near).view_as(samples))


def _count(number: Tensor, share: Tensor, n: int) -> Tensor:
    """The shares [P], again and again, by their number [D P] flat; [n]."""
    if number.device.type == "cpu":
        return torch.bincount(number, share.repeat(len(number) // len(share)), minlength=n)
    # a GPU adds up in any order, which sums of whole numbers do not show
    whole = (share.double() * WHOLE).long().repeat(len(number) // len(share))
    counted = torch.zeros(n, dtype=torch.int64, device=number.device)
    return counted.index_add_(0, number, whole).double() / WHOLE

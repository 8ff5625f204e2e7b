"""How far features are from the nearest ones of a style, and the style's from theirs.

Distributions tell how often a feature appears, and are content with mixtures that the style has
nowhere. The way to the nearest feature [Li2016] is 0 only where every place of a picture looks like
some place of the style. The way back [Simakov2008] is 0 only where every place of the style is
found in the picture: without it, a picture may be of the style's simplest pieces alone.
"""

import torch
import torch.nn.functional as F
from torch import Tensor

MOST_STYLE = 1500  # features of the style that are looked through, evenly spaced
MOST_LOOKED_UP = 1500  # features of a picture in one draw; the others in the next ones
LEAST_WEIGHT = 0.05  # below this, a feature is left out
WHOLE = 0.5  # of a draw's largest weight; no way leads back to less, as at the rim of smoke


def thin_out(style: Tensor) -> Tensor:
    """At most ``MOST_STYLE`` of a style's features [C S], evenly spaced."""
    return style[:, :: -(-style.shape[1] // MOST_STYLE)].contiguous()


def nearest_distances(
    values: Tensor, weights: Tensor | None, style: Tensor, draw: int | Tensor = 0
) -> tuple[Tensor, Tensor]:
    """Mean squares of the ways to the nearest feature: to the style, and back. [Simakov2008]

    |F - F_s|² / C: a weighted mean over features F [C P], F_s the nearest of the style's [C S]; and
    a mean over the style's, F the nearest of the picture's. The first is coherence, the second
    completeness.

    Of many features every n-th is looked up, others in each of n draws that follow each other:
    neighbours see much the same of a picture. Every other one of the style's looks back, in turns;
    of an odd number, the last always does.

    Args:
        values: of a picture.
        weights: [P], >= 0; None means 1 everywhere. See ``WHOLE`` too.
        style: see ``thin_out``.
        draw: which of the features, e.g. the iteration; a tensor on a GPU, where nothing waits for
            a number.

    Returns:
        Two scalars; 0 if no weight is above ``LEAST_WEIGHT``.

    Gradients: through ``values``, with the choice of the nearest held.
    """
    chosen, weights = _choose(values, weights, draw)
    if chosen is not None:
        # rows, as features lie in memory, and as their slopes then do
        values = values.T.index_select(0, chosen).T
    if values.shape[1] == 0:
        return values.sum(), values.sum()
    missing = style.T.index_select(0, _every_other(style, draw)).T
    to_style = values - _nearest(values, style)
    back = _nearest(missing, values, weights) - missing
    square = to_style.square().mean(0)
    if weights is None:
        return square.mean(), back.square().mean()
    least = torch.finfo(square.dtype).tiny
    is_any = weights.any()
    return (square * weights).sum() / weights.sum().clamp_min(least), back.square().mean() * is_any


def _every_other(style: Tensor, draw: int | Tensor) -> Tensor:
    """Half of a style's features [C S], as many in each draw."""
    n = style.shape[1]
    return (torch.arange((n + 1) // 2, device=style.device) * 2 + draw % 2).clamp_max(n - 1)


def _choose(
    values: Tensor, weights: Tensor | None, draw: int | Tensor
) -> tuple[Tensor | None, Tensor | None]:
    """The features of a draw (None: all), and their weights."""
    if weights is not None and weights.device.type != "cpu":
        return _drawn(weights, draw)
    if weights is None:
        chosen = torch.arange(values.shape[1], device=values.device)
    else:
        chosen = (weights > LEAST_WEIGHT).nonzero().squeeze(1)
    n_draws = max(-(-len(chosen) // MOST_LOOKED_UP), 1)
    if weights is None and n_draws == 1:
        return None, None
    chosen = chosen[draw % n_draws :: n_draws]
    return chosen, None if weights is None else weights[chosen]


def _drawn(weights: Tensor, draw: int | Tensor) -> tuple[Tensor, Tensor]:
    """The features of a draw, always as many, and their weights; 0 for those that fill up."""
    n, enough = len(weights), weights > LEAST_WEIGHT
    rank = torch.cumsum(enough, 0) - 1
    n_draws = torch.div(rank[-1] + MOST_LOOKED_UP, MOST_LOOKED_UP, rounding_mode="floor")
    n_draws = n_draws.clamp_min(1)
    is_drawn = enough & (rank % n_draws == draw % n_draws)
    place = torch.where(is_drawn, torch.arange(n, device=weights.device), n)
    chosen = place.sort().values[:MOST_LOOKED_UP]
    weights = F.pad(weights, (0, 1)).index_select(0, chosen)
    return chosen.clamp(max=n - 1), weights


def _nearest(values: Tensor, others: Tensor, weights: Tensor | None = None) -> Tensor:
    """For each feature [C P] the nearest of others [C S], of those with enough weight [S]."""
    with torch.no_grad():
        half_squares = 0.5 * others.square().sum(0)
        if weights is not None:
            half_squares.masked_fill_(weights < WHOLE * weights.max(), torch.inf)
        rows = _largest(torch.addmm(half_squares, values.T, others, beta=-1))
    if rows.device.type == "cpu":
        return others.T.index_select(0, rows).T
    return others.T[rows].T  # the slopes of many rows that are one are added in a fixed order


def _largest(values: Tensor) -> Tensor:
    """The column of the largest value of each row; on a CPU NumPy finds it nine times as fast."""
    if values.device.type == "cpu":
        return torch.from_numpy(values.numpy().argmax(axis=1))
    return values.argmax(dim=1)

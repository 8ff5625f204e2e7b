"""How far features are from the nearest ones of a style. [Li2016]

Distributions tell how often a feature appears, and are content with mixtures that the style has
nowhere. The way to the nearest feature is 0 only where every place of a picture looks like some
place of the style.
"""

import torch
import torch.nn.functional as F
from torch import Tensor

MOST_STYLE = 1500  # features of the style that are looked through, evenly spaced
MOST_LOOKED_UP = 1500  # features of a picture in one draw; the others in the next ones
LEAST_WEIGHT = 0.05  # below this, a feature is left out


def thin_out(style: Tensor) -> Tensor:
    """At most ``MOST_STYLE`` of a style's features [C S], evenly spaced."""
    return style[:, :: -(-style.shape[1] // MOST_STYLE)].contiguous()


def nearest_distance(
    values: Tensor, weights: Tensor | None, style: Tensor, draw: int | Tensor = 0
) -> Tensor:
    """Weighted mean of |F - F_s|² / C over features F [C P], F_s the nearest of the style's [C S].

    Of many features every n-th is looked up, others in each of n draws that follow each other:
    neighbours see much the same of a picture.

    Args:
        values: of a picture.
        weights: [P], >= 0; None means 1 everywhere.
        style: see ``thin_out``.
        draw: which of the features, e.g. the iteration; a tensor on a GPU, where nothing waits for
            a number.

    Returns:
        A scalar; 0 if no weight is above ``LEAST_WEIGHT``.

    Gradients: through ``values``, with the choice of the nearest held.
    """
    chosen, weights = _choose(values, weights, draw)
    if chosen is not None:
        # rows, as features lie in memory, and as their slopes then do
        values = values.T.index_select(0, chosen).T
    if values.shape[1] == 0:
        return values.sum()
    square = (values - _nearest(values, style)).square().mean(0)
    if weights is None:
        return square.mean()
    return (square * weights).sum() / weights.sum().clamp_min(torch.finfo(square.dtype).tiny)


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


@torch.no_grad()
def _nearest(values: Tensor, style: Tensor) -> Tensor:
    """For each feature [C P] the nearest of the style's [C S]."""
    half_squares = 0.5 * style.square().sum(0)
    nearness = torch.addmm(half_squares, values.T, style, beta=-1)
    return style.T.index_select(0, _largest(nearness)).T


def _largest(values: Tensor) -> Tensor:
    """The column of the largest value of each row; on a CPU NumPy finds it nine times as fast."""
    if values.device.type == "cpu":
        return torch.from_numpy(values.numpy().argmax(axis=1))
    return values.argmax(dim=1)

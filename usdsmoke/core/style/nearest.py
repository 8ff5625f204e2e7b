"""How far features are from the nearest ones of a style. [Li2016]

Distributions tell how often a feature appears, and are content with mixtures that the style has
nowhere. The way to the nearest feature is 0 only where every place of a picture looks like some
place of the style.
"""

import torch
from torch import Tensor

MOST_STYLE = 1500  # features of the style that are looked through, evenly spaced
MOST_LOOKED_UP = 1500  # features of a picture in one draw; the others in the next ones
LEAST_WEIGHT = 0.05  # below this, a feature is left out


def thin_out(style: Tensor) -> Tensor:
    """At most ``MOST_STYLE`` of a style's features [C S], evenly spaced."""
    return style[:, :: -(-style.shape[1] // MOST_STYLE)].contiguous()


def nearest_distance(
    values: Tensor, weights: Tensor | None, style: Tensor, draw: int = 0
) -> Tensor:
    """Weighted mean of |F - F_s|² / C over features F [C P], F_s the nearest of the style's [C S].

    Of many features every n-th is looked up, others in each of n draws that follow each other:
    neighbours see much the same of a picture.

    Args:
        values: of a picture.
        weights: [P], >= 0; None means 1 everywhere.
        style: see ``thin_out``.
        draw: which of the features, e.g. the iteration.

    Returns:
        A scalar; 0 if no weight is above ``LEAST_WEIGHT``.

    Gradients: through ``values``, with the choice of the nearest held.
    """
    if weights is None:
        chosen = torch.arange(values.shape[1], device=values.device)
    else:
        chosen = (weights > LEAST_WEIGHT).nonzero().squeeze(1)
    n_draws = max(-(-len(chosen) // MOST_LOOKED_UP), 1)
    if n_draws > 1 or weights is not None:
        chosen = chosen[draw % n_draws :: n_draws]
        # rows, as features lie in memory, and as their slopes then do
        values = values.T.index_select(0, chosen).T
    if values.shape[1] == 0:
        return values.sum()
    with torch.no_grad():
        half_squares = 0.5 * style.square().sum(0)
        nearness = torch.addmm(half_squares, values.T, style, beta=-1)
        wanted = style.T.index_select(0, _largest(nearness)).T
    square = (values - wanted).square().mean(0)
    if weights is None:
        return square.mean()
    weights = weights[chosen]
    return (square * weights).sum() / weights.sum()


def _largest(values: Tensor) -> Tensor:
    """The column of the largest value of each row; on a CPU NumPy finds it nine times as fast."""
    if values.device.type == "cpu":
        return torch.from_numpy(values.numpy().argmax(axis=1))
    return values.argmax(dim=1)

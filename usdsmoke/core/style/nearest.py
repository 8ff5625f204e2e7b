"""How far features are from the nearest ones of a style. [Li2016]

Distributions tell how often a feature appears, and are content with mixtures that the style has
nowhere. The way to the nearest feature is 0 only where every place of a picture looks like some
place of the style.
"""

import torch
from torch import Tensor

MOST_STYLE = 1500  # features of the style that are looked through, evenly spaced
ROWS = 4096  # features of a picture that are looked up at once
LEAST_WEIGHT = 0.05  # below this, a feature is left out


def thin_out(style: Tensor) -> Tensor:
    """At most ``MOST_STYLE`` of a style's features [C S], evenly spaced."""
    return style[:, :: -(-style.shape[1] // MOST_STYLE)].contiguous()


def nearest_distance(values: Tensor, weights: Tensor | None, style: Tensor) -> Tensor:
    """Weighted mean of |F - F_s|² / C over features F [C P], F_s the nearest of the style's [C S].

    Args:
        values: of a picture.
        weights: [P], >= 0; None means 1 everywhere.
        style: see ``thin_out``.

    Returns:
        A scalar; 0 if no weight is above ``LEAST_WEIGHT``.

    Gradients: through ``values``, with the choice of the nearest held.
    """
    if weights is not None:
        inside = weights > LEAST_WEIGHT
        values, weights = values[:, inside], weights[inside]
    if values.shape[1] == 0:
        return values.sum()
    with torch.no_grad():
        half_squares = 0.5 * style.square().sum(0)
        parts = values.T.split(ROWS)
        nearest = torch.cat([(part @ style - half_squares).argmax(1) for part in parts])
        wanted = style[:, nearest]
    square = (values - wanted).square().mean(0)
    return square.mean() if weights is None else (square * weights).sum() / weights.sum()

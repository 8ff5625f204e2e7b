"""Contrast between neighbouring voxels, raised as far as that brings pictures nearer to a style.

What differs from voxel to voxel is the last that iterations reach: each view sees it through other
voxels. Colours end with half to three quarters of their style's contrast in the finest band, and
a single step along what they have of it saves many iterations (decision 062).
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

MOST = 0.8  # of the detail that is added; with more, grain grows faster than strokes


def sharpened(
    colours: Tensor, detail: Tensor, limit: float, loss: Callable[[Tensor], float]
) -> Tensor:
    """Colours [N 3] with as much more of a detail as makes a loss smallest, up to ``MOST`` of it.

    The amount is the lowest point of the parabola through the losses of none, half and all of
    ``MOST``; it is 0 where more detail raises the loss.

    Args:
        colours: display-encoded, [N 3].
        detail: of their luma, [N 1].
        limit: the largest display-encoded value.
        loss: of colours [N 3].
    """

    def with_detail(amount: float) -> Tensor:
        return torch.add(colours, detail, alpha=amount).clamp_(0, limit)

    none, half, most = (loss(with_detail(share * MOST)) for share in (0.0, 0.5, 1.0))
    return with_detail(MOST * lowest(none, half, most))


def lowest(first: float, middle: float, last: float) -> float:
    """Where in [0, 1] the parabola through values at 0, 1/2 and 1 is lowest; 0 if one is NaN."""
    bend, slope = 2 * (first - 2 * middle + last), 4 * middle - 3 * first - last
    if not math.isfinite(bend):
        return 0.0
    if bend > 0:
        return min(max(-slope / (2 * bend), 0.0), 1.0)
    return 1.0 if last < first else 0.0

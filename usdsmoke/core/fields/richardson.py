"""Richardson's estimate: the error of a result from the same result with 2 and 4 times the step.

With R(h) = R + c h^p the difference R(h) - R(2h) is 2^p - 1 times the error of R(h), and the ratio
of two such differences is 2^p. [Richardson1911]
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class StepError:
    """An estimated error, relative to the result, and the order that was fitted."""

    value: float
    order: float


def step_error(results: Sequence[Tensor], least: float = 1.0, most: float = 2.0) -> StepError:
    """The mean absolute error of the first result, relative to its mean absolute value.

    Args:
        results: the same with the steps h, 2h and 4h, any equal shapes.
        least, most: the fitted order is clamped to this range. Where differences do not fall, as at
            edges that no step resolves, the least order gives the most cautious estimate.

    Returns:
        0 and the highest order where h and 2h give the same, or nothing at all.
    """
    fine, middle, coarse = results
    size = float(fine.abs().sum())
    near, far = float((fine - middle).abs().sum()), float((middle - coarse).abs().sum())
    if near == 0 or size == 0:
        return StepError(0.0, most)
    order = min(max(math.log2(far / near), least), most) if far > 0 else least
    return StepError(near / size / (2**order - 1), order)

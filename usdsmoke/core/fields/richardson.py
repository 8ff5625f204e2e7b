"""Richardson's estimate: the error of a result from the same result with 2 and 4 times the step.

With R(h) = R + c h^p the difference R(h) - R(2h) is 2^p - 1 times the error of R(h), and the ratio
of two such differences is 2^p. [Richardson1911]
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

# The fitted order is clamped to this range. Where differences do not fall, as at edges that no step
# resolves, the least order gives the most cautious estimate.
LEAST_ORDER, MOST_ORDER = 1.0, 2.0


@dataclass(frozen=True)
class StepError:
    """An estimated error, relative to the result, and the order that was fitted."""

    value: float
    order: float


def step_error(results: Sequence[Tensor]) -> StepError:
    """The mean absolute error of the first result, relative to its mean absolute value.

    Args:
        results: the same with the steps h, 2h and 4h, any equal shapes.

    Returns:
        0 and the highest order where h and 2h give the same, or nothing at all.
    """
    fine, middle, coarse = results
    size = float(fine.abs().sum())
    near, far = float((fine - middle).abs().sum()), float((middle - coarse).abs().sum())
    if near == 0 or size == 0:
        return StepError(0.0, MOST_ORDER)
    order = min(max(math.log2(far / near), LEAST_ORDER), MOST_ORDER) if far > 0 else LEAST_ORDER
    return StepError(near / size / (2**order - 1), order)

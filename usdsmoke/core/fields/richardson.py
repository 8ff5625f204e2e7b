"""Richardson's estimate: the error of a result from the same result with 2 and 4 times the step.

With R(h) = R + c h^p the difference R(h) - R(2h) is 2^p - 1 times the error of R(h), and the ratio
of two such differences is 2^p. [Richardson1911]
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from usdsmoke.core.fields.transport import Scheme, warp

WARP_ORDERS: dict[Scheme, float] = {"linear": 2.0, "cubic": 4.0}  # of a single warp


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


def warp_error(values: Tensor, displacement: Tensor, moved: Tensor, scheme: Scheme) -> StepError:
    """The error of a transported field, relative to the field, by Richardson's rule.

    Every second and every fourth voxel of both inputs is a sampling of the same functions. Where
    these samplings are too coarse for the field, the fitted order falls, and the estimate with it
    becomes cautious. Costs an eighth of the transport itself.

    Args:
        values: [I J K], before.
        displacement: u, [I J K 3], index units.
        moved: [I J K], what ``transport.warp`` gave by this scheme.
        scheme: of ``transport.SCHEMES``.

    Returns:
        the error of ``moved``; a box one voxel thick stays a plane.
    """
    results = [moved[_every(moved, 4)]]
    for step in (2, 4):
        place = _every(values, step)
        scale = displacement.new_tensor([part.step or 1 for part in place])
        coarse = warp(values[place], displacement[place] / scale, scheme=scheme).clamp_min(0)
        results.append(coarse if step == 4 else coarse[_every(coarse, 2)])
    return step_error(results, most=WARP_ORDERS[scheme])


def _every(values: Tensor, step: int) -> tuple[slice, slice, slice]:
    """Every ``step``-th voxel along the axes that have more than one."""
    i, j, k = (slice(None, None, step if n > 1 else 1) for n in values.shape[:3])
    return i, j, k

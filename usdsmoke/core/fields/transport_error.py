"""How accurate one transport by a displacement is, from the same on lattices 2 and 4 times as
coarse."""

from torch import Tensor

from usdsmoke.core.fields.richardson import StepError, step_error
from usdsmoke.core.fields.transport import Scheme, warp

__all__ = ["warp_error"]

ORDERS: dict[Scheme, float] = {"linear": 2.0, "maccormack": 2.0, "cubic": 4.0}  # of one warp


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
    return step_error(results, most=ORDERS[scheme])


def _every(values: Tensor, step: int) -> tuple[slice, slice, slice]:
    """Every ``step``-th voxel along the axes that have more than one."""
    i, j, k = (slice(None, None, step if n > 1 else 1) for n in values.shape[:3])
    return i, j, k

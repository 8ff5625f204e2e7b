r"""Rules for emission and absorption along a ray: the one that is used, and others beside it.

L = integral of e(s) exp(-integral of sigma before s) ds, in segments of length h with e and sigma
at their middles, t = sigma h:

============ ==================================================================================
"segments"   e h (1 - exp(-t)) / t exp(-sum before): what ``core.optics`` does [Max1995]
"middle"     e h exp(-(sum before + t / 2))
"inclusive"  e h exp(-(sum before + t)): the sum of the reference code of [Christen2020]
"exclusive"  e h exp(-sum before)
============ ==================================================================================
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

__all__ = ["RULES", "integrate"]

RULES = {
    "segments": "exponential segments (ours)",
    "middle": "sum, depth to the middle",
    "inclusive": "inclusive sum (reference code)",
    "exclusive": "exclusive sum",
}


def integrate(rule: str, emission: "Tensor", extinction: "Tensor", step: float) -> "Tensor":
    """Light that leaves the front of every ray, [R], radiance.

    Args:
        rule: one of ``RULES``.
        emission: at the middles of the segments, front to back, [S R], radiance / length.
        extinction: likewise, 1 / length, >= 0.
        step: of a segment, length.
    """
    import torch

    from usdsmoke.core.views.optics import attenuation_ratio, transmittance_before

    depth = extinction * step
    before = transmittance_before(depth)
    if rule == "segments":
        weight = attenuation_ratio(depth)
    elif rule == "middle":
        weight = torch.exp(-depth / 2)
    elif rule == "inclusive":
        weight = torch.exp(-depth)
    else:
        weight = torch.ones_like(depth)
    return (emission * before * weight).sum(0) * step

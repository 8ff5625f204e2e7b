r"""Emission and absorption along a ray, exact on every segment.

One rule serves everything: on a segment of optical depth t = gamma * d * h with constant density
and colour, the light that reaches its front is C * (1 - exp(-t)), and exp(-t) of what comes from
behind passes [Max1995]. It is second order in h and bounded for every optical depth. With r = (1 -
exp(-t)) / t a segment's share of the pixel is t * r * exp(-(sum of t before it)): voxels that share
a segment share it in proportion to their t, and an empty one divides nothing by nothing.

The paper's images are these divided by gamma [Christen2020, eqs. 8-10]: its grey integral of
d * tau is (1 - exp(-gamma * column)) / gamma, because d tau / dr = -gamma * d * tau. Multiplying by
gamma gives ordinary alpha compositing, in [0, 1] for colours in [0, 1], with no division by the
image's maximum.
"""

from typing import Any, cast

import torch
from torch import Tensor


def opacity(optical_depth: Tensor) -> Tensor:
    """1 - exp(-t), accurate to round-off for every t >= 0; any shape, dimensionless.

    Gradients: through ``optical_depth``; exp(-t), never NaN.
    """
    return -torch.expm1(-optical_depth)


class _AttenuationRatio(torch.autograd.Function):
    """(1 - exp(-t)) / t with the limit 1 at t = 0, in value and gradient."""

    @staticmethod
    def forward(ctx: Any, optical_depth: Tensor) -> Tensor:
        small = optical_depth < 1e-4
        safe = torch.where(small, torch.ones_like(optical_depth), optical_depth)
        series = 1 - optical_depth / 2 + optical_depth**2 / 6
        ratio = torch.where(small, series, -torch.expm1(-safe) / safe)
        ctx.save_for_backward(optical_depth, ratio)
        return ratio

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> Tensor:
        optical_depth, ratio = ctx.saved_tensors
        small = optical_depth < 1e-2  # the quotient below cancels there
        safe = torch.where(small, torch.ones_like(optical_depth), optical_depth)
        t = torch.where(small, optical_depth, torch.zeros_like(optical_depth))
        series = -0.5 + t / 3 - t**2 / 8 + t**3 / 30 - t**4 / 144
        slope = torch.where(small, series, (torch.exp(-safe) - ratio) / safe)
        return upstream * slope


def attenuation_ratio(optical_depth: Tensor) -> Tensor:
    """(1 - exp(-t)) / t, the mean transmittance inside a segment; in (0, 1], 1 at t = 0.

    Gradients: through ``optical_depth``, finite for every t >= 0.
    """
    return cast(Tensor, _AttenuationRatio.apply(optical_depth))


def transmittance_before(optical_depth: Tensor) -> Tensor:
    """What passes all segments in front of each one: exp(-sum_{r<s} t_r), in [0, 1].

    Args:
        optical_depth: t of the segments, [S ...], front to back along the first axis, >= 0.

    Returns:
        the same shape; 1 for the foremost segment.

    Gradients: through ``optical_depth``.
    """
    # an exclusive sum: with t_s taken off the inclusive one an infinite t_s would give NaN
    before = torch.cumsum(optical_depth[:-1], dim=0)
    return torch.exp(-torch.cat([torch.zeros_like(optical_depth[:1]), before]))

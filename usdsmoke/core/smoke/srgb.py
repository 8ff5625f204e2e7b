"""Display-encoded and scene-linear colours, their luma and luminance."""

from typing import Any, cast

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from usdsmoke.core.smoke.memory import elementwise, share_rows

REC709_WEIGHTS = (0.2126, 0.7152, 0.0722)  # of red, green and blue
CHUNK_ELEMENTS = 2**16  # numbers that are decoded at once
# Display-encoded, of what a voxel emits: 2.5 times as much light as white. Where a pixel mixes
# many voxels, a few bright ones among dark ones make strokes, and even ones fog (decision 044)
BRIGHTEST = 1.5


def encode_srgb(linear: Tensor) -> Tensor:
    """Display-encoded sRGB of scene-linear values [...], clipped below 0. [IEC 61966-2-1]

    Gradients: through ``linear``; finite everywhere.
    """
    linear = linear.clamp_min(0.0)
    curve = 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, 12.92 * linear, curve)


def decode_srgb(encoded: Tensor) -> Tensor:
    """Scene-linear values of display-encoded sRGB [...]; the inverse of ``encode_srgb``.

    Gradients: through ``encoded``, of first order.
    """
    return cast(Tensor, _Decode.apply(encoded))


class _Decode(torch.autograd.Function):
    """The curve and its slope in one pass over parts that stay in the cache."""

    @staticmethod
    def forward(ctx: Any, encoded: Tensor) -> Tensor:
        flat = encoded.reshape(-1)
        linear = torch.empty_like(flat)
        slope = torch.empty_like(flat) if ctx.needs_input_grad[0] else None

        def decode(part: slice) -> None:
            here = flat[part]
            base = here.clamp_min(0.04045).add_(0.055).div_(1.055)
            # a third of the time of base**2.4, and off by less than 1e-6 of it
            steep, curve = here > 0.04045, base.log().mul_(2.4).exp_()
            linear[part] = torch.where(steep, curve, here / 12.92)
            if slope is not None:
                slope[part] = torch.where(steep, curve.div_(base).mul_(2.4 / 1.055), 1 / 12.92)

        share_rows(decode, len(flat), CHUNK_ELEMENTS, flat.device)
        ctx.save_for_backward(slope)
        return linear.view(encoded.shape)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> Tensor:
        (slope,) = ctx.saved_tensors
        return elementwise(torch.mul, upstream, slope.view(upstream.shape))


def luma(encoded: Tensor) -> Tensor:
    """Rec.709 luma [...] of display-encoded colours [... 3]. [ITU-R BT.709-6]"""
    return encoded @ encoded.new_tensor(REC709_WEIGHTS)


def luminance(linear: Tensor) -> Tensor:
    """Luminance [...] of scene-linear colours [... 3], Rec.709, white has 1. [ITU-R BT.709-6]"""
    return linear @ linear.new_tensor(REC709_WEIGHTS)

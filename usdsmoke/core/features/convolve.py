"""Convolutions with fixed filters, whose slopes take a quarter of the time of torch's own.

Maps lie channels last: the channels of a pixel side by side. Convolutions, pooling and blurs take
half the time that way, and slopes a third.

The slope by a picture of three channels is a convolution with three channels as its result, of
which torch computes sixteen. Here it is one with the twelve channels of blocks of 2 x 2 pixels.
Slopes are multiplied in bfloat16 where the processor does so twice as fast: they are off by some
thousandths, at random, which a descent does not notice. Values are never rounded.
"""

from functools import cached_property
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

FEW = 4  # channels in, of which torch would compute sixteen


class Filters:
    """A convolution without borders: [1 C H W] to [1 D H-k+1 W-k+1].

    Args:
        weight: [D C k k].
        bias: [D]; None adds nothing.
    """

    def __init__(self, weight: Tensor, bias: Tensor | None = None) -> None:
        self._weight, self._bias = weight, bias

    def __call__(self, maps: Tensor) -> Tensor:
        """Gradients: through ``maps``, of first order."""
        return cast(Tensor, _Convolved.apply(maps, self))

    @property
    def size(self) -> int:
        """k."""
        return self._weight.shape[-1]

    def respond(self, maps: Tensor) -> Tensor:
        """The same; gradients are not followed."""
        return F.conv2d(maps, self._weight, self._bias)

    def slope(self, upstream: Tensor, height: int, width: int) -> Tensor:
        """The gradient by maps of that size, [1 C H W], of one by the result."""
        side, kernel = self._turned
        wide = _widened(upstream, -height % side, -width % side, kernel)
        found = F.conv2d(wide, kernel, stride=side, padding=self.size - 1)
        return F.pixel_shuffle(found, side)[..., :height, :width].to(upstream.dtype)

    @cached_property
    def _turned(self) -> tuple[int, Tensor]:
        """The side of a block of pixels, and the filters [C*side*side D k k] that give its slopes.

        Pixel (a, b) of a block has the filters turned by 180 degrees, a rows and b columns later.
        """
        n_out, n_in, size, _ = self._weight.shape
        side = 2 if n_in <= FEW else 1
        turned = self._weight.flip(2, 3).transpose(0, 1)
        longer = size + side - 1
        kernel = turned.new_zeros(n_in, side, side, n_out, longer, longer)
        for a in range(side):
            for b in range(side):
                kernel[:, a, b, :, a : a + size, b : b + size] = turned
        kernel = kernel.flatten(0, 2).contiguous(memory_format=torch.channels_last)
        is_single = kernel.dtype == torch.float32 and kernel.device.type == "cpu"
        is_rounded = is_single and multiplies_bfloat16()
        return side, kernel.bfloat16() if is_rounded else kernel


def padded(maps: Tensor, border: int) -> Tensor:
    """Feature maps [1 C H W] with replicated borders, channels last."""
    return replicated(maps, border).contiguous(memory_format=torch.channels_last)


def replicated(maps: Tensor, border: int) -> Tensor:
    """Feature maps [1 C H W] with replicated borders.

    Gradients: through ``maps``; summed in a fixed order, which torch's own are not on a GPU.
    """
    if maps.device.type == "cpu":
        return F.pad(maps, (border,) * 4, mode="replicate")
    return cast(Tensor, _Padded.apply(maps, border))


def unpadded(slope: Tensor, border: int) -> Tensor:
    """The slope by maps of one by ``padded`` ones, which is overwritten.

    Each pixel at the border gathers the slopes of its copies.
    """
    for maps in (slope, slope.transpose(2, 3)):
        maps[:, :, border] += maps[:, :, :border].sum(dim=2)
        maps[:, :, -border - 1] += maps[:, :, -border:].sum(dim=2)
    return slope[:, :, border:-border, border:-border]


def channels_last(maps: Tensor) -> Tensor:
    """The same maps [1 C H W]; if the channels of a pixel lie side by side, torch sees it.

    It reads that off the stride between pictures too, which views of a single one leave open.
    """
    _, n_channels, height, width = maps.shape
    rows = maps.permute(0, 2, 3, 1).flatten(0, 2)
    return rows.view(1, height, width, n_channels).permute(0, 3, 1, 2)


def empty_maps(like: Tensor, n_channels: int, height: int, width: int) -> Tensor:
    """Maps [1 C H W] without values, channels last, of the type and device of others."""
    return torch.empty(
        (1, n_channels, height, width),
        dtype=like.dtype,
        device=like.device,
        memory_format=torch.channels_last,
    )


def _widened(maps: Tensor, below: int, beside: int, like: Tensor) -> Tensor:
    """Maps with rows of 0 below and columns of 0 beside them, of another's type."""
    _, n_channels, height, width = maps.shape
    wide = empty_maps(like, n_channels, height + below, width + beside)
    wide[..., :height, :width] = maps
    wide[..., height:, :] = 0
    wide[..., width:] = 0
    return wide


class _Padded(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, maps: Tensor, border: int) -> Tensor:
        ctx.border = border
        return F.pad(maps, (border,) * 4, mode="replicate")

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        slope = upstream.clone(memory_format=torch.channels_last)
        return unpadded(slope, ctx.border), None


class _Convolved(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, maps: Tensor, filters: Filters) -> Tensor:
        ctx.filters, ctx.sides = filters, maps.shape[-2:]
        return filters.respond(maps)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        return ctx.filters.slope(upstream, *ctx.sides), None


def multiplies_bfloat16() -> bool:
    """Whether the processor has instructions for these products; without them it is slower."""
    known = getattr(torch.cpu, "_is_avx512_bf16_supported", None)
    return known is not None and bool(known())

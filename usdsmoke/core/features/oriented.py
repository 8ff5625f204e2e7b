"""The oriented half of the embedded network: local energies of a fixed bank of filters.

Four pyramid levels; at each one 24 quadrature Gabor pairs (8 orientations x 3 frequencies) on the
style's own colour axes give a local energy m = sqrt(even^2 + odd^2 + 1e-3). A level's feature map
holds what m has beyond its own neighbourhood, the whitened colour and the even responses: 51
channels.
"""

import math
from functools import cache
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

from usdsmoke.core.features.convolve import (
    Filters,
    channels_last,
    empty_maps,
    padded,
    unpadded,
)
from usdsmoke.core.features.definition import (
    BINOMIAL,
    COLOUR_FLOOR,
    ENERGY_FLOOR,
    ENVELOPE_SHARE,
    FREQUENCIES,
    N_ORIENTATIONS,
    SIZE,
    oriented_layers,
)
from usdsmoke.core.features.whitening import colour_whitening

_BINOMIAL = torch.tensor(BINOMIAL) / sum(BINOMIAL)
_REACH = len(BINOMIAL) // 2  # pixels


class OrientedFeatures:
    """Feature maps ``oriented1`` .. ``oriented4`` of pictures, finest first.

    Args:
        style: [H W 3], display-encoded; fixes the colour axes.
        seed: of the random colour axes of two filters in three.
    """

    names = oriented_layers()

    def __init__(self, style: Tensor, seed: int = 0) -> None:
        self._mean, self._matrix = colour_whitening(style, COLOUR_FLOOR)
        even, odd = _gabor_bank(torch.Generator().manual_seed(seed))
        self._bank = Filters(torch.cat([even, odd]).to(style))

    def __call__(self, picture: Tensor, requested: frozenset[str]) -> dict[str, Tensor]:
        """[1 C H/2^l W/2^l] maps of a picture [H W 3].

        Levels below the deepest requested one are not evaluated.

        Gradients: through ``picture``.
        """
        deepest = max((int(name[-1]) for name in requested), default=0)
        image = ((picture - self._mean) @ self._matrix).permute(2, 0, 1)[None]
        maps = {}
        for level in range(1, deepest + 1):
            if level > 1:
                image = _blur(image, stride=2)
            if f"oriented{level}" in requested:
                responses = self._bank(padded(image, SIZE // 2))
                maps[f"oriented{level}"] = cast(Tensor, _Level.apply(responses, image))
        return maps


class _Level(torch.autograd.Function):
    """A level's maps of its responses [1 48 H W], the even ones first, and its image [1 3 H W]."""

    @staticmethod
    def forward(ctx: Any, responses: Tensor, image: Tensor) -> Tensor:
        even, odd = responses.chunk(2, dim=1)
        energy = (even * even).addcmul_(odd, odd).add_(ENERGY_FLOOR).sqrt_()
        ctx.save_for_backward(responses, energy)
        n, n_colours = even.shape[1], image.shape[1]
        maps = empty_maps(energy, 2 * n + n_colours, *energy.shape[2:])
        torch.sub(energy, _blur(energy), out=maps[:, :n])
        maps[:, n:-n] = image
        maps[:, -n:] = even
        return maps

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, Tensor]:
        responses, energy = ctx.saved_tensors
        upstream, n = channels_last(upstream), energy.shape[1]
        excess = upstream[:, :n]
        # dm / d response = response / m
        pull = excess.sub(_blur_slope(excess)).div_(energy)
        found = torch.empty_like(responses)
        torch.mul(responses[:, :n], pull, out=found[:, :n])
        torch.mul(responses[:, n:], pull, out=found[:, n:])
        found[:, :n].add_(upstream[:, -n:])
        return found, upstream[:, n:-n]


def _gabor_bank(generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Even and odd filters [24 3 7 7]: zero mean, unit norm, each on one colour axis."""
    radius = SIZE // 2
    y, x = torch.meshgrid(
        torch.arange(-radius, radius + 1.0), torch.arange(-radius, radius + 1.0), indexing="ij"
    )
    envelope = torch.exp(-(x**2 + y**2) / (2 * (SIZE * ENVELOPE_SHARE) ** 2))
    banks: tuple[list[Tensor], list[Tensor]] = ([], [])
    number = 0
    for frequency in FREQUENCIES:
        for orientation in range(N_ORIENTATIONS):
            angle = math.pi * orientation / N_ORIENTATIONS
            phase = 2 * math.pi * frequency * (x * math.cos(angle) + y * math.sin(angle))
            for bank, wave in zip(banks, (torch.cos(phase), torch.sin(phase)), strict=True):
                plane = envelope * wave
                plane = plane - plane.mean()
                axis = torch.randn(3, generator=generator)
                if number % 3 == 0:
                    axis = torch.ones(3)
                bank.append((plane / plane.norm())[None] * (axis / axis.norm())[:, None, None])
            number += 1
    return torch.stack(banks[0]), torch.stack(banks[1])


def _blur(image: Tensor, stride: int = 1) -> Tensor:
    """5x5 binomial low-pass of [1 C H W] with replicated borders."""
    across, down = _binomial(image)
    channels, image = image.shape[1], padded(image, _REACH)
    image = F.conv2d(image, across, stride=(1, stride), groups=channels)
    return F.conv2d(image, down, stride=(stride, 1), groups=channels)


def _blur_slope(upstream: Tensor) -> Tensor:
    """The slope by an image of one by its ``_blur`` without strides, channels last."""
    across, down = _binomial(upstream)
    channels, twice = upstream.shape[1], 2 * _REACH
    wide = F.conv2d(upstream, across, padding=(0, twice), groups=channels)
    return unpadded(F.conv2d(wide, down, padding=(twice, 0), groups=channels), _REACH)


def _binomial(image: Tensor) -> tuple[Tensor, Tensor]:
    """The low-pass across and down, one filter a channel."""
    channels, kernel = image.shape[1], _binomial_on(image.device, image.dtype)
    across = kernel.view(1, 1, 1, -1).expand(channels, 1, 1, -1)
    return across, across.transpose(2, 3)


@cache
def _binomial_on(device: torch.device, dtype: torch.dtype) -> Tensor:
    return _BINOMIAL.to(device, dtype)

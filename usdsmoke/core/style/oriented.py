r"""A fixed bank of oriented filters on the style's own colour axes: no trained network is needed.

Four pyramid levels; at each one 24 quadrature Gabor pairs (8 orientations x 3 frequencies) give a
local energy m = sqrt(even^2 + odd^2 + 1e-3). A level's feature map holds what m has beyond its own
neighbourhood, the whitened colour and the even responses: 51 channels. The fourth level is not
among the default style layers.

Receptive fields, pixels across, of the even responses and of m beyond its neighbourhood, beside
those of VGG-19:

| ``oriented1`` 7, 11 | ``oriented2`` 17, 25 | ``oriented3`` 37, 53 | ``oriented4`` 77, 109 |
| relu1_1 3           | relu2_1 10           | relu3_1 24           | relu4_1 68            |
"""

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.style.definition import (
    BINOMIAL,
    COLOUR_FLOOR,
    ENERGY_FLOOR,
    ENVELOPE_SHARE,
    FREQUENCIES,
    N_LEVELS,
    N_ORIENTATIONS,
    SIZE,
)

__all__ = ["OrientedFeatures", "colour_whitening"]

_BINOMIAL = torch.tensor(BINOMIAL) / sum(BINOMIAL)


def colour_whitening(pixels: Tensor, floor: float, relative: float = 0.0) -> tuple[Tensor, Tensor]:
    """Mean [3] and ZCA matrix [3 3] of colours [... 3].

    W = U diag((e + max(floor, relative * e_max))^-1/2) U^T with the covariance's eigenvalues e and
    eigenvectors U. The floors keep directions that the style hardly has from being blown up:
    without them a two-colour style gets green and yellow tints, and a constant one divides by zero.
    """
    flat = pixels.reshape(-1, 3).double()
    mean = flat.mean(0)
    centred = flat - mean
    covariance = centred.T @ centred / max(len(flat), 1)
    values, vectors = torch.linalg.eigh(covariance)
    values = values.clamp_min(0)
    least = (relative * values[-1]).clamp_min(floor)
    matrix = vectors @ torch.diag((values + least).rsqrt()) @ vectors.T
    return mean.to(pixels.dtype), matrix.to(pixels.dtype)


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
    channels = image.shape[1]
    kernel = _BINOMIAL.to(image)
    image = F.pad(image, (2, 2, 2, 2), mode="replicate")
    across = kernel.view(1, 1, 1, 5).expand(channels, 1, 1, 5)
    down = kernel.view(1, 1, 5, 1).expand(channels, 1, 5, 1)
    image = F.conv2d(image, across, stride=(1, stride), groups=channels)
    return F.conv2d(image, down, stride=(stride, 1), groups=channels)


class OrientedFeatures:
    """Feature maps ``oriented1`` .. ``oriented4`` of pictures, finest first.

    Args:
        style: [H W 3], display-encoded; fixes the colour axes.
        seed: of the random colour axes of two filters in three.
    """

    names = tuple(f"oriented{level + 1}" for level in range(N_LEVELS))

    def __init__(self, style: Tensor, seed: int = 0) -> None:
        self._mean, self._matrix = colour_whitening(style, COLOUR_FLOOR)
        even, odd = _gabor_bank(torch.Generator().manual_seed(seed))
        self._bank = torch.cat([even, odd]).to(style)

    def __call__(self, picture: Tensor, wanted: frozenset[str]) -> dict[str, Tensor]:
        """[1 C H/2^l W/2^l] maps of a picture [H W 3].

        Levels below the deepest wanted are not evaluated.

        Gradients: through ``picture``.
        """
        deepest = max((int(name[-1]) for name in wanted), default=0)
        image = ((picture - self._mean) @ self._matrix).permute(2, 0, 1)[None]
        maps = {}
        for level in range(1, deepest + 1):
            if level > 1:
                image = _blur(image, stride=2)
            if f"oriented{level}" in wanted:
                maps[f"oriented{level}"] = self._level(image)
        return maps

    def _level(self, image: Tensor) -> Tensor:
        padded = F.pad(image, (SIZE // 2,) * 4, mode="replicate")
        even, odd = F.conv2d(padded, self._bank).chunk(2, dim=1)
        energy = torch.sqrt(even**2 + odd**2 + ENERGY_FLOOR)
        return torch.cat([energy - _blur(energy), image, even], dim=1)

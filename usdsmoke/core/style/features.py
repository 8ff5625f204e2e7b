r"""Feature maps of pictures by layer name, whatever network makes them.

A network is built for one style image, because the embedded one learns from it. It is then called
with a picture and the names of layers; deeper layers are not evaluated.

The embedded network needs no file of weights. It has two halves:

- oriented: a fixed bank of filters on the style's own colour axes. Four pyramid levels; at each one
  24 quadrature Gabor pairs (8 orientations x 3 frequencies) give a local energy
  m = sqrt(even^2 + odd^2 + 1e-3). A level's feature map holds what m has beyond its own
  neighbourhood, the whitened colour and the even responses: 51 channels.
- learned: filters learned from the style image by clustering its patches, in less than 1 s at the
  default depth. Each of four layers is a spherical k-means dictionary [Coates2012] of whitened
  patches of the layer below, followed by relu, with max-pooling between layers. A layer is learned
  when it, or a deeper one, is first used.

The fourth depth of either half is not among the default style layers. Receptive fields, pixels
across (of oriented layers: of the even responses and of m beyond its neighbourhood):

| ``oriented1`` 7, 11 | ``oriented2`` 17, 25 | ``oriented3`` 37, 53 | ``oriented4`` 77, 109 |
| ``learned1`` 5      | ``learned2`` 10      | ``learned3`` 20      | ``learned4`` 40       |
| relu1_1 3           | relu2_1 10           | relu3_1 24           | relu4_1 68            |
"""

import math
from collections.abc import Callable
from typing import Protocol

import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.base.sections import FeaturesConfig
from usdsmoke.core.style.convolve import Filters
from usdsmoke.core.style.definition import (
    BINOMIAL,
    COLOUR_FLOOR,
    COLOUR_RELATIVE,
    DEVIATION_SHARE,
    ENERGY_FLOOR,
    ENVELOPE_SHARE,
    FREQUENCIES,
    LEAST_DEVIATION,
    LEAST_POWER,
    LEAST_VARIANCE,
    N_AXES,
    N_CLUSTERINGS,
    N_FILTERS,
    N_FOR_AXES,
    N_ORIENTATIONS,
    N_PATCHES,
    PATCH_SIZES,
    SIZE,
    WHITENING_FLOOR,
    learned_layers,
    oriented_layers,
)
from usdsmoke.core.style.vgg19 import Vgg19Features

_BINOMIAL = torch.tensor(BINOMIAL) / sum(BINOMIAL)


class Network(Protocol):
    """Feature maps [1 C h w] of a picture [H W 3], display-encoded, by layer name."""

    def __call__(self, picture: Tensor, requested: frozenset[str]) -> dict[str, Tensor]: ...


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


def _padded(maps: Tensor, border: int) -> Tensor:
    """Feature maps with replicated borders; channels lie next to each other in memory.

    Convolutions, pooling and depthwise filters take half the time that way.
    """
    padded = F.pad(maps, (border,) * 4, mode="replicate")
    return padded.contiguous(memory_format=torch.channels_last)


def _blur(image: Tensor, stride: int = 1) -> Tensor:
    """5x5 binomial low-pass of [1 C H W] with replicated borders."""
    channels = image.shape[1]
    kernel = _BINOMIAL.to(image)
    image = _padded(image, 2)
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
                maps[f"oriented{level}"] = self._level(image)
        return maps

    def _level(self, image: Tensor) -> Tensor:
        even, odd = self._bank(_padded(image, SIZE // 2)).chunk(2, dim=1)
        energy = torch.sqrt(even**2 + odd**2 + ENERGY_FLOOR)
        return torch.cat([energy - _blur(energy), image, even], dim=1)


def _patches(maps: Tensor, size: int, n_patches: int, generator: torch.Generator) -> Tensor:
    """Up to ``n_patches`` random patches [N C*size*size] of feature maps [1 C H W]."""
    columns = F.unfold(_padded(maps, size // 2), size)[0].T
    if len(columns) > n_patches:
        chosen = torch.randperm(len(columns), generator=generator)[:n_patches]
        columns = columns[chosen.to(columns.device)]
    return columns


def _cluster_directions(
    points: Tensor, n: int, n_iterations: int, generator: torch.Generator
) -> Tensor:
    """[n D] unit vectors: spherical k-means of points [N D]; empty clusters are drawn anew.

    Points of (nearly) no length, such as flat patches, have no direction but round-off's.
    """
    lengths = points.norm(dim=1)
    distinct = lengths > 1e-4 * lengths.max()
    points = points[distinct] / lengths[distinct, None]
    start = torch.randint(len(points), (n,), generator=generator).to(points.device)
    centres = points[start].clone()
    for _ in range(n_iterations):
        nearest = (points @ centres.T).argmax(dim=1)
        sums = torch.zeros_like(centres).index_add_(0, nearest, points)
        empty = sums.norm(dim=1) < 1e-8
        if bool(empty.any()):
            drawn = torch.randint(len(points), (int(empty.sum()),), generator=generator)
            sums[empty] = points[drawn.to(points.device)]
        centres = sums / sums.norm(dim=1, keepdim=True).clamp_min(1e-8)
    return centres


def _principal_axes(points: Tensor, n: int) -> Tensor:
    """[n D] whitening rows of the leading principal axes, with a floor against near-empty ones."""
    points = points[:: -(-len(points) // N_FOR_AXES)]
    centred = points - points.mean(0)
    values, vectors = torch.linalg.eigh(centred.T @ centred / max(len(points), 1))
    n = min(n, len(values))
    values, vectors = values[-n:], vectors[:, -n:]
    floor = WHITENING_FLOOR * values[-1].clamp_min(1e-12)
    return ((values.clamp_min(0) + floor).rsqrt()[:, None] * vectors.T).to(points)


class LearnedFeatures:
    """Feature maps ``learned0`` (whitened colour) to ``learned4`` of pictures.

    Args:
        style: [H W 3], display-encoded; the filters are learned from it.
        seed: of the patches drawn and the clusters started from. Draws go from shallow to deep, so
            a layer's filters are the same whether or not deeper ones are learned after it.
    """

    names = learned_layers()

    def __init__(self, style: Tensor, seed: int = 0) -> None:
        self._generator = torch.Generator().manual_seed(seed)
        self._mean, self._matrix = colour_whitening(style, LEAST_VARIANCE, relative=COLOUR_RELATIVE)
        self._layers: list[Filters] = []
        self._style_maps = self._colour(style)  # of the deepest layer learned so far

    @torch.no_grad()
    def _learn_to(self, deepest: int) -> None:
        """Learn what is missing of the layers 1 to ``deepest``."""
        for number in range(len(self._layers), deepest):
            maps = self._style_maps
            size = PATCH_SIZES[number]
            if number:
                maps = F.max_pool2d(maps, 2, ceil_mode=True)
            weight = self._learn(maps, size, N_FILTERS[number], number, self._generator)
            response = self._respond(maps, Filters(weight))
            deviation = response.std(dim=(0, 2, 3), correction=0)
            # a floor, or filters that the style hardly excites explode on noise
            deviation = torch.sqrt(deviation**2 + (DEVIATION_SHARE * deviation.max()) ** 2)
            deviation = deviation.clamp_min(LEAST_DEVIATION)
            bias = -response.mean(dim=(0, 2, 3)) / deviation
            self._layers.append(Filters(weight / deviation[:, None, None, None], bias))
            self._style_maps = torch.relu(self._respond(maps, self._layers[-1]))

    @staticmethod
    def _learn(
        maps: Tensor, size: int, n_filters: int, number: int, generator: torch.Generator
    ) -> Tensor:
        channels = maps.shape[1]
        patches = _patches(maps, size, N_PATCHES[number], generator)
        if number == 0:
            patches = patches - patches.mean(dim=1, keepdim=True)
        if patches.var(dim=0, correction=0).sum() < LEAST_POWER:
            filters = patches.new_zeros(n_filters, patches.shape[1])  # there is nothing to learn
        elif number == 0:
            filters = _cluster_directions(patches, n_filters, N_CLUSTERINGS[number], generator)
            filters = filters - filters.mean(dim=1, keepdim=True)
        else:
            axes = _principal_axes(patches, N_AXES)
            whitened = (patches - patches.mean(0)) @ axes.T
            filters = _cluster_directions(whitened, n_filters, N_CLUSTERINGS[number], generator)
            filters = filters @ axes
        return filters.view(n_filters, channels, size, size)

    @staticmethod
    def _respond(maps: Tensor, filters: Filters) -> Tensor:
        return filters(_padded(maps, filters.size // 2))

    def _colour(self, picture: Tensor) -> Tensor:
        return ((picture - self._mean) @ self._matrix).permute(2, 0, 1)[None]

    def __call__(self, picture: Tensor, requested: frozenset[str]) -> dict[str, Tensor]:
        """[1 C H W] maps of a picture [H W 3], halved after each layer.

        Layers deeper than the deepest requested one are neither learned nor evaluated.

        Gradients: through ``picture``.
        """
        deepest = max((int(name[-1]) for name in requested), default=-1)
        if deepest < 0:
            return {}
        self._learn_to(deepest)
        maps = self._colour(picture)
        found = {"learned0": maps} if "learned0" in requested else {}
        for number in range(1, deepest + 1):
            if number > 1:
                maps = F.max_pool2d(maps, 2, ceil_mode=True)
            maps = torch.relu(self._respond(maps, self._layers[number - 1]))
            if f"learned{number}" in requested:
                found[f"learned{number}"] = maps
        return found


class EmbeddedFeatures:
    """The default: oriented filters, and filters learned from the style image; no weights file.

    Each half is made when one of its layers is first used. The fourth depth of either serves those
    who name it in ``features.layers``: larger structures, at the cost of learning 160 more filters.
    """

    names = OrientedFeatures.names + LearnedFeatures.names

    def __init__(self, style: Tensor, seed: int = 0) -> None:
        self._style, self._seed = style, seed
        self._parts: dict[type, Network] = {}

    def __call__(self, picture: Tensor, requested: frozenset[str]) -> dict[str, Tensor]:
        maps: dict[str, Tensor] = {}
        for part in (OrientedFeatures, LearnedFeatures):
            names = requested & frozenset(part.names)
            if names and part not in self._parts:
                self._parts[part] = part(self._style, self._seed)
            if names:
                maps.update(self._parts[part](picture, names))
        return maps


def independent_layers(network: Network, requested: frozenset[str]) -> list[frozenset[str]]:
    """The requested layers in groups that have no layer beneath them in common, longest first."""
    if not isinstance(network, EmbeddedFeatures):
        return [requested]
    colours = frozenset(LearnedFeatures.names[:1])
    learned, oriented = frozenset(LearnedFeatures.names[1:]), frozenset(OrientedFeatures.names)
    groups = (requested & names for names in (learned, oriented, colours))
    return [group for group in groups if group]


def build_network(config: FeaturesConfig, seed: int) -> Callable[[Tensor], Network]:
    """A function that gives the network for a style image [H W 3].

    Raises:
        FeatureError: the VGG-19 file is missing or wrong.
    """
    if config.network == "embedded":
        return lambda style: EmbeddedFeatures(style, seed)
    vgg19 = Vgg19Features.from_file(config.vgg19_file)
    return lambda style: vgg19.to(style)

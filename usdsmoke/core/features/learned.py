"""The learned half of the embedded network: filters learned from the style image.

They are found by clustering its patches, in less than 1 s at the default depth. Each of four layers
is a spherical k-means dictionary [Coates2012] of whitened patches of the layer below, followed by
relu, with max-pooling between layers. A layer is learned when it, or a deeper one, is first used.
"""

import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.features.convolve import Filters, padded
from usdsmoke.core.features.definition import (
    COLOUR_RELATIVE,
    DEVIATION_SHARE,
    LEAST_DEVIATION,
    LEAST_POWER,
    LEAST_VARIANCE,
    N_AXES,
    N_CLUSTERINGS,
    N_FILTERS,
    N_FOR_AXES,
    N_PATCHES,
    PATCH_SIZES,
    WHITENING_FLOOR,
    learned_layers,
)
from usdsmoke.core.features.whitening import colour_whitening
from usdsmoke.core.smoke.memory import add_at


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
        return filters(padded(maps, filters.size // 2))

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


def _patches(maps: Tensor, size: int, n_patches: int, generator: torch.Generator) -> Tensor:
    """Up to ``n_patches`` random patches [N C*size*size] of feature maps [1 C H W]."""
    n_channels, height, width = maps.shape[1:]
    around = padded(maps, size // 2)[0]
    if height * width <= n_patches:
        return F.unfold(around[None], size)[0].T
    chosen = torch.randperm(height * width, generator=generator)[:n_patches].to(maps.device)
    row, column = chosen // width, chosen % width
    patches = maps.new_empty(n_patches, n_channels, size, size)
    for down in range(size):
        for right in range(size):
            patches[:, :, down, right] = around[:, row + down, column + right].T
    return patches.flatten(1)


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
        sums = torch.zeros_like(centres)
        add_at(sums, nearest, points)
        empty = sums.norm(dim=1) < 1e-8
        if bool(empty.any()):
            drawn = torch.randint(len(points), (int(empty.sum()),), generator=generator)
            sums[empty] = points[drawn.to(points.device)]
        centres = sums / sums.norm(dim=1, keepdim=True).clamp_min(1e-8)
    return centres


def _eigen(matrix: Tensor) -> tuple[Tensor, Tensor]:
    """Eigenvalues and vectors of a symmetric matrix.

    Of few points in many dimensions most values are equal, and 32 bits may fail to tell them apart.
    """
    try:
        values, vectors = torch.linalg.eigh(matrix)
        if bool(values.isfinite().all() & vectors.isfinite().all()):
            return values, vectors
    except torch.linalg.LinAlgError:
        pass
    values, vectors = torch.linalg.eigh(matrix.double())
    return values.to(matrix), vectors.to(matrix)


def _principal_axes(points: Tensor, n: int) -> Tensor:
    """[n D] whitening rows of the leading principal axes, with a floor against near-empty ones."""
    points = points[:: -(-len(points) // N_FOR_AXES)]
    centred = points - points.mean(0)
    values, vectors = _eigen(centred.T @ centred / max(len(points), 1))
    n = min(n, len(values))
    values, vectors = values[-n:], vectors[:, -n:]
    floor = WHITENING_FLOOR * values[-1].clamp_min(1e-12)
    return ((values.clamp_min(0) + floor).rsqrt()[:, None] * vectors.T).to(points)

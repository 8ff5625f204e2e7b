r"""The loss of a picture: the distance of its features from a style, and what it keeps of itself.

The style loss of a layer compares Gram matrices G = F F^T / sum T^2 of guided features T * F
[Christen2020, eqs. 3 and 7; Gatys2017]. Deviations from the paper, each for stability or speed of
convergence:

- normalised by the guided area, so that a masked region and a whole image compare;
- channels are scaled by their rms on the style, and a constant channel is appended, so that the
  Gram matrix holds the means too and colour cannot drift;
- relative and rooted, |G - G_S| / |G_S| in the Frobenius norm, so that every layer has the same
  weight and a bad start does not explode;
- sums are accumulated in float32 at least.

Instead of Gram matrices, or in addition, the distributions of the features are compared: channel by
channel (the histogram loss [Risser2017]), or along random directions (sliced Wasserstein
[Heitz2021]). Patches of pixels are also drawn to the nearest ones of the style, see ``patches``.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.config.look_sections import LossesConfig
from usdsmoke.core.features.network import Network, independent_layers
from usdsmoke.core.smoke.memory import accumulate
from usdsmoke.core.smoke.replay import Replay, enlarged
from usdsmoke.core.smoke.srgb import luma
from usdsmoke.core.style.content import content_distance, laplacian_distance, photorealism_distance
from usdsmoke.core.style.local_contrast import AreaLevels, area_distance
from usdsmoke.core.style.patches import StylePatches, padded_shares, patch_shares
from usdsmoke.core.style.quantiles import (
    at_least_single,
    quantile_distance,
    quantile_table,
    random_directions,
    some_of,
)
from usdsmoke.core.style.sliced import sliced_distance
from usdsmoke.core.style.style_image import alpha_of, in_areas

N_DIRECTIONS = 32  # of sliced Wasserstein, for each layer of a picture
MOST_PER_CHANNEL = 4  # directions: colours alone have three channels
N_DRAWS = 16  # sets of directions, taken in turn
MOST_SAMPLES = 2**12  # of a style's features, drawn anew for each set, whose quantiles are taken
LEAST_RMS = 5e-3  # of a feature; only styles without structure have less, pictures 0.01 and more


@dataclass(frozen=True)
class Content:
    """What is known of a view's content picture: the smoke's own, before anything is changed."""

    grey: Tensor  # [H W 3], three equal channels
    maps: tuple[dict[str, Tensor], ...]  # by style image: the embedded network depends on it


class PictureLoss:
    """Weighted sum of the losses of a picture; a loss of weight 0 is not evaluated.

    The content is a grey picture. Features and edges are compared with those of the picture's
    luminance, so that they keep light and dark and leave the colours to the style.

    Args:
        targets: one for each style image.
        shares: of the style images, adding up to 1.
        losses: the other weights.
        areas: of the style, at the size of the pictures; None leaves out what areas lack.
    """

    def __init__(
        self,
        targets: Sequence["StyleTarget"],
        shares: Sequence[float],
        losses: LossesConfig,
        areas: AreaLevels | None = None,
    ) -> None:
        self._targets = tuple(zip(shares, targets, strict=True))
        self._losses, self._areas = losses, areas

    @property
    def uses_content(self) -> bool:
        """Whether any loss looks at the content picture."""
        losses = self._losses
        return losses.content > 0 or losses.laplacian > 0 or losses.photorealism > 0

    def content(self, grey: Tensor) -> Content:
        """What the losses need of a content picture [H W 3], display-encoded grey."""
        targets = self._targets if self._losses.content else ()
        return Content(grey, tuple(target.content_maps(grey) for _, target in targets))

    def __call__(
        self, picture: Tensor, guide: Tensor, content: Content | None = None, draw: int = 0
    ) -> Tensor:
        """The loss of a picture, a scalar.

        Args:
            picture: [H W 3], display-encoded.
            guide: T of the guidance mask, [H W] in [0, 1].
            content: from ``content``; None leaves out the losses that need it.
            draw: picks random directions where a loss has any, e.g. the iteration.

        Gradients: through ``picture``.
        """
        total = picture.new_zeros(())
        for share, target in self._targets:
            total = total + share * target.loss(picture, guide, draw)
        if self._areas is not None:
            lack = area_distance(picture, guide, self._areas)
            total = total + self._losses.style * self._losses.local_contrast * lack
        if self._losses.total_variation:
            total = total + self._losses.total_variation * total_variation(picture)
        return total if content is None else total + self._content_loss(picture, guide, content)

    def _content_loss(self, picture: Tensor, guide: Tensor, content: Content) -> Tensor:
        losses, total = self._losses, picture.new_zeros(())
        grey = luma(picture)[..., None].expand(-1, -1, 3)
        if losses.content:
            for (share, target), maps in zip(self._targets, content.maps, strict=True):
                total = total + share * losses.content * target.content_loss(grey, maps, guide)
        if losses.laplacian:
            total = total + losses.laplacian * laplacian_distance(grey, content.grey, guide)
        if losses.photorealism:
            distance = photorealism_distance(picture, content.grey, guide)
            total = total + losses.photorealism * distance
        return total


class StyleTarget:
    """The features of one style image at one size, and the losses measured by its network.

    Args:
        style: [H W 3], display-encoded; or [H W 4], whose alpha is 1 in the areas that count.
        network: feature maps by name.
        layers: weight of each style layer; one of weight 0 is not evaluated.
        losses: which statistic, and the weight of the histograms.
        content_layers: for ``content_loss``.
        patches: of the style, for ``losses.nearest``; None leaves them out.
        seed: of the directions of sliced Wasserstein.
    """

    def __init__(
        self,
        style: Tensor,
        network: Network,
        layers: Mapping[str, float],
        losses: LossesConfig | None = None,
        content_layers: Iterable[str] = (),
        patches: StylePatches | None = None,
        seed: int = 0,
    ) -> None:
        self._network, self._losses = network, losses or LossesConfig()
        self._weights = {name: weight for name, weight in layers.items() if weight != 0}
        self._content_layers, self._patches = frozenset(content_layers), patches
        with torch.no_grad():
            maps, areas = network(style[..., :3], frozenset(self._weights)), alpha_of(style)
            self._layers = {name: _LayerTarget(maps[name], seed, areas) for name in self._weights}
        # on a GPU, by shape and type of the pictures
        self._replays: dict[tuple[torch.Size, torch.dtype], Replay] = {}

    def loss(self, picture: Tensor, guide: Tensor | None, draw: int = 0) -> Tensor:
        """Weighted sum over the style layers, and that of patches; scalar.

        Small for the style itself; without patches, (nearly) 0.

        Args:
            picture: [H W 3], display-encoded.
            guide: [H W] in [0, 1], where the smoke is; None is 1 everywhere.
            draw: picks the directions of sliced Wasserstein and the patches, e.g. the iteration.

        Gradients: through ``picture``.
        """
        shares = picture.new_zeros(0, 0)
        if self._patches is not None:
            shares = patch_shares(torch.ones_like(picture[..., 0]) if guide is None else guide)
        if guide is None or picture.device.type == "cpu":
            return self._sum(picture, guide, draw, shares)
        number = torch.full((), draw, device=picture.device)
        picture, guide = enlarged(picture, guide)
        shares = padded_shares(shares, guide)
        key = (picture.shape, picture.dtype)
        if key not in self._replays:
            if not picture.requires_grad:  # seen once
                return self._sum(picture, guide, number, shares)
            self._replays[key] = Replay(self._sum, picture, guide, number, shares)
        return self._replays[key](picture, guide, number, shares)

    def _sum(
        self, picture: Tensor, guide: Tensor | None, draw: int | Tensor, shares: Tensor
    ) -> Tensor:
        groups = independent_layers(self._network, frozenset(self._weights))
        terms = [partial(self._loss_of, group, guide=guide, draw=draw) for group in groups]
        if self._patches is not None:
            terms.append(partial(self._patches.loss, shares=shares, draw=draw))
        return accumulate(picture, terms)

    def _loss_of(
        self, names: frozenset[str], picture: Tensor, guide: Tensor | None, draw: int | Tensor
    ) -> Tensor:
        """The part of the loss that some of the style layers have."""
        maps, losses = self._network(picture, names), self._losses
        total = picture.new_zeros(())
        for name, weight in self._weights.items():
            if name not in names:
                continue
            layer = self._layers[name]
            if losses.statistic == "sliced_wasserstein":
                distance = layer.sliced_distance(maps[name], guide, draw % N_DRAWS)
            else:
                distance = layer.gram_distance(maps[name], guide)
            if losses.histogram:
                distance = distance + losses.histogram * layer.histogram_distance(maps[name], guide)
            total = total + weight * distance
        return total

    def content_maps(self, picture: Tensor) -> dict[str, Tensor]:
        """Feature maps of a content picture [H W 3], for ``content_loss``."""
        with torch.no_grad():
            return self._network(picture, self._content_layers)

    def content_loss(
        self, picture: Tensor, content: Mapping[str, Tensor], guide: Tensor | None
    ) -> Tensor:
        """Distance of a picture's features from a content picture's ``content_maps``; scalar.

        Gradients: through ``picture``.
        """
        maps = self._network(picture, self._content_layers)
        return content_distance(maps, content, dict.fromkeys(self._content_layers, 1.0), guide)


class _LayerTarget:
    """One layer's features of the style; each statistic is made when it is first used.

    Distances take a picture's maps [1 C h w], and measure channels in units of the style's rms.
    Features of areas of the style that do not count are left out.
    """

    def __init__(self, maps: Tensor, seed: int, areas: Tensor | None = None) -> None:
        small = None if areas is None else _small(areas, maps)
        style = in_areas(at_least_single(_flat(maps)).T, small).T
        rms = style.float().square().mean(dim=1).sqrt()
        self._scale = (1 / (rms.clamp_min(LEAST_RMS) + 1e-3)).to(style)
        self._style = style * self._scale[:, None]  # [C P]
        self._seed = seed
        self._slices: dict[int, tuple[Tensor, Tensor]] = {}

    @cached_property
    def _gram(self) -> Tensor:
        ones = torch.ones_like(self._style[:1])
        return gram_matrix(torch.cat([self._style, ones])[None, :, :, None])

    @cached_property
    def _table(self) -> Tensor:
        return quantile_table(self._style)

    def gram_distance(self, maps: Tensor, guide: Tensor | None) -> Tensor:
        """|G - G_S| / |G_S|, smoothed at 0; G has a constant channel, whose products are means."""
        flat = at_least_single(_flat(maps))
        small = None if guide is None else _small(guide, flat.new_empty(1, *maps.shape[1:]))[0]
        return cast(Tensor, _GramDistance.apply(flat, small, self._scale, self._gram))

    def histogram_distance(self, maps: Tensor, guide: Tensor | None) -> Tensor:
        """Root mean square way from the picture's features to the style's, channel by channel."""
        weights = None if guide is None else _small(guide, maps).square()[0]
        scaled = at_least_single(_flat(maps)) * self._scale[:, None]
        return torch.sqrt(quantile_distance(scaled, weights, self._table) + 1e-8)

    def sliced_distance(self, maps: Tensor, guide: Tensor | None, draw: int | Tensor) -> Tensor:
        """The same along a draw of random directions."""
        if isinstance(draw, Tensor):
            axes, table = (every.index_select(0, draw[None])[0] for every in self._all_slices)
        else:
            axes, table = self._slice(draw)
        weights = None if guide is None else _small(guide, maps).square()[0]
        return torch.sqrt(sliced_distance(_flat(maps), weights, axes, table) + 1e-8)

    def _slice(self, draw: int) -> tuple[Tensor, Tensor]:
        """The directions of a draw, and the quantiles of the style along them."""
        if draw not in self._slices:
            seed = self._seed + draw
            n = min(N_DIRECTIONS, MOST_PER_CHANNEL * len(self._style))
            axes = random_directions(len(self._style), n, seed, self._style)
            table = quantile_table(axes @ _some(self._style, MOST_SAMPLES, seed))
            self._slices[draw] = axes * self._scale, table
        return self._slices[draw]

    @cached_property
    def _all_slices(self) -> tuple[Tensor, Tensor]:
        """Those of every draw, [N_DRAWS D C] and [N_DRAWS D n]."""
        axes, tables = zip(*map(self._slice, range(N_DRAWS)), strict=True)
        return torch.stack(axes), torch.stack(tables)


class _GramDistance(torch.autograd.Function):
    """|G - G_S| / |G_S| of features F [C P] under a guide T [P]; one product in each direction.

    With S the channels' scales, A = F T^2 F^T / sum T^2 and b = F T^2 1 / sum T^2 the Gram matrix
    is G = [[S A S, S b], [b^T S, 1]]: neither scaled maps nor a channel of ones are made.
    """

    @staticmethod
    def forward(
        ctx: Any, flat: Tensor, guide: Tensor | None, scale: Tensor, wanted: Tensor
    ) -> Tensor:
        guide = torch.ones_like(flat[0]) if guide is None else guide
        area, guided = guide.square().sum().clamp_min(1e-12), flat * guide
        gram = torch.empty_like(wanted)
        gram[:-1, :-1] = scale[:, None] * (guided @ guided.T) * scale / area
        gram[-1, :-1] = gram[:-1, -1] = scale * (guided @ guide) / area
        gram[-1, -1] = guide.square().sum() / area
        difference = gram - wanted
        root, size = torch.sqrt(difference.square().sum() + 1e-8), wanted.square().sum().sqrt()
        pull = difference[:-1] * (scale[:, None] * (2 / (root * size * area)))
        pull[:, :-1] *= scale
        ctx.save_for_backward(guided, guide, pull)
        return root / size

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None, None]:
        guided, guide, pull = ctx.saved_tensors
        found = torch.addmm(pull[:, -1:] * guide, pull[:, :-1], guided)
        return found.mul_(guide * upstream), None, None, None


def gram_matrix(maps: Tensor, guide: Tensor | None = None) -> Tensor:
    """Area-normalised Gram matrix [C C] of feature maps [1 C H W], float32 or wider.

    G = sum_p T_p^2 F_p F_p^T / sum_p T_p^2; symmetric, positive semidefinite, blind to pixel order.

    Args:
        maps: features.
        guide: T, [h w], any size, >= 0; averaged to the maps' size. None means 1 everywhere.

    Gradients: through ``maps``.
    """
    flat = at_least_single(_flat(maps))
    if guide is None:
        return flat @ flat.T / flat.shape[1]
    small = _small(guide, maps)
    guided = flat * small
    return guided @ guided.T / (small**2).sum().clamp_min(1e-12)


def total_variation(picture: Tensor) -> Tensor:
    """Mean absolute difference of neighbouring pixels of [H W C]; scalar.

    Gradients: through ``picture``; 0 where neighbours are equal.
    """
    across = (picture[:, 1:] - picture[:, :-1]).abs()
    down = (picture[1:] - picture[:-1]).abs()
    return (across.sum() + down.sum()) / max(across.numel() + down.numel(), 1)


def _some(features: Tensor, most: int, seed: int) -> Tensor:
    """At most so many of features [C P], drawn at random: even steps would meet the same columns of
    an image again and again."""
    if features.shape[1] <= most:
        return features
    chosen = some_of(features.shape[1], most, seed)
    # maps have channels last; by columns all of them would be copied
    return features.T.index_select(0, chosen.to(features.device)).T.contiguous()


def _flat(maps: Tensor) -> Tensor:
    """[C P] of maps [1 C h w]: a view, also of gradients, whatever lies next to what in memory."""
    return maps.flatten(2).squeeze(0)


def _small(guide: Tensor, maps: Tensor) -> Tensor:
    """The guide at the maps' size, [1 P]."""
    height, width = maps.shape[-2:]
    if guide.shape == (height, width):
        return guide.reshape(1, -1)
    return F.adaptive_avg_pool2d(guide[None, None], (height, width)).reshape(1, -1)

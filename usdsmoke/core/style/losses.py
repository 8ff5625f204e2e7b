r"""The style statistics that pictures are compared by.

The style loss of a layer compares Gram matrices G = F F^T / sum T^2 of guided features T * F
[Christen2020, eqs. 3 and 7; Gatys2017]. Deviations from the paper, each for stability or speed of
convergence:

- normalised by the guided area, so that a masked region and a whole image compare;
- channels are scaled by their rms on the style, and a constant channel is appended, so that the
  Gram matrix holds the means too and colour cannot drift;
- relative and rooted, |G - G_S| / |G_S| in the Frobenius norm, so that every layer counts alike and
  a bad start does not explode;
- sums are accumulated in float32 at least.

Instead of Gram matrices, or beside them, the distributions of the features are compared: channel by
channel (the histogram loss [Risser2017]), or along random directions (sliced Wasserstein
[Heitz2021]).
"""

from collections.abc import Callable, Hashable, Iterable, Mapping

import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.base.sections import LossesConfig
from usdsmoke.core.style.content import content_distance
from usdsmoke.core.style.features import Network
from usdsmoke.core.style.quantiles import quantile_distance, quantile_table, random_directions

__all__ = ["StyleTarget", "gram_matrix", "total_variation"]

N_DRAWS = 16  # sets of directions of sliced Wasserstein, taken in turn
LEAST_RMS = 5e-3  # of a feature; only styles without structure have less, pictures 0.01 and more


def gram_matrix(maps: Tensor, guide: Tensor | None = None) -> Tensor:
    """Area-normalised Gram matrix [C C] of feature maps [1 C H W], float32 or wider.

    G = sum_p T_p^2 F_p F_p^T / sum_p T_p^2; symmetric, positive semidefinite, blind to pixel order.

    Args:
        maps: features.
        guide: T, [h w], any size, >= 0; averaged to the maps' size. None means 1 everywhere.

    Gradients: through ``maps``.
    """
    flat = maps[0].flatten(1)
    if flat.dtype in (torch.float16, torch.bfloat16):
        flat = flat.float()
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


class StyleTarget:
    """The style statistics of one image, and the losses that its network measures.

    Args:
        style: [H W 3], display-encoded.
        network: feature maps by name.
        layers: weight of each style layer; one of weight 0 is not evaluated.
        losses: which statistic, and the weight of the histograms.
        content_layers: what ``kept`` compares by.
        seed: of the directions of sliced Wasserstein.
    """

    def __init__(
        self,
        style: Tensor,
        network: Network,
        layers: Mapping[str, float],
        losses: LossesConfig | None = None,
        content_layers: Iterable[str] = (),
        seed: int = 0,
    ) -> None:
        self._network, self._losses, self._seed = network, losses or LossesConfig(), seed
        self._layers = {name: weight for name, weight in layers.items() if weight != 0}
        self._content_layers = frozenset(content_layers)
        self._scale: dict[str, Tensor] = {}
        self._style: dict[str, Tensor] = {}  # scaled maps [C P]
        self._made: dict[Hashable, Tensor] = {}  # statistics of the style
        with torch.no_grad():
            for name, maps in network(style, frozenset(self._layers)).items():
                rms = maps.float().square().mean(dim=(0, 2, 3)).sqrt()
                self._scale[name] = (1 / (rms.clamp_min(LEAST_RMS) + 1e-3)).to(maps.dtype)
                self._style[name] = self._scaled(name, maps)[0].flatten(1)

    def content(self, picture: Tensor) -> dict[str, Tensor]:
        """Feature maps of a content picture [H W 3], for ``kept``."""
        with torch.no_grad():
            return self._network(picture, self._content_layers)

    def kept(self, picture: Tensor, content: Mapping[str, Tensor], guide: Tensor | None) -> Tensor:
        """How far a picture's features are from those that ``content`` gave; scalar.

        Gradients: through ``picture``.
        """
        maps = self._network(picture, self._content_layers)
        return content_distance(maps, content, dict.fromkeys(self._content_layers, 1.0), guide)

    def loss(self, picture: Tensor, guide: Tensor | None, draw: int = 0) -> Tensor:
        """Weighted sum over the style layers; scalar, (nearly) 0 for the style itself.

        Args:
            picture: [H W 3], display-encoded.
            guide: [H W] in [0, 1], where the smoke is.
            draw: picks the directions of sliced Wasserstein, e.g. the iteration.

        Gradients: through ``picture``.
        """
        maps = self._network(picture, frozenset(self._layers))
        total = picture.new_zeros(())
        for name, weight in self._layers.items():
            scaled = self._scaled(name, maps[name])
            distance = self._distance(name, scaled, guide, draw)
            if self._losses.histogram:
                distance = distance + self._losses.histogram * self._transport(name, scaled, guide)
            total = total + weight * distance
        return total

    def _scaled(self, name: str, maps: Tensor) -> Tensor:
        return maps * self._scale[name][None, :, None, None]

    def _distance(self, name: str, scaled: Tensor, guide: Tensor | None, draw: int) -> Tensor:
        if self._losses.statistic == "sliced_wasserstein":
            return self._transport(name, scaled, guide, draw % N_DRAWS)
        wanted = self._remembered(
            name, lambda: gram_matrix(_with_ones(self._style[name][None, :, :, None]))
        )
        difference = gram_matrix(_with_ones(scaled), guide) - wanted
        return torch.sqrt(difference.square().sum() + 1e-8) / wanted.square().sum().sqrt()

    def _transport(
        self, name: str, scaled: Tensor, guide: Tensor | None, draw: int | None = None
    ) -> Tensor:
        """Root mean square way from the picture's features to the style's, one axis at a time.

        The axes are the channels (histograms), or a draw of directions (sliced Wasserstein).
        """
        values, style = scaled[0].flatten(1), self._style[name]
        if draw is not None:
            axes = self._remembered(
                (name, draw, "axes"),
                lambda: random_directions(len(style), len(style), self._seed + draw, style),
            )
            values, style = axes @ values.to(axes), axes @ style.to(axes)
        table = self._remembered((name, draw), lambda: quantile_table(style))
        weights = None if guide is None else _small(guide, scaled).square()[0]
        return torch.sqrt(quantile_distance(values, weights, table) + 1e-8)

    def _remembered(self, key: Hashable, make: Callable[[], Tensor]) -> Tensor:
        if key not in self._made:
            with torch.no_grad():
                self._made[key] = make()
        return self._made[key]


def _with_ones(maps: Tensor) -> Tensor:
    """The maps [1 C h w] and a constant channel, whose products are the others' means."""
    return torch.cat([maps, torch.ones_like(maps[:, :1])], dim=1)


def _small(guide: Tensor, maps: Tensor) -> Tensor:
    """The guide at the maps' size, [1 P]."""
    height, width = maps.shape[-2:]
    return F.adaptive_avg_pool2d(guide[None, None], (height, width)).reshape(1, -1)

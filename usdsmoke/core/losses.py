r"""What pictures are compared by.

The style loss of a layer compares Gram matrices G = F F^T / sum T^2 of guided features T * F
[Christen2020, eqs. 3 and 7; Gatys2017]. Deviations from the paper, each for stability or speed of
convergence:

- normalised by the guided area, so that a masked region and a whole image compare;
- channels are scaled by their rms on the style, and a constant channel is appended, so that the
  Gram matrix holds the means too and colour cannot drift;
- relative and rooted, |G - G_S| / |G_S| in the Frobenius norm, so that every layer counts alike and
  a bad start does not explode;
- sums are accumulated in float32 at least.
"""

from collections.abc import Mapping

import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.features import Network

__all__ = ["StyleTarget", "gram_matrix", "total_variation"]

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
    height, width = maps.shape[-2:]
    small = F.adaptive_avg_pool2d(guide[None, None], (height, width)).reshape(1, -1)
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
    """The style statistics of one image, and the loss of a picture against them.

    Args:
        style: [H W 3], display-encoded.
        network: feature maps by name.
        layers: weight of each style layer; one of weight 0 is not evaluated.
    """

    def __init__(self, style: Tensor, network: Network, layers: Mapping[str, float]) -> None:
        self._network = network
        self._layers = {name: weight for name, weight in layers.items() if weight != 0}
        self._wanted = frozenset(self._layers)
        self._scale: dict[str, Tensor] = {}
        self._gram: dict[str, Tensor] = {}
        with torch.no_grad():
            for name, maps in network(style, self._wanted).items():
                rms = maps.float().square().mean(dim=(0, 2, 3)).sqrt()
                self._scale[name] = 1 / (rms.clamp_min(LEAST_RMS) + 1e-3)
                self._gram[name] = gram_matrix(self._prepare(name, maps))

    def _prepare(self, name: str, maps: Tensor) -> Tensor:
        scaled = maps * self._scale[name].to(maps.dtype)[None, :, None, None]
        return torch.cat([scaled, torch.ones_like(scaled[:, :1])], dim=1)

    def loss(self, picture: Tensor, guide: Tensor | None) -> Tensor:
        """Weighted sum over the style layers of |G - G_S| / |G_S|; scalar, 0 for the style itself.

        Args:
            picture: [H W 3], display-encoded.
            guide: [H W] in [0, 1], where the smoke is.

        Gradients: through ``picture``.
        """
        total = picture.new_zeros(())
        for name, maps in self._network(picture, self._wanted).items():
            difference = gram_matrix(self._prepare(name, maps), guide) - self._gram[name]
            reference = self._gram[name].square().sum().sqrt()
            distance = torch.sqrt(difference.square().sum() + 1e-8)
            total = total + self._layers[name] * distance / reference
        return total

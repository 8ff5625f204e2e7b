"""What pictures are judged by at every octave, in colour and in grey, made once and kept."""

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from usdsmoke.config import Config, style_shares
from usdsmoke.core.features import Network, build_network, content_layers, style_layers
from usdsmoke.core.losses import StyleTarget
from usdsmoke.core.picture_loss import PictureLoss
from usdsmoke.core.scene import Scene
from usdsmoke.core.style import decode_srgb, luminance, match_grey, scale_style

__all__ = ["StyleTargets"]


class StyleTargets:
    """Targets of one run; asking for one that exists costs nothing.

    Args:
        styles: display-encoded images [H W 3] in [0, 1].
        scene: sets the pictures' size and the grey level that grey styles are matched to.
        device: where the features are computed.

    Raises:
        ConfigError: see ``features.style_layers`` and ``config.style_shares``; ``at`` raises
            FeatureError, see ``features.build_network``.
    """

    def __init__(
        self, styles: Sequence[np.ndarray], scene: Scene, config: Config, device: torch.device
    ) -> None:
        shares = style_shares(config.style, len(styles))
        used = [number for number, share in enumerate(shares) if share > 0]
        self._styles = [styles[number] for number in used]
        self._shares = [shares[number] for number in used]
        self._scene = scene
        self._config = config
        self._like = torch.zeros((), device=device)
        self._layers = {
            name: config.losses.style * weight
            for name, weight in style_layers(config.features).items()
        }
        self._content_layers = content_layers(config.features)
        self._made: dict[tuple[int, bool], PictureLoss] = {}

    @cached_property
    def _network_for(self) -> Callable[[Tensor], Network]:
        """Made when first asked for: a window of empty frames does not read VGG-19's parameters."""
        return build_network(self._config.features, self._config.optimize.seed)

    @cached_property
    def background(self) -> Tensor:
        """Mean colour of the styles, linear [3]: what stands behind the smoke it is painted on."""
        means = [
            share * decode_srgb(torch.as_tensor(np.ascontiguousarray(style))).mean(dim=(0, 1))
            for share, style in zip(self._shares, self._styles, strict=True)
        ]
        return torch.stack(means).sum(0).to(self._like)

    @cached_property
    def brightness(self) -> tuple[float, float]:
        """Mean and deviation of the styles' luminance, display-encoded."""
        lights = [luminance(torch.as_tensor(np.ascontiguousarray(s))) for s in self._styles]
        mean = sum(s * float(x.mean()) for s, x in zip(self._shares, lights, strict=True))
        spread = sum(
            s * float(x.std(correction=0)) for s, x in zip(self._shares, lights, strict=True)
        )
        return mean, spread

    def at(self, factor: int, grey: bool = False) -> PictureLoss:
        """What judges pictures 1/factor of full size."""
        if (factor, grey) not in self._made:
            targets = [self._target(style, factor, grey) for style in self._styles]
            self._made[factor, grey] = PictureLoss(targets, self._shares, self._config.losses)
        return self._made[factor, grey]

    def _target(self, style: np.ndarray, factor: int, grey: bool) -> StyleTarget:
        config = self._config
        scaled = scale_style(style, self._scene.image_size / factor, config.style, self._like)
        if grey:
            scaled = match_grey(scaled, self._scene.grey_mean, self._scene.grey_deviation)
        return StyleTarget(
            scaled,
            self._network_for(scaled),
            self._layers,
            config.losses,
            self._content_layers,
            config.optimize.seed,
        )

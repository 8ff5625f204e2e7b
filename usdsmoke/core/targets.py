"""The style's statistics at every octave, in colour and in grey, made once and kept."""

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from usdsmoke.config import Config
from usdsmoke.core.features import Network, build_network, style_layers
from usdsmoke.core.losses import StyleTarget
from usdsmoke.core.scene import Scene
from usdsmoke.core.style import decode_srgb, match_grey, scale_style

__all__ = ["StyleTargets"]


class StyleTargets:
    """Targets of one run; asking for one that exists costs nothing.

    Args:
        styles: display-encoded images [H W 3] in [0, 1].
        scene: sets the pictures' size and the grey level that grey styles are matched to.
        device: where the features are computed.

    Raises:
        ConfigError: see ``features.style_layers``; ``at`` raises FeatureError, see
            ``features.build_network``.
    """

    def __init__(
        self, styles: Sequence[np.ndarray], scene: Scene, config: Config, device: torch.device
    ) -> None:
        self._styles = list(styles)
        self._scene = scene
        self._config = config
        self._like = torch.zeros((), device=device)
        self._layers = {
            name: config.losses.style * weight
            for name, weight in style_layers(config.features).items()
        }
        self._made: dict[tuple[int, bool], list[StyleTarget]] = {}

    @cached_property
    def _network_for(self) -> Callable[[Tensor], Network]:
        """Made when first asked for: a window of empty frames does not read VGG-19's parameters."""
        return build_network(self._config.features, self._config.optimize.seed)

    @cached_property
    def background(self) -> Tensor:
        """Mean colour of the styles, linear [3]: what stands behind the smoke it is painted on."""
        means = [
            decode_srgb(torch.as_tensor(np.ascontiguousarray(style))).mean(dim=(0, 1))
            for style in self._styles
        ]
        return torch.stack(means).mean(0).to(self._like)

    def at(self, factor: int, grey: bool = False) -> list[StyleTarget]:
        """One target per style image for pictures 1/factor of full size."""
        if (factor, grey) not in self._made:
            self._made[factor, grey] = [self._target(style, factor, grey) for style in self._styles]
        return self._made[factor, grey]

    def _target(self, style: np.ndarray, factor: int, grey: bool) -> StyleTarget:
        scaled = scale_style(style, self._scene.image_size / factor, self._config.style, self._like)
        if grey:
            scaled = match_grey(scaled, self._scene.grey_mean, self._scene.grey_deviation)
        return StyleTarget(scaled, self._network_for(scaled), self._layers)

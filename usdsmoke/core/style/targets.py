"""What pictures are judged by at every octave, in colour and in grey, made once and kept."""

from collections.abc import Callable, Sequence
from copy import copy
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.sections import StyleConfig
from usdsmoke.base.settings import Config, style_shares
from usdsmoke.core.smoke.srgb import decode_srgb, luminance, match_grey, scale_style
from usdsmoke.core.style.features import Network, build_network
from usdsmoke.core.style.layers import content_layers, style_layers
from usdsmoke.core.style.losses import StyleTarget
from usdsmoke.core.style.picture_loss import PictureLoss
from usdsmoke.core.views.scene import Scene

__all__ = ["StyleTargets"]


class _Styles:
    """The images of a run with what is measured on each, whatever its share; measured once."""

    def __init__(
        self, images: Sequence[np.ndarray], scene: Scene, config: Config, device: torch.device
    ) -> None:
        self.images, self.config = images, config
        self._scene = scene
        self._like = torch.zeros((), device=device)
        self._layers = {
            name: config.losses.style * weight
            for name, weight in style_layers(config.features).items()
        }
        self._content_layers = content_layers(config.features)
        self._targets: dict[tuple[int, int, bool], StyleTarget] = {}
        self._lights: dict[int, tuple[float, float]] = {}
        self._means: dict[int, Tensor] = {}

    @cached_property
    def _network_for(self) -> Callable[[Tensor], Network]:
        """Made when first asked for: a window of empty frames does not read VGG-19's parameters."""
        return build_network(self.config.features, self.config.optimize.seed)

    def mean(self, number: int) -> Tensor:
        """Linear mean colour [3] of an image, on the CPU."""
        if number not in self._means:
            self._means[number] = decode_srgb(self._pixels(number)).mean(dim=(0, 1))
        return self._means[number]

    def light(self, number: int) -> tuple[float, float]:
        """Mean and deviation of an image's luminance, display-encoded."""
        if number not in self._lights:
            light = luminance(self._pixels(number))
            self._lights[number] = float(light.mean()), float(light.std(correction=0))
        return self._lights[number]

    def target(self, number: int, factor: int, grey: bool) -> StyleTarget:
        """What judges pictures 1/factor of full size by one image."""
        key = (number, factor, grey)
        if key not in self._targets:
            self._targets[key] = self._made(self.images[number], factor, grey)
        return self._targets[key]

    def on_device(self, values: Tensor) -> Tensor:
        return values.to(self._like)

    def _pixels(self, number: int) -> Tensor:
        return torch.as_tensor(np.ascontiguousarray(self.images[number]))

    def _made(self, style: np.ndarray, factor: int, grey: bool) -> StyleTarget:
        config = self.config
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


class StyleTargets:
    """Targets of one run; asking for one that exists costs nothing.

    Args:
        styles: display-encoded images [H W 3] in [0, 1].
        scene: sets the pictures' size and the grey level that grey styles are matched to.
        device: where the features are computed.

    Raises:
        ConfigError: see ``layers.style_layers`` and ``config.style_shares``; ``at`` raises
            FeatureError, see ``features.build_network``.
    """

    def __init__(
        self, styles: Sequence[np.ndarray], scene: Scene, config: Config, device: torch.device
    ) -> None:
        self._share_out(_Styles(styles, scene, config, device), config.style)

    def _share_out(self, styles: _Styles, config: StyleConfig) -> None:
        shares = style_shares(config, len(styles.images))
        self._styles = styles
        self._shares = {number: share for number, share in enumerate(shares) if share > 0}
        self._judges: dict[tuple[int, bool], PictureLoss] = {}

    @property
    def n_styles(self) -> int:
        """Images, those without a share included."""
        return len(self._styles.images)

    def weighted(self, config: StyleConfig) -> "StyleTargets":
        """The same images in other shares; what is measured on them is shared, and measured once.

        Args:
            config: ``weights`` count; tiling and size stay the run's.

        Raises:
            ConfigError: see ``config.style_shares``.
        """
        other = copy(self)
        other.__dict__.pop("background", None)
        other.__dict__.pop("brightness", None)
        other._share_out(self._styles, config)
        return other

    @cached_property
    def background(self) -> Tensor:
        """Mean colour of the styles, linear [3]: what stands behind the smoke it is painted on."""
        means = [share * self._styles.mean(number) for number, share in self._shares.items()]
        return self._styles.on_device(torch.stack(means).sum(0))

    @cached_property
    def brightness(self) -> tuple[float, float]:
        """Mean and deviation of the styles' luminance, display-encoded."""
        lights = [(share, *self._styles.light(number)) for number, share in self._shares.items()]
        mean = sum(share * mean for share, mean, _ in lights)
        return mean, sum(share * spread for share, _, spread in lights)

    def at(self, factor: int, grey: bool = False) -> PictureLoss:
        """What judges pictures 1/factor of full size."""
        if (factor, grey) not in self._judges:
            targets = [self._styles.target(number, factor, grey) for number in self._shares]
            shares = list(self._shares.values())
            losses = self._styles.config.losses
            self._judges[factor, grey] = PictureLoss(targets, shares, losses)
        return self._judges[factor, grey]

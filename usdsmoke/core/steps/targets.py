"""What a step works on: a frame's smoke, and the loss of its pictures at every octave."""

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import numpy as np
import torch
from torch import Tensor

from usdsmoke.config.look_sections import LossesConfig, StyleConfig
from usdsmoke.config.settings import Config, style_shares
from usdsmoke.core.features.layers import content_layers, style_layers
from usdsmoke.core.features.network import build_network
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.memory import run_on
from usdsmoke.core.smoke.schedule import OCTAVE_SCALE
from usdsmoke.core.smoke.srgb import decode_srgb, luma
from usdsmoke.core.style.hues import Hues, count_hues
from usdsmoke.core.style.local_contrast import AREAS, AreaLevels, area_levels
from usdsmoke.core.style.losses import PictureLoss, StyleTarget
from usdsmoke.core.style.patches import COARSER, StylePatches
from usdsmoke.core.style.style_areas import marked_areas
from usdsmoke.core.style.style_image import adjust_tones, counted_pixels, match_grey, scale_style
from usdsmoke.core.views.lighting import Lighting
from usdsmoke.core.views.scene import Scene
from usdsmoke.core.views.visibility import EffectMask

Target = tuple[StyleTarget, AreaLevels | None]  # None: areas are not looked at
_NEAR = 0.08  # standard deviation of a brightest channel that counts as near a value
_FAR = 1e-3  # of the weight of a pixel there, which all have


class StyleFeatures:
    """A style image and what is measured on it, once, whatever its share.

    Args:
        pixels: display-encoded [H W 3] in [0, 1]; or [H W 4], whose alpha is 1 where they count.
        make_target: pixels, factor, grey -> what pictures 1/factor of full size are compared with,
            and what their areas should have.
        scaled: pixels -> those at the size of full pictures.
    """

    def __init__(
        self,
        pixels: np.ndarray,
        make_target: Callable[[np.ndarray, int, bool], Target],
        scaled: Callable[[np.ndarray], Tensor],
    ) -> None:
        self._pixels = counted_pixels(torch.as_tensor(np.ascontiguousarray(pixels)))
        self._scaled = partial(scaled, pixels)
        #: value -> see ``_sum_at``
        self.sum_at: Callable[[float], Tensor] = cache(self._sum_at)
        #: factor, grey -> see ``make_target``
        self.target: Callable[[int, bool], Target] = cache(partial(make_target, pixels))

    @cached_property
    def mean(self) -> Tensor:
        """Linear mean colour [3], on the CPU."""
        return decode_srgb(self._pixels).mean(dim=0)

    @cached_property
    def hues(self) -> Tensor:
        """See ``hues.count_hues``; on the CPU."""
        return count_hues(self._pixels)

    @cached_property
    def white(self) -> float:
        """Linear luminance that one pixel in a hundred is brighter than."""
        return decode_srgb(luma(self._pixels).flatten().quantile(0.99)).item()

    @cached_property
    def brightness(self) -> tuple[float, float]:
        """Mean and deviation of the luminance, display-encoded."""
        light = luma(self._pixels)
        return float(light.mean()), float(light.std(correction=0))

    @cached_property
    def value(self) -> float:
        """Median of the brightest channel, display-encoded."""
        return float(self._pixels.amax(-1).median())

    def _sum_at(self, value: float) -> Tensor:
        """Sum [3] of the colours of pixels, display-encoded, over the number of pixels, at the size
        of full pictures. They count by how near their brightest channel is to a value, and all
        count a little, for styles that have none there."""
        pixels = counted_pixels(self._scaled()).double().cpu()
        near = (-0.5 * ((pixels.amax(1) - value) / _NEAR).square()).exp() + _FAR
        return near @ pixels / len(near)

    @cached_property
    def colours(self) -> tuple[Tensor, float]:
        """Mean [3] and deviation (of all channels together) of the colours, display-encoded."""
        return _mean_and_deviation(self._pixels)

    @cached_property
    def shown(self) -> float:
        """The share of the colours' deviation that is left at the size of full pictures."""
        spread = self.colours[1]
        return (
            _mean_and_deviation(counted_pixels(self._scaled()))[1] / spread if spread > 0 else 1.0
        )


def _mean_and_deviation(pixels: Tensor) -> tuple[Tensor, float]:
    """See ``StyleFeatures.colours``."""
    pixels = pixels.double()
    mean = pixels.mean(0)
    return mean, math.sqrt(float((pixels - mean).square().sum(1).mean()))


@dataclass(frozen=True, eq=False)
class StyleTargets:
    """Style images with their shares; what is measured on an image is kept."""

    images: tuple[StyleFeatures, ...]
    shares: tuple[float, ...]  # of the images, adding up to 1
    losses: LossesConfig
    device: torch.device

    def weighted(self, config: StyleConfig) -> "StyleTargets":
        """The same images with other ``weights``.

        Raises:
            ConfigError: see ``config.settings.style_shares``.
        """
        return replace(self, shares=tuple(style_shares(config, len(self.images))))

    @cached_property
    def background(self) -> Tensor:
        """Mean colour of the styles, linear [3]: the background of the smoke in the pictures."""
        means = torch.stack([share * image.mean for share, image in self._used])
        return means.sum(0).to(self.device, torch.float32)

    @cached_property
    def hues(self) -> Hues:
        """The hues of the styles, in which colours are looked for."""
        return Hues(sum((share * image.hues for share, image in self._used), torch.zeros(())))

    @property
    def white(self) -> float:
        """The brightest style's ``StyleFeatures.white``."""
        return max(image.white for _, image in self._used)

    @property
    def value(self) -> float:
        """The styles' medians of the brightest channel, by their shares, display-encoded."""
        return sum(share * image.value for share, image in self._used)

    def hue_at(self, value: float) -> Tensor:
        """The styles' mean colour where their brightest channel is near a value, as bright as can
        be, display-encoded [3]."""
        mean = sum((share * image.sum_at(value) for share, image in self._used), torch.zeros(3))
        hue = mean / mean.max().clamp_min(torch.finfo(mean.dtype).tiny)
        return hue.to(self.device, torch.float32)

    @property
    def brightness(self) -> tuple[float, float]:
        """Mean and deviation of the styles' luminance, display-encoded."""
        mean = sum(share * image.brightness[0] for share, image in self._used)
        return mean, sum(share * image.brightness[1] for share, image in self._used)

    @property
    def colours(self) -> tuple[Tensor, float]:
        """Mean [3] and deviation (of all channels together) of the colours, display-encoded."""
        mean = torch.stack([share * image.colours[0] for share, image in self._used]).sum(0)
        squares = (
            share * (image.colours[1] ** 2 + float((image.colours[0] - mean).square().sum()))
            for share, image in self._used
        )
        return mean, math.sqrt(sum(squares))

    @property
    def shown(self) -> float:
        """See ``StyleFeatures.shown``; the mean over the styles."""
        return sum(share * image.shown for share, image in self._used)

    def at(self, factor: int, grey: bool = False) -> PictureLoss:
        """The loss of pictures 1/factor of full size.

        Raises:
            FeatureError: see ``features.build_network``.
        """
        made = [(share, *image.target(factor, grey)) for share, image in self._used]
        levels = [(share, areas) for share, _, areas in made if areas is not None]
        return PictureLoss(
            [target for _, target, _ in made],
            [share for share, _, _ in made],
            self.losses,
            AreaLevels.mean(levels) if levels else None,
        )

    def prepare(self, iterations: Mapping[str, Sequence[int]]) -> None:
        """Make what steps compare with at the octaves that have iterations, shared among threads.

        Args:
            iterations: by step, "shape" or "colour", per octave, coarse to fine.
        """
        wanted = [
            (OCTAVE_SCALE**before, step == "shape")
            for step, per_octave in iterations.items()
            for before, n_iterations in enumerate(reversed(per_octave))
            if n_iterations
        ]
        pairs = [
            (image, of) for of in sorted(wanted) for _, image in self._used
        ]  # large ones first
        run_on(self.device, [partial(_make, image, *of) for image, of in pairs])

    @property
    def _used(self) -> list[tuple[float, StyleFeatures]]:
        pairs = zip(self.shares, self.images, strict=True)
        return [(share, image) for share, image in pairs if share > 0]


def _make(image: StyleFeatures, factor: int, grey: bool) -> None:
    image.target(factor, grey)


@dataclass(frozen=True)
class StepProblem:
    """What one frame's shape or colour step works on."""

    smoke: ActiveSmoke
    targets: StyleTargets
    scene: Scene
    config: Config
    mask: EffectMask | None = None  # share of the effect; None: 1 everywhere
    lighting: Lighting | None = None  # of the colour step's smoke; None: it scatters no light


def make_targets(
    styles: Sequence[np.ndarray], scene: Scene, config: Config, device: torch.device
) -> StyleTargets:
    """The targets of one run.

    Args:
        styles: display-encoded images [H W 3] in [0, 1].
        scene: sets the pictures' size and the grey level that grey styles are matched to.
        config: style, features, losses and the seed.
        device: where the features are computed.

    Raises:
        ConfigError: see ``layers.style_layers`` and ``config.settings.style_shares``.
    """
    features, seed = config.features, config.optimize.seed
    layers = {name: config.losses.style * weight for name, weight in style_layers(features).items()}
    content = content_layers(features)
    like, sized = torch.zeros((), device=device), sized_style(config.style, scene)
    # made when it is first used: a window of empty frames does not read VGG-19's weights
    network_for, loading = cache(partial(build_network, features, seed)), threading.Lock()

    def scaled(pixels: np.ndarray, factor: int = 1) -> Tensor:
        return scale_style(pixels, scene.image_size / factor, sized, like)

    def make_target(pixels: np.ndarray, factor: int, grey: bool) -> Target:
        style, areas, patches = scaled(pixels, factor), None, None
        if config.losses.local_contrast and not grey:
            areas = area_levels(style, scene.image_size / AREAS / factor)
        weight = config.losses.style * config.losses.nearest * (COARSER if factor > 1 else 1.0)
        if weight and not grey:
            patches = StylePatches(style, weight, seed)
        if grey:
            style = match_grey(style, scene.grey_mean, scene.grey_deviation)
        with loading:  # weights are read once
            network = network_for()
        target = StyleTarget(
            style, network(style[..., :3]), layers, config.losses, content, patches, seed
        )
        return target, areas

    images = tuple(
        StyleFeatures(_prepared(pixels, config.style), make_target, scaled) for pixels in styles
    )
    shares = tuple(style_shares(config.style, len(images)))
    return StyleTargets(images, shares, config.losses, device)


def _prepared(pixels: np.ndarray, config: StyleConfig) -> np.ndarray:
    """An image [H W 3] in the tones that are asked for, with alpha if some of it does not count."""
    toned = adjust_tones(pixels, config)
    areas = marked_areas(pixels) if config.areas == "marked" else None
    if areas is None or areas.all():
        return toned
    return np.concatenate([toned, areas[..., None].astype(toned.dtype)], axis=2)


def sized_style(config: StyleConfig, scene: Scene) -> StyleConfig:
    """The settings with the size that the shot's scene has, if none is set."""
    return config if config.size is not None else config.replace(size=scene.style_size)

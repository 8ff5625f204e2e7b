"""Feature maps of pictures by layer name, whatever network makes them.

A network is built for one style image, because the embedded one learns from it, and is then called
with a picture and the names of the layers that are wanted; deeper layers are not evaluated.
"""

from collections.abc import Callable
from typing import Protocol

from torch import Tensor

from usdsmoke.config import FeaturesConfig
from usdsmoke.core.definition import default_layers
from usdsmoke.core.learned import LearnedFeatures
from usdsmoke.core.oriented import OrientedFeatures
from usdsmoke.core.vgg19 import Vgg19Features
from usdsmoke.errors import ConfigError

__all__ = [
    "EmbeddedFeatures",
    "Network",
    "build_network",
    "content_layers",
    "layer_names",
    "style_layers",
]


class Network(Protocol):
    """Feature maps [1 C h w] of a picture [H W 3], display-encoded, by layer name."""

    def __call__(self, picture: Tensor, wanted: frozenset[str]) -> dict[str, Tensor]: ...


class EmbeddedFeatures:
    """The default: oriented filters, and filters learned from the style image; no weights file.

    Each half is made when one of its layers is first wanted. The fourth depth of either is there to
    be named in ``features.layers``: larger structures, at the cost of learning 160 more filters.
    """

    names = OrientedFeatures.names + LearnedFeatures.names
    default_style_layers = default_layers()

    def __init__(self, style: Tensor, seed: int = 0) -> None:
        self._style, self._seed = style, seed
        self._parts: dict[type, Network] = {}

    def __call__(self, picture: Tensor, wanted: frozenset[str]) -> dict[str, Tensor]:
        maps: dict[str, Tensor] = {}
        for part in (OrientedFeatures, LearnedFeatures):
            names = wanted & frozenset(part.names)
            if names and part not in self._parts:
                self._parts[part] = part(self._style, self._seed)
            if names:
                maps.update(self._parts[part](picture, names))
        return maps


def layer_names(config: FeaturesConfig) -> tuple[str, ...]:
    """Every layer that the configured network has, each kind shallow to deep."""
    return EmbeddedFeatures.names if config.network == "embedded" else Vgg19Features.names


def style_layers(config: FeaturesConfig) -> dict[str, float]:
    """The style layers and their weights; those of weight 0 are left out.

    Raises:
        ConfigError: an unknown layer, weights that do not match the layers in number, or none
            above 0.
    """
    known = layer_names(config)
    network = EmbeddedFeatures if config.network == "embedded" else Vgg19Features
    names = config.layers or list(network.default_style_layers)
    for name in names:
        if name not in known:
            raise ConfigError(
                f"features.layers names {name!r}, which the {config.network} network has not; "
                f"it has: {', '.join(known)}"
            )
    weights = config.weights or [1.0] * len(names)
    if len(weights) != len(names):
        raise ConfigError(
            f"features.weights holds {len(weights)} numbers for {len(names)} style layers "
            f"({', '.join(names)}); give one for each or none"
        )
    used = {name: weight for name, weight in zip(names, weights, strict=True) if weight > 0}
    if not used:
        raise ConfigError(
            f"features.weights are all 0 for the style layers {', '.join(names)}; wanted at least "
            "one above 0, or losses.style=0 to leave the style out"
        )
    return used


def content_layers(config: FeaturesConfig) -> tuple[str, ...]:
    """The layers that content is compared by; the deepest style layer when none is named.

    Raises:
        ConfigError: an unknown layer; see ``style_layers`` too.
    """
    known = layer_names(config)
    for name in config.content_layers:
        if name not in known:
            raise ConfigError(
                f"features.content_layers names {name!r}, which the {config.network} network has "
                f"not; it has: {', '.join(known)}"
            )
    if config.content_layers:
        return tuple(config.content_layers)
    return (max(style_layers(config), key=known.index),)


def build_network(config: FeaturesConfig, seed: int) -> Callable[[Tensor], Network]:
    """A function that gives the network for a style image [H W 3].

    Raises:
        FeatureError: the VGG-19 file is missing or wrong.
    """
    if config.network == "embedded":
        return lambda style: EmbeddedFeatures(style, seed)
    vgg19 = Vgg19Features.from_file(config.vgg19_file)
    return lambda style: vgg19.to(style)

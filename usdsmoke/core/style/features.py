"""Feature maps of pictures by layer name, whatever network makes them.

A network is built for one style image, because the embedded one learns from it, and is then called
with a picture and the names of the layers that are wanted; deeper layers are not evaluated.
"""

from collections.abc import Callable
from typing import Protocol

from torch import Tensor

from usdsmoke.base.sections import FeaturesConfig
from usdsmoke.core.style.learned import LearnedFeatures
from usdsmoke.core.style.oriented import OrientedFeatures
from usdsmoke.core.style.vgg19 import Vgg19Features

__all__ = [
    "EmbeddedFeatures",
    "Network",
    "build_network",
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


def build_network(config: FeaturesConfig, seed: int) -> Callable[[Tensor], Network]:
    """A function that gives the network for a style image [H W 3].

    Raises:
        FeatureError: the VGG-19 file is missing or wrong.
    """
    if config.network == "embedded":
        return lambda style: EmbeddedFeatures(style, seed)
    vgg19 = Vgg19Features.from_file(config.vgg19_file)
    return lambda style: vgg19.to(style)

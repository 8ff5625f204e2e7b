r"""Feature maps of pictures by layer name, whatever network makes them.

A network is built for one style image, because the embedded one learns from it. It is then called
with a picture and the names of layers; deeper layers are not evaluated.

The embedded network needs no file of weights. It has two halves: ``oriented`` and ``learned``. The
fourth depth of either half is not among the default style layers. Receptive fields, pixels across
(of oriented layers: of the even responses and of m beyond its neighbourhood):

| ``oriented1`` 7, 11 | ``oriented2`` 17, 25 | ``oriented3`` 37, 53 | ``oriented4`` 77, 109 |
| ``learned1`` 5      | ``learned2`` 10      | ``learned3`` 20      | ``learned4`` 40       |
| relu1_1 3           | relu2_1 10           | relu3_1 24           | relu4_1 68            |
"""

from collections.abc import Callable
from typing import Protocol

from torch import Tensor

from usdsmoke.config.look_sections import FeaturesConfig
from usdsmoke.core.features.learned import LearnedFeatures
from usdsmoke.core.features.oriented import OrientedFeatures
from usdsmoke.core.features.vgg19 import Vgg19Features


class Network(Protocol):
    """Feature maps [1 C h w] of a picture [H W 3], display-encoded, by layer name."""

    def __call__(self, picture: Tensor, requested: frozenset[str]) -> dict[str, Tensor]: ...


class EmbeddedFeatures:
    """The default: oriented filters, and filters learned from the style image; no weights file.

    Each half is made when one of its layers is first used. The fourth depth of either serves those
    who name it in ``features.layers``: larger structures, at the cost of learning 160 more filters.
    """

    names = OrientedFeatures.names + LearnedFeatures.names

    def __init__(self, style: Tensor, seed: int = 0) -> None:
        self._style, self._seed = style, seed
        self._parts: dict[type, Network] = {}

    def __call__(self, picture: Tensor, requested: frozenset[str]) -> dict[str, Tensor]:
        maps: dict[str, Tensor] = {}
        for part in (OrientedFeatures, LearnedFeatures):
            names = requested & frozenset(part.names)
            if names and part not in self._parts:
                self._parts[part] = part(self._style, self._seed)
            if names:
                maps.update(self._parts[part](picture, names))
        return maps


def independent_layers(network: Network, requested: frozenset[str]) -> list[frozenset[str]]:
    """The requested layers in groups that have no layer beneath them in common, longest first."""
    if not isinstance(network, EmbeddedFeatures):
        return [requested]
    colours = frozenset(LearnedFeatures.names[:1])
    learned, oriented = frozenset(LearnedFeatures.names[1:]), frozenset(OrientedFeatures.names)
    groups = (requested & names for names in (learned, oriented, colours))
    return [group for group in groups if group]


def build_network(config: FeaturesConfig, seed: int) -> Callable[[Tensor], Network]:
    """A function that gives the network for a style image [H W 3].

    Raises:
        FeatureError: the VGG-19 file is missing or wrong.
    """
    if config.network == "embedded":
        return lambda style: EmbeddedFeatures(style, seed)
    vgg19 = Vgg19Features.from_file(config.vgg19_file)
    return lambda style: vgg19.to(style)

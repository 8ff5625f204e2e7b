"""Which features a run compares pictures by, and their hash; torch is not needed to tell."""

from collections.abc import Iterable

from usdsmoke.base.record_format import hash_file
from usdsmoke.base.sections import FeaturesConfig
from usdsmoke.core.style.definition import embedded_hash
from usdsmoke.core.style.layers import content_layers, find_vgg19_file, style_layers

__all__ = ["check_features", "features_hash", "features_hashes"]


def check_features(config: FeaturesConfig, here: bool = True) -> None:
    """Refuse layers that the network has not, and a network whose parameters are not here.

    Args:
        config: which network and layers.
        here: whether the parameter file must be at hand; not if other machines do the work.

    Raises:
        ConfigError: see ``core.layers.style_layers`` and ``content_layers``.
        FeatureError: the parameter file is missing.
    """
    style_layers(config)
    content_layers(config)
    if here and config.network == "vgg19":
        find_vgg19_file(config.vgg19_file)


def features_hash(config: FeaturesConfig) -> str:
    """SHA-256 of the network's parameter file, or of the embedded features' fixed numbers.

    Raises:
        FeatureError: the parameter file is missing.
        FileUnreadable: it cannot be read.
    """
    if config.network == "embedded":
        return embedded_hash()
    return hash_file(find_vgg19_file(config.vgg19_file))


def features_hashes(configs: Iterable[FeaturesConfig]) -> str:
    """What all Volumes of a run are compared by: one hash, or several where networks differ.

    Raises:
        FeatureError, FileUnreadable: see ``features_hash``.
    """
    different = {(config.network, config.vgg19_file): config for config in configs}
    return " ".join(dict.fromkeys(features_hash(config) for config in different.values()))

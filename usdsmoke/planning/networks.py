"""The networks of a run, without torch: the one whose features pictures are compared by, with its
hash, and the one that frames start from."""

from collections.abc import Iterable
from pathlib import Path

from usdsmoke.base.record_format import hash_file
from usdsmoke.config.look_sections import FeaturesConfig
from usdsmoke.config.settings import Config
from usdsmoke.core.features.definition import embedded_hash
from usdsmoke.core.features.layers import content_layers, find_vgg19_file, style_layers


def check_features(config: FeaturesConfig, here: bool = True) -> None:
    """Refuse unknown layers, and a network whose parameter file is missing.

    Args:
        here: True if the parameter file must exist; False if other machines do the work.

    Raises:
        ConfigError: see ``style_layers`` and ``content_layers`` of ``core.features.layers``.
        FeatureError: the parameter file is missing.
    """
    style_layers(config)
    content_layers(config)
    if here and config.network == "vgg19":
        find_vgg19_file(config.vgg19_file)


def start_needed(config: Config) -> list[str]:
    """The network that frames start from, as what a run needs."""
    if not config.optimize.paints:
        return []
    if config.optimize.trains:
        return [
            "a network trained on the shot, whose colours frames without a neighbour start from"
        ]
    name = Path(config.optimize.start).name
    return [f"the network {name}, whose colours frames without a neighbour start from"]


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
    """The hash of the features of all Volumes; several hashes if their networks differ.

    Raises:
        FeatureError, FileUnreadable: see ``features_hash``.
    """
    different = {(config.network, config.vgg19_file): config for config in configs}
    return " ".join(dict.fromkeys(features_hash(config) for config in different.values()))

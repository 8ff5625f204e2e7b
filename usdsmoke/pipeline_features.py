"""Which features a run compares pictures by, as a hash; torch is not needed to tell."""

from collections.abc import Iterable

from usdsmoke.core.definition import embedded_hash
from usdsmoke.core.vgg19_file import find_vgg19_file
from usdsmoke.provenance import hash_file
from usdsmoke.sections import FeaturesConfig

__all__ = ["features_hash", "features_hashes"]


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

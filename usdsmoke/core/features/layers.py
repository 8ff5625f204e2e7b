"""What a network offers, without loading torch: its layers, and the file of its weights."""

import os
from pathlib import Path

from usdsmoke.base.errors import ConfigError, FeatureError, count_text
from usdsmoke.config.look_sections import FeaturesConfig
from usdsmoke.core.features.definition import default_layers, learned_layers, oriented_layers

VGG19_BLOCKS = ((64, 2), (128, 2), (256, 4), (512, 4), (512, 4))  # channels, convolutions
VGG19_FILE_NAME = "vgg19-dcbb9e9d.pth"  # as torchvision names it
VGG19_STYLE = ("relu2_1", "relu3_1")  # [Christen2020, section 4]


def vgg19_layers() -> tuple[str, ...]:
    """Names of VGG-19's rectified convolutions, shallow to deep: relu1_1 to relu5_4."""
    return tuple(
        f"relu{block}_{number}"
        for block, (_, count) in enumerate(VGG19_BLOCKS, start=1)
        for number in range(1, count + 1)
    )


def layer_names(config: FeaturesConfig) -> tuple[str, ...]:
    """Every layer that the configured network has, each kind shallow to deep."""
    return vgg19_layers() if config.network == "vgg19" else oriented_layers() + learned_layers()


def style_layers(config: FeaturesConfig) -> dict[str, float]:
    """The style layers and their weights; those of weight 0 are left out.

    Raises:
        ConfigError: an unknown layer, weights that do not match the layers in number, or none
            above 0.
    """
    known = layer_names(config)
    default = VGG19_STYLE if config.network == "vgg19" else default_layers()
    names = config.layers or list(default)
    for name in names:
        if name not in known:
            raise ConfigError(
                f"features.layers names {name!r}, which the {config.network} network does not "
                f"have. Choose from: {', '.join(known)}."
            )
    weights = config.weights or [1.0] * len(names)
    if len(weights) != len(names):
        raise ConfigError(
            f"features.weights has {count_text(len(weights), 'number')} for "
            f"{count_text(len(names), 'style layer')} "
            f"({', '.join(names)}). Give one for each, or none."
        )
    used = {name: weight for name, weight in zip(names, weights, strict=True) if weight > 0}
    if not used:
        raise ConfigError(
            f"features.weights are all 0 for the style layers {', '.join(names)}. Set at least "
            "one above 0, or losses.style=0 to leave the style out."
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
                f"features.content_layers names {name!r}, which the {config.network} network "
                f"does not have. Choose from: {', '.join(known)}."
            )
    if config.content_layers:
        return tuple(config.content_layers)
    return (max(style_layers(config), key=known.index),)


def named_vgg19_file(configured: str = "") -> str:
    """The file that was asked for, by setting or by ``USDSMOKE_VGG19``; "" if none was."""
    return configured or os.environ.get("USDSMOKE_VGG19", "")


def find_vgg19_file(configured: str = "") -> Path:
    """The weights file: as configured, from ``USDSMOKE_VGG19``, or in torch's hub cache.

    Raises:
        FeatureError: there is none; the message lists where it was looked for.
    """
    cache = Path(os.environ.get("TORCH_HOME", Path.home() / ".cache" / "torch"))
    named = named_vgg19_file(configured)
    places = [Path(named)] if named else [cache / "hub" / "checkpoints" / VGG19_FILE_NAME]
    for place in places:
        if place.is_file():
            return place
    raise FeatureError(
        f"no VGG-19 weights at {places[0]}. Give torchvision's {VGG19_FILE_NAME} or a safetensors "
        "file as features.vgg19_file or in USDSMOKE_VGG19, or set features.network=embedded."
    )

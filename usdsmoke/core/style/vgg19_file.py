"""Where the parameters of VGG-19 are; nothing is downloaded, and torch is not needed to look."""

import os
from pathlib import Path

from usdsmoke.base.errors import FeatureError

__all__ = ["FILE_NAME", "find_vgg19_file", "named_vgg19_file"]

FILE_NAME = "vgg19-dcbb9e9d.pth"


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
    places = [Path(named)] if named else [cache / "hub" / "checkpoints" / FILE_NAME]
    for place in places:
        if place.is_file():
            return place
    raise FeatureError(
        f"no VGG-19 weights at {places[0]}; give torchvision's {FILE_NAME} or a safetensors file "
        "as features.vgg19_file or in USDSMOKE_VGG19, or use features.network=embedded"
    )

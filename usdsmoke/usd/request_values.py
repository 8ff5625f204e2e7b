"""The attributes of UsdSmokeStyleAPI, and composed values of properties as plain ones.

The setting of each attribute is declared with the setting, in ``config``.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

from pxr import Ar, Sdf, Tf, Usd

from usdsmoke.config.setting_model import extra_of
from usdsmoke.config.settings import declared_settings
from usdsmoke.usd.values import authored_path, value_at

REQUEST_PREFIX = "usdSmoke:request:"

STYLE_IMAGES = f"{REQUEST_PREFIX}styleImages"  # asset[]; not a setting, but what --style gives
CAMERA = f"{REQUEST_PREFIX}camera"  # relationship
MASK = f"{REQUEST_PREFIX}mask"  # relationship


@dataclass(frozen=True)
class RequestAttribute:
    """An attribute of UsdSmokeStyleAPI that stands for a setting."""

    name: str  # with the prefix
    setting: str  # the setting's dotted name
    control: str = ""  # field of FrameControls; "" for what may not change over time


REQUEST_ATTRIBUTES = tuple(
    RequestAttribute(f"{REQUEST_PREFIX}{extra['request']}", name, extra.get("control", ""))
    for name, field in declared_settings().items()
    if "request" in (extra := extra_of(field))
)


def values_at(
    attribute: Usd.Attribute, time_codes: Sequence[float], plain: Callable[[Any], Any]
) -> list[Any]:
    """An attribute's value at each timeCode, interpolated as USD does, made plain by ``plain``."""
    if not attribute.ValueMightBeTimeVarying():
        return [plain(value_at(attribute, time_codes[0]))] * len(time_codes)
    return [plain(value_at(attribute, code)) for code in time_codes]


def plain_value(value: Any) -> Any:
    """Arrays as lists; a text, a number or None as it is; a value of no known type as text."""
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    return list(value) if hasattr(value, "__iter__") else str(value)


def image_paths(value: Any) -> list[tuple[str, str]] | None:
    """Resolved and authored path of each image; a single asset is a list of one."""
    if value is None:
        return None
    assets = [value] if isinstance(value, Sdf.AssetPath) else plain_value(value)
    if not all(isinstance(asset, Sdf.AssetPath) for asset in assets):
        return [("", str(value))]
    return [(str(asset.resolvedPath), authored_path(asset)) for asset in assets]


def image_problem(authored: str, resolved: str) -> str:
    """Why an image cannot be read, and what to do; "" if it can be read."""
    if not authored:
        return "it is empty. Author the path of an image."
    if Ar.IsPackageRelativePath(resolved):
        return "that is inside a package, and images are read from plain files only. Unpack it."
    if not os.path.isfile(resolved):
        return "no file is found there. Check the path, and whether the image was copied too."
    return ""


def forwarded_targets(relationship: Usd.Relationship) -> list[Sdf.Path] | None:
    """Forwarded targets; None where a layer has an attribute of that name."""
    try:
        return list(relationship.GetForwardedTargets())
    except Tf.ErrorException:
        return None


def authoring_layer(item: Usd.Property) -> str:
    """The file, or else the identifier, of the layer that holds the strongest opinion."""
    keys = ("timeSamples", "default", "spline", "targetPaths")
    for spec in item.GetPropertyStack():
        if any(spec.HasInfo(key) for key in keys):
            layer = spec.layer
            return layer.identifier if layer.anonymous else str(PurePath(layer.realPath))
    return "no layer"

"""What each Volume would be stylized with, and whose word that is."""

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pxr import Usd

from usdsmoke.base.config import Config, config_to_dict, explicit_names, merge_settings, read_config
from usdsmoke.base.given_settings import Settings, Styles, resolve_settings, style_paths
from usdsmoke.base.request_attributes import REQUEST_ATTRIBUTES
from usdsmoke.base.volume import StageSource, VolumeSource
from usdsmoke.usd.volume_requests import has_request, request_origins
from usdsmoke.usd.volume_settings import ResolvedVolumes, VolumeSettings, resolve_volumes

__all__ = ["GivenSettings", "describe_requests"]

_SETTINGS = ("stage.mask", "views.camera", *(row.setting for row in REQUEST_ATTRIBUTES))


@dataclass(frozen=True)
class GivenSettings:
    """What a run would be called with."""

    config: Config  # resolved, explicit settings among them
    configured: frozenset[str] = frozenset()  # dotted names that the configuration sets
    explicit: frozenset[str] = frozenset()  # dotted names that are stronger than a prim's
    styles: Sequence[Path] = ()  # absolute; none: Volumes bring theirs

    @classmethod
    def of(
        cls, style: Styles, config: Settings, settings: Mapping[str, Any] | Sequence[str]
    ) -> "GivenSettings":
        """From the arguments of ``stylize``."""
        resolved, explicit = resolve_settings(config, settings)
        configured = explicit_names(_configured(config))
        styles = [Path(image).absolute() for image in style_paths(style)]
        return cls(resolved, configured, explicit, styles)


def _configured(config: Settings) -> dict[str, dict[str, Any]]:
    """The settings that a configuration names; of one that is ready made, those it changes."""
    if config is None or isinstance(config, Mapping):
        return merge_settings(config or {})
    if not isinstance(config, Config):
        return merge_settings(read_config(Path(config)))
    defaults = config_to_dict(Config())
    return {
        section: {key: value for key, value in keys.items() if value != defaults[section][key]}
        for section, keys in config_to_dict(config).items()
    }


def describe_requests(
    stage: Usd.Stage, source: StageSource, given: GivenSettings
) -> list[dict[str, Any]]:
    """For each Volume, as plain values, every setting that a prim may ask for.

    Args:
        stage: gives the layers of opinions.
        source: from ``find_volumes``.
        given: the other words.

    Returns:
        ``applied`` (whether UsdSmokeStyleAPI is), ``styles`` and ``settings`` by dotted name. Each
        of the latter two has ``value`` and ``origin``, which is default, config, prim or option; of
        a prim's ``attribute`` and ``layer``, and ``samples`` (timeCode and value) where it changes.

    Raises:
        ConfigError: a Volume's settings contradict each other.
    """
    styles = [Path(style) for style in given.styles]
    resolved = resolve_volumes(source, given.config, styles, given.explicit, bare=True)
    return [
        _describe(stage.GetPrimAtPath(volume.prim_path), volume, own, resolved, given)
        for volume, own in zip(resolved.source.volumes, resolved.volumes, strict=True)
    ]


def _describe(
    prim: Usd.Prim,
    volume: VolumeSource,
    own: VolumeSettings,
    resolved: ResolvedVolumes,
    given: GivenSettings,
) -> dict[str, Any]:
    origins = request_origins(prim)
    values = config_to_dict(own.config)
    settings = {}
    for name in _SETTINGS:
        section, _, key = name.partition(".")
        asked = key in volume.request.settings.get(section, {})
        settings[name] = {
            "value": values[section][key],
            **_origin(name, asked, origins, given, bool(volume.request.styles)),
            **_samples(name, volume),
        }
    images = [str(resolved.style_files[place]) for place in own.styles]
    by_prim = {"origin": "prim", **origins.get("style", {})}
    origin = {"origin": "option"} if given.styles else by_prim if images else {"origin": "default"}
    return {
        "applied": has_request(prim),
        "styles": {"value": images, **origin},
        "settings": settings,
    }


def _origin(
    name: str,
    asked: bool,
    origins: Mapping[str, Mapping[str, str]],
    given: GivenSettings,
    own_images: bool,
) -> dict[str, str]:
    if asked:
        return {"origin": "prim", **origins.get(name, {})}
    if name in given.explicit:
        return {"origin": "option"}
    configured: Collection[str] = given.configured
    if own_images:  # they do not take the configuration's weights
        configured = given.configured - {"style.weights"}
    return {"origin": "config" if name in configured else "default"}


def _samples(name: str, volume: VolumeSource) -> dict[str, Any]:
    """Values by timeCode of what changes over time."""
    control = next((row.control for row in REQUEST_ATTRIBUTES if row.setting == name), "")
    if not control:
        return {}
    pairs = [
        [frame.time_code, dataclasses.asdict(frame.controls)[control]] for frame in volume.frames
    ]
    return {"samples": pairs} if any(value is not None for _, value in pairs) else {}

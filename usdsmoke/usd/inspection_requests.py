"""What each Volume would be stylized with, and where each setting comes from."""

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pxr import Usd

from usdsmoke.base.resolve import (
    Settings,
    Styles,
    read_settings,
    resolve_settings,
    style_paths,
)
from usdsmoke.base.settings import Config
from usdsmoke.base.volume import StageSource, VolumeSource
from usdsmoke.usd.request_values import REQUEST_ATTRIBUTES
from usdsmoke.usd.volume_requests import has_request, request_origins
from usdsmoke.usd.volume_settings import ResolvedVolumes, VolumeSettings, resolve_volumes

_SETTINGS = ("stage.mask", "views.camera", *(row.setting for row in REQUEST_ATTRIBUTES))


@dataclass(frozen=True)
class RunArguments:
    """What a run would be called with."""

    config: Config  # of the run, explicit settings among them
    styles: Sequence[Path] = ()  # absolute; none: Volumes bring theirs
    named: frozenset[str] = frozenset()  # dotted names of all settings that are given

    @classmethod
    def of(cls, style: Styles, settings: Settings) -> "RunArguments":
        """From the arguments of ``stylize``."""
        styles = [Path(image).absolute() for image in style_paths(style)]
        return cls(resolve_settings(settings), styles, frozenset(read_settings(settings)))


def describe_requests(
    stage: Usd.Stage, source: StageSource, given: RunArguments
) -> list[dict[str, Any]]:
    """For each Volume, as plain values, every setting that a prim may request.

    Args:
        stage: gives the layers of opinions.
        source: from ``find_volumes``.
        given: what the run would be called with.

    Returns:
        ``applied`` (whether UsdSmokeStyleAPI is), ``styles`` and ``settings`` by dotted name. Each
        of the latter two has ``value`` and ``origin``, which is default, config, prim or option; of
        a prim's ``attribute`` and ``layer``, and ``samples`` (timeCode and value) where it changes.

    Raises:
        ConfigError: a Volume's settings contradict each other.
    """
    resolved = resolve_volumes(source, given.config, given.styles, bare=True)
    return [
        _describe(stage.GetPrimAtPath(volume.prim_path), volume, own, resolved, given)
        for volume, own in zip(resolved.source.volumes, resolved.volumes, strict=True)
    ]


def _describe(
    prim: Usd.Prim,
    volume: VolumeSource,
    own: VolumeSettings,
    resolved: ResolvedVolumes,
    given: RunArguments,
) -> dict[str, Any]:
    origins = request_origins(prim)
    values = own.config.model_dump()
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
    given: RunArguments,
    own_images: bool,
) -> dict[str, str]:
    if asked:
        return {"origin": "prim", **origins.get(name, {})}
    if name in given.config.explicit:
        return {"origin": "option"}
    configured: Collection[str] = given.named
    if own_images:  # they do not take the weights of a file
        configured = given.named - {"style.weights"}
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

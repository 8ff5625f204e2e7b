"""The settings and style images of each Volume, and where each comes from.

In order of precedence, a setting is the one given explicitly for this run (the command line's
options, ``settings=``), the one that the Volume's prim requests, that of the configuration, or the
default.
"""

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pxr import Usd

from usdsmoke.base.errors import ConfigError, ImageError
from usdsmoke.base.time_codes import format_time_code
from usdsmoke.base.volume import FrameControls, StageSource, StyleRequest, VolumeSource
from usdsmoke.config.resolve import (
    Settings,
    Styles,
    read_settings,
    resolve_settings,
    style_paths,
)
from usdsmoke.config.settings import Config, style_shares
from usdsmoke.usd.request_values import REQUEST_ATTRIBUTES, STYLE_IMAGES
from usdsmoke.usd.schema import STYLE_API
from usdsmoke.usd.volume_requests import has_request, request_origins


@dataclass(frozen=True)
class VolumeSettings:
    """The settings and style images of one Volume."""

    config: Config
    styles: tuple[int, ...]  # indices of its images among the run's


@dataclass(frozen=True)
class ResolvedVolumes:
    """All Volumes with their settings, and every style image that any of them takes, each once."""

    source: StageSource  # with the requests and controls that are in effect
    volumes: tuple[VolumeSettings, ...]  # in the order of the source's
    style_files: tuple[Path, ...]  # absolute


def resolve_volumes(
    source: StageSource,
    config: Config,
    styles: Sequence[Path] = (),
    bare: bool = False,
) -> ResolvedVolumes:
    """The settings of every Volume; explicit settings override its own request.

    Images belong to their weights: a Volume that uses the run's images ignores its own weights, and
    one with its own images ignores the configuration's weights.

    Args:
        styles: absolute paths of the images that were given for the run; they are stronger than a
            Volume's own.
        bare: whether Volumes may be without images.

    Raises:
        ImageError: there are Volumes without images; the message names them.
        ConfigError: a Volume's settings contradict each other.
    """
    if not bare:
        _refuse_without_images(source, styles)
    given = config.explicit | ({"style.weights"} if styles else set())
    volumes = [_effective(volume, given, bool(styles)) for volume in source.volumes]
    files: dict[Path, int] = {}
    resolved = []
    for volume in volumes:
        images = [*styles] or [Path(name) for name in volume.request.styles]
        own = _own_settings(volume.request, "style.weights" in given)
        places = tuple(files.setdefault(image, len(files)) for image in images)
        resolved.append(VolumeSettings(_resolve(volume, config, own, len(images)), places))
    source = dataclasses.replace(source, volumes=tuple(volumes))
    return ResolvedVolumes(source, tuple(resolved), tuple(files))


def _refuse_without_images(source: StageSource, styles: Sequence[Path]) -> None:
    bare = [f"<{volume.prim_path}>" for volume in source.volumes if not volume.request.styles]
    unread = [f"<{one.prim_path}>" for one in source.volumes if STYLE_IMAGES in one.request.ignored]
    if unread and not styles:
        raise ImageError(
            f"{', '.join(unread)} has {STYLE_IMAGES}, which is ignored, because {STYLE_API} is not "
            "applied to the prim. Apply it, or give --style."
        )
    if bare and not styles:
        raise ImageError(
            f"no style image was given for {', '.join(bare)}. Give --style, or author "
            f"{STYLE_IMAGES} on the prim."
        )


def _effective(volume: VolumeSource, given: Collection[str], has_styles: bool) -> VolumeSource:
    """The Volume with those of its requests and controls that are not overridden."""
    settings = {
        section: kept
        for section, values in volume.request.settings.items()
        if (kept := {k: v for k, v in values.items() if f"{section}.{k}" not in given})
    }
    styles = () if has_styles else volume.request.styles
    request = StyleRequest(styles, settings, volume.request.ignored)
    silent = {row.control for row in REQUEST_ATTRIBUTES if row.control and row.setting in given}
    frames = tuple(
        dataclasses.replace(frame, controls=_without(frame.controls, silent))
        for frame in volume.frames
    )
    return dataclasses.replace(volume, request=request, frames=frames)


def _without(controls: FrameControls, silent: Collection[str]) -> FrameControls:
    return FrameControls(
        **{
            name: None if name in silent else value
            for name, value in dataclasses.asdict(controls).items()
        }
    )


def _own_settings(request: StyleRequest, given_weights: bool) -> Mapping[str, Mapping[str, Any]]:
    if not request.styles or given_weights:
        return request.settings
    style = {"weights": [], **request.settings.get("style", {})}
    return {**request.settings, "style": style}


def _resolve(
    volume: VolumeSource, config: Config, own: Mapping[str, Mapping[str, Any]], n_styles: int
) -> Config:
    try:
        resolved = config.with_values(own)
        if n_styles:
            style_shares(resolved.style, n_styles)
        for frame in volume.frames if n_styles else ():
            if (weights := frame.controls.style_weights) is not None:
                style = resolved.style.replace(weights=list(weights))
                _check_shares(style, n_styles, frame.time_code)
    except ConfigError as error:
        if not (volume.request.settings or volume.request.styles):
            raise
        raise ConfigError(f"Volume <{volume.prim_path}>: {error}") from None
    return resolved


def _check_shares(style: Any, n_styles: int, time_code: float) -> None:
    try:
        style_shares(style, n_styles)
    except ConfigError as error:
        raise ConfigError(f"at timeCode {format_time_code(time_code)}: {error}") from None


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

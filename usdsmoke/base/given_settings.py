"""What a run is called with: files in any spelling, settings from files, mappings and texts."""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

from usdsmoke.base.asset_paths import relative_asset_path
from usdsmoke.base.config import (
    Config,
    config_to_dict,
    explicit_names,
    merge_settings,
    read_config,
    resolve_config,
)

__all__ = [
    "FilePath",
    "RunSettings",
    "Settings",
    "Styles",
    "explicit_values",
    "portable_settings",
    "read_settings",
    "resolve_settings",
    "settle_files",
    "style_paths",
]

FilePath = str | PathLike[str]
Styles = FilePath | Sequence[FilePath] | None
Settings = Config | Mapping[str, Any] | FilePath | None
RunSettings = Settings | Sequence[Any]  # of these


def style_paths(style: Styles) -> list[FilePath]:
    """The image files of a call; none where Volumes bring their own."""
    if style is None:
        return []
    return [style] if isinstance(style, (str, PathLike)) else list(style)


def read_settings(settings: RunSettings) -> tuple[Config, frozenset[str]]:
    """The run's settings, and the dotted names of those that are stronger than a Volume's own.

    >>> config, explicit = read_settings([Config(), {"windows.size": 3}, "optimize.seed=7"])
    >>> config.windows.size, sorted(explicit)
    (3, ['optimize.seed', 'windows.size'])

    Args:
        settings: a YAML file or a ready-made Config, which a Volume's own settings override; a
            mapping (nested or with dotted names) or texts such as ``windows.size=3``, which
            override a Volume's own; or a sequence of these, the strongest last.

    Raises:
        ConfigError: see ``resolve_config``.
    """
    merged: dict[str, dict[str, Any]] = {}
    explicit: frozenset[str] = frozenset()
    for source in _sources(settings):
        is_explicit = isinstance(source, Mapping) or (isinstance(source, str) and "=" in source)
        part = _read_source(source)
        merged = merge_settings(merged, part)
        names = explicit_names(part)
        explicit = explicit | names if is_explicit else explicit - names
    return resolve_config(merged), explicit


def _sources(settings: Any) -> Iterator[Any]:
    """Settings one source after the other; sequences may hold sequences."""
    if isinstance(settings, (Config, Mapping, str, PathLike)):
        yield settings
    else:
        for part in settings or ():
            yield from _sources(part)


def _read_source(source: Any) -> dict[str, dict[str, Any]]:
    """One source of settings by section and key."""
    if isinstance(source, Config):
        return config_to_dict(source)
    if isinstance(source, str) and "=" in source:
        return merge_settings(assignments=[source])
    if not isinstance(source, Mapping):
        return merge_settings(read_config(Path(source)))
    nested = {name: value for name, value in source.items() if "." not in name}
    dotted = [(*name.partition("."), value) for name, value in source.items() if "." in name]
    return merge_settings(nested, *({section: {key: value}} for section, _, key, value in dotted))


def resolve_settings(
    config: Settings, settings: Mapping[str, Any] | Sequence[str]
) -> tuple[Config, frozenset[str]]:
    """The run's settings, and the dotted names of those that are stronger than a Volume's own.

    Args:
        config: a YAML file, a mapping of sections, or ready made; a Volume's own are stronger.
        settings: explicit ones, stronger than a Volume's own.

    Raises:
        ConfigError: see ``resolve_config``.
    """
    if isinstance(config, Config):
        sections: Mapping[str, Any] = config_to_dict(config)
    elif config is None or isinstance(config, Mapping):
        sections = config or {}
    else:
        sections = read_config(Path(config))
    if isinstance(settings, Mapping):
        explicit = merge_settings(settings)
    else:
        explicit = merge_settings(assignments=settings)
    return resolve_config(sections, explicit), explicit_names(explicit)


def explicit_values(config: Config, explicit: frozenset[str]) -> dict[str, dict[str, Any]]:
    """The settings of these dotted names, to be handed on as ``settings=``.

    >>> explicit_values(Config(), frozenset({"windows.size"}))
    {'windows': {'size': 8}}
    """
    return {
        section: kept
        for section, values in config_to_dict(config).items()
        if (kept := {k: v for k, v in values.items() if f"{section}.{k}" in explicit})
    }


def portable_settings(config: Config, folder: Path) -> dict[str, dict[str, Any]]:
    """The settings as a record in a folder keeps them: the parameter file, the one that names a
    place, is named relative to it.

    Args:
        config: a run's settings.
        folder: of the record.
    """
    sections, file = config_to_dict(config), config.features.vgg19_file
    if file:
        place = relative_asset_path(file, folder) if Path(file).is_file() else Path(file).name
        sections["features"]["vgg19_file"] = place
    return sections


def settle_files(config: Config, folder: Path) -> Config:
    """The settings of a record with the place of the parameter file as it is now.

    Args:
        config: from ``portable_settings``.
        folder: of the record.
    """
    file = config.features.vgg19_file
    if not file.startswith(("./", "../")):
        return config
    place = os.path.normpath(folder / file)
    return replace(config, features=replace(config.features, vgg19_file=place))

"""Settings from YAML files and from the command line, read strictly into the frozen sections.

Strict means: an unknown section or key, a key that stands twice, a wrong type, a number out of
range are errors that name the dotted key and what was wanted. Nothing is derived while reading.
"""

import dataclasses
import math
import typing
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from usdsmoke.base.errors import ConfigError
from usdsmoke.base.sections import (
    ColourConfig,
    Config,
    FeaturesConfig,
    GridsConfig,
    LayerConfig,
    LossesConfig,
    OpticsConfig,
    OptimizeConfig,
    ShapeConfig,
    StageConfig,
    StyleConfig,
    ViewsConfig,
    WindowsConfig,
)
from usdsmoke.base.setting_checks import check_setting, limits_text, nearest

__all__ = [
    "ColourConfig",
    "Config",
    "FeaturesConfig",
    "GridsConfig",
    "LayerConfig",
    "LossesConfig",
    "OpticsConfig",
    "OptimizeConfig",
    "ShapeConfig",
    "StageConfig",
    "StyleConfig",
    "ViewsConfig",
    "WindowsConfig",
    "check_value",
    "config_to_dict",
    "config_to_yaml",
    "explicit_names",
    "merge_settings",
    "read_config",
    "resolve_config",
    "style_shares",
]


_END_MARK = "...\n"  # yaml puts it behind a bare scalar


class _StrictLoader(yaml.SafeLoader):
    """YAML without objects in it; a key that stands twice is an error, not a silent choice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value != "<<":
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"the key {key.value!r} stands here twice", key.start_mark
                    )
                seen.add(key.value)
        return super().construct_mapping(node, deep)


def read_config(file_path: str | Path) -> dict[str, Any]:
    """The sections of a YAML file as plain dictionaries, unchecked.

    Raises:
        ConfigError: the file is missing, is no YAML, names a key twice or is not a mapping of
            sections.
    """
    try:
        sections = _read_yaml(Path(file_path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(
            f"cannot read the configuration {file_path}: {error.strerror or error}; "
            "check the path given as --config or --overrides"
        ) from None
    except (UnicodeDecodeError, ValueError, yaml.YAMLError) as error:
        raise ConfigError(
            f"cannot read the configuration {file_path}: {' '.join(str(error).split())}; "
            "wanted YAML: sections such as 'optimize:' with settings below them"
        ) from None
    if sections is None:
        return {}
    if not isinstance(sections, dict):
        raise ConfigError(
            f"the configuration {file_path} holds a {type(sections).__name__}; "
            "wanted sections such as 'optimize:' with settings below them"
        )
    return sections


def resolve_config(*sources: Mapping[str, Any], assignments: Sequence[str] = ()) -> Config:
    """The defaults, overridden by each source in turn and then by ``section.key=value`` strings.

    >>> resolve_config({"windows": {"size": 3}}, assignments=["optimize.seed=7"]).windows.size
    3

    Args:
        sources: mappings of section name to mapping of settings, weakest first.
        assignments: texts such as ``windows.size=3``; the value is read as YAML.

    Raises:
        ConfigError: an unknown section or key (names the nearest), a wrong type or range, or
            settings that contradict each other.
    """
    values = merge_settings(*sources, assignments=assignments)
    config = Config(
        **{
            name: _build_section(name, section_class, values.get(name, {}))
            for name, section_class in typing.get_type_hints(Config).items()
        }
    )
    _check_together(config)
    return config


def merge_settings(
    *sources: Mapping[str, Any], assignments: Sequence[str] = ()
) -> dict[str, dict[str, Any]]:
    """Settings of several sources in one, by section and key; the values themselves unchecked.

    Args:
        sources, assignments: as in ``resolve_config``.

    Raises:
        ConfigError: an unknown section, or an assignment that cannot be read.
    """
    values: dict[str, dict[str, Any]] = {}
    for source in sources:
        for section, settings in source.items():
            _section_class(section)
            if settings is None:
                continue
            if not isinstance(settings, Mapping):
                raise ConfigError(
                    f"section {section} holds {settings!r}; wanted settings below it, as in "
                    f"'{section}: {{key: value}}'"
                )
            values.setdefault(section, {}).update(settings)
    for assignment in assignments:
        section, key, value = _split_assignment(assignment)
        values.setdefault(section, {})[key] = value
    return values


def explicit_names(settings: Mapping[str, Mapping[str, Any]]) -> frozenset[str]:
    """The dotted names of settings.

    >>> sorted(explicit_names({"windows": {"size": 3}, "optimize": {"seed": 7, "threads": 1}}))
    ['optimize.seed', 'optimize.threads', 'windows.size']
    """
    return frozenset(f"{section}.{key}" for section, keys in settings.items() for key in keys)


def check_value(section: str, key: str, value: Any, where: str) -> Any:
    """A value for one setting as the type that it wants and within its limits.

    Args:
        section, key: of the setting.
        value: as given.
        where: what to call it in messages.

    Raises:
        ConfigError: there is no such setting, or it wants another type or range.
    """
    section_class: Any = _section_class(section)
    fields = {item.name: item for item in dataclasses.fields(section_class)}
    if key not in fields:
        raise ConfigError(f"unknown setting {section}.{key}{nearest(key, list(fields))}")
    wanted = typing.get_type_hints(section_class)[key]
    return check_setting(where, value, wanted, fields[key].metadata)


def style_shares(config: StyleConfig, n_styles: int) -> list[float]:
    """What share each style image has, adding up to 1.

    >>> style_shares(StyleConfig(weights=[3, 1]), 2)
    [0.75, 0.25]

    Raises:
        ConfigError: not one weight for each image, or none above 0.
    """
    weights = config.weights or [1.0] * n_styles
    if len(weights) != n_styles:
        raise ConfigError(
            f"style.weights holds {len(weights)} numbers for {n_styles} style images; give one for "
            "each or none"
        )
    if not max(weights) > 0:
        raise ConfigError("style.weights are all 0; wanted at least one above 0")
    relative = [weight / max(weights) for weight in weights]  # their sum cannot overflow
    return [weight / sum(relative) for weight in relative]


def config_to_dict(config: Config) -> dict[str, dict[str, Any]]:
    """The configuration as nested dictionaries; ``resolve_config`` takes it back unchanged."""
    return dataclasses.asdict(config)


def config_to_yaml(config: Config, comments: bool = True) -> str:
    """The configuration as a YAML file that ``read_config`` takes back unchanged.

    Args:
        config: what to write.
        comments: whether each setting is preceded by its meaning, limits and choices.
    """
    lines = []
    for section in dataclasses.fields(config):
        settings = getattr(config, section.name)
        if comments:
            lines.append(f"# {(type(settings).__doc__ or '').strip()}")
        lines.append(f"{section.name}:")
        for setting in dataclasses.fields(settings):
            if comments:
                lines.append(f"  # {setting.metadata['doc']}{limits_text(setting.metadata)}")
            value = yaml.safe_dump(
                getattr(settings, setting.name),
                default_flow_style=True,
                width=math.inf,
            )
            lines.append(f"  {setting.name}: {value.removesuffix(_END_MARK).strip(chr(10))}")
        lines.append("")
    return "\n".join(lines)


def _read_yaml(text: str) -> Any:
    return yaml.load(text, Loader=_StrictLoader)


def _section_class(name: str) -> type:
    hints = typing.get_type_hints(Config)
    if name not in hints:
        raise ConfigError(f"unknown section {name!r}{nearest(name, list(hints))}")
    section_class: type = hints[name]
    return section_class


def _split_assignment(text: str) -> tuple[str, str, Any]:
    name, equals, value = text.partition("=")
    section, dot, key = name.strip().partition(".")
    if not equals or not dot:
        raise ConfigError(
            f"cannot read the setting {text!r}; wanted section.key=value, as in windows.size=3"
        )
    _section_class(section)
    try:
        return section, key, _read_yaml(value)
    except (ValueError, yaml.YAMLError) as error:
        raise ConfigError(
            f"cannot read the value of {name.strip()}: {' '.join(str(error).split())}; "
            'wanted YAML, as in 3, true, [1, 2] or "text"'
        ) from None


def _build_section(section: str, section_class: Any, settings: Mapping[str, Any]) -> Any:
    return section_class(
        **{
            key: check_value(section, key, value, f"{section}.{key}")
            for key, value in settings.items()
        }
    )


def _check_together(config: Config) -> None:
    layers, weights = config.features.layers, config.features.weights
    if weights and len(weights) != len(layers):
        raise ConfigError(
            f"features.weights has {len(weights)} elements but features.layers has {len(layers)}; "
            "wanted one weight for each style layer, or none at all"
        )

"""Settings from YAML files, mappings and texts, merged once into a ``Config``, and records of them.

The precedence is: default, files of settings (``--preset``, then ``--config``), a Volume's own
request, what is given explicitly for this run (options, mappings, texts).
"""

import difflib
import math
import os
import re
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, cast

import yaml
from pydantic.fields import FieldInfo

from usdsmoke.base.errors import ConfigError
from usdsmoke.base.naming import relative_asset_path
from usdsmoke.config.run_sections import OWN_NETWORK
from usdsmoke.config.setting_model import allowed_values, extra_of, range_text, type_text
from usdsmoke.config.settings import SECTIONS, Config, declared_settings, flatten_settings

FilePath = str | PathLike[str]
Styles = FilePath | Sequence[FilePath] | None
Settings = Config | Mapping[str, Any] | FilePath | Sequence[Any] | None  # see resolve_settings

PATH_SETTINGS = ("features.vgg19_file", "optimize.start")  # settings that name a file
_FORMS = "Give a mapping, a YAML file, a text such as 'windows.size=3', or a list of these."
_END_MARK = "...\n"  # yaml puts it behind a bare scalar


class GivenSettings(dict[str, Any]):
    """Settings by dotted name, their values not yet checked, and where each of them comes from."""

    def __init__(self, values: Mapping[str, Any], sources: str | Mapping[str, str] = "") -> None:
        super().__init__(values)
        self.sources = dict.fromkeys(values, sources) if isinstance(sources, str) else dict(sources)


class _StrictLoader(yaml.SafeLoader):
    """YAML without objects; a repeated key is an error, not a silent choice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value != "<<":
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"the key {key.value!r} is repeated here", key.start_mark
                    )
                seen.add(key.value)
        return super().construct_mapping(node, deep)


def style_paths(style: Styles) -> list[FilePath]:
    """The image files of a call; none where Volumes bring their own."""
    if style is None:
        return []
    return [style] if isinstance(style, (str, PathLike)) else list(style)


def read_settings(given: Settings, source: str = "") -> GivenSettings:
    """Settings in any of their forms, by dotted name; the values are not checked.

    Args:
        given: see ``resolve_settings``; of a ``Config``, those settings that are explicit or not
            the default.
        source: where they come from, for messages.

    Raises:
        ConfigError: a file or a text cannot be read, or a section is unknown.
    """
    if isinstance(given, GivenSettings):
        return given
    if isinstance(given, Config):
        return GivenSettings(given.given_values(), source)
    if isinstance(given, Mapping):
        return GivenSettings(flatten_settings(given, source), source)
    if isinstance(given, str) and "=" in given:
        return GivenSettings(dict([_read_text(given, source)]), source)
    if isinstance(given, (str, PathLike)):
        return GivenSettings(_read_file(Path(given)), source or str(given))
    merged = GivenSettings({})
    for part in given or ():
        found = read_settings(part, source)
        merged.update(found)
        merged.sources |= found.sources
    return merged


def resolve_settings(settings: Settings) -> Config:
    """The settings of a run.

    >>> config = resolve_settings([{"windows.size": 3}, "optimize.seed=7"])
    >>> config.windows.size, sorted(config.explicit)
    (3, ['optimize.seed', 'windows.size'])

    Args:
        settings: the path of a YAML file, which a Volume's own settings override; a mapping (by
            section and key, or by dotted name) or a text such as ``windows.size=3``, which become
            explicit and override a Volume's own; a ``Config``, which knows what is explicit; or a
            sequence of these, the strongest last. None: the defaults.

    Raises:
        ConfigError: an unknown section or key (the message names the nearest one), a wrong type, a
            value out of range, or settings that contradict each other.
    """
    config = Config()
    for part in _parts_of(settings):
        if isinstance(part, Config):
            config = part
            continue
        is_file = isinstance(part, PathLike) or (isinstance(part, str) and "=" not in part)
        given = read_settings(part)
        config = config.with_values(given, given.sources, explicit=not is_file)
        if is_file:
            config = config.with_explicit(config.explicit - given.keys())
    return config


def resolve_config(*sources: Settings) -> Config:
    """The defaults, overridden by each source in turn; no setting is explicit.

    >>> resolve_config({"windows": {"size": 3}}, "optimize.seed=7").windows.size
    3

    Raises:
        ConfigError: see ``resolve_settings``.
    """
    return resolve_settings(sources).with_explicit()


def settings_record(config: Config, folder: Path) -> dict[str, Any]:
    """The settings as JSON values for a record in a folder.

    Args:
        folder: of the record. The files among the settings are recorded relative to it.

    Returns:
        ``config``, all settings by section and key, and ``explicit``, the dotted names.
    """
    sections = config.model_dump()
    for section, _, key in (name.partition(".") for name in PATH_SETTINGS):
        file = sections[section][key]
        if file and file != OWN_NETWORK:
            place = relative_asset_path(file, folder) if Path(file).is_file() else Path(file).name
            sections[section][key] = place
    return {"config": sections, "explicit": sorted(config.explicit)}


def recorded_settings(record: Mapping[str, Any], folder: Path) -> Config:
    """The settings of a record, with the paths of files as they are now.

    Args:
        record: from ``settings_record``; ``explicit`` may be missing.
        folder: of the record.

    Raises:
        ConfigError: the record's settings are not those of this version.
    """
    config = resolve_config(record["config"]).with_explicit(record.get("explicit", ()))
    files = {name: value for name, value in config.given_values().items() if name in PATH_SETTINGS}
    here = {
        name: os.path.normpath(folder / file)
        for name, file in files.items()
        if file.startswith(("./", "../"))
    }
    return config.with_values(here) if here else config


def settings() -> dict[str, dict[str, Any]]:
    """Every setting by dotted name: ``type``, ``default``, ``range``, ``unit``, ``description``.

    >>> settings()["windows.size"]["range"]
    'at least 1'
    """
    return {
        name: {
            "type": type_text(field),
            "default": field.get_default(call_default_factory=True),
            "range": range_text(field),
            "unit": extra_of(field).get("unit", ""),
            "description": str(field.description),
        }
        for name, field in declared_settings().items()
    }


def settings_yaml(config: Config, comments: bool = True) -> str:
    """The settings as a YAML file that ``read_settings`` reads back unchanged.

    Args:
        comments: whether each setting is preceded by its meaning, unit and limits.
    """
    lines, declared = [], declared_settings()
    for section, model in SECTIONS.items():
        lines += [f"# {model.__doc__}"] if comments else []
        lines.append(f"{section}:")
        for key, value in getattr(config, section).model_dump().items():
            if comments:
                lines.append(f"  # {_meaning(declared[f'{section}.{key}'])}")
            text = yaml.safe_dump(value, default_flow_style=True, width=math.inf)
            lines.append(f"  {key}: {text.removesuffix(_END_MARK).strip(chr(10))}")
        lines.append("")
    return "\n".join(lines)


def _meaning(field: FieldInfo) -> str:
    """A setting's description, unit and limits; its choices only if the description has not."""
    about = str(field.description)
    words = set(re.findall(r"\w+", about))
    limits = range_text(field, with_choices=not words.issuperset(allowed_values(field)))
    beside = "; ".join(filter(None, (extra_of(field).get("unit", ""), limits)))
    return f"{about} ({beside})" if beside else about


def _parts_of(settings: Any) -> Iterator[Any]:
    """One source after the other; sequences may hold sequences."""
    if isinstance(settings, (Config, Mapping, str, PathLike)):
        yield settings
    elif not isinstance(settings, Iterable | None):
        raise ConfigError(f"{settings!r} does not hold settings. {_FORMS}")
    else:
        for part in settings or ():
            yield from _parts_of(part)


def _read_file(file_path: Path) -> dict[str, Any]:
    advice = "Check the path, and that it is a YAML file with sections such as 'optimize:'."
    try:
        sections = _read_yaml(file_path.read_text(encoding="utf-8"))
    except OSError as error:
        reason = error.strerror or error
        raise ConfigError(f"cannot read the settings in {file_path} ({reason}). {advice}") from None
    except (ValueError, yaml.YAMLError) as error:
        reason = _yaml_problem(error)
        raise ConfigError(f"cannot read the settings in {file_path} ({reason}). {advice}") from None
    if not isinstance(sections, dict | None):
        raise ConfigError(
            f"{file_path} holds no settings. Write sections such as 'optimize:' in it."
        )
    try:
        return flatten_settings(sections or {})
    except ConfigError as error:
        raise ConfigError(f"{file_path}: {error}") from None


def _read_text(text: str, source: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    name = name.strip()
    if not equals:
        raise ConfigError(f"cannot read the setting {text!r}. Write it as windows.size=3.")
    if "." not in name:
        raise ConfigError(f"the setting {name!r} has no section. {_with_section(name)}")
    flatten_settings({name: None}, source)
    try:
        return name, _read_yaml(value)
    except (ValueError, yaml.YAMLError):
        if type_text(declared_settings()[name]) == "a string":  # such as {name}.{frame}.vdb
            return name, value.strip()
        raise ConfigError(
            f"cannot read the value of {name} ({value!r:.99}). "
            'Write it as YAML: 3, true, [1, 2] or "text".'
        ) from None


def _with_section(name: str) -> str:
    """What to do about a setting that is named without its section."""
    known = [full for full in declared_settings() if full.partition(".")[2] == name]
    if not known:
        close = difflib.get_close_matches(name, list(declared_settings()), n=3, cutoff=0.5)
        known = close or ["windows.size"]
        return f"Write SECTION.NAME=VALUE, such as {known[0]}=VALUE."
    return f"Did you mean {', '.join(known)}?"


def _yaml_problem(error: Exception) -> str:
    """The line and the problem, without the parser's context and excerpt."""
    if isinstance(error, UnicodeDecodeError):
        return "it is not UTF-8 text"
    mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None)
    text = " ".join(str(problem or error).split())
    return f"line {mark.line + 1}: {text}" if mark is not None else text


def _read_yaml(text: str) -> Any:
    try:
        return cast(Any, yaml.load(text, Loader=_StrictLoader))
    except RecursionError:
        raise ValueError("it is nested too deeply") from None

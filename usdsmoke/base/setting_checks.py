"""What a setting is, and whether a value is what it wants: type, limits, choices."""

import dataclasses
import difflib
import math
import re
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Any

from usdsmoke.base.errors import ConfigError

__all__ = ["check_setting", "limits_text", "nearest", "setting"]


def setting(default: Any, doc: str, **limits: Any) -> Any:
    """A dataclass field with its help text and its limits.

    ``low``, ``high`` (inclusive) and ``above`` (exclusive) bound a number or every element of a
    list, ``choices`` names the words there are, ``pattern`` is what a text must match as a whole
    and ``wanted`` says it in words,
    ``least`` is the smallest length of a list, and ``distinct`` refuses a list that names something
    twice.
    """
    metadata = {"doc": doc, **limits}
    if isinstance(default, (list, dict)):
        return dataclasses.field(default_factory=lambda: type(default)(default), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def check_setting(where: str, value: Any, wanted: Any, limits: Mapping[str, Any]) -> Any:
    """``value`` as the type that is wanted and within its limits.

    Args:
        where: the setting's dotted name, for messages.
        value: what YAML or a caller gave; a single value is taken as a list of one.
        wanted: the annotation: a plain type, ``list[type]`` or ``type | None``.
        limits: the field's metadata, see ``setting``.

    Raises:
        ConfigError: another type, out of range, too few or repeated elements.
    """
    if isinstance(wanted, types.UnionType):
        if value is None:
            return None
        wanted = next(kind for kind in typing.get_args(wanted) if kind is not type(None))
    if typing.get_origin(wanted) is not list:
        return _check_limits(where, _convert(where, value, wanted), limits)
    (element,) = typing.get_args(wanted)
    items = value if isinstance(value, (list, tuple)) else [value]
    checked = [
        _check_limits(f"{where}[{n}]", _convert(f"{where}[{n}]", item, element), limits)
        for n, item in enumerate(items)
    ]
    if len(checked) < limits.get("least", 0):
        raise ConfigError(f"{where} has {len(checked)} elements; wanted at least {limits['least']}")
    if limits.get("distinct") and len(set(checked)) < len(checked):
        raise ConfigError(f"{where} is {checked!r}; wanted every element once")
    return checked


def _convert(where: str, value: Any, wanted: type) -> Any:
    """``value`` as ``wanted``, where YAML's reading of a number or a text loses nothing."""
    if wanted is float and isinstance(value, (int, str)) and not isinstance(value, bool):
        try:  # YAML 1.1 reads 1e-3 as a text
            value = float(value)
        except (ValueError, OverflowError):
            pass
    if wanted is str and value is None:
        value = ""
    if wanted is str and isinstance(value, (int, float)) and not isinstance(value, bool):
        value = str(value)
    if not isinstance(value, wanted) or (isinstance(value, bool) and wanted is not bool):
        kind = type(value).__name__
        raise ConfigError(f"{where} is {value!r}, of type {kind}; wanted {wanted.__name__}")
    return value


def _check_limits(where: str, value: Any, limits: Mapping[str, Any]) -> Any:
    found = f"{where} is {value!r}"
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{found}; wanted a finite number")
    if "choices" in limits and value not in limits["choices"]:
        raise ConfigError(f"{found}; wanted one of {', '.join(limits['choices'])}")
    if "pattern" in limits and not re.fullmatch(limits["pattern"], value):
        raise ConfigError(f"{found}; wanted {limits['wanted']}")
    if "low" in limits and value < limits["low"]:
        raise ConfigError(f"{found}; wanted >= {limits['low']}")
    if "above" in limits and value <= limits["above"]:
        raise ConfigError(f"{found}; wanted > {limits['above']}")
    if "high" in limits and value > limits["high"]:
        raise ConfigError(f"{found}; wanted <= {limits['high']}")
    return value


def nearest(word: object, known: Sequence[str]) -> str:
    """The end of a message about an unknown word: the nearest known one, or all there are."""
    close = difflib.get_close_matches(str(word), known, n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else f"; there are: {', '.join(known)}"


def limits_text(limits: Mapping[str, Any]) -> str:
    """The limits as shown behind a setting's meaning: " (>= 1, <= 64)", or "" without any."""
    parts = [
        f"{sign} {limits[key]}"
        for key, sign in (("low", ">="), ("above", ">"), ("high", "<="))
        if key in limits
    ]
    if "choices" in limits:
        parts.append(" | ".join(limits["choices"]))
    return f" ({', '.join(parts)})" if parts else ""

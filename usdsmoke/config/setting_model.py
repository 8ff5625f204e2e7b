"""What a setting is: its type, limits, unit and meaning, declared once as a pydantic field.

The same declaration checks values, words the error messages, and gives the texts of
``usdsmoke settings``, of the command line's help and of the request attributes on a stage.
"""

import difflib
import re
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
)
from pydantic.fields import FieldInfo

from usdsmoke.base.errors import ConfigError

_Section = TypeVar("_Section", bound="Section")  # typing.Self came with Python 3.11
_TYPES = {int: "a whole number", float: "a number", bool: "true or false", str: "a string"}


def setting(default: Any, description: str, **declared: Any) -> Any:
    """A field of a section.

    Args:
        description: what it means, without a full stop.
        declared: limits as in ``pydantic.Field`` (``ge``, ``gt``, ``le``, ``min_length``), and
            ``unit``; ``distinct`` (a list names nothing twice); ``pattern`` with ``form`` (what a
            whole text must match, and the same in words); ``request`` (the attribute of
            UsdSmokeStyleAPI that stands for the setting) and ``control`` (the field of
            ``FrameControls``, if the attribute may be animated).
    """
    own = ("unit", "distinct", "pattern", "form", "request", "control")
    extra = {name: declared.pop(name) for name in own if name in declared}
    return Field(default, description=description, json_schema_extra=extra, **declared)


class ValueType(NamedTuple):
    """The type of a setting's value: a list or not, of which plain type, or None."""

    is_list: bool
    element: type  # int, float, bool or str
    is_optional: bool
    annotation: Any  # of the value or element, with its choices and limits

    @classmethod
    def of(cls, field: FieldInfo) -> "ValueType":
        """From a setting's declaration."""
        annotation: Any = field.annotation
        is_optional = isinstance(annotation, types.UnionType)
        if is_optional:
            annotation = typing.get_args(annotation)[0]
        is_list = typing.get_origin(annotation) is list
        if is_list:
            (annotation,) = typing.get_args(annotation)
        is_literal = typing.get_origin(annotation) is Literal
        element = str if is_literal else getattr(annotation, "__origin__", annotation)
        return cls(is_list, element, is_optional, annotation)


class Section(BaseModel):
    """Settings of one kind. ``model_fields_set`` holds those that the user gave explicitly."""

    model_config = ConfigDict(
        strict=True, frozen=True, extra="forbid", allow_inf_nan=False, hide_input_in_errors=True
    )

    @field_validator("*", mode="before")
    @classmethod
    def _read(cls, value: Any, info: ValidationInfo) -> Any:
        """Accept what YAML or a caller may write for the same value, without any loss."""
        is_list, kind, *_ = ValueType.of(cls.model_fields[str(info.field_name)])
        if is_list:
            items = value if isinstance(value, (list, tuple)) else [value]
            return [_convert(item, kind) for item in items]
        return _convert(value, kind)

    @field_validator("*", mode="after")
    @classmethod
    def _check_text(cls, value: Any, info: ValidationInfo) -> Any:
        extra = extra_of(cls.model_fields[str(info.field_name)])
        if extra.get("distinct") and len(set(value)) < len(value):
            raise ValueError("repeated elements")
        if "pattern" in extra and not re.fullmatch(extra["pattern"], value):
            raise ValueError("text does not match")
        return value

    @classmethod
    def checked(
        cls: type[_Section], name: str, values: Mapping[str, Any], sources: Mapping[str, str]
    ) -> _Section:
        """A section of these values; the others are defaults.

        Args:
            sources: where values come from, such as "--set", by dotted name; for messages.

        Raises:
            ConfigError: an unknown key, a wrong type, or a value out of range.
        """
        try:
            return cls.model_validate(dict(values))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            raise ConfigError(cls.explain(name, {**first}, sources)) from None

    def replace(self: _Section, **values: Any) -> _Section:
        """The section with other values, for code: nothing is checked or becomes explicit."""
        if unknown := values.keys() - type(self).model_fields.keys():
            raise TypeError(f"{type(self).__name__} has no {', '.join(sorted(unknown))}")
        return self.model_construct(set(self.model_fields_set), **{**self.__dict__, **values})

    @classmethod
    def explain(cls, name: str, error: Mapping[str, Any], sources: Mapping[str, str]) -> str:
        """A validation error of pydantic in plain words: what is wrong, and what to do."""
        key, *index = error["loc"]
        dotted = f"{name}.{key}"
        source = f" (from {sources[dotted]})" if sources.get(dotted) else ""
        if key not in cls.model_fields:
            close = nearest(key, list(cls.model_fields), name)
            return f"unknown setting {dotted}{source}. {close}"
        place = "".join(f"[{n}]" for n in index)
        allowed = _allowed_text(cls.model_fields[str(key)])
        option = sources.get(dotted, "")
        if option.startswith("--") and option != "--set":  # an option cannot be null
            allowed = allowed.removeprefix("null or ")
            return f"{option}{place} is {error['input']!r:.99}. Give {allowed}."
        return f"{dotted}{place} is {error['input']!r:.99}{source}. Set it to {allowed}."


def nearest(word: object, known: Sequence[str], section: str = "") -> str:
    """What to do about an unknown word: a sentence with the nearest known one, or all of them.

    Args:
        section: of the known settings; the nearest one is named with it.
    """
    close = difflib.get_close_matches(str(word), known, n=1, cutoff=0.5)
    if not close:
        return f"Known names: {', '.join(known)}."
    return f"Did you mean {f'{section}.{close[0]}' if section else repr(close[0])}?"


def extra_of(field: FieldInfo) -> dict[str, Any]:
    """What ``setting`` declares beyond pydantic's own limits."""
    return field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}


def allowed_values(field: FieldInfo) -> tuple[str, ...]:
    """The words that a setting, or each element of its list, is chosen from; () for any."""
    annotation = ValueType.of(field).annotation
    return typing.get_args(annotation) if typing.get_origin(annotation) is Literal else ()


def limits_of(field: FieldInfo) -> dict[str, float]:
    """Limits of a number, or of each element of a list: ``ge``, ``gt``, ``le``."""
    annotation, metadata = ValueType.of(field).annotation, list(field.metadata)
    for item in getattr(annotation, "__metadata__", ()):
        metadata += item.metadata if isinstance(item, FieldInfo) else [item]
    signs = ("ge", "gt", "le")
    return {sign: getattr(item, sign) for sign in signs for item in metadata if hasattr(item, sign)}


def type_text(field: FieldInfo) -> str:
    """A setting's type in words, such as "a whole number" or "a list of strings"."""
    is_list, kind, is_optional, _ = ValueType.of(field)
    text = _TYPES[kind]
    if allowed_values(field):
        text = "a list of" if is_list else "one of"
    elif is_list:
        text = f"a list of {text.removeprefix('a ')}s"
    return f"null or {text}" if is_optional else text


def range_text(field: FieldInfo, with_choices: bool = True) -> str:
    """A setting's choices and limits, such as "above 0 and at most 8"; "" without any."""
    is_list, limits, extra = ValueType.of(field).is_list, limits_of(field), extra_of(field)
    if "ge" in limits and "le" in limits:
        numbers = f"{_number(limits['ge'])} to {_number(limits['le'])}"
    else:
        words = {"ge": "at least", "gt": "above", "le": "at most"}
        numbers = " and ".join(f"{words[sign]} {_number(limits[sign])}" for sign in limits)
    choices = ", ".join(allowed_values(field)) if with_choices else ""
    if is_list:
        numbers = f"each {numbers}" if numbers else ""
        if any(hasattr(item, "min_length") for item in field.metadata):
            choices = f"one or more of {choices}" if choices else "one or more"
    repeats = "without repeats" if extra.get("distinct") else ""
    parts = (choices, extra.get("form", ""), numbers, repeats)
    return ", ".join(part for part in parts if part)


def _allowed_text(field: FieldInfo) -> str:
    is_list, limits, limits_text = ValueType.of(field).is_list, limits_of(field), range_text(field)
    if not limits_text:
        return type_text(field)
    between = ", " if is_list else " " if "gt" in limits else " of "
    if {"ge", "le"} <= limits.keys() and not is_list:
        between = " from "
    if extra_of(field).get("form"):
        between = ": "
    return f"{type_text(field)}{' ' if allowed_values(field) else between}{limits_text}"


def _number(value: float) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _convert(value: Any, kind: type) -> Any:
    """A value as ``kind``, where nothing is lost: 1 as 1.0, and what YAML reads as another type."""
    if isinstance(value, bool):
        return value
    if kind is float and isinstance(value, (int, str)):
        try:  # YAML 1.1 reads 1e-3 as a text
            return float(value)
        except (ValueError, OverflowError):
            return value
    if kind is str and value is None:
        return ""
    return str(value) if kind is str and isinstance(value, (int, float)) else value

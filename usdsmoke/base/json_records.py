"""Frozen dataclasses as JSON values and back, checked by their type hints."""

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import TypeAdapter

_Record = TypeVar("_Record")
_ADAPTERS: dict[Any, TypeAdapter[Any]] = {}


def to_json(record: Any, defaults: bool = False) -> dict[str, Any]:
    """A dataclass as JSON values, by the names of its fields.

    Args:
        record: of fields that JSON can hold, dataclasses, tuples and mappings among them.
        defaults: whether fields at their default are there too.
    """
    values: dict[str, Any] = _adapter(type(record)).dump_python(
        record, mode="json", exclude_defaults=not defaults
    )
    return values


def from_json(kind: type[_Record], values: Mapping[str, Any]) -> _Record:
    """The dataclass that ``to_json`` gave the values of; names that it does not know are ignored.

    Raises:
        ValueError: a field is missing or has a value of another type.
    """
    record: _Record = _adapter(kind).validate_python(dict(values))
    return record


def _adapter(kind: Any) -> TypeAdapter[Any]:
    """Made once for each dataclass: making it takes milliseconds."""
    if kind not in _ADAPTERS:
        _ADAPTERS[kind] = TypeAdapter(kind)
    return _ADAPTERS[kind]

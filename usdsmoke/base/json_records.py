"""Values as JSON: frozen dataclasses and back, checked by their type hints, and any others."""

import json
from collections.abc import Mapping
from typing import Any, ClassVar, TypeVar

from pydantic import TypeAdapter

_Record = TypeVar("_Record", bound="JsonRecord")
_ADAPTERS: dict[Any, TypeAdapter[Any]] = {}


class JsonRecord:
    """Base of dataclasses whose fields JSON can hold, dataclasses and tuples among them."""

    keeps_defaults: ClassVar[bool] = True  # whether fields at their default are written

    def to_json(self) -> dict[str, Any]:
        """As JSON values, by the names of the fields."""
        values: dict[str, Any] = _adapter(type(self)).dump_python(
            self, mode="json", exclude_defaults=not self.keeps_defaults
        )
        return values

    @classmethod
    def from_json(cls: type[_Record], values: Mapping[str, Any]) -> _Record:
        """What ``to_json`` gave the values of; names that are not known are ignored.

        Raises:
            ValueError: a field is missing or has a value of another type.
        """
        record: _Record = _adapter(cls).validate_python(dict(values))
        return record


def read_json(text: str | bytes) -> Any:
    """The values of a text that may be damaged.

    Raises:
        ValueError: it is no JSON, or nested too deeply.
    """
    try:
        values = json.loads(text)
        json.dumps(values)  # whoever uses them can go as deep
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    return values


def plain_values(value: Any) -> Any:
    """The value as JSON can say it: mappings, lists, texts, truth values, numbers."""
    if isinstance(value, Mapping):
        return {str(key): plain_values(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_values(item) for item in value]
    if isinstance(value, (str, bool, int, float)) or value is None:
        return value
    return float(value)


def _adapter(kind: Any) -> TypeAdapter[Any]:
    """Made once for each dataclass: making it takes milliseconds."""
    if kind not in _ADAPTERS:
        _ADAPTERS[kind] = TypeAdapter(kind)
    return _ADAPTERS[kind]

"""What differs between two runs, in words."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

__all__ = ["list_changes"]

_MOST_CHANGES = 6  # that a message names


def list_changes(earlier: Mapping[str, Any], later: Mapping[str, Any]) -> str:
    """What differs between two descriptions, in words.

    >>> list_changes({"optimize": {"seed": 0}}, {"optimize": {"seed": 1}})
    'optimize.seed was 0, now 1'
    """
    before, after = dict(_flatten(earlier)), dict(_flatten(later))
    changes = [
        f"{name} was {_shown(before, name)}, now {_shown(after, name)}"
        for name in sorted({*before, *after})
        if before.get(name) != after.get(name)
    ]
    more = len(changes) - _MOST_CHANGES
    return ", ".join(changes[:_MOST_CHANGES]) + (f" and {more} more" if more > 0 else "")


def _flatten(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping) and value:
            yield from _flatten(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _shown(values: Mapping[str, Any], name: str) -> str:
    if name not in values:
        return "absent"
    text = json.dumps(values[name], ensure_ascii=False)
    return text if len(text) <= 40 else f"{text[:12]}..."

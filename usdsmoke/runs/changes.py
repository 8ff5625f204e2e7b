"""What differs between two runs, in words."""

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

__all__ = ["list_changes"]

_MOST_CHANGES = 6  # that a message names
_LONGEST = 60  # letters of a value
_DIGEST = re.compile(r"\b([0-9a-f]{12})[0-9a-f]{52}\b")


def list_changes(earlier: Mapping[str, Any], later: Mapping[str, Any]) -> str:
    """What differs between two descriptions, in words; empty where nothing does.

    >>> list_changes({"optimize": {"seed": 0}}, {"optimize": {"seed": 1}})
    'optimize.seed was 0, now 1'
    >>> list_changes({"styles": ["a.png 0f"]}, {"styles": ["a.png 0f", "b.png 1e"]})
    'styles[1] was absent, now "b.png 1e"'
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
        elif name == "styles" and isinstance(value, list):  # images: each for itself
            yield from ((f"{prefix}{name}[{n}]", item) for n, item in enumerate(value))
        else:
            yield f"{prefix}{name}", value


def _shown(values: Mapping[str, Any], name: str) -> str:
    """A value as people read it: of digests the first digits, of long texts the beginning."""
    if name not in values:
        return "absent"
    text = _DIGEST.sub(r"\1...", json.dumps(values[name], ensure_ascii=False))
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."

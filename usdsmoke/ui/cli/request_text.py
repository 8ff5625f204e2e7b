"""What ``inspect`` prints of a Volume's request: values and where each comes from."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

_WORDS = {"config": "configuration", "option": "option", "default": "default"}


def request_rows(request: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Name, value and origin of everything but defaults, and the number of defaults.

    Args:
        request: a Volume's, from ``inspection_requests.describe_requests``.
    """
    images = ", ".join(Path(name).name for name in request["styles"]["value"])
    rows = [("style images", images or "none", _origin(request["styles"]))] if images else []
    settings = request["settings"]
    rows += [
        (name, _value(entry), _origin(entry))
        for name, entry in settings.items()
        if entry["origin"] != "default"
    ]
    n_others = sum(entry["origin"] == "default" for entry in settings.values())
    if rows and n_others:
        rows.append(("others", f"{n_others} settings", "default"))
    return rows


def _value(entry: Mapping[str, Any]) -> str:
    if samples := entry.get("samples"):
        (first, start), (last, end) = samples[0], samples[-1]
        return f"{start} at {first:g} to {end} at {last:g}"
    return str(entry["value"])


def _origin(entry: Mapping[str, Any]) -> str:
    if entry["origin"] != "prim":
        return _WORDS[entry["origin"]]
    return f"<{entry['attribute']}> in {Path(entry['layer']).name}"

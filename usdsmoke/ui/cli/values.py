"""Values of options that are more than a word or a number."""

import argparse
import math
import re

__all__ = ["duration_value", "empty_path", "repair_value", "size_value"]

_SECOND, _MINUTE, _HOUR = 1.0, 60.0, 3600.0
_UNITS = {
    "s": _SECOND, "sec": _SECOND, "secs": _SECOND, "second": _SECOND, "seconds": _SECOND,
    "m": _MINUTE, "min": _MINUTE, "mins": _MINUTE, "minute": _MINUTE, "minutes": _MINUTE,
    "h": _HOUR, "hr": _HOUR, "hour": _HOUR, "hours": _HOUR,
}  # fmt: skip
_PART = re.compile(r"\s*(\d+(?:\.\d*)?)\s*([a-z]+)\s*")
_LEAST = 1.0  # seconds
_PATHS = ("stage", "style", "output", "config", "overrides", "template", "file")


def empty_path(arguments: argparse.Namespace) -> str | None:
    """Name of a path that was given as an empty text, as by a script whose variable is not set.

    Taken as a path it would mean the folder in which the command was called.
    """
    for name in _PATHS:
        value = getattr(arguments, name, None)
        if value == "" or (isinstance(value, list) and "" in value):
            return name
    return None


def size_value(text: str) -> tuple[int, int]:
    """Width and height of ``960x540``.

    Raises:
        argparse.ArgumentTypeError: it is no such text.
    """
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r}; wanted WIDTHxHEIGHT, as in 960x540")
    return int(width), int(height)


def repair_value(text: str) -> float:
    """The number of ``nan=0``.

    Raises:
        argparse.ArgumentTypeError: it is no such text, or the number is not finite.
    """
    name, equals, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if name.strip().lower() != "nan" or not equals or not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"{text!r}; wanted nan=NUMBER, as in nan=0")
    return number


def duration_value(text: str) -> float:
    """Seconds of a duration such as ``5min``, ``5m``, ``300s``, ``60 sec``, ``1h30min`` or ``90``.

    >>> duration_value("5min"), duration_value("1.5 h"), duration_value("1h30m")
    (300.0, 5400.0, 5400.0)

    Raises:
        argparse.ArgumentTypeError: it is no duration, or less than a second.
    """
    seconds = _seconds(text.strip().lower())
    if not _LEAST <= seconds < float("inf"):
        raise argparse.ArgumentTypeError(
            f"{text!r}; wanted a number of seconds, minutes or hours, one second at least, as in "
            "300s, 5min or 1h30min"
        )
    return seconds


def _seconds(text: str) -> float:
    """0 for what is no duration; every unit counts once, the largest first."""
    if re.fullmatch(r"\d+(\.\d*)?", text):
        return float(text)
    place, total, last = 0, 0.0, float("inf")
    while place < len(text):
        found = _PART.match(text, place)
        unit = _UNITS.get(found[2], 0.0) if found else 0.0
        if not found or not 0 < unit < last:
            return 0.0
        place, total, last = found.end(), total + float(found[1]) * unit, unit
    return total

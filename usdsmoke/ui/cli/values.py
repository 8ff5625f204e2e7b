"""Options whose values are more than a word or a number."""

import argparse
import math
import re

_UNITS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}
_DURATION = re.compile(r"(\d+(?:\.\d*)?)\s*(s|min|h|)")
_LEAST = 1.0  # seconds
_ARGUMENTS = {"stage": "STAGE", "file": "FILE", "output": "OUT"}  # without an option
_NEVER_EMPTY = (
    "stage",
    "style",
    "output",
    "config",
    "overrides",
    "template",
    "file",
    "start",
    "frames",
    "prim",
    "junit",
    "mend",
)


def empty_value(arguments: argparse.Namespace) -> str | None:
    """The option or argument that is empty, as from a script whose variable is not set.

    An empty path would mean the current folder, and empty frames all of them.
    """
    for name in _NEVER_EMPTY:
        value = getattr(arguments, name, None)
        if value == "" or (isinstance(value, list) and "" in value):
            is_argument = name in ("stage", "file") or (
                name == "output" and arguments.command == "assemble"
            )
            return _ARGUMENTS[name] if is_argument else f"--{name}"
    return None


def count_value(text: str) -> int:
    """A whole number of at least 1.

    Raises:
        argparse.ArgumentTypeError: the text is something else.
    """
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1.")
    return int(text)


def size_value(text: str) -> tuple[int, int]:
    """Width and height of ``960x540``.

    Raises:
        argparse.ArgumentTypeError: the text has another form.
    """
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a size. Write WIDTHxHEIGHT, such as 960x540."
        )
    return int(width), int(height)


def repair_value(text: str) -> float:
    """The number of ``nan=0``.

    Raises:
        argparse.ArgumentTypeError: the text has another form, or the number is not finite.
    """
    name, equals, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if name.strip().lower() != "nan" or not equals or not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"cannot read {text!r}. Write nan=NUMBER, such as nan=0.")
    return number


def duration_value(text: str) -> float:
    """Seconds of a duration such as ``90``, ``300s``, ``5min`` or ``1.5h``.

    >>> duration_value("5min"), duration_value("1.5 h")
    (300.0, 5400.0)

    Raises:
        argparse.ArgumentTypeError: it is not a duration, or less than a second.
    """
    found = _DURATION.fullmatch(text.strip().lower())
    seconds = float(found[1]) * _UNITS[found[2]] if found else 0.0
    if not _LEAST <= seconds < math.inf:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a duration of at least one second. Write 300s, 5min or 1h."
        )
    return seconds

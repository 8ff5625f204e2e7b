"""Values of options that are more than a word or a number."""

import argparse
import math

__all__ = ["repair_value", "size_value"]


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

"""Selections of timeCodes: "1-24x2,30" into ranges, ranges into those that exist, and back."""

import re
import statistics
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

from usdsmoke.base.errors import ConfigError

_Item = TypeVar("_Item")

# A step of more than this many usual steps is a gap: a frame or more is missing. A cut, over which
# nothing is carried, takes more than two steps: see ``planning.windows``.
_GAP = 1.5
_TOLERANCE = 1e-6  # layer offsets with a scale leave rounding in timeCodes
_MOST_STEPS = 100_000  # beyond that only the ends of a range are looked for
_NUMBER = r"-?\d+(?:\.\d+)?"
_PART = re.compile(rf"({_NUMBER})(?:\s*-\s*({_NUMBER})(?:\s*x\s*({_NUMBER}))?)?")


@dataclass(frozen=True)
class FrameRange:
    """One part of a selection: the timeCodes from ``first`` to ``last``, inclusive."""

    first: float
    last: float
    step: float | None = None  # None takes every timeCode in between, fractional ones too

    def requested(self) -> tuple[float, ...]:
        """The timeCodes that have to exist: both ends, and all in between if there is a step."""
        steps = 0 if self.step is None else (self.last - self.first + _TOLERANCE) / self.step
        if self.step is None or steps > _MOST_STEPS:
            return self.first, self.last
        return tuple(self.first + n * self.step for n in range(int(steps) + 1))

    def holds(self, time_code: float) -> bool:
        """Whether ``time_code`` belongs to this range."""
        if not self.first - _TOLERANCE <= time_code <= self.last + _TOLERANCE:
            return False
        if self.step is None:
            return True
        n_steps = round((time_code - self.first) / self.step)
        return abs(time_code - self.first - n_steps * self.step) <= _tolerance(n_steps)


def parse_frames(text: str) -> tuple[FrameRange, ...]:
    """The ranges of a text such as ``1-24``, ``1,5,9``, ``1-24x2`` or ``-3-5,7.5``.

    An empty text gives no range, which selects every timeCode.

    >>> parse_frames("-3-5, 8-12x2")
    (FrameRange(first=-3.0, last=5.0, step=None), FrameRange(first=8.0, last=12.0, step=2.0))

    Raises:
        ConfigError: a part is neither a number nor a range, a range runs backwards, or a step is
            not above 0.
    """
    if not text.strip():
        return ()
    return tuple(_parse_part(part.strip(), text) for part in text.split(","))


def select_frames(
    ranges: Sequence[FrameRange], time_codes: Iterable[float]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Which of the existing timeCodes are selected, and which requested ones do not exist.

    A range requests its ends. With a step it requests every timeCode of the step. Without a step,
    it does not say which timeCodes lie in between.

    Args:
        ranges: from ``parse_frames``; none selects everything.
        time_codes: those that exist, in any order.

    Returns:
        The selected timeCodes and the missing ones, both ascending.
    """
    existing = sorted(time_codes)
    if not ranges:
        return tuple(existing), ()
    selected = tuple(code for code in existing if any(part.holds(code) for part in ranges))
    requested = {code: _tolerance(n) for part in ranges for n, code in enumerate(part.requested())}
    missing = (code for code, near in requested.items() if not _is_among(code, existing, near))
    return selected, tuple(sorted(missing))


def describe_gaps(part: FrameRange, selected: Sequence[float], existing: Sequence[float]) -> str:
    """Where a range lacks timeCodes: steps longer than a timeCode and the usual step; or "".

    >>> describe_gaps(FrameRange(1, 6), [1, 2, 4, 5, 6], [1, 2, 4, 5, 6, 7]).partition(".")[0]
    'no timeCode between 2 and 4, in the range 1-6'

    Args:
        part: one with a step has no gaps: what it requests must exist.
        selected: ascending.
        existing: ascending; the usual step is the median of theirs.
    """
    if part.step is not None or len(existing) < 3:
        return ""
    usual = max(1.0, statistics.median(later - code for code, later in pairwise(existing)))
    held = [code for code in selected if part.holds(code)]
    gaps = [pair for pair in pairwise(held) if pair[1] - pair[0] > usual + _TOLERANCE]
    if not gaps:
        return ""
    places = ", ".join(" and ".join(map(format_time_code, gap)) for gap in gaps)
    return (
        f"no timeCode between {places}, in the range {format_time_code(part.first)}-"
        f"{format_time_code(part.last)}. Both ends of a range, and every single timeCode, must "
        "exist; those in between need not"
    )


def find_holes(codes: Sequence[float]) -> list[tuple[float, float]]:
    """Neighbouring timeCodes that lie further apart than most do.

    Two different steps are no rhythm, unless one of them is a whole frame.

    >>> find_holes([1, 2, 3, 7, 8]), find_holes([0, 1, 3]), find_holes([1, 10, 12])
    ([(3, 7)], [(1, 3)], [])
    """
    steps = [round(after - before, 6) for before, after in pairwise(codes)]
    if len(steps) < 2:
        return []
    usual, n_usual = min(Counter(steps).items(), key=lambda item: (-item[1], item[0]))
    if n_usual == 1 and (len(steps) > 2 or usual != 1.0):
        return []  # files at chosen moments
    return [(codes[n], codes[n + 1]) for n, step in enumerate(steps) if step > _GAP * usual]


def _is_among(code: float, existing: Sequence[float], near: float) -> bool:
    place = bisect_left(existing, code - near)
    return place < len(existing) and existing[place] <= code + near


def _tolerance(n_steps: int) -> float:
    """What a timeCode may be off after steps of a length that is written with six decimals."""
    return _TOLERANCE * max(1, n_steps)


def format_time_code(time_code: float) -> str:
    """A timeCode without needless decimals, as ``parse_frames`` reads it.

    >>> format_time_code(7.0), format_time_code(7.5), format_time_code(34 / 11)
    ('7', '7.5', '3.090909')
    """
    text = f"{time_code:.6f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def format_time_codes(time_codes: Iterable[float]) -> str:
    """Many timeCodes in the syntax of ``parse_frames``; three or more at one step form a range.

    >>> format_time_codes([1, 2, 3, 4, 10, 12, 14, 20])
    '1-4,10-14x2,20'
    """
    codes = sorted(time_codes)
    parts = []
    start = 0
    while start < len(codes):
        end = _end_of_run(codes, start)
        if end - start < 2:
            parts.append(format_time_code(codes[start]))
            start += 1
            continue
        step = codes[start + 1] - codes[start]
        suffix = "" if abs(step - 1.0) <= _TOLERANCE else f"x{format_time_code(step)}"
        parts.append(f"{format_time_code(codes[start])}-{format_time_code(codes[end])}{suffix}")
        start = end + 1
    return ",".join(parts)


def name_time_codes(time_codes: Iterable[float]) -> str:
    """The same with the noun: timeCode 7, timeCodes 1-4."""
    codes = list(time_codes)
    return f"timeCode{'s' if len(codes) > 1 else ''} {format_time_codes(codes)}"


def spread(items: Sequence[_Item], count: int = 3) -> list[_Item]:
    """At most ``count`` of some items, at least 2, evenly from the first to the last; in order.

    >>> spread([1, 2, 3, 4, 5, 6, 7])
    [1, 4, 7]
    """
    if len(items) <= count:
        return list(items)
    step = (len(items) - 1) / (count - 1)
    return [items[round(number * step)] for number in range(count)]


def _end_of_run(codes: Sequence[float], start: int) -> int:
    """Index of the last timeCode that follows ``start`` at one constant step."""
    end = min(start + 1, len(codes) - 1)
    while end + 1 < len(codes):
        if abs((codes[end + 1] - codes[end]) - (codes[start + 1] - codes[start])) > _TOLERANCE:
            break
        end += 1
    return end


def _parse_part(part: str, text: str) -> FrameRange:
    where = repr(part) if part == text.strip() else f"{part!r} in {text!r}"
    match = _PART.fullmatch(part)
    if match is None:
        raise ConfigError(
            f"cannot read the frames {where}. Use timeCodes and ranges such as 1-24, 1,5,9, 1-24x2 "
            "or -3-5."
        )
    first = float(match[1])
    last = float(match[2]) if match[2] is not None else first
    step = float(match[3]) if match[3] is not None else None
    if last < first:
        raise ConfigError(
            f"the range {where} runs backwards. "
            f"Put the smaller timeCode first: {match[2]}-{match[1]}."
        )
    if step is not None and step <= 0.0:
        raise ConfigError(f"the step of {where} is {match[3]}. Use a step above 0.")
    return FrameRange(first, last, step)

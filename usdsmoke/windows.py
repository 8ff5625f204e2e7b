"""A sequence of timeCodes cut into frame windows.

A window is the unit of work: its frames are stylized together, each starting from its neighbour's
result, and no window needs another one, so that they can be run anywhere and resumed one by one.
Every frame belongs to exactly one window.
"""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from usdsmoke.config import WindowsConfig
from usdsmoke.errors import ShapeError

__all__ = ["Window", "split_windows"]

_GAP = 2.0  # a step this many times the usual one is a cut: nothing is carried over it


@dataclass(frozen=True)
class Window:
    """A run of neighbouring frames."""

    index: int
    time_codes: tuple[float, ...]  # ascending, at least one


def split_windows(time_codes: Sequence[float], config: WindowsConfig) -> tuple[Window, ...]:
    """Windows of at most ``config.size`` frames, in order; a gap in the sequence ends one early.

    A gap is a step of more than twice the median step: two shots in one volume, or frames left out.

    >>> [window.time_codes for window in split_windows([1, 2, 3, 10, 11], WindowsConfig(size=2))]
    [(1, 2), (3,), (10, 11)]

    Args:
        time_codes: ascending, each once.
        config: section ``windows``.

    Raises:
        ShapeError: the timeCodes do not rise.
    """
    steps = [later - earlier for earlier, later in pairwise(time_codes)]
    if any(not step > 0 for step in steps):
        raise ShapeError(f"timeCodes are {list(time_codes)}; wanted them ascending, each once")
    longest = _GAP * statistics.median(steps) if steps else 0.0
    runs: list[list[float]] = []
    for number, time_code in enumerate(time_codes):
        is_cut = number > 0 and steps[number - 1] > longest
        if not runs or is_cut or len(runs[-1]) == config.size:
            runs.append([])
        runs[-1].append(time_code)
    return tuple(Window(index, tuple(run)) for index, run in enumerate(runs))

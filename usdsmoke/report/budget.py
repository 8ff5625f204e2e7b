"""The time that a report may take, and how its sweeps share it."""

import re
import time
from collections.abc import Callable, Sequence

from usdsmoke.errors import ConfigError

__all__ = ["Budget", "parse_budget"]

_UNITS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}
_LEAST = 1.0  # seconds


def parse_budget(text: str) -> float:
    """Seconds of a duration such as ``5min``, ``300s``, ``1h`` or ``90``.

    >>> parse_budget("5min"), parse_budget("1.5 h"), parse_budget("90")
    (300.0, 5400.0, 90.0)

    Raises:
        ConfigError: it is no duration, or less than a second.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*(s|min|h|)\s*", text)
    seconds = float(found[1]) * _UNITS[found[2]] if found else 0.0
    if seconds < _LEAST:
        raise ConfigError(
            f"cannot take {text!r} as the time of a report; wanted a number of seconds, minutes or "
            "hours, one second at least, as in 300s, 5min or 1h"
        )
    return seconds


class Budget:
    """Seconds from now on.

    Args:
        seconds: how many there are.
        clock: for tests.
    """

    def __init__(self, seconds: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.seconds, self._clock = seconds, clock
        self._began = clock()

    @property
    def spent(self) -> float:
        """Seconds since the beginning."""
        return self._clock() - self._began

    @property
    def left(self) -> float:
        """Seconds that there still are; negative when too many were used."""
        return self.seconds - self.spent

    def until(self, weights: Sequence[float]) -> float:
        """When the first of several sweeps has to end, in seconds from the beginning.

        What it does not use is shared by those that follow.

        Args:
            weights: of this sweep and of all that are still to come.
        """
        return self.spent + max(self.left, 0.0) * weights[0] / sum(weights)

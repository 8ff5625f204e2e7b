"""The time that a report may take, and how its sweeps share it."""

import time
from collections.abc import Callable, Sequence

__all__ = ["Budget"]


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

"""Rays cut into segments that lie in one cell of each lattice."""

from typing import Protocol

import numpy as np
from torch import Tensor

GAUSS = 0.5 / 3**0.5  # distance of the two points from a segment's middle, in its length
OPAQUE = 36.0  # optical depth; less than 3e-16 of the light behind it arrives
PARALLEL = 1e-12  # share of a ray's direction below which it does not cross an axis' planes


class Segments(Protocol):
    """The segments that hold anything and can be seen, sorted by ray and then by distance."""

    ray: np.ndarray  # [M] int64
    length: np.ndarray  # [M] stage units
    thickness: np.ndarray  # [M] optical depth

    def sample(self, index: np.ndarray, low: np.ndarray, high: np.ndarray) -> Tensor:
        """Values at the Gauss points of parts of segments, [m 2 5].

        Args:
            index: [m], which segments.
            low, high: [m], where the parts begin and end, as shares of the segments.
        """


def depth_before(ray: np.ndarray, thickness: np.ndarray) -> np.ndarray:
    """Optical depth in front of each segment on its ray, [M]; sorted by ray and then by distance.

    Args:
        ray, thickness: [M].
    """
    limited = np.minimum(thickness, 2 * OPAQUE)  # sums over all rays keep their digits
    before: np.ndarray = np.cumsum(limited) - limited
    if len(ray) == 0:
        return before
    first = np.flatnonzero(np.diff(ray, prepend=-1))
    counts = np.diff(first, append=len(ray))
    return before - np.repeat(before[first], counts)

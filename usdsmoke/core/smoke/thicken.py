"""Thin smoke made more opaque beside thick smoke, which stays as it is."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.smoke.tasks import run_slices
from usdsmoke.core.smoke.voxels import occupied

_WIDEST = 1e8  # times the density that the search begins at, and its inverse
_STEP = 1.25  # times that density, and its inverse: the first bracket
_TRIALS = 40  # at most; it takes one to five
_CHUNK = 2**16  # values that a thread computes at once, in its cache


@dataclass(frozen=True)
class Thickening:
    """The curve density -> ``times`` knee ln(1 + density / knee), which keeps their order.

    Far below the knee density grows ``times`` as large, and far above it by the logarithm alone.
    The paper has no such curve; decision 064.
    """

    times: float  # >= 1
    knee: float  # density, > 0

    def __call__(self, density: np.ndarray, floor: float = 0.0) -> np.ndarray:
        """The thickened density, any shape, of the same type.

        Args:
            floor: what a simulation leaves everywhere; densities down to it stay as they are, and
                of others what lies above it is thickened.
        """
        flat = density.reshape(-1)
        found = np.empty_like(flat)

        def thicken(part: slice) -> None:
            above = np.maximum(flat[part].astype(np.float64) - floor, 0.0)  # 32 bits hold no ratios
            more = floor + np.log1p(above / self.knee) * (self.times * self.knee)
            found[part] = np.where(above > 0, more, flat[part])

        run_slices(thicken, len(flat), _CHUNK)
        return found.reshape(density.shape)

    def of_frame(self, frame: VolumeFrame) -> VolumeFrame:
        """The frame with all of its density thickened."""
        return replace(frame, density=self.of_field(frame.density))

    def of_field(self, field: DenseField) -> DenseField:
        """The field with all of its values thickened that lie above its floor and background."""
        smoke = occupied(field, np.eye(4))
        if smoke.is_empty:
            return field
        floor = max(smoke.floor, float(np.max(field.background)))
        return replace(field, values=self(field.values, floor))


def find_thickening(
    times: float,
    near: float,
    thickness: Callable[[Thickening], float],
    wanted: float,
    precision: float = 1e-4,
) -> Thickening | None:
    """The curve that keeps the thickness of thick smoke; None without smoke.

    Args:
        times: of the thinnest smoke, above 1.
        near: a density that the knee is near, where the search begins.
        thickness: that thick smoke has behind a curve; it grows with the knee.
        wanted: that it should have, in the same unit.
        precision: up to which it has that, relative.
    """
    if near <= 0 or wanted <= 0:
        return None

    def excess(log_knee: float) -> float:
        return math.log(max(thickness(Thickening(times, math.exp(log_knee))), 1e-300) / wanted)

    # bracket: from no smoke at all to ``times`` as much; then the secant rule of Illinois, which
    # halves the value of an end that stays
    step = math.log(_STEP)
    low, high = math.log(near) - step, math.log(near) + step
    below, above = excess(low), excess(high)
    while below > 0 and low > math.log(near / _WIDEST):
        step *= 2
        high, above = low, below
        low -= step
        below = excess(low)
    while above < 0 and high < math.log(near * _WIDEST):
        step *= 2
        low, below = high, above
        high += step
        above = excess(high)
    middle = low if below == 0 else high
    for _ in range(_TRIALS):
        if below * above >= 0:
            break
        middle = high - above * (high - low) / (above - below)
        found = excess(middle)
        if abs(found) < precision:
            break
        if found * above < 0:
            low, below = high, above
        else:
            below /= 2
        high, above = middle, found
    return Thickening(times, math.exp(middle))

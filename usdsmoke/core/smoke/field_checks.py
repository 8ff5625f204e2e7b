"""What of a frame's fields cannot be used, does not count as smoke, or was replaced."""

import math
from collections.abc import Iterator

import numpy as np

from usdsmoke.base.errors import NonFiniteError
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.smoke.voxels import LEAST_DENSITY

_BESIDE = 0.01  # of the largest density: as much in inactive voxels is no rounding
_MOST_DENSITY = 1e32
_NEGATIVE = 0.01  # of the density: less is what simulations leave behind


def check_fields(frame: VolumeFrame) -> None:
    """Refuse numbers that the core cannot compute with.

    Raises:
        NonFiniteError: NaN, infinity, or a density that is too large.
    """
    for item in (frame.density, frame.velocity, frame.mask):
        if item is None:
            continue
        count = sum(int((~np.isfinite(part)).sum()) for part in (item.values, item.background))
        if count:
            raise NonFiniteError(
                f'{count} values of grid "{item.name}" at timeCode {frame.time_code:g} are NaN or '
                "infinite. Set grids.repair_nan to the value that replaces them."
            )
    largest = float(frame.density.values.max(initial=0.0))
    if largest > _MOST_DENSITY:
        raise NonFiniteError(
            f"the density at timeCode {frame.time_code:g} reaches {largest:.3g}, and sums over it "
            f"leave the range of 32-bit floats above {_MOST_DENSITY:g}. Scale the density down."
        )


def field_warnings(frame: VolumeFrame, density: DenseField, n_voxels: int) -> tuple[str, ...]:
    """What of a frame's fields was replaced, and what of its density does not count as smoke.

    Args:
        density: of the frame, refined.
        n_voxels: that hold smoke.
    """
    values, found = density.values, [*_repairs(frame)]
    if not n_voxels and (values > 0).any():
        found.append(
            f"all densities are below {LEAST_DENSITY:.2g} and count as empty. Scale the density up"
        )
    if density.beside > max(_BESIDE * values.max(initial=0.0), np.max(np.abs(density.background))):
        found.append(
            f"inactive voxels outside the box of the active ones hold densities up to "
            f"{density.beside:.3g} and count as empty. Activate them, or set them to 0, in the "
            "program that writes the file"
        )
    negative = float(-values.clip(max=0).sum(dtype=np.float64))
    if negative > _NEGATIVE * float(np.abs(values).sum(dtype=np.float64)):
        found.append(
            f"more than {_NEGATIVE:.0%} of the density is negative and counts as empty. Check that "
            "it is a fog volume, not a level set"
        )
    return tuple(found)


def _repairs(frame: VolumeFrame) -> Iterator[str]:
    """A sentence for each field with numbers that ``grids.repair_nan`` has replaced.

    Their count is rounded down to a power of ten, so that frames of a shot say the same.
    """
    for item in (frame.density, frame.velocity, frame.mask):
        if item is not None and item.repaired:
            least = 10 ** int(math.log10(item.repaired))
            yield (
                f'grid "{item.name}" has {least:,} or more voxels with NaN or infinity, which '
                "grids.repair_nan has replaced. Correct the simulation"
            )

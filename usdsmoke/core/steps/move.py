"""Density moved by a displacement: with which voxels, how accurately, and with what mass."""

import time

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.frame_report import Estimate, TransportReport
from usdsmoke.base.sections import ShapeConfig
from usdsmoke.base.volume import DenseField
from usdsmoke.core.fields.lattice import Lattice, field_from_box
from usdsmoke.core.fields.potential import Displacement, border_mask
from usdsmoke.core.fields.richardson import warp_error
from usdsmoke.core.fields.transport import correct_mass, warp
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.views.visibility import EffectMask

__all__ = ["PADDING", "effect_on", "move_density", "shares_on"]

PADDING = 2  # empty voxels around the smoke, whose displacement ends at its border
LEAST_SHARE = 1e-6  # of the largest density: less is round-off


def effect_on(density: Tensor, share: Tensor | None) -> Tensor:
    """The share of the displacement that is kept, [I J K]: 0 at the smoke's border.

    Args:
        density: [I J K].
        share: the mask's values there, from ``shares_on``.
    """
    inside = border_mask(density)
    return inside if share is None else inside * share


def shares_on(lattice: Lattice, mask: EffectMask | None, like: Tensor) -> Tensor | None:
    """The mask's values on a box, [I J K], with the dtype and device of ``like``; None without."""
    return None if mask is None else lattice.on_voxels(mask.at, like).to(like)


def move_density(
    density: DenseField,
    source: ActiveSmoke,
    displacement: Displacement,
    shape: ShapeConfig,
    strength: float,
    share: Tensor | None = None,
    is_part: bool = False,
) -> tuple[DenseField, TransportReport]:
    """The full density moved by the accurate scheme, and the errors of that.

    Args:
        density: the frame's (refined) density; ``source`` holds its active voxels.
        displacement: on the box that ``lattice.surround(source, PADDING)`` gives.
        shape: scheme and correction of mass.
        strength: factor of the displacement.
        share: the mask's values on that box; where it is 0 the source stays bit for bit.
        is_part: ``source`` holds only some of the active voxels, and the others are kept.
    """
    # move the box by its share of the displacement
    lattice = displacement.lattice
    box = lattice.fill(source)
    u = lattice.from_stage(displacement.values).mul_(strength)
    largest = float(u.norm(dim=-1).max())
    u.div_(box.new_tensor(lattice.spacing))
    scheme = shape.interpolation
    moved = warp(box, u, scheme=scheme).clamp_min(0)
    # round-off of the spline is not smoke: it would fill the box with active voxels
    moved = torch.where(moved > LEAST_SHARE * box.max(), moved, torch.zeros_like(moved))

    # measure the errors of the scheme
    linear = None
    if scheme != "linear":
        active = torch.nonzero((box > 0) | (moved > 0))
        cheap = warp(box, u[tuple(active.T)], active_ijk=active, scheme="linear")
        difference = (cheap - moved[tuple(active.T)]).abs().sum() / moved.sum().clamp_min(1e-30)
        linear = float(difference)
    started = time.perf_counter()
    error = warp_error(box, u, moved, scheme)
    # where the voxels are too coarse for Richardson's rule, the linear scheme's error is a bound
    value = error.value if linear is None else min(error.value, linear)
    estimate = Estimate(value, time.perf_counter() - started, error.order)
    del u

    # restore the mass, and put the box into the field
    result, mass_error = _with_mass(moved, box, shape.mass_correction, share)
    values, low = result.cpu().numpy(), lattice.low
    if is_part and share is not None:
        values, low = _among_the_rest(density, values, low, (share > 0).cpu().numpy())
    report = TransportReport(
        largest_displacement=largest,
        linear_difference=linear,
        error=estimate,
        mass_error=mass_error,
    )
    return field_from_box(density, values, low), report


def _with_mass(
    moved: Tensor, box: Tensor, is_corrected: bool, share: Tensor | None
) -> tuple[Tensor, float]:
    """The moved density, with the mass it had if that is corrected, and the error before."""
    if share is None:
        corrected, error = correct_mass(moved, box)
        return corrected if is_corrected else moved, error
    # a curl reaches one voxel beyond the mask, and a factor would reach everywhere
    here, result = share > 0, box.clone()
    corrected, error = correct_mass(moved[here], box[here])
    result[here] = corrected if is_corrected else moved[here]
    return result, error


def _among_the_rest(
    density: DenseField, box: np.ndarray, low: np.ndarray, changed: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A field with a box put into it where that is changed, and the index of its first voxel."""
    field_low = np.asarray(density.ijk_min)
    first = np.minimum(low, field_low)
    end = np.maximum(low + box.shape, field_low + density.values.shape)
    values = np.full(tuple(end - first), density.background, np.float32)
    values[_slices(field_low - first, density.values.shape)] = density.values
    part = values[_slices(low - first, box.shape)]
    part[changed] = box[changed]
    return values, first


def _slices(low: np.ndarray, shape: tuple[int, ...]) -> tuple[slice, ...]:
    return tuple(slice(int(a), int(a) + n) for a, n in zip(low, shape, strict=True))

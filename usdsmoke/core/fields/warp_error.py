"""The error of a transported field, estimated from its voxels.

Two things are wrong with a value that is looked up between voxels. The scheme is not exact even for
what voxels can hold, which is every wave longer than two of them; a look-up by the sampling theorem
is, and the difference is this part B. And smoke may hold shorter waves, at edges for instance, of
which its voxels tell nothing. How much that adds shows where every second voxel is left out: there
the true error E is known, and B as well. As smoke is smoother at its own resolution than at half of
it, only a power of the ratio is taken:

    error = B (E / B at half the resolution) ^ 0.75
"""

import torch
from torch import Tensor

from usdsmoke.core.fields.sample import sample_cubic, sample_linear
from usdsmoke.core.fields.transport import Scheme

PLACES = 1024  # at which voxels are compared
HALF_WIDTH = 8  # voxels, of the windowed sinc
KAISER = 8.0  # beta of its window: exact to 1e-4 up to two thirds of the band
POWER = 0.75  # least wrong over 15 densities by both schemes and ``benchmarks/told_true.py``
MOST_RATIO = 10.0  # of E and B; edges of a voxel have 40, of which less is left
_CHUNK = 256


def warp_error(values: Tensor, displacement: Tensor, moved: Tensor, scheme: Scheme) -> float:
    """The mean absolute error of a transported field, relative to its mean.

    Where smoke has detail of one or two voxels, its voxels do not tell what lies between them. The
    estimate is then only an expectation.

    Args:
        values: [I J K], before; at least 0.
        displacement: u, [I J K 3], index units.
        moved: [I J K], what ``transport.warp`` gave by this scheme, with nothing below 0.
        scheme: of ``transport.SCHEMES``.

    Returns:
        0 where nothing is moved, or there is nothing.
    """
    top, active = values.max(), (moved > 0) | (values > 0)
    if not top > 0:
        return 0.0
    at = _some(active)
    wanted = _band_limited(values / top, at.to(values) - displacement[tuple(at.T)]).clamp(0, 1)
    found = (moved[tuple(at.T)] / top).double()
    size, near = float(found.sum()), float((found - wanted).abs().sum())
    if near == 0 or size == 0:
        return 0.0
    return near / size * _ratio_at_half(values / top, active, scheme) ** POWER


def _ratio_at_half(values: Tensor, active: Tensor, scheme: Scheme) -> float:
    """E / B where voxels that are left out are looked up between the others."""
    look_up = sample_linear if scheme == "linear" else sample_cubic
    steps = [2 if n > 1 else 1 for n in values.shape]
    true, known = 0.0, 0.0
    for first in (0, 1):  # a sheet of one voxel is in one of both
        starts = [first if step > 1 else 0 for step in steps]
        kept = tuple(slice(start, None, step) for start, step in zip(starts, steps, strict=True))
        left_out = active.clone()
        left_out[kept] = False
        at, coarse = _some(left_out), values[kept].contiguous()
        places = (at.to(values) - values.new_tensor(starts)) / values.new_tensor(steps)
        found = look_up(coarse, places).clamp(0, 1).double()
        true += float((found - values[tuple(at.T)]).abs().sum())
        known += float((found - _band_limited(coarse, places).clamp(0, 1)).abs().sum())
    return min(max(true / known, 1.0), MOST_RATIO) if known > 0 else MOST_RATIO


def _some(mask: Tensor) -> Tensor:
    """Up to about ``PLACES`` of a mask's voxels, spread evenly, [N 3]."""
    voxels = mask.nonzero()
    return voxels[:: max(1, len(voxels) // PLACES)]


def _band_limited(values: Tensor, positions: Tensor) -> Tensor:
    """Look-up [N] by a sinc in a Kaiser window; zeros around the box."""
    n, lengths = len(positions), values.shape
    offsets = torch.arange(1 - HALF_WIDTH, HALF_WIDTH + 1, device=positions.device)
    indices, weights = [], []
    for axis, length in enumerate(lengths):
        place = positions[:, axis, None]
        if length == 1:
            indices.append(torch.zeros_like(place, dtype=torch.long))
            weights.append(torch.ones_like(place))
            continue
        index = place.floor().long() + offsets
        away = place - index
        window = torch.special.i0(KAISER * (1 - (away / HALF_WIDTH) ** 2).clamp_min(0).sqrt())
        weight = torch.sinc(away) * window
        inside = (index >= 0) & (index < length)
        weights.append(weight / weight.sum(1, keepdim=True) * inside)
        indices.append(index.clamp(0, length - 1))
    found = [values.new_empty(0)]
    for part in torch.arange(n, device=positions.device).split(_CHUNK):
        i, j, k = (index[part] for index in indices)
        around = values[i[:, :, None, None], j[:, None, :, None], k[:, None, None, :]]
        found.append(torch.einsum("nijk,ni,nj,nk->n", around, *(w[part] for w in weights)))
    return torch.cat(found)

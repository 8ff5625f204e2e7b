r"""Displacement fields: made from potentials, and clamped.

A displacement u is [I J K 3], in world units along the grid's axes, on the voxels of its box;
divide by ``spacing`` for index units. Stream function psi and potential phi live on the same
voxels, in world units squared:

    u = curl psi   (moves smoke without compressing it: div u = 0)
    u = grad phi   (compresses and expands it: curl u = 0)

Derivatives are second order: central, and one-sided in the first and the last voxel. Each acts
along one axis only, and operators along different axes commute, so div(curl psi) = 0 and
curl(grad phi) = 0 hold to round-off in every voxel with these differences, whatever the spacing.
Across an axis of length 1 everything is constant and nothing moves along it: in 2-D only the
out-of-plane component of psi has an effect.

``from_stream``, ``from_potential`` and ``from_mixed`` work on a whole box; ``SparseDisplacement``
computes the same at chosen voxels, at a cost that follows their number (decision 010).
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, cast

import torch
from torch import Tensor

from usdsmoke.base.errors import NonFiniteError, ShapeError
from usdsmoke.core.fields.resample import smooth
from usdsmoke.core.fields.sparse_map import (
    AxisMatrix,
    Nodes,
    SparseMap,
    SparseSums,
    Table,
    read_along,
)
from usdsmoke.core.smoke.levels import ranked

DENSE = 0.8  # of the voxels with smoke: denser ones are thick smoke (decision 045)
MIXED_SHARE = 0.5  # of the compressible part in a mixed displacement


def from_stream(psi: Tensor, spacing: Sequence[float]) -> Tensor:
    """u = curl psi, [I J K 3], world units; divergence-free to round-off.

    Args:
        psi: stream function, [I J K 3], world units squared; where an axis has length 1
            also [I J K 1], its component along that axis: in 2-D the out-of-plane one.
        spacing: voxel size along i, j, k, world units, > 0.

    Returns:
        the displacement; 0 along axes of length 1, and everywhere in 1-D.

    Raises:
        ShapeError: psi or spacing does not have that shape or range.

    Gradients: through ``psi``.
    """
    if psi.ndim == 4 and psi.shape[3] == 1 and 1 in psi.shape[:3]:
        zero = torch.zeros_like(psi)
        parts = [psi if psi.shape[axis] == 1 else zero for axis in range(3)]
        psi = torch.cat(parts, dim=3)
    displacement = curl(psi, spacing)
    flat = [axis for axis in range(3) if psi.shape[axis] == 1]
    if not flat:
        return displacement
    moving = torch.ones(3, dtype=psi.dtype, device=psi.device)
    moving[flat] = 0.0
    return displacement * moving


def from_potential(phi: Tensor, spacing: Sequence[float]) -> Tensor:
    """u = grad phi, [I J K 3], world units; curl-free to round-off.

    Args:
        phi: potential, [I J K], world units squared.
        spacing: voxel size along i, j, k, world units, > 0.

    Raises:
        ShapeError: phi or spacing does not have that shape or range.

    Gradients: through ``phi``.
    """
    if phi.ndim != 3:
        raise ShapeError(f"the potential has shape {list(phi.shape)}. Pass [I J K].")
    _check_spacing(spacing)
    return torch.stack([_slope(phi, axis, spacing) for axis in range(3)], dim=-1)


def from_mixed(psi: Tensor, phi: Tensor, spacing: Sequence[float], share: float) -> Tensor:
    """u = share * grad phi + (1 - share) * curl psi, [I J K 3], world units.

    Args:
        psi: as in ``from_stream``.
        phi: as in ``from_potential``, on the same voxels.
        spacing: voxel size along i, j, k, world units, > 0.
        share: of the compressible part, in [0, 1].

    Raises:
        ShapeError: shapes or spacing are not as above.

    Gradients: through ``psi`` and ``phi``.
    """
    if psi.shape[:3] != phi.shape:
        raise ShapeError(
            f"the stream function has shape {list(psi.shape)} and the potential {list(phi.shape)}. "
            "Pass [I J K 3] and [I J K] on the same voxels."
        )
    return share * from_potential(phi, spacing) + (1.0 - share) * from_stream(psi, spacing)


def curl(field: Tensor, spacing: Sequence[float]) -> Tensor:
    """Curl of a vector field [I J K 3] on its voxels, in the field's unit per world unit."""
    _check_vector(field)
    _check_spacing(spacing)
    x, y, z = field.unbind(dim=-1)
    return torch.stack(
        [
            _slope(z, 1, spacing) - _slope(y, 2, spacing),
            _slope(x, 2, spacing) - _slope(z, 0, spacing),
            _slope(y, 0, spacing) - _slope(x, 1, spacing),
        ],
        dim=-1,
    )


def clamp_displacement(displacement: Tensor, cap: float, share: Tensor | None = None) -> Tensor:
    r"""The displacement, smoothly clamped to a length: u / (1 + (|u| / cap)^4)^(1/4).

    Small displacements are kept (0.2 % are lost at 0.3 cap), large ones keep their direction
    and tend to ``cap``; the map is smooth everywhere and one to one.

    Args:
        displacement: [... 3], world units, finite.
        cap: the length that is never reached, world units, > 0.
        share: [...] in [0, 1], the share of the cap that applies at each place; at 0 nothing moves.

    Raises:
        ShapeError: cap is not a positive number.

    Gradients: through ``displacement``, finite at 0 as well.
    """
    if not (math.isfinite(cap) and cap > 0):
        raise ShapeError(f"the displacement's cap is {cap}. Pass a length above 0.")
    squared = (displacement / cap).square().sum(dim=-1, keepdim=True)
    # hypot, because the fourth power of a large displacement overflows
    if share is None:
        return displacement / torch.hypot(torch.ones_like(squared), squared).sqrt()
    allowed = share[..., None]
    # where both the share and the displacement are 0, the quotient must not be 0 / 0
    length = torch.hypot(allowed.clamp_min(1e-6).square(), squared).sqrt()
    return displacement * (allowed / length)


def smooth_mask(density: Tensor, sigma: float | Sequence[float], share: float = 0.25) -> Tensor:
    """Where there is smoke, [I J K] in [0, 1], blurred: 1 inside, 0 a few sigma outside.

    Before the blur the mask is 1 from ``share`` of the density on that a fifth of the voxels
    exceed: the veil around thick smoke is not its border (decision 045). It does not depend on the
    density's unit, nor on how dense that fifth is.

    Args:
        density: [I J K]; negative values are taken as 0.
        sigma: of the Gaussian, voxels, >= 0; one number or one per axis.
        share: > 0.

    Raises:
        ShapeError: density, sigma or share are not as above.
        NonFiniteError: the density holds NaN or infinity.
    """
    if density.ndim != 3:
        raise ShapeError(f"the density has shape {list(density.shape)}. Pass [I J K].")
    if not share > 0:
        raise ShapeError(f"the mask's share is {share}. Pass a number above 0.")
    if not torch.isfinite(density).all():
        raise NonFiniteError(
            "the density given to the mask holds NaN or infinity. Pass finite numbers."
        )
    positive = density.detach().clamp(min=0)
    level = share * ranked(positive[positive > 0], DENSE)
    if not level > 0:
        return torch.zeros_like(positive)
    return smooth((positive / level).clamp(max=1.0), sigma).clamp(0.0, 1.0)


class SparseDisplacement:
    """``potential.unclamped_displacement`` at the active voxels, from those with an effect.

    Args:
        active: voxels at which the displacement is computed.
        nodes: voxels of the same box that hold the potential; one that no active voxel reads has no
            effect and no gradient.
        effect: [I J K] in [0, 1], the potential's share; 0 outside of ``nodes``.
        kind, spacing: see ``unclamped_displacement``.
        n_channels: of the potential: 3 for a stream function (in a slab 1), 1 for a potential, 4
            for both.
    """

    def __init__(
        self,
        active: Nodes,
        nodes: Nodes,
        effect: Tensor,
        kind: str,
        spacing: Sequence[float],
        n_channels: int,
    ) -> None:
        mask = effect.reshape(-1)[nodes.flat]
        axes = [axis for axis in range(3) if active.shape[axis] > 1]
        slopes = {axis: slope_matrix(active.shape[axis], spacing[axis]) for axis in axes}
        forth = {axis: AxisMatrix.of(matrix, mask) for axis, matrix in slopes.items()}
        back = {axis: AxisMatrix.of(matrix.T, mask) for axis, matrix in slopes.items()}
        padded = torch.cat([mask, mask.new_zeros(1)])  # the last for what reads nothing

        def slope(axis: int, part: slice) -> Table:
            place, weight = read_along(active, nodes, axis, forth[axis], part)
            return place, weight * padded[place]

        def transposed(part: slice) -> Table:
            n = part.stop - part.start
            tables = [(active.numbers.new_empty(n, 0), mask.new_empty(n, 0))]
            for number, axis in enumerate(axes):
                place, weight = read_along(nodes, active, axis, back[axis], part)
                place = torch.where(place < 0, -1, place + number * len(active))
                tables.append((place, weight * mask[part, None]))
            places, weights = zip(*tables, strict=True)
            return torch.cat(places, 1), torch.cat(weights, 1)

        self._slopes = SparseMap(
            SparseSums.of(
                max((rows.width for rows in forth.values()), default=0),
                *((len(active), partial(slope, axis)) for axis in axes), like=mask,
            ),
            SparseSums.of(
                sum(rows.width for rows in back.values()),
                (len(nodes), transposed), like=mask,
            ),
        )  # fmt: skip
        self._n_active, self._mixing = len(active), _mixing(kind, active.shape, n_channels)

    def apply(self, potential: Tensor) -> Tensor:
        """The displacement before it is clamped, [N 3] along the axes, stage units.

        Args:
            potential: [n C] at ``nodes``, stage unit^2.

        Gradients: through ``potential``, exact adjoint.
        """
        slopes = self._slopes.apply(potential)
        by_axis = slopes.view(len(self._mixing), self._n_active, potential.shape[1])
        return cast(Tensor, _Mix.apply(by_axis, self._mixing)).T


class _Mix(torch.autograd.Function):
    """Slopes [A N C] along the axes to components [3 N], each a sum of few of them."""

    @staticmethod
    def forward(ctx: Any, slopes: Tensor, mixing: Tensor) -> Tensor:
        ctx.mixing = mixing
        components = slopes.new_zeros(3, slopes.shape[1])
        for a, c, b in torch.nonzero(mixing).tolist():
            components[b].add_(slopes[a, :, c], alpha=float(mixing[a, c, b]))
        return components

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        mixing = ctx.mixing
        slopes = upstream.new_zeros(len(mixing), upstream.shape[1], mixing.shape[1])
        for a, c, b in torch.nonzero(mixing).tolist():
            slopes[a, :, c].add_(upstream[b], alpha=float(mixing[a, c, b]))
        return slopes, None


def _mixing(kind: str, shape: tuple[int, int, int], n_channels: int) -> Tensor:
    """What channel c's slope along an axis a longer than 1 adds to component b, [a c b]."""
    mixing = torch.zeros(3, n_channels, 3, dtype=torch.float64)
    if kind != "potential":
        share = 1.0 if kind == "stream" else 1.0 - MIXED_SHARE
        for b in range(3):
            a, c = (b + 1) % 3, (b + 2) % 3  # u_b = d_a psi_c - d_c psi_a
            for axis, of, sign in ((a, c, share), (c, a, -share)):
                if n_channels > 1:
                    mixing[axis, of, b] += sign
                elif shape[of] == 1:  # the one channel is the component across the slab
                    mixing[axis, 0, b] += sign
    if kind != "stream":
        for axis in range(3):
            mixing[axis, -1, axis] += 1.0 if kind == "potential" else MIXED_SHARE
    mixing[:, :, [axis for axis in range(3) if shape[axis] == 1]] = 0.0  # nothing moves across
    return mixing[[axis for axis in range(3) if shape[axis] > 1]]


def slope_matrix(n: int, spacing: float) -> Tensor:
    """[n n] float64: the derivative that all operators here take along an axis of n voxels."""
    return _slope(torch.eye(n, dtype=torch.float64)[:, :, None], 0, (spacing, 1.0, 1.0))[..., 0]


def _slope(values: Tensor, axis: int, spacing: Sequence[float]) -> Tensor:
    """Derivative of [I J K] values along an axis, second order up to the first and last voxel."""
    n = values.shape[axis]
    if n == 1:
        return torch.zeros_like(values)
    first, second = values.narrow(axis, 0, 1), values.narrow(axis, 1, 1)
    last, before = values.narrow(axis, n - 1, 1), values.narrow(axis, n - 2, 1)
    if n == 2:
        beyond = [2 * first - second, 2 * last - before]
    else:  # the parabola through the three border voxels, one voxel further out
        beyond = [
            3 * (first - second) + values.narrow(axis, 2, 1),
            3 * (last - before) + values.narrow(axis, n - 3, 1),
        ]
    extended = torch.cat([beyond[0], values, beyond[1]], dim=axis)
    return (extended.narrow(axis, 2, n) - extended.narrow(axis, 0, n)) * (0.5 / spacing[axis])


def _check_vector(field: Tensor) -> None:
    if field.ndim != 4 or field.shape[3] != 3:
        raise ShapeError(f"the vector field has shape {list(field.shape)}. Pass [I J K 3].")


def _check_spacing(spacing: Sequence[float]) -> None:
    sizes = [float(size) for size in spacing]
    if len(sizes) != 3 or not all(math.isfinite(size) and size > 0 for size in sizes):
        raise ShapeError(f"the voxel size is {sizes}. Pass three lengths above 0.")

"""From a potential on some voxels of a box to the displacement at others."""

from collections.abc import Sequence
from functools import partial
from typing import Any, cast

import torch
from torch import Tensor

from usdsmoke.core.fields.displacement import slope_matrix
from usdsmoke.core.fields.potential import MIXED_SHARE
from usdsmoke.core.fields.sparse_map import Nodes, SparseMap, SparseSums, Table, Taps, read_along

__all__ = ["SparseDisplacement"]


class SparseDisplacement:
    """What ``potential.free_displacement`` gives at the active voxels, from those with an effect.

    Args:
        active: voxels at which the displacement is wanted.
        nodes: voxels of the same box that hold the potential; one that no active voxel reads moves
            nothing, and gets no gradient.
        effect: [I J K] in [0, 1], the potential's share; 0 outside of ``nodes``.
        kind, spacing: see ``free_displacement``.
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
        forth = {axis: Taps.of(matrix, mask) for axis, matrix in slopes.items()}
        back = {axis: Taps.of(matrix.T, mask) for axis, matrix in slopes.items()}
        padded = torch.cat([mask, mask.new_zeros(1)])  # the last for what reads nothing

        def slope(axis: int, part: slice) -> Table:
            place, weight = read_along(active, nodes, axis, forth[axis], part)
            return place, weight * padded[place]

        def told(part: slice) -> Table:
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
                max((taps.width for taps in forth.values()), default=0),
                *((len(active), partial(slope, axis)) for axis in axes), like=mask,
            ),
            SparseSums.of(
                sum(taps.width for taps in back.values()),
                (len(nodes), told), like=mask,
            ),
        )  # fmt: skip
        self._n_active, self._mixing = len(active), _mixing(kind, active.shape, n_channels)

    def free(self, potential: Tensor) -> Tensor:
        """The displacement before it is held, [N 3] along the axes, stage units.

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

"""Weighted sums over the voxels around index positions: the kernel under ``fields.sample``.

Along each axis a position reads two voxels (hat function) or four (cubic B-spline). The first voxel
is computed once per position; each weight is then a gather from a shifted view of the same flat
array, so a 3-D sum costs 8 or 64 gathers and no index arithmetic. Axes of length 1 are left out.
Positions are processed in chunks that stay in the processor's second-level cache.
"""

import math
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from usdsmoke.core.smoke.memory import add_at, chunks, run_on, share_rows

ADJOINT_BLOCKS = 4  # of positions, at most
GATHER_CHUNK = 65536  # points; measured best of 2^14 ... 2^20


class _AxisWeights(NamedTuple):
    """The weights of the voxels that some positions read along one axis."""

    first: Tensor  # [N] int64, index of the first voxel along the axis
    weights: tuple[Tensor, ...]  # each [N]
    slopes: tuple[Tensor, ...]  # derivatives of the weights by the position; () if not requested


def gather_sum(values: Tensor, positions_ijk: Tensor, cubic: bool) -> Tensor:
    """Weighted sums of the voxels of ``values`` around each position, [N] or [N C].

    Args:
        values: [I J K] or [I J K C]; voxels outside the box are 0.
        positions_ijk: [N 3], finite, same dtype and device.
        cubic: B-spline weights over 4 voxels an axis (``values`` are spline coefficients, and
            positions are clamped to one voxel inside the box) instead of hat functions over 2.

    Gradients: through both tensors, once. On a voxel the slope is the one towards larger indices.
    """
    return _GatherSum.apply(values, positions_ijk, cubic)


def planar(values: Tensor) -> Tensor:
    """The same [... C] with every channel contiguous in memory, for repeated sampling.

    Other layouts are copied into this one by every call of ``gather_sum``.
    """
    return values.movedim(-1, 0).contiguous().movedim(0, -1)


class _GatherSum(torch.autograd.Function):
    """The sum; its Jacobian by the positions is made in the forward pass, from the same gathers."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, positions: Tensor, cubic: bool) -> Tensor:
        flat, strides, axes = _flatten(values)
        planes = _planes(flat)
        want_slopes = ctx.needs_input_grad[1]
        sums = flat.new_empty((len(planes), len(positions)))
        jacobian = flat.new_zeros((3, *sums.shape)) if want_slopes else None

        def gather(part: slice) -> None:
            base, by_axis = _find_weights(
                positions[part], values.shape, strides, axes, cubic, want_slopes
            )
            for channel, plane in enumerate(planes):
                terms = _weighted_sum(plane, base, strides, by_axis)
                sums[channel, part] = terms[0]
                if jacobian is not None:
                    for axis, slope in zip(axes, terms[1:], strict=True):
                        jacobian[axis, channel, part] = slope

        share_rows(gather, len(positions), GATHER_CHUNK, positions.device)
        ctx.shape, ctx.cubic = values.shape, cubic
        ctx.save_for_backward(positions if ctx.needs_input_grad[0] else None, jacobian)
        return sums.T if flat.ndim == 2 else sums[0]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_sums: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        positions, jacobian = ctx.saved_tensors
        grad_planes = _planes(grad_sums)
        grad_values = grad_positions = None
        if ctx.needs_input_grad[0]:
            grad_values = _adjoint(grad_planes, positions, ctx.shape, ctx.cubic)
        if ctx.needs_input_grad[1]:
            by_axis = torch.empty_like(jacobian[:, 0])

            def multiply(part: slice) -> None:
                by_axis[:, part] = (jacobian[..., part] * grad_planes[:, part]).sum(dim=1)

            n = grad_planes.shape[1]
            share_rows(multiply, n, GATHER_CHUNK, grad_planes.device)
            grad_positions = by_axis.T
        return grad_values, grad_positions, None


def _adjoint(grad_planes: Tensor, positions: Tensor, shape: torch.Size, cubic: bool) -> Tensor:
    """What each voxel's weight is in all sums together, weighted with ``grad_planes`` [C N].

    Threads share a fixed number of blocks of positions. Neighbours in the list are neighbours in
    the box, so each block adds up the part of the box that it reads, and little is added twice.
    """
    n_voxels = shape[:3].numel()
    strides, axes = _layout(shape)
    size = max(-(-len(positions) // ADJOINT_BLOCKS), GATHER_CHUNK)
    blocks = list(chunks(len(positions), size, positions.device))

    def add_block(block: slice) -> tuple[int, Tensor]:
        low, high = 0, n_voxels
        if axes and len(blocks) > 1:
            least, most = torch.aminmax(positions[block, axes[0]])
            low = min(max(math.floor(least) - 1, 0), shape[axes[0]] - 1 - cubic) * strides[0]
            high = min(max(math.floor(most) + 3, 2 + cubic), shape[axes[0]]) * strides[0]
        sums = grad_planes.new_zeros(len(grad_planes), high - low)
        for part in chunks(block.stop - block.start, GATHER_CHUNK, positions.device):
            here = slice(block.start + part.start, block.start + part.stop)
            base, by_axis = _find_weights(
                positions[here], shape, strides, axes, cubic, want_slopes=False
            )
            for plane, grad_plane in zip(sums, grad_planes, strict=True):
                _add_weighted(plane, base - low, strides, by_axis, grad_plane[here])
        return low, sums

    found = run_on(positions.device, [partial(add_block, block) for block in blocks])
    if len(found) == 1:
        return found[0][1].T.reshape(shape)
    planes = grad_planes.new_zeros(len(grad_planes), n_voxels)
    for low, sums in found:
        planes[:, low : low + sums.shape[1]].add_(sums)
    return planes.T.reshape(shape)


def _layout(shape: torch.Size) -> tuple[list[int], list[int]]:
    """Strides (in voxels) and numbers of the axes longer than 1."""
    lengths = shape[:3]
    axes = [axis for axis in range(3) if lengths[axis] > 1]
    return [lengths[axis + 1 :].numel() for axis in axes], axes


def _flatten(values: Tensor) -> tuple[Tensor, list[int], list[int]]:
    """``values`` as [voxels] or [voxels C], and its layout."""
    return values.reshape(-1, *values.shape[3:]), *_layout(values.shape)


def _planes(flat: Tensor) -> Tensor:
    """[N] or [N C] as [C N], each channel contiguous: three times faster to gather from."""
    return flat[None].contiguous() if flat.ndim == 1 else flat.T.contiguous()


def _find_weights(
    positions: Tensor,
    shape: torch.Size,
    strides: list[int],
    axes: list[int],
    cubic: bool,
    want_slopes: bool,
) -> tuple[Tensor, list[_AxisWeights]]:
    """The flat index of each position's first voxel, and its weights along the given axes."""
    find = _spline_weights if cubic else _hat_weights
    by_axis = [find(positions[:, axis].contiguous(), shape[axis], want_slopes) for axis in axes]
    base = torch.zeros(len(positions), dtype=torch.int64, device=positions.device)
    for along, stride in zip(by_axis, strides, strict=True):
        base.add_(along.first, alpha=stride)
    return base, by_axis


def _hat_weights(position: Tensor, length: int, want_slopes: bool) -> _AxisWeights:
    """Hat functions of the two voxels that surround a position, or lie nearest to it."""
    floor = position.floor().clamp_(0, length - 2)
    right = position - floor  # in [0, 1] inside the box, beyond it outside
    if position.device.type == "cpu" and _is_within(right):  # the same bits in half the time
        one = torch.ones_like(right)
        return _AxisWeights(floor.long(), (1 - right, right), (-one, one) if want_slopes else ())
    weights = (
        torch.minimum(1 - right, 1 + right).clamp_(min=0),
        torch.minimum(right, 2 - right).clamp_(min=0),
    )
    if not want_slopes:
        return _AxisWeights(floor.long(), weights, ())
    inside = ((right >= 0) & (right <= 1)).to(position.dtype)
    entering = ((right > -1) & (right < 0)).to(position.dtype)
    leaving = ((right > 1) & (right < 2)).to(position.dtype)
    return _AxisWeights(floor.long(), weights, (entering - inside, inside - leaving))


def _is_within(right: Tensor) -> bool:
    low, high = torch.aminmax(right)
    return bool(low >= 0) and bool(high <= 1)


def _spline_weights(position: Tensor, length: int, want_slopes: bool) -> _AxisWeights:
    """Cubic B-spline weights of four neighbouring voxels."""
    clamped = position.clamp(1, length - 2)
    floor = clamped.floor().clamp_(1, length - 3)
    t = clamped - floor
    s = 1 - t
    weights = (
        s * s * s / 6,
        (t * t * (3 * t - 6) + 4) / 6,
        (s * s * (3 * s - 6) + 4) / 6,
        t * t * t / 6,
    )
    base = floor.long() - 1
    if not want_slopes:
        return _AxisWeights(base, weights, ())
    slopes = (-s * s / 2, t * (1.5 * t - 2), s * (2 - 1.5 * s), t * t / 2)
    return _AxisWeights(base, weights, slopes)


def _weighted_sum(
    plane: Tensor, base: Tensor, strides: list[int], by_axis: list[_AxisWeights]
) -> list[Tensor]:
    """[sum, its slope along each axis...]; no slopes if the weights have none."""
    if not by_axis:
        return [plane.index_select(0, base)]
    sums: list[Tensor] = []
    for step, weight in enumerate(by_axis[0].weights):
        inner = _weighted_sum(plane[step * strides[0] :], base, strides[1:], by_axis[1:])
        factors, terms = [weight], inner[:1]
        if by_axis[0].slopes:
            factors += [by_axis[0].slopes[step], *[weight] * (len(inner) - 1)]
            terms = [inner[0], *inner]
        if not sums:
            sums = [factor * term for factor, term in zip(factors, terms, strict=True)]
        else:
            for total, factor, term in zip(sums, factors, terms, strict=True):
                total.addcmul_(factor, term)
    return sums


def _add_weighted(
    plane: Tensor, base: Tensor, strides: list[int], by_axis: list[_AxisWeights], amounts: Tensor
) -> None:
    """The adjoint of ``_weighted_sum``: adds weighted ``amounts`` to ``plane``."""
    if not by_axis:
        add_at(plane, base, amounts)
        return
    for step, weight in enumerate(by_axis[0].weights):
        _add_weighted(plane[step * strides[0] :], base, strides[1:], by_axis[1:], weight * amounts)

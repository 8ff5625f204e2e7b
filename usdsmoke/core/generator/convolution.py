"""Convolutions of 3 x 3 x 3 over voxels that hold smoke, with the same bits for any threads.

A voxel's neighbours are gathered into a row, and rows are multiplied with the weights, a fixed
number of rows at a time, so that their memory does not grow with the frame. The gradient is the
same gather with the weights turned around, because being a neighbour is mutual.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

from usdsmoke.core.smoke.memory import chunks, run_on, share_rows

ROWS = 2**12  # voxels at a time
LANES = 64  # numbers that torch computes at once, or a multiple of them
FEWEST = 64  # rows of a product: for fewer, BLAS sums in another order


def convolve(values: Tensor, neighbours: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """Sums over the neighbours of values times weights, [N D].

    Args:
        values: [N C].
        neighbours: [N 27], see ``Level``.
        weight: [27 C D].
        bias: [D].

    Gradients: through ``values``, ``weight`` and ``bias``, of first order.
    """
    return cast(Tensor, _Convolve.apply(values, neighbours, weight, bias))


def row_product(rows: Tensor, weight: Tensor) -> Tensor:
    """``rows @ weight`` of [n C] and [C D]; on a CPU a row has the same bits among any others."""
    n = len(rows)
    if n < FEWEST:  # without this look, all rows would be copied
        rows = F.pad(rows, (0, 0, 0, FEWEST - n))
    return (rows @ weight)[:n]


def by_number(function: Callable[[Tensor], Tensor], values: Tensor) -> Tensor:
    """A function of each number, with the same bits wherever it stands in the tensor.

    torch computes the last few numbers of a tensor one by one, which rounds in another way.
    """
    n = values.numel()
    return function(F.pad(values.reshape(-1), (0, -n % LANES)))[:n].view(values.shape)


class _Convolve(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, values: Tensor, neighbours: Tensor, weight: Tensor, bias: Tensor
    ) -> Tensor:
        ctx.save_for_backward(values, neighbours, weight)
        return _gathered_product(values, neighbours, weight) + bias

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, None, Tensor, Tensor]:
        values, neighbours, weight = ctx.saved_tensors
        slopes = None
        if ctx.needs_input_grad[0]:
            turned = weight.flip(0).transpose(1, 2)
            slopes = _gathered_product(upstream, neighbours, turned)
        table = _with_zeros(values)

        def correlate(part: slice) -> Tensor:
            return _gather(table, neighbours[part]).T @ upstream[part]

        parts = chunks(len(values), ROWS, values.device)
        products = run_on(values.device, [partial(correlate, part) for part in parts])
        steep = products[0]
        for product in products[1:]:
            steep = steep + product
        return slopes, None, steep.view(weight.shape), upstream.sum(0)


def _gathered_product(values: Tensor, neighbours: Tensor, weight: Tensor) -> Tensor:
    table, flat = _with_zeros(values), weight.reshape(-1, weight.shape[2])
    found = values.new_empty(len(values), weight.shape[2])

    def multiply(part: slice) -> None:
        found[part] = row_product(_gather(table, neighbours[part]), flat)

    share_rows(multiply, len(values), ROWS, values.device)
    return found


def _with_zeros(values: Tensor) -> Tensor:
    """The table with one row more, which stands for voxels without smoke."""
    return torch.cat([values, values.new_zeros(1, values.shape[1])])


def _gather(table: Tensor, neighbours: Tensor) -> Tensor:
    """The neighbours' values side by side, [n 27 C] as [n 27C]."""
    rows = table.index_select(0, neighbours.reshape(-1))
    return rows.view(len(neighbours), -1)

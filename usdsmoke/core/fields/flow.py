r"""The flow of a velocity over a unit of time: a displacement that does not fold space.

A displacement of several voxels that turns within a few voxels folds: det(I - grad u) <= 0, where
some smoke is read twice and some by nobody. The flow of a field, whatever the field, is one to one
[Arsigny2006]. Here the field is followed in 2^n equal steps by n compositions,

    u_0(x) = v(x) / 2^n,    u_{k+1}(x) = u_k(x) + u_k(x - u_k(x)),

with trilinear look-ups, so |u| never exceeds the largest |v|. What can still fold is what voxels do
not resolve: where the flow is sheared by several voxels from one voxel to the next
(``folding.py``).
"""

from functools import partial
from typing import Any, cast

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from usdsmoke.core.fields.sample import sample_linear, voxel_positions
from usdsmoke.core.fields.sparse_map import Nodes
from usdsmoke.core.smoke.memory import run_on

DOUBLINGS = 2  # n


def flow(velocity: Tensor) -> Tensor:
    """The displacement of a velocity, [I J K 3], index units, 0 beyond the box.

    Args:
        velocity: [I J K 3], index units per unit of time.
    """
    arrivals = voxel_positions(velocity.shape, velocity)
    u = velocity.reshape(-1, 3) / 2**DOUBLINGS
    for _ in range(DOUBLINGS):
        u = u + sample_linear(u.view(velocity.shape), arrivals - u)
    return u.view(velocity.shape)


def flow_at(velocity: Tensor, active: Nodes, arrivals: Tensor) -> Tensor:
    """The displacement [N 3] of a velocity that is 0 outside of the active voxels, index units.

    Args:
        velocity: [N 3] at the active voxels, index units per unit of time.
        active: voxels of a box.
        arrivals: [N 3], their positions.

    Gradients: through ``velocity``.
    """
    u = velocity / 2**DOUBLINGS
    for _ in range(DOUBLINGS):
        box = cast(Tensor, _Filled.apply(u, active)).view(3, *active.shape)
        u = u + sample_linear(box.movedim(0, -1), arrivals - u)
    return u


class _Filled(torch.autograd.Function):
    """A box [3 V] of values [N 3] at its active voxels, 0 elsewhere.

    Component by component, because that is how look-ups take them; threads share these.

    Gradients: through ``values``, once.
    """

    @staticmethod
    def forward(ctx: Any, values: Tensor, active: Nodes) -> Tensor:
        ctx.active = active
        box = values.new_zeros(3, len(active.numbers))

        def fill(axis: int) -> None:
            box[axis].index_copy_(0, active.flat, values[:, axis])

        run_on(values.device, [partial(fill, axis) for axis in range(3)])
        return box

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        flat = ctx.active.flat
        rows = upstream.new_empty(3, len(flat))

        def take(axis: int) -> None:
            torch.index_select(upstream[axis], 0, flat, out=rows[axis])

        run_on(upstream.device, [partial(take, axis) for axis in range(3)])
        return rows.T, None

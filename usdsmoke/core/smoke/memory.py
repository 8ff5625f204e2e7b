"""Work in bounded memory: long tensors in chunks, lazy lists, sums whose graph is freed by term."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Generic, TypeVar, cast, overload

import torch
from torch import Tensor

CHUNK_ROWS = 2**14  # voxels or sums in a chunk, unless a module has measured a better size
GPU_CHUNK_FACTOR = 256  # times as many on a GPU, where every chunk costs time

Item = TypeVar("Item")
Term = Callable[[Tensor], Tensor]


def chunks(n: int, size: int, device: torch.device) -> Iterator[slice]:
    """Slices that make up 0 to n - 1, ``size`` each; more each on a GPU."""
    size *= 1 if device.type == "cpu" else GPU_CHUNK_FACTOR
    for first in range(0, n, size):
        yield slice(first, min(first + size, n))


class LazyList(Sequence[Item], Generic[Item]):
    """``make(0)`` ... ``make(n - 1)``, each made when it is first read, and kept.

    For a pool of views, for example: a short optimisation draws few of them.
    """

    def __init__(self, n: int, make: Callable[[int], Item]) -> None:
        self._n, self._make = n, make
        self._made: dict[int, Item] = {}

    def __len__(self) -> int:
        return self._n

    @overload
    def __getitem__(self, index: int) -> Item: ...

    @overload
    def __getitem__(self, index: slice) -> list[Item]: ...

    def __getitem__(self, index: int | slice) -> Item | list[Item]:
        if isinstance(index, slice):
            return [self[number] for number in range(*index.indices(self._n))]
        number = range(self._n)[index]  # raises out of range; below 0 from the end
        if number not in self._made:
            self._made[number] = self._make(number)
        return self._made[number]


class _Accumulate(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, shared: Tensor, terms: Iterable[Term]) -> Tensor:
        total, gradient = shared.new_zeros(()), None
        for term in terms:
            with torch.enable_grad():
                leaf = shared.detach().requires_grad_(ctx.needs_input_grad[0])
                value = term(leaf)
                if leaf.requires_grad and value.requires_grad:
                    (found,) = torch.autograd.grad(value, leaf, materialize_grads=True)
                    # not in place: a gradient may be one number, expanded
                    gradient = found if gradient is None else gradient + found
            total = total + value.detach()
        ctx.save_for_backward(torch.zeros_like(shared) if gradient is None else gradient)
        return total

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return upstream * gradient, None


def accumulate(shared: Tensor, terms: Iterable[Term]) -> Tensor:
    """Sum of scalar functions of one tensor; the graph of each term is freed at once.

    Nine pictures of one smoke then take the memory of one, and the graph that leads to the smoke
    itself is differentiated once, not nine times.

    Args:
        shared: any shape.
        terms: functions of ``shared`` alone: gradients to other tensors are not followed.

    Gradients: through ``shared``; exact, of first order only.
    """
    return cast(Tensor, _Accumulate.apply(shared, terms))

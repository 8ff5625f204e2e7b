"""Work in bounded memory: long tensors in chunks, lazy lists, sums whose graph is freed by term."""

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any, Generic, TypeVar, cast, overload

import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.smoke.tasks import run_beside, run_tasks

CHUNK_ROWS = 2**14  # voxels or sums in a chunk, unless a module has measured a better size
SHARED_ROWS = 2**17  # sums that a thread does at once
GPU_CHUNK_FACTOR = 256  # times as many on a GPU, where every chunk costs time

Item = TypeVar("Item")
Term = Callable[[Tensor], Tensor]
Run = Callable[[Sequence[Callable[[], Any]]], Sequence[Any]]


def chunks(n: int, size: int, device: torch.device) -> Iterator[slice]:
    """Slices that make up 0 to n - 1, ``size`` each; more each on a GPU."""
    size *= 1 if device.type == "cpu" else GPU_CHUNK_FACTOR
    for first in range(0, n, size):
        yield slice(first, min(first + size, n))


def run_on(device: torch.device, tasks: Sequence[Callable[[], Item]]) -> list[Item]:
    """What tasks return, in their order; threads share them, but not on a GPU.

    There Python only queues the work, and its threads wait for each other (decision 067).
    """
    return run_tasks(tasks) if device.type == "cpu" else [task() for task in tasks]


def share_rows(work: Callable[[slice], None], n: int, size: int, device: torch.device) -> None:
    """``work(part)`` for the slices of ``chunks``, see ``run_on``."""
    run_on(device, [partial(work, part) for part in chunks(n, size, device)])


def elementwise(work: Callable[..., Tensor], first: Tensor, *others: Tensor) -> Tensor:
    """``work(first, *others)`` of tensors of one shape, number by number; threads share them.

    Gradients: none.
    """
    flat = [tensor.reshape(-1) for tensor in (first, *others)]
    found = torch.empty_like(flat[0])

    def compute(part: slice) -> None:
        found[part] = work(*(tensor[part] for tensor in flat))

    share_rows(compute, len(found), SHARED_ROWS, found.device)
    return found.view(first.shape)


def add_at(total: Tensor, index: Tensor, values: Tensor) -> None:
    """``total[index] += values`` in place, in a fixed order, which takes a sort on a GPU."""
    if total.device.type == "cpu":
        total.index_add_(0, index, values)
    else:
        total.index_put_((index.long(),), values, accumulate=True)


def sums_of(number: Tensor, values: Tensor, n: int) -> Tensor:
    """The sums of values [N] that have the same number, [n], in a fixed order."""
    if values.device.type == "cpu":
        return torch.bincount(number, values, minlength=n)
    sums = values.new_zeros(n)
    add_at(sums, number, values)
    return sums


def weighted_rows(table: Tensor, index: Tensor, start: Tensor, weight: Tensor) -> Tensor:
    """Weighted sums of rows of a table [n C], each over a run of entries, [m C]; no gradients.

    Args:
        index: [E], the row that an entry reads.
        start: [m], the first entry of each sum.
        weight: [E].
    """
    table, m = table.contiguous(), len(start)
    found = table.new_empty(m, table.shape[1])

    def add(part: slice) -> None:
        first = int(start[part.start]) if part.start else 0
        last = int(start[part.stop]) if part.stop < m else len(index)
        entries, runs, weights = index[first:last], start[part] - first, weight[first:last]
        if table.device.type == "cpu":
            found[part] = _sparse_rows(runs, entries, weights, len(table)) @ table
        else:  # in a fixed order
            found[part] = F.embedding_bag(
                entries, table, runs, mode="sum", per_sample_weights=weights
            )

    share_rows(add, m, SHARED_ROWS, table.device)
    return found


def _sparse_rows(start: Tensor, column: Tensor, weight: Tensor, n_columns: int) -> Tensor:
    """A sparse matrix by its rows; its product takes half the time of ``embedding_bag``."""
    ends = torch.cat([start, start.new_tensor([len(column)])])
    size = (len(start), n_columns)
    return torch.sparse_csr_tensor(ends, column, weight, size=size, check_invariants=False)


with warnings.catch_warnings():  # torch tells once that its sparse matrices may change
    warnings.simplefilter("ignore")
    _sparse_rows(torch.tensor([0]), torch.tensor([0]), torch.zeros(1), 1)


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

    def prepare(self, numbers: Iterable[int]) -> None:
        """Make some items, which threads share, before they are read."""
        missing = [number for number in numbers if number not in self._made]
        made = run_tasks([partial(self._make, number) for number in missing])
        self._made.update(zip(missing, made, strict=True))


class _Accumulate(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, shared: Tensor, terms: Iterable[Term], run: Run) -> Tensor:
        needs_gradient = ctx.needs_input_grad[0]

        def evaluate(term: Term) -> tuple[Tensor, Tensor | None]:
            with torch.enable_grad():
                leaf = shared.detach().requires_grad_(needs_gradient)
                value = term(leaf)
                if not (leaf.requires_grad and value.requires_grad):
                    return value.detach(), None
                (found,) = torch.autograd.grad(value, leaf, materialize_grads=True)
                return value.detach(), found

        total, gradient = shared.new_zeros(()), None
        for value, found in run([partial(evaluate, term) for term in terms]):
            total = total + value
            if found is not None:
                # not in place: a gradient may be one number, expanded
                gradient = found if gradient is None else elementwise(torch.add, gradient, found)
        ctx.save_for_backward(torch.zeros_like(shared) if gradient is None else gradient)
        return total

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None]:
        (gradient,) = ctx.saved_tensors
        if upstream.device.type == "cpu" and float(upstream) == 1:
            return gradient.contiguous(), None, None
        return elementwise(lambda part: part * upstream, gradient), None, None


def accumulate(shared: Tensor, terms: Iterable[Term]) -> Tensor:
    """Sum of scalar functions of one tensor, which threads share; a term's graph is freed at once.

    Nine pictures of one smoke then take the memory of one for each thread, and the graph that leads
    to the smoke itself is differentiated once, not nine times.

    Args:
        shared: any shape.
        terms: functions of ``shared`` alone: gradients to other tensors are not followed.

    Gradients: through ``shared``; exact, of first order only.
    """
    return cast(Tensor, _Accumulate.apply(shared, terms, partial(run_on, shared.device)))


def accumulate_beside(shared: Tensor, first: Term, second: Term) -> Tensor:
    """``accumulate`` of two functions, of which the first one's own work is shared as well.

    For a picture's loss and a penalty: a thread computes the second one, and then takes part in
    the first.
    """

    def run(tasks: Sequence[Callable[[], Item]]) -> Sequence[Item]:
        return run_beside(*tasks) if shared.device.type == "cpu" else run_on(shared.device, tasks)

    return cast(Tensor, _Accumulate.apply(shared, (first, second), run))

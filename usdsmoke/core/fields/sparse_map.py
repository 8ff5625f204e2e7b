"""Sparse linear maps between some nodes of lattices, and their exact adjoints.

A separable operator, an interpolation or a derivative, is a small matrix along each axis; on a
whole box ``fields.resample`` multiplies with it. If few nodes of a box have values, the same matrix
is applied to those alone: entries that read other nodes are dropped. Both directions are stored as
runs of entries and summed run by run, so results are reproducible bit by bit.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import torch
from torch import Tensor

from usdsmoke.core.smoke.memory import CHUNK_ROWS, chunks, weighted_rows

Table = tuple[Tensor, Tensor]


@dataclass(frozen=True)
class Nodes:
    """Some nodes of a lattice; ``numbers`` is as large as the box: do not keep it."""

    shape: tuple[int, int, int]
    flat: Tensor  # [n] int64, ascending: their numbers in C order among all of the lattice
    numbers: Tensor  # [I*J*K] int32: a node's place in ``flat``, -1 for all others

    @classmethod
    def where(cls, mask: Tensor) -> "Nodes":
        """Where a mask [I J K] bool is set."""
        flat = torch.nonzero(mask.reshape(-1)).squeeze(1)
        numbers = torch.full((mask.numel(),), -1, dtype=torch.int32, device=mask.device)
        numbers[flat] = torch.arange(len(flat), dtype=torch.int32, device=mask.device)
        i, j, k = mask.shape
        return cls((i, j, k), flat, numbers)

    def __len__(self) -> int:
        return len(self.flat)


@dataclass(frozen=True)
class SparseSums:
    """Weighted sums of rows of a table: m of them, each over a run of the entries."""

    index: Tensor  # [E] int32 (int64 where there are too many), the row that an entry reads
    weight: Tensor  # [E]
    start: Tensor  # [m], the first entry of each sum

    @classmethod
    def of(
        cls, width: int, *blocks: tuple[int, Callable[[slice], Table]], like: Tensor
    ) -> "SparseSums":
        """From functions that give tables [m K] of the rows that some of a block's sums read.

        Args:
            width: the largest K.
            blocks: how many sums each has, and its function; an index below 0 reads nothing.
            like: dtype and device of the weights.
        """
        n_sums = sum(n for n, _ in blocks)
        kind = torch.int32 if n_sums * width < 2**31 else torch.int64
        index, weight = like.new_empty(n_sums * width, dtype=kind), like.new_empty(n_sums * width)
        start = like.new_empty(n_sums, dtype=kind)
        done = end = 0
        for n, tables in blocks:
            for part in chunks(n, CHUNK_ROWS, like.device):
                indices, weights = tables(part)
                there = indices >= 0
                counts = there.sum(1)
                after = torch.cumsum(counts, 0) + end
                start[done : done + len(counts)] = after - counts
                chosen, done = indices.masked_select(there), done + len(counts)
                index[end : end + len(chosen)] = chosen
                weight[end : end + len(chosen)] = weights.masked_select(there)
                end += len(chosen)
        return cls(index[:end].clone(), weight[:end].clone(), start)

    def __call__(self, table: Tensor) -> Tensor:
        """[m C] from [n C]; without gradients."""
        if len(self.index) == 0:
            return table.new_zeros(len(self.start), table.shape[1])
        return weighted_rows(table.detach(), self.index, self.start, self.weight)

    def transposed(self, n: int) -> "SparseSums":
        """The transpose: ``n`` sums over what reads each of n rows."""
        n_entries, counts = len(self.index), torch.bincount(self.index, minlength=n)
        ends = torch.cat([self.start[1:], self.start.new_tensor([n_entries])])
        sums = torch.arange(len(self.start), dtype=self.index.dtype, device=self.index.device)
        reader = torch.repeat_interleave(sums, (ends - self.start).long())
        order = torch.argsort(self.index, stable=True)
        start = (torch.cumsum(counts, 0) - counts).to(self.start.dtype)
        return SparseSums(reader[order], self.weight[order], start)


class _Apply(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor, linear: "SparseMap") -> Tensor:
        ctx.linear = linear
        return linear.forth(values)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        return ctx.linear.back(upstream), None


@dataclass(frozen=True)
class SparseMap:
    """A linear map from n to m rows; ``back`` is the transpose of ``forth``."""

    forth: SparseSums
    back: SparseSums

    def apply(self, values: Tensor) -> Tensor:
        """[m C] of values [n C]. Gradients: through ``values``, exact adjoint."""
        return cast(Tensor, _Apply.apply(values, self))


@dataclass(frozen=True)
class AxisMatrix:
    """A matrix along an axis, row by row: what each row reads, padded to the longest."""

    n_columns: int
    column: Tensor  # [n_rows K] int64
    weight: Tensor  # [n_rows K], 0 where a row reads less than others

    @classmethod
    def of(cls, matrix: Tensor, like: Tensor) -> "AxisMatrix":
        """Of a matrix [n_rows n_columns], with the dtype and device of ``like``."""
        row, column = torch.nonzero(matrix).T
        counts = torch.bincount(row, minlength=len(matrix))
        slot = torch.arange(len(row)) - (torch.cumsum(counts, 0) - counts)[row]
        width = max(1, int(counts.max()))
        columns = torch.zeros(len(matrix), width, dtype=torch.int64)
        weights = matrix.new_zeros(len(matrix), width)
        columns[row, slot] = column
        weights[row, slot] = matrix[row, column]
        return cls(matrix.shape[1], columns.to(like.device), weights.to(like))

    @property
    def width(self) -> int:
        """Of the longest row."""
        return self.column.shape[1]

    def numbers(self, rows: Nodes, axis: int, part: slice) -> tuple[Tensor, Tensor]:
        """For some of the nodes: the numbers of those they read among all of a lattice, and the
        weights, [m K] each."""
        inner, n_rows = torch.Size(rows.shape[axis + 1 :]).numel(), len(self.column)
        row = torch.div(rows.flat[part], inner, rounding_mode="floor")
        outer = torch.div(row, n_rows, rounding_mode="floor")
        along = row - outer * n_rows
        first = rows.flat[part] + inner * (outer * self.n_columns - row)
        columns = (inner * self.column).index_select(0, along)
        return columns.add_(first[:, None]), self.weight.index_select(0, along)


def nodes_read(rows: Nodes, axis: int, matrix: AxisMatrix) -> Nodes:
    """The nodes that are read for ``rows`` along an axis."""
    shape = _with_length(rows.shape, axis, matrix.n_columns)
    needed = torch.zeros(shape, dtype=torch.bool, device=rows.flat.device)
    for part in chunks(len(rows), CHUNK_ROWS, rows.flat.device):
        numbers, weight = matrix.numbers(rows, axis, part)
        needed.view(-1).index_fill_(0, numbers.masked_select(weight != 0), True)
    return Nodes.where(needed)


def read_along(rows: Nodes, columns: Nodes, axis: int, matrix: AxisMatrix, part: slice) -> Table:
    """What some of the ``rows`` read from ``columns`` along an axis.

    Returns:
        Places in ``columns.flat`` [m K] int32, -1 where there is nothing to read, and the weights.
    """
    numbers, weight = matrix.numbers(rows, axis, part)
    places = columns.numbers.index_select(0, numbers.view(-1)).view(numbers.shape)
    return places.masked_fill_(weight == 0, -1), weight


def map_along(rows: Nodes, columns: Nodes, axis: int, matrix: Tensor, like: Tensor) -> SparseMap:
    """A matrix [n_rows n_columns] along an axis, between nodes; all others are 0."""
    return SparseMap(
        _sums_along(rows, columns, axis, matrix, like),
        _sums_along(columns, rows, axis, matrix.T, like),
    )


def _sums_along(rows: Nodes, columns: Nodes, axis: int, matrix: Tensor, like: Tensor) -> SparseSums:
    sparse = AxisMatrix.of(matrix, like)
    block = (len(rows), partial(read_along, rows, columns, axis, sparse))
    return SparseSums.of(sparse.width, block, like=like)


def _with_length(shape: tuple[int, int, int], axis: int, length: int) -> tuple[int, int, int]:
    i, j, k = (length if a == axis else n for a, n in enumerate(shape))
    return i, j, k

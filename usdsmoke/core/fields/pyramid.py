"""Coefficient pyramids: a field as a sum of coefficient fields, coarse to fine.

Optimising the levels instead of the voxels lets coarse structure form first and keeps speckle out.
A displacement reads the potential only where the effect is above 0. The nodes of each level are
those that the interpolation to the next finer one reads, found once, axis by axis; all others
always have a gradient of 0. The cost is therefore proportional to these nodes, not to the box.
Values and gradients are those of ``expand_levels`` at these nodes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from usdsmoke.base.errors import ShapeError
from usdsmoke.core.fields.resample import interpolation_matrix, upsample
from usdsmoke.core.fields.sparse_map import AxisMatrix, Nodes, SparseMap, map_along, nodes_read


@dataclass(frozen=True)
class LevelNodes:
    """Which nodes of a pyramid's levels have coefficients; coarse to fine."""

    shapes: Sequence[tuple[int, int, int]]  # of the levels' lattices
    flats: Sequence[Tensor]  # [n] each: the nodes' numbers in C order among all of their lattice

    def zeros(self, n_channels: int, like: Tensor) -> list[Tensor]:
        """Coefficients of all levels' nodes, [n C] each, with the dtype and device of ``like``."""
        return [like.new_zeros(len(flat), n_channels) for flat in self.flats]

    def take(self, boxes: Sequence[Tensor]) -> list[Tensor]:
        """The nodes' values [n C] of dense levels [i j k C]."""
        return [
            box.reshape(-1, box.shape[-1])[flat]
            for box, flat in zip(boxes, self.flats, strict=True)
        ]

    def fill(self, levels: Sequence[Tensor]) -> list[Tensor]:
        """Dense levels [i j k C] of the nodes' values [n C], 0 elsewhere."""
        boxes = []
        for shape, flat, level in zip(self.shapes, self.flats, levels, strict=True):
            box = level.new_zeros(*shape, level.shape[-1])
            box.view(-1, level.shape[-1])[flat] = level.detach()
            boxes.append(box)
        return boxes


class SparsePyramid:
    """The nodes of a pyramid that the chosen voxels of its finest level depend on.

    Args:
        nodes: the chosen voxels of the finest level.
        n_levels: as of ``pyramid_shapes``.
        like: dtype and device of the coefficients.
    """

    def __init__(self, nodes: Nodes, n_levels: int, like: Tensor) -> None:
        shapes, flats = pyramid_shapes(nodes.shape, n_levels), [nodes.flat]
        self._steps: list[list[SparseMap]] = []  # from each level to the next finer one
        for coarse in shapes[-2::-1]:
            step: list[SparseMap] = []
            for axis in (2, 1, 0):  # neighbours along k lie next to each other
                matrix = interpolation_matrix(nodes.shape[axis], coarse[axis], "cubic")
                if matrix is not None:
                    read = nodes_read(nodes, axis, AxisMatrix.of(matrix, like))
                    step.insert(0, map_along(nodes, read, axis, matrix, like))
                    nodes = read
            self._steps.insert(0, step)
            flats.insert(0, nodes.flat)
        #: without the maps between them
        self.nodes = LevelNodes(shapes, flats)

    def expand(self, levels: Sequence[Tensor]) -> Tensor:
        """The field at the chosen voxels, [n C]. Gradients: through ``levels``, exact adjoint."""
        total = levels[0]
        for step, level in zip(self._steps, levels[1:], strict=True):
            for linear in step:
                total = linear.apply(total)
            total = total + level
        return total

    def chosen(self, box: Tensor) -> Tensor:
        """A box's values [I J K C] at the chosen voxels, [n C]."""
        return box.reshape(-1, box.shape[-1])[self.nodes.flats[-1]]


def pyramid_shapes(shape: Sequence[int], n_levels: int) -> list[tuple[int, int, int]]:
    """Lattice shapes of a pyramid, each half of the next finer one; the last is ``shape``.

    Args:
        shape: I, J, K of the finest level.
        n_levels: most levels, >= 1; a small box has fewer.

    Raises:
        ShapeError: a number is out of range.
    """
    finest: tuple[int, ...] = tuple(int(n) for n in tuple(shape)[:3])
    if n_levels < 1 or len(finest) != 3 or min(finest) < 1:
        raise ShapeError(
            f"cannot make a pyramid of {n_levels} levels on {list(finest)} voxels. Pass at least "
            "1 level and at least 1 voxel along 3 axes."
        )
    shapes: list[tuple[int, ...]] = [finest]
    while len(shapes) < n_levels:
        coarser = tuple(max(min(n, 2), math.ceil(n / 2)) for n in shapes[0])
        if coarser == shapes[0]:
            break
        shapes.insert(0, coarser)
    return [(i, j, k) for i, j, k in shapes]


def expand_levels(levels: Sequence[Tensor]) -> Tensor:
    """The field of a pyramid on the whole box, [I J K C] on the finest level's lattice.

    Every level is added to the upsampled sum of the coarser ones, so the whole costs little more
    than one upsampling to the finest lattice. The upsampling is cubic, because the derivative of a
    potential is needed.

    Args:
        levels: coarse to fine, each [i j k C]; see ``pyramid_shapes``.

    Gradients: through ``levels``.
    """
    total = levels[0]
    for level in levels[1:]:
        total = upsample(total, level.shape) + level
    return total

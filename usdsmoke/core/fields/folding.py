r"""Where a displacement folds space or reads smoke unevenly.

The moved density is d(x - u(x)). Where det(I - grad u) <= 0 the map x - u folds: neighbours swap
sides, and smoke is read several times. Where it is far from 1 smoke is thinned out or piled up. A
sum over all voxels hides both. Derivatives are central differences, as a voxel sees its neighbours.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from usdsmoke.core.fields.displacement import slope_matrix
from usdsmoke.core.fields.gather import gather_sum
from usdsmoke.core.fields.sparse_map import Nodes, SparseMap, map_along
from usdsmoke.core.smoke.memory import chunks

LEAST_DETERMINANT = 0.3  # below it a voxel is penalised
STEEPEST = 4.0  # below 0 by more than this the penalty is flat: its slope would drown all others
UNREAD, TWICE = 0.05, 2.0  # how often a voxel is read, of 1
CHUNK = 2**16  # voxels


@dataclass(frozen=True)
class Evenness:
    """How evenly a displacement reads smoke; shares of 0 to 1."""

    folded: float  # of the voxels with smoke, those with det <= 0
    unread: float  # of the mass, that of which less than a twentieth is read
    read_twice: float  # of the mass, that which is read more than twice


class FoldingPenalty:
    """Mean over the smoke's voxels of max(0, 0.3 - det(I - grad u))^2, linear far from 0.

    Args:
        smoke: voxels that it is taken over.
        active: voxels with a displacement; it is 0 elsewhere.
        like: dtype and device.
    """

    def __init__(self, smoke: Nodes, active: Nodes, like: Tensor) -> None:
        self._slopes: list[SparseMap | None] = [
            map_along(smoke, active, axis, slope_matrix(n, 1.0), like) if n > 1 else None
            for axis, n in enumerate(smoke.shape)
        ]

    def __call__(self, u: Tensor) -> Tensor:
        """Of a displacement [N 3] at the active voxels, index units. Gradients: through it."""
        found = determinants([None if s is None else s.apply(u) for s in self._slopes])
        short = (LEAST_DETERMINANT - found).clamp(0, LEAST_DETERMINANT + STEEPEST)
        return softened(short).mean()


def softened(values: Tensor) -> Tensor:
    """x^2 near 0, 2 |x| far out: no outlier owns the mean. [Charbonnier1994]"""
    return 2 * (torch.hypot(torch.ones_like(values), values) - 1)


def determinants(slopes: Sequence[Tensor | None]) -> Tensor:
    """det(I - grad u), [N].

    Args:
        slopes: of the displacement along i, j and k, [N 3] each; None along axes one voxel long.

    Raises:
        ValueError: all three are None.
    """
    like = next((slope for slope in slopes if slope is not None), None)
    if like is None:
        raise ValueError("a single voxel has no slopes")
    unit = torch.eye(3, dtype=like.dtype, device=like.device)
    a, b, c = (
        axis.expand_as(like) if slope is None else axis - slope
        for axis, slope in zip(unit, slopes, strict=True)
    )
    return (a * torch.linalg.cross(b, c)).sum(dim=-1)


def measure_evenness(displacement: Tensor, density: Tensor) -> Evenness:
    """How evenly a displacement reads the smoke of a box.

    Args:
        displacement: [I J K 3], index units.
        density: [I J K], before it is moved.
    """
    smoke = torch.nonzero(density > 0)
    if not len(smoke) or density.numel() == 1:
        return Evenness(0.0, 0.0, 0.0)
    n_folded = sum(
        int((determinants(_slopes_at(displacement, smoke[part])) <= 0).sum())
        for part in chunks(len(smoke), CHUNK, density.device)
    )
    counts = _read_counts(displacement)[density > 0]
    mass = density[density > 0].double()
    mass = mass / mass.sum()
    return Evenness(
        n_folded / len(smoke),
        float(mass[counts < UNREAD].sum()),
        float(mass[counts > TWICE].sum()),
    )


def _slopes_at(field: Tensor, ijk: Tensor) -> list[Tensor | None]:
    """Central differences of a box [I J K 3] at voxels [N 3]; one-sided at the box's faces."""
    slopes: list[Tensor | None] = []
    for axis in range(3):
        last = field.shape[axis] - 1
        if last == 0:
            slopes.append(None)
            continue
        after, before = ijk.clone(), ijk.clone()
        after[:, axis] = (ijk[:, axis] + 1).clamp(max=last)
        before[:, axis] = (ijk[:, axis] - 1).clamp(min=0)
        difference = field[tuple(after.T)] - field[tuple(before.T)]
        slopes.append(difference / (after[:, axis] - before[:, axis])[:, None])
    return slopes


def _read_counts(displacement: Tensor) -> Tensor:
    """How often each voxel is read by trilinear look-ups at x - u(x), [I J K]."""
    shape = displacement.shape[:3]
    counts = displacement.new_zeros(shape, requires_grad=True)
    rests = (displacement == 0).all(dim=-1)
    moving = torch.nonzero(~rests)
    # component by component, because that is how the look-up takes them
    places = moving.T.to(displacement, memory_format=torch.contiguous_format).T
    departures = places - displacement[tuple(moving.T)]
    with torch.enable_grad():
        gather_sum(counts, departures, cubic=False).sum().backward()
    assert counts.grad is not None  # a box has voxels
    return counts.grad + rests

"""A dense box around the smoke of one octave, on which potentials and displacements live."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from usdsmoke.core.sample import sample_linear
from usdsmoke.core.smoke import ActiveSmoke, densify
from usdsmoke.errors import PlanError
from usdsmoke.volume import DenseField

__all__ = ["Lattice", "field_from_box", "reachable_voxels", "surround"]

LONGEST = 4096  # voxels along an axis: blurs and pyramids take a square matrix of that size


@dataclass(frozen=True)
class Lattice:
    """Voxels ``low`` .. ``low + shape - 1`` of an octave, in its own index space."""

    low: np.ndarray  # [3] int64
    shape: tuple[int, int, int]
    index_to_stage: np.ndarray  # [4 4]

    @property
    def spacing(self) -> tuple[float, float, float]:
        """Voxel edge lengths along i, j, k, stage units."""
        sides = np.linalg.norm(self.index_to_stage[:3, :3], axis=1)
        return float(sides[0]), float(sides[1]), float(sides[2])

    def positions(self, ijk: Tensor | None = None) -> Tensor:
        """Stage positions [N 3] float64 of voxels [N 3] of the box, or of all of them in order."""
        if ijk is None:
            axes = [torch.arange(n) for n in self.shape]
            ijk = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        matrix = torch.as_tensor(self.index_to_stage, device=ijk.device)
        low = torch.as_tensor(self.low, device=ijk.device)
        return (ijk + low).double() @ matrix[:3, :3] + matrix[3, :3]

    def fill(self, smoke: ActiveSmoke) -> Tensor:
        """The smoke's density as a dense box [I J K]."""
        low = torch.as_tensor(self.low, device=smoke.ijk.device)
        return densify(smoke.ijk, smoke.density[:, None], low, self.shape)[..., 0]

    def sample(self, values: Tensor, positions: Tensor) -> Tensor:
        """Box values [I J K C] at stage positions [N 3]; the border value continues outside."""
        matrix = torch.as_tensor(np.linalg.inv(self.index_to_stage), device=positions.device)
        low = torch.as_tensor(self.low, device=positions.device)
        place = positions @ matrix[:3, :3] + matrix[3, :3] - low
        return sample_linear(values, place.to(values.dtype), boundary="nearest")


def surround(smoke: ActiveSmoke, reach: float) -> Lattice:
    """The box of the smoke with room for it to move by ``reach`` stage units.

    Axes one voxel thick stay so: what is flat moves in its plane.

    Raises:
        PlanError: the box is too long to be dense; smoke in places far apart.
    """
    low, high = smoke.box
    sides = np.linalg.norm(smoke.index_to_stage[:3, :3], axis=1)
    room = np.where(high > low, np.ceil(reach / sides).astype(np.int64) + 1, 0)
    shape = tuple(int(n) for n in high - low + 1 + 2 * room)
    if max(shape) > LONGEST:
        raise PlanError(
            f"the shape step needs a dense box of {' x '.join(map(str, shape))} voxels around the "
            f"smoke; it takes at most {LONGEST} along an axis: split smoke in places far apart into "
            "Volumes of their own, or leave the shape step out with optimize.steps=[colour]"
        )
    return Lattice(low - room, shape, smoke.index_to_stage)  # type: ignore[arg-type]


def reachable_voxels(density: Tensor, reach: tuple[int, int, int]) -> Tensor:
    """Voxels [N 3] of a box [I J K] to which smoke can come.

    They are the active ones, dilated by ``reach`` whole voxels along i, j, k.
    """
    grown = density > 0
    for axis, steps in enumerate(reach):
        if steps:  # as running counts, whose cost does not grow with the reach
            n = grown.shape[axis]
            none = torch.zeros_like(grown.narrow(axis, 0, 1), dtype=torch.int32)
            counts = torch.cat([none, grown.cumsum(axis, dtype=torch.int32)], axis)
            place = torch.arange(n, device=grown.device)
            first = counts.index_select(axis, (place - steps).clamp_min(0))
            grown = counts.index_select(axis, (place + steps + 1).clamp_max(n)) > first
    return torch.nonzero(grown)


def field_from_box(like: DenseField, values: np.ndarray, ijk_min: np.ndarray) -> DenseField:
    """A field with another box of values, trimmed to what differs from the background."""
    filled = np.argwhere(values != like.background)
    if len(filled):
        first, last = filled.min(0), filled.max(0)
        values = values[tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))]
        ijk_min = ijk_min + first
    else:
        values, ijk_min = np.zeros((0, 0, 0), np.float32), np.zeros(3, np.int64)
    return DenseField(
        like.name,
        np.ascontiguousarray(values, np.float32),
        tuple(int(n) for n in ijk_min),  # type: ignore[arg-type]
        like.index_to_world,
        like.background,
        like.grid_class,
        like.half,
        like.metadata,
    )

"""A dense box around the smoke of one octave, on which displacements are computed."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import cast

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.base.errors import PlanError
from usdsmoke.base.volume import DenseField
from usdsmoke.core.fields.sample import Boundary, sample_linear
from usdsmoke.core.smoke.active import ActiveSmoke, densify
from usdsmoke.core.smoke.memory import chunks, run_on

LATTICE_CHUNK = 2**16  # voxels
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

    def matrices_from(self, coarse: "Lattice") -> list[Tensor]:
        """Matrices [I i] float64 that interpolate linearly from another lattice along each axis.

        Beyond its box there is 0, as with ``sample``; it is constant along an axis of length 1.

        Args:
            coarse: of the same axes; it may have another place and spacing.
        """
        to_coarse, found = self.index_to_stage @ np.linalg.inv(coarse.index_to_stage), []
        for axis, (n, length) in enumerate(zip(self.shape, coarse.shape, strict=True)):
            if length == 1:
                found.append(torch.ones(n, 1, dtype=torch.float64))
                continue
            index = torch.arange(n, dtype=torch.float64) + int(self.low[axis])
            place = index * to_coarse[axis, axis] + to_coarse[3, axis] - int(coarse.low[axis])
            place = place.round(decimals=9)  # round-off would read one more voxel
            away = (place[:, None] - torch.arange(length, dtype=torch.float64)).abs()
            found.append((1 - away).clamp_min(0))
        return found

    def positions(self, ijk: Tensor | None = None) -> Tensor:
        """Stage positions [N 3] float64 of voxels [N 3] of the box, or of all of them in order."""
        if ijk is None:
            axes = [torch.arange(n) for n in self.shape]
            ijk = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        matrix = torch.as_tensor(self.index_to_stage, device=ijk.device)
        low = torch.as_tensor(self.low, device=ijk.device)
        return (ijk + low).double() @ matrix[:3, :3] + matrix[3, :3]

    def on_voxels(
        self, at: Callable[[Tensor], Tensor], like: Tensor, where: Tensor | None = None
    ) -> Tensor:
        """The values of a function of position on the voxels of the box, [I J K ...], by chunks.

        Args:
            at: stage positions [n 3] float64 -> [n ...]; called from several threads, and once
                more for the first voxel, whose value tells the shape.
            like: gives the device of the positions.
            where: [I J K] bool, voxels that get a value; the others are 0. None: all.
        """
        n_voxels = math.prod(self.shape)
        chosen = None if where is None else torch.nonzero(where.reshape(-1)).squeeze(1)

        def values_of(flat: Tensor) -> Tensor:
            ij, k = flat // self.shape[2], flat % self.shape[2]
            return at(self.positions(torch.stack([ij // self.shape[1], ij % self.shape[1], k], -1)))

        one = values_of(torch.zeros(1, dtype=torch.int64, device=like.device))
        found = one.new_zeros((n_voxels, *one.shape[1:]))

        def put(part: slice) -> None:
            if chosen is not None:
                found[chosen[part]] = values_of(chosen[part])
            else:
                found[part] = values_of(torch.arange(part.start, part.stop, device=like.device))

        n_chosen = n_voxels if chosen is None else len(chosen)
        parts = chunks(n_chosen, LATTICE_CHUNK, like.device)
        run_on(like.device, [partial(put, part) for part in parts])
        return found.view(*self.shape, *found.shape[1:])

    def to_stage(self, vectors: Tensor) -> Tensor:
        """Vectors [... 3] with lengths along the grid's axes, stage units, as stage vectors."""
        return vectors @ torch.as_tensor(self._axes, dtype=vectors.dtype, device=vectors.device)

    def from_stage(self, vectors: Tensor) -> Tensor:
        """Stage vectors [... 3] as lengths along the grid's axes; 0 along axes one voxel long."""
        matrix = np.linalg.inv(self._axes) * (np.array(self.shape) > 1)
        return vectors @ torch.as_tensor(matrix, dtype=vectors.dtype, device=vectors.device)

    @property
    def _axes(self) -> np.ndarray:
        return self.index_to_stage[:3, :3] / np.array(self.spacing)[:, None]

    def fill(self, smoke: ActiveSmoke) -> Tensor:
        """The smoke's density as a dense box [I J K]."""
        low = torch.as_tensor(self.low, device=smoke.ijk.device)
        return densify(smoke.ijk, smoke.density[:, None], low, self.shape)[..., 0]

    def index_of(self, positions: Tensor) -> Tensor:
        """Stage positions [N 3] float64 in voxels of the box, of which the first is (0, 0, 0)."""
        matrix = torch.as_tensor(np.linalg.inv(self.index_to_stage), device=positions.device)
        low = torch.as_tensor(self.low, device=positions.device)
        return positions @ matrix[:3, :3] + matrix[3, :3] - low

    def sample(self, values: Tensor, positions: Tensor, beyond: Boundary = "nearest") -> Tensor:
        """Box values [I J K C] at stage positions [N 3]; ``beyond``: see ``fields.sample``."""
        place = self.index_of(positions)
        return sample_linear(values, place.to(values.dtype), boundary=beyond)


def surround(smoke: ActiveSmoke, padding: int | Sequence[int]) -> Lattice:
    """The box of the smoke with ``padding`` empty voxels around, one number or one per axis.

    Axes one voxel thick get no padding: flat smoke moves in its plane.

    Raises:
        PlanError: the box is too long to be dense; smoke in places far apart, or flat voxels.
    """
    low, high = smoke.box
    margin = np.where(high > low, padding, 0)
    shape = tuple(int(n) for n in high - low + 1 + 2 * margin)
    if max(shape) > LONGEST:
        what = "Split smoke in places far apart into Volumes of their own"
        if max(high - low) < LONGEST:  # the room around it is what is long
            what = (
                f"Its voxels are {_edges_text(smoke)} stage units long: correct their transform "
                "if that is not meant"
            )
        raise PlanError(
            f"the shape step needs a dense box of {' x '.join(map(str, shape))} voxels around the "
            f"smoke, more than {LONGEST} along an axis. {what}, or leave the shape step out with "
            "optimize.steps=[colour]."
        )
    return Lattice(low - margin, cast(tuple[int, int, int], shape), smoke.index_to_stage)


def _edges_text(smoke: ActiveSmoke) -> str:
    return " x ".join(f"{edge:.3g}" for edge in np.linalg.norm(smoke.edges, axis=1))


def grow(mask: Tensor, by: Sequence[int] = (1, 1, 1)) -> Tensor:
    """A mask [I J K] of a box, grown by some voxels along each axis, corners included."""
    return largest_near(mask.float(), by) > 0


def largest_near(values: Tensor, by: Sequence[int]) -> Tensor:
    """The largest of a box's values [I J K] up to ``by`` voxels away along each axis."""
    found = values[None, None]
    for axis in range(3):
        padding = [by[axis] if other == axis else 0 for other in range(3)]
        sizes = [2 * n + 1 for n in padding]
        found = F.max_pool3d(found, sizes, stride=1, padding=padding)
    return found[0, 0]


def field_from_box(like: DenseField, values: np.ndarray, ijk_min: np.ndarray) -> DenseField:
    """A field with another box of values, trimmed to what differs from the background."""
    differs = values != np.asarray(like.background, np.float32)
    filled = np.argwhere(differs.any(-1) if differs.ndim == 4 else differs)
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

"""The active voxels of a frame, and the same smoke at half the resolution."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.volume import DenseField
from usdsmoke.core.smoke.memory import SHARED_ROWS, share_rows, sums_of
from usdsmoke.core.smoke.schedule import OCTAVE_SCALE
from usdsmoke.core.smoke.voxels import Placed, Voxels, occupied

MOST_EXTENT = 5.0  # edges of a cube as large as the smoke
MOST_SPARSE = 4  # times as many cells as voxels; from there on a table takes longer than a sort
NEARLY = 0.02  # of a doubling: voxels that are nearly cubes have edges of slightly different length


@dataclass(frozen=True)
class ActiveSmoke(Placed):
    """Voxels that hold smoke: nothing in the core touches the empty rest of the box.

    ``ijk`` are absolute voxel indices of this resolution, so that neither noise nor octaves depend
    on how the box was cropped. Voxels lie in lexicographic order.
    """

    ijk: Tensor  # [N 3] int64
    density: Tensor  # [N], > 0
    index_to_stage: np.ndarray  # [4 4]

    def take(self, chosen: Tensor) -> "ActiveSmoke":
        """Some of the voxels; chosen is [N] bool."""
        return ActiveSmoke(self.ijk[chosen], self.density[chosen], self.index_to_stage)

    def to(self, device: torch.device) -> "ActiveSmoke":
        """The same on a device."""
        return ActiveSmoke(self.ijk.to(device), self.density.to(device), self.index_to_stage)

    @property
    def is_empty(self) -> bool:
        """Whether there is no voxel."""
        return len(self.ijk) == 0

    @property
    def voxels(self) -> Voxels:
        """The same as numpy arrays; on the CPU they share memory."""
        return Voxels(self.ijk.cpu().numpy(), self.density.cpu().numpy(), self.index_to_stage)

    @property
    def positions(self) -> Tensor:
        """Voxel centres, [N 3] float64, stage space."""
        matrix = torch.as_tensor(self.index_to_stage, dtype=torch.float64, device=self.ijk.device)
        return self.ijk.double() @ matrix[:3, :3] + matrix[3, :3]

    @cached_property
    def outline(self) -> np.ndarray:
        """Centres of the voxels that begin or end a row along k, [M 3], stage space.

        The largest and the smallest of all voxels in any direction are among them. A million
        voxels have some ten thousand.
        """
        rows = self.ijk[:, :2]
        begins = torch.ones(len(rows), dtype=torch.bool, device=rows.device)
        begins[1:] = (rows[1:] != rows[:-1]).any(1)
        ends = torch.ones_like(begins)
        ends[:-1] = begins[1:]
        return self.take(begins | ends).positions.cpu().numpy()

    @cached_property
    def extent(self) -> float:
        """The usual length, stage units, but at most ``MOST_EXTENT`` edges of a cube (of a square,
        for a slab) that is as large as all voxels: stray voxels far away make no smoke large.
        """
        low, high = self.box
        sides = np.linalg.norm(self.index_to_stage[:3, :3], axis=1)[high > low]
        if not sides.size:
            return self.longest_side
        edge = float(len(self.ijk) * np.prod(sides)) ** (1 / sides.size)
        return min(self.voxels.usual_length, MOST_EXTENT * edge)

    @cached_property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest active index, [3] each."""
        return self.ijk.amin(0).cpu().numpy(), self.ijk.amax(0).cpu().numpy()


def activate(density: DenseField, to_stage: np.ndarray, device: torch.device) -> ActiveSmoke:
    """``occupied`` on a device of torch's."""
    found = occupied(density, to_stage)
    ijk, values = (torch.from_numpy(part).to(device) for part in (found.ijk, found.density))
    return ActiveSmoke(ijk, values, found.index_to_stage)


def flat_key(ijk: Tensor, low: Tensor, shape: Tensor) -> Tensor:
    """The number of each voxel [N 3] in a box, in C order, [N]."""
    shifted = ijk - low
    return (shifted[:, 0] * shape[1] + shifted[:, 1]) * shape[2] + shifted[:, 2]


def coarsen(smoke: ActiveSmoke, divisor: Tensor | None = None) -> ActiveSmoke:
    """The smoke at half the resolution along every axis that has more than one voxel; mass is kept.

    Args:
        divisor: [3], 2 along each axis that is halved, else 1; None: see ``divisor_of``.

    Blocks are aligned to even absolute indices, and the coarse transform maps block centres, so
    column integrals of density agree between octaves.
    """
    if len(smoke.ijk) == 0:
        return smoke
    divisor = divisor_of(smoke) if divisor is None else divisor
    factor, shift = divisor.cpu().numpy(), divisor - 1  # a shift rounds down, also below 0
    low, high = (torch.as_tensor(end, device=shift.device) >> shift for end in smoke.box)
    shape = high - low + 1
    keys, inverse = _distinct(flat_key(smoke.ijk >> shift, low, shape), int(shape.prod()))
    sums = sums_of(inverse, smoke.density.double(), len(keys))
    density = (sums / float(np.prod(factor))).to(smoke.density.dtype)
    ijk = torch.stack(
        [keys // (shape[1] * shape[2]), keys // shape[2] % shape[1], keys % shape[2]], dim=1
    )
    block_to_index = np.diag([*factor, 1.0]).astype(float)
    block_to_index[3, :3] = (factor - 1) / 2  # the centre of a block of 2 lies between its voxels
    return ActiveSmoke(ijk + low, density, block_to_index @ smoke.index_to_stage)


def _distinct(keys: Tensor, n: int) -> tuple[Tensor, Tensor]:
    """The different keys, ascending, and the place of each key among them; keys are below ``n``."""
    if n > MOST_SPARSE * len(keys):  # a table of all would be too long
        return torch.unique(keys, return_inverse=True)
    there = torch.zeros(n, dtype=torch.bool, device=keys.device)
    there[keys] = True
    return torch.nonzero(there).squeeze(1), (torch.cumsum(there, 0) - 1)[keys]


def divisor_of(smoke: ActiveSmoke) -> Tensor:
    """2 along each axis with more than one voxel, else 1, [3]; the smoke is not empty."""
    low, high = smoke.box
    return torch.as_tensor(np.where(high > low, 2, 1), device=smoke.ijk.device)


def block_of(smoke: ActiveSmoke, coarse: ActiveSmoke, divisor: Tensor) -> Tensor:
    """The row in ``coarsen(smoke, divisor)`` of each voxel's block, [N]."""
    return rows_at(coarse, torch.div(smoke.ijk, divisor, rounding_mode="floor"))


def rows_at(smoke: ActiveSmoke, ijk: Tensor) -> Tensor:
    """The rows [N] of voxels by their indices [N 3]; the smoke has them all."""
    first = smoke.ijk.amin(0)
    shape = smoke.ijk.amax(0) - first + 1
    known = flat_key(smoke.ijk, first, shape)  # ascending, as ``activate`` and ``coarsen`` order
    return torch.searchsorted(known, flat_key(ijk, first, shape))


def densify(ijk: Tensor, values: Tensor, low: Tensor, shape: Sequence[int]) -> Tensor:
    """Voxel values [N C] as a dense box [I J K C], zero elsewhere."""
    dense = values.new_zeros(shape[0] * shape[1] * shape[2], values.shape[1])
    dense[flat_key(ijk, low, torch.as_tensor(shape, device=ijk.device))] = values
    return dense.view(*shape, -1)


def sample_colours(smoke: ActiveSmoke, colours: Tensor, positions: Tensor) -> tuple[Tensor, Tensor]:
    """Colours at points, trilinear between the voxels that hold smoke, and how much smoke is near.

    Empty voxels take no part (normalised weights), so nothing bleeds in from outside the smoke.

    Args:
        colours: [N C], at the smoke's voxels.
        positions: [P 3], stage space, float64.

    Returns:
        [P C], and the trilinear weight of active voxels [P 1] in [0, 1]; the colour is 0 where
        that is 0.
    """
    matrix = torch.as_tensor(np.linalg.inv(smoke.index_to_stage), device=positions.device)
    low = smoke.ijk.amin(0) - 1
    shape = tuple(int(n) for n in (smoke.ijk.amax(0) - low + 2))
    ones = torch.ones_like(colours[:, :1])
    box = densify(smoke.ijk, torch.cat([colours, ones], 1), low, shape).view(
        -1, colours.shape[1] + 1
    )
    limit, stride = (
        torch.tensor(of, device=positions.device)
        for of in ([n - 1 for n in shape], [shape[1] * shape[2], shape[2], 1])
    )
    summed = box.new_zeros(len(positions), box.shape[1])

    def add(part: slice) -> None:
        place = positions[part] @ matrix[:3, :3] + matrix[3, :3] - low
        base = torch.floor(place)
        share = (place - base).to(colours.dtype)
        # along each axis: rows and weights of the voxels before and behind the point
        ends = [torch.minimum((base.long() + end).clamp_min(0), limit) for end in (0, 1)]
        rows = [(end * stride).T.contiguous() for end in ends]
        weights = [near.T.contiguous() for near in (1 - share, share)]
        for i, j, k in itertools.product((0, 1), repeat=3):
            weight = weights[i][0] * weights[j][1] * weights[k][2]
            summed[part] += weight[:, None] * box[rows[i][0] + rows[j][1] + rows[k][2]]

    share_rows(add, len(positions), SHARED_ROWS, positions.device)
    near = summed[:, -1:]
    return summed[:, :-1] / near.clamp_min(1e-12), near


def blocks_in(pixel_size: float, smoke: ActiveSmoke) -> int:
    """How many times voxels can be joined two by two and still be no longer than a pixel."""
    low, high = smoke.box
    longest = max(np.linalg.norm(smoke.edges, axis=1)[high > low], default=pixel_size)
    return max(0, math.floor(math.log2(pixel_size / longest) + NEARLY))


def make_octaves(smoke: ActiveSmoke, n: int, divisor: Tensor | None = None) -> list[ActiveSmoke]:
    """The smoke at 1/2^(n-1), ..., 1/2, 1 of its resolution, coarse to fine.

    Args:
        divisor: of all of them, see ``coarsen``.
    """
    octaves = [smoke]
    for _ in range(n - 1):
        octaves.insert(0, coarsen(octaves[0], divisor))
    return octaves


def octaves_to_do(
    smoke: ActiveSmoke, iterations: Sequence[int], pixel_size: float
) -> list[tuple[int, int, ActiveSmoke, int]]:
    """The octaves that a step works on, coarse to fine; those coarser than the first are not made.

    Where a pixel holds several voxels, the finest octave has blocks of them: no picture tells one
    voxel from the next.

    Args:
        smoke: at full resolution.
        iterations: per octave, coarse to fine; an octave with 0 is skipped.
        pixel_size: of the finest octave's pictures, stage units.

    Returns:
        Number of the octave, its pixels in those of the finest one, its smoke, and its iterations.
    """
    active = [number for number, n in enumerate(iterations) if n]
    if not active or len(smoke.ijk) == 0:
        return []
    n_finer = blocks_in(pixel_size, smoke)
    octaves = make_octaves(smoke, len(iterations) - active[0] + n_finer)
    return [
        (
            number,
            OCTAVE_SCALE ** (len(iterations) - 1 - number),
            octaves[number - active[0]],
            iterations[number],
        )
        for number in active
    ]

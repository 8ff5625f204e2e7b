"""Rays along an axis of one lattice: no cell has to be searched for.

Such a ray stays between four columns of voxels with the same four weights, and it is cut only at
the planes of voxel centres across it. On a segment every field is a line between two planes, so the
planes' values give what ``views.march`` samples at Gauss points, with the same rule for the light.
Front views of smoke that is not turned on the stage are such pictures, and so are contact sheets.
"""

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.views.media import EXTINCTION, Medium
from usdsmoke.core.views.segments import GAUSS, OPAQUE, PARALLEL, Segments


def follows_axis(medium: Medium, direction: np.ndarray) -> bool:
    """Whether a direction follows one of a lattice's axes.

    Args:
        medium: gives the lattice.
        direction: [3], stage space.
    """
    step = np.abs(direction @ np.linalg.inv(medium.index_to_stage)[:3, :3])
    return int((step > PARALLEL * step.max()).sum()) == 1


class Columns:
    """A medium as columns of voxels along the rays of one picture, front to back.

    Args:
        medium: the smoke.
        direction: [3], of all rays, stage space; along an axis of the medium.
    """

    def __init__(self, medium: Medium, direction: np.ndarray) -> None:
        self._to_index = np.linalg.inv(medium.index_to_stage)
        step = direction @ self._to_index[:3, :3]
        axis = int(np.abs(step).argmax())
        self._length = 1 / abs(float(step[axis]))  # of a segment, stage units
        values = np.moveaxis(medium.values, axis, 2)
        values = values[:, :, ::-1] if step[axis] < 0 else values
        self._across = [n for n in range(3) if n != axis]
        self._sides = np.array(values.shape[:2])
        self.numbers_per_ray = values.shape[2] * values.shape[3]
        self._values = torch.from_numpy(np.ascontiguousarray(values)).flatten(2).flatten(0, 1)
        depths = values[..., EXTINCTION].sum(axis=2, dtype=np.float64) * self._length
        self._depths = torch.from_numpy(depths).view(-1, 1)

    def cut(
        self, origin: np.ndarray, direction: np.ndarray, with_light: bool
    ) -> tuple[np.ndarray, Segments | None]:
        """Optical depths of rays [R 3], and with their light the segments that can be seen."""
        hit, columns, weights = self._taps(origin)
        depth = np.zeros(len(origin))
        depth[hit] = _weighted(columns, self._depths, weights)[:, 0].numpy()
        return depth, self._segments(hit, columns, weights) if with_light else None

    def _taps(self, origin: np.ndarray) -> tuple[np.ndarray, Tensor, Tensor]:
        """Which rays [R 3] hit the lattice, and the columns [m 4] around these, with weights."""
        place = (origin @ self._to_index[:3, :3] + self._to_index[3, :3])[:, self._across]
        hit = np.flatnonzero(((place >= 0) & (place <= self._sides - 1)).all(axis=1))
        cell = np.clip(np.floor(place[hit]), 0, self._sides - 2)
        (x, y), (i, j) = (place[hit] - cell).T, cell.astype(np.int64).T
        corners = list(np.ndindex(2, 2))
        number = [(i + a) * self._sides[1] + j + b for a, b in corners]
        share = [(x if a else 1 - x) * (y if b else 1 - y) for a, b in corners]
        return hit, torch.from_numpy(np.stack(number, 1)), torch.from_numpy(np.stack(share, 1))

    def _segments(self, hit: np.ndarray, columns: Tensor, weights: Tensor) -> Segments:
        planes = _weighted(columns, self._values, weights.float()).unflatten(1, (-1, 5))
        extinction = planes[..., EXTINCTION].double()
        thickness = (extinction[:, :-1] + extinction[:, 1:]) * (self._length / 2)
        before = torch.cumsum(thickness, dim=1) - thickness
        filled = (planes != 0).any(dim=2)
        seen = (filled[:, :-1] | filled[:, 1:]) & (before < OPAQUE)
        ray, number = torch.nonzero(seen, as_tuple=True)
        first, rows = ray * planes.shape[1] + number, planes.view(-1, 5)
        begin, end = rows.index_select(0, first), rows.index_select(0, first + 1)
        lengths = np.full(len(ray), self._length)
        return _ColumnSegments(hit[ray.numpy()], lengths, thickness[seen].numpy(), begin, end)


@dataclass
class _ColumnSegments:
    """See ``Segments``."""

    ray: np.ndarray
    length: np.ndarray
    thickness: np.ndarray
    begin: Tensor  # [M 5] values
    end: Tensor

    def sample(self, index: np.ndarray, low: np.ndarray, high: np.ndarray) -> Tensor:
        chosen = torch.from_numpy(index)
        begin = self.begin[chosen]
        change = self.end[chosen] - begin
        middle, half = (low + high) / 2, (high - low) * GAUSS
        points = [torch.from_numpy((middle + side * half).astype(np.float32)) for side in (-1, 1)]
        return torch.stack([torch.addcmul(begin, change, place[:, None]) for place in points], 1)


def _weighted(columns: Tensor, values: Tensor, weights: Tensor) -> Tensor:
    return F.embedding_bag(columns, values, mode="sum", per_sample_weights=weights)

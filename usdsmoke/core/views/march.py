r"""Pictures of smoke that emits and absorbs, by rays through any number of lattices at once.

Between voxel centres every lattice is interpolated trilinearly, and outside it is empty, as in
renderers. A ray is cut at every plane of voxel centres of every lattice, so a segment lies
in one cell of each; there extinction is a cubic polynomial along the ray, and two Gauss points give
its optical depth exactly. Each of the two halves obeys the rule of ``views.optics``,

    light = e h r(t) T,    T *= exp(-t),    t = sigma h,    r(t) = (1 - exp(-t)) / t    [Max1995]

which is exact where the colour e / sigma does not change, for every optical depth; where it may,
segments of much optical depth are cut once more. Lattices that overlap add up, and those behind are
hidden by those in front, because all share the segments.

The optimiser's own projection (``views.project``) splats voxels on pixels instead; that is a sparse
linear map with a cheap gradient, but needs pixels as large as voxels and smoke in front of the eye.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.views.cameras import View, view_rays
from usdsmoke.core.views.media import EXTINCTION, Medium
from usdsmoke.core.views.optics import attenuation_ratio, opacity

__all__ = ["Picture", "march"]

_GAUSS = 0.5 / 3**0.5  # distance of the two points from a segment's middle, in its length
_CHUNK = 1 << 20  # cuts that are in memory at once, over all rays of a chunk
_OPAQUE = 1e4  # optical depth behind which nothing is visible; larger ones would cost digits
_THICK = 0.1  # optical depth above which a segment is cut once more
_MOST_PARTS = 64
_MOST_RAYS = 4  # a pixel's rays along each side
_PARALLEL = 1e-12  # share of a ray's direction below which it does not cross an axis' planes


@dataclass(frozen=True)
class Picture:
    """A picture of the smoke; scene-linear, float32."""

    depth: np.ndarray  # [H W] optical depth along the whole ray, the mean over the pixel
    emission: np.ndarray  # [H W 3] light of emission fields, after absorption
    grey: np.ndarray  # [H W] light of smoke that has no emission, after absorption
    alpha: np.ndarray  # [H W] in [0, 1]: 1 - transmittance, the mean over the pixel

    @property
    def rgba(self) -> np.ndarray:
        """[H W 4], colour premultiplied by alpha."""
        colour = self.emission + self.grey[..., None]
        return np.concatenate([colour, self.alpha[..., None]], axis=-1)


def march(
    media: Sequence[Medium],
    view: View,
    clip: tuple[float, float] = (-np.inf, np.inf),
    rays: int | None = None,
) -> Picture:
    """The picture of all media together in a view.

    Args:
        media: in stage space; may overlap.
        view: orthographic or perspective; nothing behind a perspective eye is visible.
        clip: nearest and farthest depth along the view's axis, stage units.
        rays: along each side of a pixel; None takes as many as voxels fall on a pixel, up to 4.
    """
    count = view.height * view.width
    total = np.zeros((count, 6))  # depth, emission, grey, alpha
    tables = [_Table(medium) for medium in media]
    if rays is None:
        rays = max((_rays_across(medium, view) for medium in media), default=1)
    offsets = (np.arange(rays) + 0.5) / rays - 0.5
    n_cuts = sum(sum(medium.values.shape[:3]) for medium in media)
    size = max(1, _CHUNK // max(n_cuts, 1))
    for start in range(0, count if media else 0, size):
        pixels = np.arange(start, min(start + size, count))
        for dy in offsets:
            for dx in offsets:
                x, y = pixels % view.width + dx, pixels // view.width + dy
                origin, direction = view_rays(view, x, y)
                total[pixels] += _march_rays(tables, origin, direction, view, clip)
    mean = (total / rays**2).astype(np.float32).reshape(view.height, view.width, 6)
    return Picture(mean[..., 0], mean[..., 1:4], mean[..., 4], np.clip(mean[..., 5], 0.0, 1.0))


def _rays_across(medium: Medium, view: View) -> int:
    """Voxels along a pixel's side, where the medium's middle is."""
    shape = np.array(medium.values.shape[:3]) - 2
    edges = np.linalg.norm(medium.index_to_stage[:3, :3], axis=1)
    edge = float(np.min(edges[shape > 1])) if (shape > 1).any() else float(edges.min())
    size = view.pixel_size
    if view.focal is not None:
        middle = (shape + 1) / 2 @ medium.index_to_stage[:3, :3] + medium.index_to_stage[3, :3]
        size = max(float((middle - view.centre) @ view.forward), 0.0) / view.focal
    return int(np.clip(np.ceil(size / edge - 0.1), 1, _MOST_RAYS))


class _Table:
    """A medium ready to be looked up; cell (a, b, c) lies between its voxel of that index and the
    next along every axis."""

    def __init__(self, medium: Medium) -> None:
        values = medium.values
        self.last = np.array(values.shape[:3]) - 2  # cell along each axis
        self.values = torch.from_numpy(values.reshape(-1, values.shape[3]))
        filled = (values != 0).any(axis=-1)
        cells = np.zeros(self.last + 1, bool)
        for a, b, c in np.ndindex(2, 2, 2):
            cells |= filled[a : a + cells.shape[0], b : b + cells.shape[1], c : c + cells.shape[2]]
        self.cells = cells
        self.strides = np.array([values.shape[1] * values.shape[2], values.shape[2], 1])
        self.to_index = np.linalg.inv(medium.index_to_stage)

    def rays(self, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same rays [R 3] in the array's indices; distances along them stay."""
        moved = origin @ self.to_index[:3, :3] + self.to_index[3, :3]
        return moved, direction @ self.to_index[:3, :3]

    def cuts(self, start: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances [R K] at which rays meet planes of voxel centres, and which rays [R] hit."""
        enter, leave = np.full(len(start), -np.inf), np.full(len(start), np.inf)
        crossings = []
        for axis in range(3):
            ends = np.array([0.0, self.last[axis] + 1.0])
            slow = np.abs(step[:, axis]) <= _PARALLEL * np.abs(step).max(axis=1)
            safe = np.where(slow, 1.0, step[:, axis])
            planes = np.arange(self.last[axis] + 2)
            met = (planes - start[:, axis, None]) / safe[:, None]
            inside = (start[:, axis] >= ends[0]) & (start[:, axis] <= ends[1])
            first, last = np.minimum(met[:, 0], met[:, -1]), np.maximum(met[:, 0], met[:, -1])
            enter = np.maximum(enter, np.where(slow, np.where(inside, -np.inf, np.inf), first))
            leave = np.minimum(leave, np.where(slow, np.inf, last))
            crossings.append(np.where(slow[:, None], np.nan, met))
        hit = enter < leave
        enter, leave = np.where(hit, enter, 0.0), np.where(hit, leave, 0.0)
        found = np.clip(np.concatenate(crossings, axis=1), enter[:, None], leave[:, None])
        return np.where(np.isnan(found), enter[:, None], found), hit

    def sample(
        self, start: np.ndarray, step: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> tuple[np.ndarray, Tensor]:
        """Values at the Gauss points of segments of rays that lie in one cell each.

        Args:
            start, step: [M 3], the rays of the segments, indices.
            low, high: [M], where the segments begin and end.

        Returns:
            Which segments [m] hold anything, and their values [m 2 5].
        """
        middle = start + ((low + high) / 2)[:, None] * step
        cell = np.floor(middle).astype(np.int64)
        inside = np.flatnonzero(((cell >= 0) & (cell <= self.last)).all(axis=1))
        held = inside[self.cells[tuple(cell[inside].T)]]
        corner = cell[held]
        half = (high - low)[held, None] * step[held] * _GAUSS
        points = np.stack([middle[held] - half, middle[held] + half], axis=1) - corner[:, None]
        part = np.clip(points, 0.0, 1.0).astype(np.float32)  # [m 2 3]
        base = corner @ self.strides
        index, weight = [], []
        for choice in np.ndindex(2, 2, 2):
            index.append(base + np.array(choice) @ self.strides)
            sides = [part[..., n] if choice[n] else 1 - part[..., n] for n in range(3)]
            weight.append(sides[0] * sides[1] * sides[2])
        taps = np.repeat(np.stack(index, axis=1), 2, axis=0)
        weights = np.stack(weight, axis=-1).reshape(-1, 8)
        values = F.embedding_bag(
            torch.from_numpy(taps),
            self.values,
            mode="sum",
            per_sample_weights=torch.from_numpy(weights),
        )
        return held, values.view(len(held), 2, self.values.shape[1])


def _march_rays(
    tables: Sequence[_Table],
    origin: np.ndarray,
    direction: np.ndarray,
    view: View,
    clip: tuple[float, float],
) -> np.ndarray:
    """Depth, emission, grey and alpha of rays, [R 6] float64."""
    moved = [table.rays(origin, direction) for table in tables]
    found = [table.cuts(*rays) for table, rays in zip(tables, moved, strict=True)]
    hit = np.flatnonzero(np.any([hits for _, hits in found], axis=0))
    result = np.zeros((len(origin), 6))
    # depth along the axis grows by this much a unit of distance; a parallel view's starts at centre
    slope = (direction[hit] @ view.forward)[:, None]
    near, far = (max(clip[0], 0.0) if view.focal is not None else clip[0]), clip[1]
    cuts = np.concatenate([crossed[hit] for crossed, _ in found], axis=1)
    cuts = np.sort(np.clip(cuts, near / slope, far / slope), axis=1)
    ray, segment = np.nonzero(cuts[:, 1:] > cuts[:, :-1])
    low, high = cuts[ray, segment], cuts[ray, segment + 1]
    values = _sample(tables, moved, hit[ray], low, high)
    thickness = values[..., EXTINCTION].mean(dim=1).double().numpy() * (high - low)
    parts = np.clip(np.ceil(thickness / _THICK), 1, _MOST_PARTS).astype(np.int64)
    if (
        parts.max(initial=1) > 1
    ):  # light that is lost within a segment is only known to second order
        number = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
        ray, low, share = (np.repeat(item, parts) for item in (ray, low, (high - low) / parts))
        low = low + number * share
        high = low + share
        values = _sample(tables, moved, hit[ray], low, high)
    result[hit] = _composite(values, torch.from_numpy(high - low), torch.from_numpy(ray), len(hit))
    return result


def _sample(
    tables: Sequence[_Table],
    rays: Sequence[tuple[np.ndarray, np.ndarray]],
    ray: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> Tensor:
    """Sums over all lattices at the two points of every segment, [M 2 5]."""
    values = torch.zeros(len(ray), 2, 5)
    for table, (start, step) in zip(tables, rays, strict=True):
        held, sampled = table.sample(start[ray], step[ray], low, high)
        values[torch.from_numpy(held)] += sampled
    return values


def _composite(values: Tensor, length: Tensor, ray: Tensor, n_rays: int) -> np.ndarray:
    """Front to back along every ray; segments are sorted by ray and then by distance."""
    pieces = values.reshape(-1, values.shape[2]).double()
    ray = ray.repeat_interleave(2)
    half = length.repeat_interleave(2) / 2
    depth = pieces[:, EXTINCTION] * half
    limited = depth.clamp_max(_OPAQUE)
    before = torch.cumsum(limited, 0) - limited  # over all rays; earlier rays are subtracted below
    first = torch.searchsorted(ray, torch.arange(n_rays))
    started = torch.cat([before, before.new_zeros(1)])[first]
    passed = torch.exp(-(before - started[ray]))
    light = pieces[:, 1:] * (half * attenuation_ratio(depth) * passed)[:, None]
    total = torch.zeros(n_rays, 5, dtype=torch.float64)
    total.index_add_(0, ray, torch.cat([depth[:, None], light], dim=1))
    return torch.cat([total, opacity(total[:, :1])], dim=1).numpy()

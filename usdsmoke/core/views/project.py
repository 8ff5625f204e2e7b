"""Projection of active voxels onto the image plane, and its exact adjoint.

A voxel is splatted bilinearly on the pixels around its centre, or around several points in it
(``footprint``): the empty part of the box is never touched, and the adjoint is a plain gather. Two
linear maps come out of it:

- ``column_map``: density -> column integral of density per pixel, for the grey picture;
- ``colour_map``: voxel colour -> composited picture, for fixed density. The density is splatted
  trilinearly into view-aligned slabs, the slabs are weighted by the rule of ``views.optics``, and
  each voxel gets the share of its slab's weight that it contributed to the slab's optical depth.

The same slabs, seen from a light, tell how much of its light arrives at a point (``shadows``).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, cast

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.smoke.memory import chunks, weighted_rows
from usdsmoke.core.smoke.tasks import run_tasks
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.footprint import voxel_points
from usdsmoke.core.views.optics import THICKEST, Slabs, opacity

# Share of the most opaque pixel: fainter light vanishes in the rounding of float32 sums anyway.
NEGLIGIBLE = 1e-9
SCATTERED_ROWS = 2**15  # voxels whose light is added to a picture at once, at least
CHUNK_ROWS = 2**15  # voxels whose pixels are found at once
MOST_SUMS = 32  # such pictures, which are in memory together


class _Apply(torch.autograd.Function):
    """Values [N C] -> picture [P C]; both sum in a fixed order, so bits are reproducible."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, image: "SparseImage") -> Tensor:
        ctx.image = image
        if image.rows is not None:
            values = values.index_select(0, image.rows)
        if values.device.type == "cpu":
            return _scattered(values.detach(), image)
        entry, by_pixel, start = image.runs
        return weighted_rows(values.detach(), entry, start, by_pixel)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        return ctx.image.adjoint(upstream.contiguous()), None


def _scattered(values: Tensor, image: "SparseImage") -> Tensor:
    """[P C], entry after entry: nothing has to be sorted first.

    A map is applied two to eight times, and sorting takes as long as that or longer. One channel
    takes no longer than sums over sorted runs on one thread, three take three times as long.
    """
    n_pixels = image.height * image.width

    def add_up(part: slice) -> Tensor:
        pixel, weight = image.pixel[part].reshape(-1), image.weight[part]
        columns = values[part].unbind(1)
        return torch.stack(
            [
                torch.bincount(pixel, (weight * column[:, None]).reshape(-1), minlength=n_pixels)
                for column in columns
            ]
        )

    n_rows = max(SCATTERED_ROWS, -(-len(image.pixel) // MOST_SUMS))
    parts = chunks(len(image.pixel), n_rows, values.device)
    found = values.new_zeros(values.shape[1], n_pixels)
    for sums in run_tasks([partial(add_up, part) for part in parts]):
        found += sums
    return found.T.contiguous()


@dataclass(frozen=True)
class SparseImage:
    """A linear map from N voxels to H x W pixels with K pixels a voxel: four for each point in it.

    Weights of pixels outside the image are 0, but a value there that is not finite still reaches
    the picture.
    """

    height: int
    width: int
    pixel: Tensor  # [M K]
    weight: Tensor  # [M K]
    rows: Tensor | None = None  # [M], the voxels that can be seen, ascending; None: all, M = N
    n_voxels: int = 0  # N, where there are rows

    def total_weights(self) -> Tensor:
        """Of each voxel, over all pixels, [N]."""
        total = self.weight.sum(dim=1)
        if self.rows is None:
            return total
        return total.new_zeros(self.n_voxels).index_copy_(0, self.rows, total)

    def without_faint(self, least: Tensor) -> "SparseImage":
        """The map of the voxels with a weight above ``least`` [H W] in some pixel.

        Asked is the pixel above and left of each point, for all four of it. Takes over the memory
        of this map, which is of no use afterwards.
        """
        n_rows, n_points = len(self.pixel), self.pixel.shape[1] // 4
        rows = self.rows
        if rows is None:
            rows = torch.arange(n_rows, device=least.device)
        least, end = least.reshape(-1), 0
        for part in chunks(n_rows, CHUNK_ROWS, least.device):
            first = self.pixel[part].view(-1, n_points, 4)[..., 0]
            most = self.weight[part].view(-1, n_points, 4).amax(2)
            enough = least.index_select(0, first.reshape(-1)).view_as(most)
            chosen = (most > enough).any(1).nonzero().squeeze(1)
            some = slice(end, end + len(chosen))
            for values in (self.pixel, self.weight, rows):
                values[some] = values[part].index_select(0, chosen)
            end = some.stop
        pixel, weight, rows = (values[:end] for values in (self.pixel, self.weight, rows))
        return SparseImage(self.height, self.width, pixel, weight, rows, self.n_voxels or n_rows)

    @cached_property
    def runs(self) -> tuple[Tensor, Tensor, Tensor]:
        """The entries with a weight, sorted by pixel: row, weight, first entry of each pixel.

        For devices on which scattered sums come in any order.
        """
        pixel, weight = self.pixel.reshape(-1), self.weight.reshape(-1)
        keep = torch.nonzero(weight).squeeze(1)
        ordered, place = torch.sort(pixel[keep], stable=True)
        order = keep[place]
        del keep, place  # each as large as all that is returned
        n_pixels = self.height * self.width
        start = torch.zeros(n_pixels, dtype=torch.int32, device=pixel.device)
        start[1:] = torch.cumsum(torch.bincount(ordered, minlength=n_pixels), 0)[:-1]
        row = torch.div(order, self.pixel.shape[1], rounding_mode="floor").to(torch.int32)
        return row, weight[order], start

    def apply(self, values: Tensor) -> Tensor:
        """Picture [H W C] of voxel values [N C]. Gradients: through ``values``, exact adjoint."""
        flat = cast(Tensor, _Apply.apply(values, self))
        return flat.view(self.height, self.width, -1)

    def adjoint(self, picture: Tensor) -> Tensor:
        """Voxel values [N C] of a picture [H W C] or [P C]: the transpose of ``apply``."""
        flat = picture.reshape(self.height * self.width, -1)
        n_entries, step = self.pixel.numel(), self.pixel.shape[1]
        start = torch.arange(0, n_entries, step, dtype=torch.int32, device=flat.device)
        rows = None if self.rows is None else (self.rows, self.n_voxels)
        return weighted_rows(flat, self.pixel.reshape(-1), start, self.weight.reshape(-1), rows)


@dataclass(frozen=True)
class Footprint:
    """The four pixels that each point covers in a view: the next one, those below, see ``shifts``.

    Where a picture is one pixel wide or high, what lies beyond it has no weight.
    """

    first: Tensor  # [N] int32, the pixel above and left of the point, or the nearest to that
    weights: Tensor  # [4 N], bilinear; 0 outside the picture
    depth: Tensor  # [N], along the view's axis, stage units
    per_area: Tensor | float  # [N], 1 / area that a pixel covers there, perpendicular to the ray


class Projector:
    """Bilinear footprints of points in a view.

    Args:
        positions: [N 3], stage space, float64: smoke may be far from the origin. All that is
            projected lies among them, or nearly.
        view: orthographic or perspective; points behind a perspective eye get weight 0.
        dtype: of the footprints.
    """

    def __init__(self, positions: Tensor, view: View, dtype: torch.dtype = torch.float64) -> None:
        self._view, self._dtype = view, dtype
        axes = torch.as_tensor(np.stack([view.right, -view.up, view.forward]))
        self._axes = axes.to(positions)
        self._centre = torch.as_tensor(view.centre).to(positions)
        self._sides = view.width, view.height
        middle = [(n - 1) / 2 + s for n, s in zip(self._sides, view.shift, strict=True)]
        self._middle = self._column(middle)
        self._last = self._column([max(n - 2, 0) for n in self._sides])
        self._nearest, self._farthest = 1.0, 0.0
        if view.focal is not None and len(positions):
            depth = (positions - self._centre) @ self._axes[2]
            self._farthest = float(depth.abs().amax())
            seen = depth > 1e-6 * self._farthest
            self._nearest = float(depth[seen].amin()) if bool(seen.any()) else 1.0

    @property
    def shifts(self) -> tuple[int, ...]:
        """From a footprint's first pixel to each of the four."""
        return (0, 1, self._view.width, self._view.width + 1)

    def footprints(self, positions: Tensor, offsets: Tensor | None = None) -> Iterator[Footprint]:
        """Of points [N 3], moved by each of [n 3]; None: where they are."""
        near = (positions - self._centre).to(self._dtype)
        turned = self._axes.to(near) @ near.T
        if offsets is None:
            offsets = positions.new_zeros(1, 3)
        for shift in (offsets @ self._axes.T).to(near):
            yield self._footprint(turned + shift[:, None])

    def _footprint(self, turned: Tensor) -> Footprint:
        view, place, depth = self._view, turned[:2], turned[2]
        scale: Tensor | float
        per_area: Tensor | float
        visible = None
        if view.focal is None:
            scale = 1 / view.pixel_size
            per_area = scale**2
        else:
            visible = depth > 1e-6 * self._farthest
            # points behind the eye get the depth of the nearest in front, so that none is stretched
            depth = torch.where(visible, depth, self._nearest)
            scale = view.focal / depth
            # the area seen at a slant is smaller by its cosine
            per_area = scale**2 * torch.sqrt(1 + (place**2).sum(0) / depth**2)
        place = place.mul_(scale).add_(self._middle)
        nearest = torch.minimum(torch.floor(place).clamp_(min=0), self._last)
        (across, down), (column, row) = self._hats(place.sub_(nearest)), nearest
        first = row.mul_(view.width).add_(column).to(torch.int32)
        weights = (down[:, None] * across).flatten(0, 1)
        if visible is not None:
            weights *= visible
        return Footprint(first, weights, depth, per_area)

    def _hats(self, after: Tensor) -> Tensor:
        """The weights of two pixels along both sides, [2 2 N], for places [2 N] after the first."""
        hats = torch.stack([1 - after, after], 1)
        if hats.numel() and float(hats.amin()) < 0:  # outside the picture
            hats = torch.minimum(hats, 2 - hats).clamp_(min=0)
        for side in (0, 1):
            if self._sides[side] == 1:
                hats[side, 1] = 0  # there is no second pixel
        return hats

    def _column(self, numbers: Sequence[float]) -> Tensor:
        return torch.tensor(numbers, dtype=self._dtype, device=self._centre.device)[:, None]

    def depth_range(self, positions: Tensor, offsets: Tensor) -> tuple[float, float]:
        """The least and the largest depth of footprints of points, moved by each of [n 3]."""
        depth, more = (positions - self._centre) @ self._axes[2], offsets @ self._axes[2]
        if self._view.focal is not None:
            depth = torch.where(depth > 1e-6 * self._farthest, depth, self._nearest)
        low, high = torch.aminmax(depth)
        return float(low + more.min()), float(high + more.max())


def point_offsets(positions: Tensor, edges: np.ndarray, view: View) -> Tensor:
    """Where in each of the voxels [N 3] it is splatted: offsets from its centre, [n 3]."""
    pixel = view.pixel_size
    if view.focal is not None:  # pixels of every size: the largest ones, of the farthest smoke
        forward = torch.as_tensor(view.forward, dtype=positions.dtype, device=positions.device)
        centre = torch.as_tensor(view.centre, dtype=positions.dtype, device=positions.device)
        depth = float(((positions - centre) @ forward).max()) if len(positions) else 0.0
        if depth <= 0:
            return positions.new_zeros(1, 3)
        pixel = depth / view.focal
    return torch.as_tensor(voxel_points(edges, view, pixel)).to(positions)


def column_map(
    positions: Tensor, edges: np.ndarray, view: View, dtype: torch.dtype = torch.float32
) -> SparseImage:
    """The map from voxel density [N 1] to its column integral per pixel, density x stage unit.

    Args:
        positions: voxel centres, [N 3] float64, stage space.
        edges: of a voxel, [3 3] rows, stage units.
        view: of any direction; voxels may be larger than its pixels.
    """
    offsets, projector = point_offsets(positions, edges, view), Projector(positions, view, dtype)
    volume, n, device = abs(float(np.linalg.det(edges))), len(positions), positions.device
    last, shape = view.height * view.width - 1, (n, len(offsets), len(projector.shifts))
    shifts = torch.tensor(projector.shifts, dtype=torch.int32, device=device)
    pixel = torch.empty(shape, dtype=torch.int32, device=device)
    weight = torch.empty(shape, dtype=dtype, device=device)
    for part in chunks(n, CHUNK_ROWS, device):
        for point, foot in enumerate(projector.footprints(positions[part], offsets)):
            scale = foot.per_area * (volume / len(offsets))
            pixel[part, point] = (foot.first[:, None] + shifts).clamp_(max=last)
            weight[part, point] = (foot.weights * scale).T
    return SparseImage(view.height, view.width, pixel.flatten(1), weight.flatten(1))


def colour_map(
    positions: Tensor,
    density: Tensor,
    edges: np.ndarray,
    gamma_w: float,
    view: View,
    step: float,
    share: Tensor | None = None,
) -> tuple[SparseImage, Tensor]:
    """The map from voxel colour [N 3] to the picture of fixed smoke, and its opacity [H W].

    Args:
        positions: voxel centres, [N 3] float64, stage space.
        density: [N], >= 0.
        edges: of a voxel, [3 3] rows, stage units.
        gamma_w: extinction per density, 1/stage unit.
        view: see ``column_map``.
        step: thickness of the slabs, stage units; about the voxel's size.
        share: [N] in [0, 1], the share of each voxel's light in the picture; None means all. Smoke
            with a share of 0 still hides the smoke behind it.

    Returns:
        The map, from the voxels with a share above 0, and the picture of white smoke, alpha: with
        all shares 1 it is 1 - exp(-gamma_w * column integral).

    Gradients: none through density; it is fixed in the colour step.
    """
    offsets, device = point_offsets(positions, edges, view), density.device
    n_voxels, n_points = len(positions), len(offsets)
    if n_voxels == 0:
        pixel = torch.empty(0, 4, dtype=torch.int32, device=device)
        image = SparseImage(view.height, view.width, pixel, density.new_empty(0, 4))
        return image, density.new_zeros(view.height, view.width)
    projector = Projector(positions, view, density.dtype)
    depth_range, shifts = projector.depth_range(positions, offsets), projector.shifts
    slabs = Slabs(view, depth_range, step, density)
    scale = gamma_w * abs(float(np.linalg.det(edges))) / n_points
    first = torch.empty(n_points, n_voxels, dtype=torch.int32, device=device)
    cell, far = torch.empty_like(first), density.new_empty(first.shape)
    light = density.new_empty(n_points, len(shifts), n_voxels)
    for part in chunks(n_voxels, CHUNK_ROWS, device):
        mass = density[part] * scale
        for point, foot in enumerate(projector.footprints(positions[part], offsets)):
            here = (mass * foot.per_area).clamp_max_(THICKEST)
            first[point, part] = foot.first
            cell[point, part], far[point, part] = place = slabs.place(foot.first, foot.depth)
            depths = torch.mul(foot.weights, here, out=light[point, :, part])
            slabs.add(*place, shifts, depths)
    alpha = opacity(slabs.values.sum(0)).view(view.height, view.width)
    slabs.light_up()
    least = NEGLIGIBLE * float(alpha.max())
    for part in chunks(n_voxels, CHUNK_ROWS, device):
        for point in range(n_points):
            light[point, :, part] *= slabs.at(cell[point, part], far[point, part], shifts)
    del slabs, cell, far
    image = _shown(view, first, shifts, light.flatten(0, 1), least, share)
    if share is None:
        return image, alpha
    return image, image.apply(density.new_ones(image.n_voxels, 1))[..., 0]


def _shown(
    view: View, first: Tensor, shifts: Sequence[int], light: Tensor, least: float,
    share: Tensor | None,
) -> SparseImage:  # fmt: skip
    """The map of the voxels with light [n*4 N] above ``least`` in a pixel.

    Args:
        first: pixel of each point, [n N].
        share: see ``colour_map``.
    """
    width, n_voxels = light.shape
    pixel = first.new_empty(n_voxels, width)  # memory that is not written is not taken
    weight = light.new_empty(n_voxels, width)
    steps, last = first.new_tensor(shifts), view.height * view.width - 1
    rows, end = [], 0
    for part in chunks(n_voxels, CHUNK_ROWS, light.device):
        here = light[:, part]
        here = F.threshold(here, least, 0)  # ten times as fast as ``where`` on mixed values
        seen = here.amax(0) > 0
        if share is not None:
            here *= share[part].to(here)
            seen &= share[part] > 0
        chosen = seen.nonzero().squeeze(1)
        some = slice(end, end + len(chosen))
        weight[some] = here.index_select(1, chosen).T
        pixels = first[:, part].index_select(1, chosen).T[..., None] + steps
        pixel[some] = pixels.clamp_(max=last).flatten(1)
        rows.append(chosen.add_(part.start))
        end = some.stop
    number = torch.cat(rows)
    if share is not None:  # among those that are painted
        painted = torch.cumsum(share > 0, 0)
        number, n_voxels = painted[number] - 1, int(painted[-1])
    return SparseImage(view.height, view.width, pixel[:end], weight[:end], number, n_voxels)

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

from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor

from usdsmoke.core.smoke.memory import CHUNK_ROWS, chunks, weighted_rows
from usdsmoke.core.smoke.tasks import run_tasks
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.footprint import voxel_points
from usdsmoke.core.views.optics import attenuation_ratio, opacity, transmittance_before

# Share of the most opaque pixel: fainter light vanishes in the rounding of float32 sums anyway.
NEGLIGIBLE = 1e-9
THICKEST = 1e30  # optical depth of one voxel in one pixel; sums of thicker ones overflow float32
MOST_CELLS = 2**27  # slabs times pixels: empty space between far places must not fill memory
SCATTERED_ROWS = 2**15  # voxels whose light is added to a picture at once, at least
MOST_SUMS = 32  # such pictures, which are in memory together
CHUNK_CELLS = 2**19  # slabs times pixels in a chunk


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

    def without_hidden(self) -> "SparseImage":
        """The same map, without the voxels that have no weight."""
        seen = (self.weight != 0).any(dim=1)
        return replace(
            self,
            pixel=self.pixel[seen],
            weight=self.weight[seen],
            rows=seen.nonzero().squeeze(1),
            n_voxels=len(seen),
        )

    def total_weights(self) -> Tensor:
        """Of each voxel, over all pixels, [N]."""
        total = self.weight.sum(dim=1)
        if self.rows is None:
            return total
        return total.new_zeros(self.n_voxels).index_copy_(0, self.rows, total)

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
        found = weighted_rows(flat, self.pixel.reshape(-1), start, self.weight.reshape(-1))
        if self.rows is None:
            return found
        return found.new_zeros(self.n_voxels, found.shape[1]).index_copy_(0, self.rows, found)


@dataclass(frozen=True)
class _Footprint:
    """The pixels that points cover in a view."""

    pixel: Tensor  # [N 4] int32
    weight: Tensor  # [N 4], bilinear
    depth: Tensor  # [N] float64, along the view's axis, stage units
    per_area: Tensor  # [N] float64, 1 / area that a pixel covers there, perpendicular to the ray


def project_voxels(positions: Tensor, view: View, dtype: torch.dtype = torch.float64) -> _Footprint:
    """Bilinear footprints of points in a view.

    Args:
        positions: [N 3], stage space, float64: smoke may be far from the origin.
        view: orthographic or perspective; points behind a perspective eye get weight 0.
        dtype: of the weights.
    """
    n, device = len(positions), positions.device
    axes = torch.as_tensor(np.stack([view.right, view.up, view.forward]), device=device)
    axes, centre = axes.to(positions.dtype), torch.as_tensor(view.centre).to(positions)
    found = _Footprint(
        torch.empty(n, 4, dtype=torch.int32, device=device),
        torch.empty(n, 4, dtype=dtype, device=device),
        positions.new_empty(n),
        positions.new_empty(n),
    )
    nearest, farthest = 1.0, 0.0
    if view.focal is not None and n:
        depth = (positions - centre) @ axes[2]
        farthest = float(depth.abs().amax())
        seen = depth > 1e-6 * farthest
        nearest = float(depth[seen].amin()) if bool(seen.any()) else 1.0
    for part in chunks(n, CHUNK_ROWS, device):
        right, up, depth = ((positions[part] - centre) @ axes.T).unbind(-1)
        scale, visible = torch.ones_like(depth), None
        if view.focal is None:
            scale /= view.pixel_size
            found.per_area[part] = scale**2
        else:
            visible = depth > 1e-6 * farthest
            # points behind the eye get the depth of the nearest in front, so that none is stretched
            depth = torch.where(visible, depth, nearest)
            scale = view.focal / depth
            # the area seen at a slant is smaller by its cosine
            slant = torch.sqrt(1 + (right**2 + up**2) / depth**2)
            found.per_area[part] = scale**2 * slant
        x = _hats((view.width - 1) / 2 + view.shift[0] + right * scale, view.width)
        y = _hats((view.height - 1) / 2 + view.shift[1] - up * scale, view.height)
        found.depth[part] = depth
        for corner, ((row, down), (column, across)) in enumerate(product(y, x)):
            both = across * down
            found.weight[part, corner] = both if visible is None else both * visible
            found.pixel[part, corner] = row * view.width + column
    return found


def _hats(place: Tensor, length: int) -> list[tuple[Tensor, Tensor]]:
    """The two pixels around each place [N] along a side, and their weights; 0 outside."""
    first = torch.floor(place)
    after, found = place - first, []
    for number, weight in ((first, 1 - after), (first + 1, after)):
        inside = (number >= 0) & (number < length)
        found.append((number.clamp(0, length - 1).to(torch.int32), weight * inside))
    return found


def split_points(positions: Tensor, edges: np.ndarray, view: View) -> tuple[Tensor, int]:
    """The points that voxels [N 3] are splatted at, [N n 3] flattened, and n."""
    pixel = view.pixel_size
    if view.focal is not None:  # pixels of every size: the largest ones, of the farthest smoke
        forward = torch.as_tensor(view.forward, dtype=positions.dtype, device=positions.device)
        centre = torch.as_tensor(view.centre, dtype=positions.dtype, device=positions.device)
        depth = float(((positions - centre) @ forward).max()) if len(positions) else 0.0
        if depth <= 0:
            return positions, 1
        pixel = depth / view.focal
    offsets = voxel_points(edges, view, pixel)
    if len(offsets) == 1:
        return positions, 1
    moved = positions[:, None] + torch.as_tensor(offsets, device=positions.device)
    return moved.view(-1, 3), len(offsets)


def column_map(
    positions: Tensor, edges: np.ndarray, view: View, dtype: torch.dtype = torch.float32
) -> SparseImage:
    """The map from voxel density [N 1] to its column integral per pixel, density x stage unit.

    Args:
        positions: voxel centres, [N 3] float64, stage space.
        edges: of a voxel, [3 3] rows, stage units.
        view: of any direction; voxels may be larger than its pixels.
    """
    points, n_points = split_points(positions, edges, view)
    foot, volume = project_voxels(points, view, dtype), abs(float(np.linalg.det(edges))) / n_points
    for part in chunks(len(points), CHUNK_ROWS, points.device):
        foot.weight[part] *= (volume * foot.per_area[part])[:, None]
    width = 4 * n_points
    return SparseImage(
        view.height, view.width, foot.pixel.view(-1, width), foot.weight.view(-1, width)
    )


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
    points, n_points = split_points(positions, edges, view)
    foot, dtype = project_voxels(points, view, density.dtype), density.dtype
    if len(positions) == 0:
        empty = SparseImage(view.height, view.width, foot.pixel, foot.weight)
        return empty, density.new_zeros(view.height, view.width)
    volume, n_pixels = abs(float(np.linalg.det(edges))) / n_points, view.height * view.width
    slab, pixel, weight = foot.depth - foot.depth.min(), foot.pixel, foot.weight
    slab /= max(step, float(slab.max()) * n_pixels / MOST_CELLS)
    if n_points > 1:
        density = density.repeat_interleave(n_points)
    for part in chunks(len(slab), CHUNK_ROWS, slab.device):
        mass = density[part] * (gamma_w * volume) * foot.per_area[part]
        weight[part] *= mass.clamp_max(THICKEST)[:, None]
    depths = _slab_depths(slab, pixel, weight, n_pixels)
    alpha = opacity(depths.sum(0)).view(view.height, view.width)
    light_up(depths)
    per_depth, least = depths.view(-1), NEGLIGIBLE * float(alpha.max())
    for part in chunks(len(slab), CHUNK_ROWS, slab.device):
        cell, far = slab_cells(slab[part], pixel[part], n_pixels, dtype)
        light = per_depth[cell] * (1 - far) + per_depth[cell + n_pixels] * far
        light *= weight[part]
        weight[part] = light.masked_fill_(~(light > least), 0)
    del depths, per_depth
    pixel, weight = pixel.view(-1, 4 * n_points), weight.view(-1, 4 * n_points)
    if share is None:
        return SparseImage(view.height, view.width, pixel, weight).without_hidden(), alpha
    some = share > 0
    weight = weight[some] * share[some, None].to(weight)
    image = SparseImage(view.height, view.width, pixel[some], weight).without_hidden()
    return image, image.apply(torch.ones_like(weight[:, :1]))[..., 0]


def slab_cells(
    slab: Tensor, pixel: Tensor, n_pixels: int, dtype: torch.dtype
) -> tuple[Tensor, Tensor]:
    """The near cells [N 4] of voxels at slab [N] and pixel [N 4], and the far ones' share [N 1]."""
    near = torch.floor(slab)
    cell = near.to(torch.int64)[:, None] * n_pixels + pixel.long()
    return cell, (slab - near).to(dtype)[:, None]


def _slab_depths(slab: Tensor, pixel: Tensor, share: Tensor, n_pixels: int) -> Tensor:
    """The optical depth of voxels with the shares [N 4] in slabs and pixels, [S P]."""
    n_cells = (int(slab.max()) + 2) * n_pixels
    near, behind = share.new_zeros(n_cells), share.new_zeros(n_cells)
    for part in chunks(len(slab), CHUNK_ROWS, slab.device):
        add_depths(near, behind, slab[part], pixel[part], share[part], n_pixels)
    return near.add_(behind).view(-1, n_pixels)


def add_depths(
    near: Tensor, behind: Tensor, slab: Tensor, pixel: Tensor, share: Tensor, n_pixels: int
) -> None:
    """Add optical depths [N 4] of voxels to the two slabs around each, [S P] flattened.

    On a GPU the order of the sums, and with it the last bits, is not fixed.
    """
    cell, far = slab_cells(slab, pixel, n_pixels, share.dtype)
    near.index_add_(0, cell.view(-1), (share * (1 - far)).view(-1))
    behind.index_add_(0, (cell + n_pixels).view(-1), (share * far).view(-1))


def light_up(depths: Tensor) -> None:
    """Replace optical depths [S P] by what a unit of each adds to the picture."""
    n_slabs, n_pixels = depths.shape
    for part in chunks(n_pixels, max(CHUNK_CELLS // n_slabs, 1), depths.device):
        here = depths[:, part].contiguous()
        depths[:, part] = transmittance_before(here) * attenuation_ratio(here)

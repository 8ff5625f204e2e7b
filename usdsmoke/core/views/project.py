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

from dataclasses import dataclass
from functools import cached_property, partial
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
CHUNK_CELLS = 2**19  # slabs times pixels in a chunk


class _Apply(torch.autograd.Function):
    """Values [N C] -> picture [P C]; both sum in a fixed order, so bits are reproducible."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, image: "SparseImage") -> Tensor:
        ctx.image = image
        if values.device.type == "cpu":
            return _scattered(values, image)
        voxel, by_pixel, start = image.runs
        return weighted_rows(values.detach(), voxel, start, by_pixel)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        return ctx.image.adjoint(upstream.contiguous()), None


def _scattered(values: Tensor, image: "SparseImage") -> Tensor:
    """[P C], entry after entry: nothing has to be sorted first.

    A map is applied two to eight times, and sorting takes as long as that or longer. One channel
    takes no longer than sums over sorted runs on one thread, three take three times as long.
    """
    n_pixels, pixel = image.height * image.width, image.pixel.reshape(-1)

    def add_up(column: Tensor) -> Tensor:
        return torch.bincount(
            pixel, (image.weight * column[:, None]).reshape(-1), minlength=n_pixels
        )

    found = run_tasks([partial(add_up, column) for column in values.detach().unbind(1)])
    return torch.stack(found, 1).to(values.dtype)


@dataclass(frozen=True)
class SparseImage:
    """A linear map from N voxels to H x W pixels with K pixels a voxel: four for each point in it.

    ``pixel`` and ``weight`` are [N K]. Weights of pixels outside the image are 0, but a value there
    that is not finite still reaches the picture.
    """

    height: int
    width: int
    pixel: Tensor
    weight: Tensor

    @cached_property
    def runs(self) -> tuple[Tensor, Tensor, Tensor]:
        """The entries with a weight, sorted by pixel: voxel, weight, first entry of each pixel.

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
        voxel = torch.div(order, self.pixel.shape[1], rounding_mode="floor").to(torch.int32)
        return voxel, weight[order], start

    def apply(self, values: Tensor) -> Tensor:
        """Picture [H W C] of voxel values [N C]. Gradients: through ``values``, exact adjoint."""
        flat = cast(Tensor, _Apply.apply(values, self))
        return flat.view(self.height, self.width, -1)

    def adjoint(self, picture: Tensor) -> Tensor:
        """Voxel values [N C] of a picture [H W C] or [P C]: the transpose of ``apply``."""
        flat = picture.reshape(self.height * self.width, -1)
        n_entries, step = self.pixel.numel(), self.pixel.shape[1]
        start = torch.arange(0, n_entries, step, dtype=torch.int32, device=flat.device)
        return weighted_rows(flat, self.pixel.reshape(-1), start, self.weight.reshape(-1))


@dataclass(frozen=True)
class _Footprint:
    """The pixels that voxels cover in a view; float64."""

    pixel: Tensor  # [N 4] int32
    weight: Tensor  # [N 4], bilinear
    depth: Tensor  # [N], along the view's axis, stage units
    per_area: Tensor  # [N], 1 / area that a pixel covers at the voxel, perpendicular to the ray


def project_voxels(positions: Tensor, view: View) -> _Footprint:
    """Bilinear footprints of points in a view.

    Args:
        positions: [N 3], stage space, float64: smoke may be far from the origin.
        view: orthographic or perspective; points behind a perspective eye get weight 0.
    """
    axes = torch.as_tensor(np.stack([view.right, view.up, view.forward]), device=positions.device)
    centre = torch.as_tensor(view.centre, dtype=positions.dtype, device=positions.device)
    right, up, depth = ((positions - centre) @ axes.T.to(positions.dtype)).unbind(-1)
    if view.focal is None:
        scale = torch.full_like(depth, 1.0 / view.pixel_size)
        per_area = scale**2
        visible = torch.ones_like(depth)
    else:
        seen = depth > (1e-6 * depth.abs().amax() if len(depth) else 0.0)
        visible = seen.to(depth.dtype)
        # points behind the eye get the depth of the nearest in front, so that none is stretched
        depth = torch.where(seen, depth, depth[seen].amin() if bool(seen.any()) else 1.0)
        scale = view.focal / depth
        # the area seen at a slant is smaller by its cosine
        per_area = scale**2 * torch.sqrt(1 + (right**2 + up**2) / depth**2)
    x = (view.width - 1) / 2 + view.shift[0] + right * scale
    y = (view.height - 1) / 2 + view.shift[1] - up * scale
    pixel = torch.empty(len(x), 4, dtype=torch.int32, device=x.device)
    weight = x.new_empty(len(x), 4)
    for part in chunks(len(x), CHUNK_ROWS, x.device):
        _spread(x[part], y[part], visible[part], view, pixel[part], weight[part])
    return _Footprint(pixel, weight, depth, per_area)


def _spread(
    x: Tensor, y: Tensor, visible: Tensor, view: View, pixel: Tensor, weight: Tensor
) -> None:
    """Fill in the four pixels around each place [N] and their weights, [N 4] each."""
    x0, y0 = torch.floor(x), torch.floor(y)
    fx, fy = x - x0, y - y0
    for dy in (0, 1):
        for dx in (0, 1):
            px, py = x0 + dx, y0 + dy
            inside = (px >= 0) & (px < view.width) & (py >= 0) & (py < view.height)
            w = (fx if dx else 1 - fx) * (fy if dy else 1 - fy) * visible
            weight[:, 2 * dy + dx] = torch.where(inside, w, torch.zeros_like(w))
            index = py.clamp(0, view.height - 1) * view.width + px.clamp(0, view.width - 1)
            pixel[:, 2 * dy + dx] = index.to(torch.int32)


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
    foot, volume = project_voxels(points, view), abs(float(np.linalg.det(edges))) / n_points
    weight = foot.weight.mul_((volume * foot.per_area)[:, None])
    width = 4 * n_points
    return SparseImage(
        view.height, view.width, foot.pixel.view(-1, width), weight.to(dtype).view(-1, width)
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
    foot, volume = project_voxels(points, view), abs(float(np.linalg.det(edges))) / n_points
    if len(positions) == 0:
        empty = SparseImage(view.height, view.width, foot.pixel, foot.weight.to(density.dtype))
        return empty, density.new_zeros(view.height, view.width)
    n_pixels = view.height * view.width
    depth = foot.depth - foot.depth.min()
    slab = depth / max(step, float(depth.max()) * n_pixels / MOST_CELLS)
    if n_points > 1:
        density = density.repeat_interleave(n_points)
    mass = (density * (gamma_w * volume) * foot.per_area).clamp_max(THICKEST)
    pixel, weight = foot.pixel, foot.weight.mul_(mass[:, None]).to(density.dtype)
    del foot, depth, mass  # each as large as the weights
    depths = _slab_depths(slab, pixel, weight, n_pixels)
    alpha = opacity(depths.sum(0)).view(view.height, view.width)
    light_up(depths)
    per_depth = depths.view(-1)
    for part in chunks(len(slab), CHUNK_ROWS, slab.device):
        cell, far = slab_cells(slab[part], pixel[part], n_pixels, density.dtype)
        weight[part] *= per_depth[cell] * (1 - far) + per_depth[cell + n_pixels] * far
    del depths, per_depth
    least = NEGLIGIBLE * float(alpha.max())
    weight.masked_fill_(~(weight > least), 0)
    pixel, weight = pixel.view(-1, 4 * n_points), weight.view(-1, 4 * n_points)
    if share is None:
        return SparseImage(view.height, view.width, pixel, weight), alpha
    some = share > 0
    weight = weight[some] * share[some, None].to(weight)
    image = SparseImage(view.height, view.width, pixel[some], weight)
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

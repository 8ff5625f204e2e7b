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
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.fields.sparse_image import SparseImage
from usdsmoke.core.smoke.memory import add_at, chunks
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.footprint import voxel_points
from usdsmoke.core.views.optics import THICKEST, Slabs, opacity

# Share of the most opaque pixel: fainter light vanishes in the rounding of float32 sums anyway.
NEGLIGIBLE = 1e-9
DIM = 0.01  # of the most opaque pixel: how opaque all count at least when shares are compared
CHUNK_ROWS = 2**17  # voxels whose pixels are found at once; fewer take longer, as threads wait


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


class Shown(NamedTuple):
    """What of the voxels a picture shows.

    Attributes:
        share: [N] in [0, 1], of each voxel's light; None means all. Smoke with a share of 0 still
            hides the smoke behind it.
        faint: voxels that have no more than this share of the opacity of any pixel are left out.
            Asked is the pixel above and left of each point; ``DIM`` of the most opaque one is the
            least opacity that counts.
    """

    share: Tensor | None = None
    faint: float = 0.0


ALL = Shown()


def colour_map(
    positions: Tensor,
    density: Tensor,
    edges: np.ndarray,
    gamma_w: float,
    view: View,
    step: float,
    shown: Shown = ALL,
) -> tuple[SparseImage, Tensor]:
    """The map from voxel colour [N 3] to the picture of fixed smoke, and its opacity [H W].

    Args:
        positions: voxel centres, [N 3] float64, stage space.
        density: [N], >= 0.
        edges: of a voxel, [3 3] rows, stage units.
        gamma_w: extinction per density, 1/stage unit.
        view: see ``column_map``.
        step: thickness of the slabs, stage units; about the voxel's size.
        shown: see ``Shown``.

    Returns:
        The map, from the voxels with a share above 0, and the picture of white smoke, alpha: with
        all shares 1 it is 1 - exp(-gamma_w * column integral), faint voxels and all.

    Gradients: none through density; it is fixed in the colour step.
    """
    share, faint = shown
    if len(positions) == 0:
        pixel = torch.empty(0, 4, dtype=torch.int32, device=density.device)
        image = SparseImage(view.height, view.width, pixel, density.new_empty(0, 4))
        return image, density.new_zeros(view.height, view.width)
    lit = _LitPoints(positions, density * (gamma_w * abs(float(np.linalg.det(edges)))), view, step,
                     point_offsets(positions, edges, view))  # fmt: skip
    alpha = lit.alpha
    nothing = NEGLIGIBLE * float(alpha.max())
    if share is not None:  # what is faint depends on the picture of all that is painted
        lit.take_share(share)
        alpha = lit.picture()
    image = lit.image(nothing, faint * (alpha + DIM * alpha.max()).flatten())
    return (image, alpha) if share is None else (_among_painted(image, share), alpha)


class _LitPoints:
    """Points of voxels in slabs across a view, and the light that each gives the pixels around it.

    Args:
        positions: voxel centres, [N 3] float64, stage space.
        mass: [N], extinction times volume.
        view, step: as of ``colour_map``.
        offsets: from a centre to the points, [n 3].
    """

    def __init__(
        self, positions: Tensor, mass: Tensor, view: View, step: float, offsets: Tensor
    ) -> None:
        n_voxels, n_points, device = len(positions), len(offsets), mass.device
        projector = Projector(positions, view, mass.dtype)
        depth_range = projector.depth_range(positions, offsets)
        self._view, self._shifts = view, projector.shifts
        self._slabs = Slabs(view, depth_range, step, mass)
        self._first = torch.empty(n_points, n_voxels, dtype=torch.int32, device=device)
        self._cell, self._far = torch.empty_like(self._first), mass.new_empty(n_points, n_voxels)
        # optical depths, then the light of what is lit
        self._light = mass.new_empty(n_points, len(self._shifts), n_voxels)
        self._is_lit = False
        for part in chunks(n_voxels, CHUNK_ROWS, device):
            here = mass[part] / n_points
            for point, foot in enumerate(projector.footprints(positions[part], offsets)):
                thick = (here * foot.per_area).clamp_max_(THICKEST)
                place = self._slabs.place(foot.first, foot.depth)
                self._first[point, part] = foot.first
                self._cell[point, part], self._far[point, part] = place
                depths = torch.mul(foot.weights, thick, out=self._light[point, :, part])
                self._slabs.add(*place, self._shifts, depths)
        #: of all smoke, [H W]
        self.alpha = opacity(self._slabs.values.sum(0)).view(view.height, view.width)
        self._slabs.light_up()

    def take_share(self, share: Tensor) -> None:
        """Leave each voxel a share [N] of its light."""
        for part in chunks(len(share), CHUNK_ROWS, share.device):
            self._light_up(part)
            self._light[..., part] *= share[part].to(self._light)
        self._is_lit = True

    def picture(self) -> Tensor:
        """All light, [H W]; behind ``take_share``."""
        n_pixels = self._view.height * self._view.width
        # and what has no weight beyond the picture
        total = self._light.new_zeros(n_pixels + max(self._shifts))
        for pixel, light in zip(self._first, self._light, strict=True):
            for shift, corner in zip(self._shifts, light, strict=True):
                add_at(total[shift:], pixel, corner)
        return total[:n_pixels].view(self._view.height, self._view.width)

    def image(self, nothing: float, least: Tensor) -> SparseImage:
        """The map of the voxels that are seen.

        Args:
            nothing: light that is 0.
            least: what a voxel has more of by the pixel of a point, [P].
        """
        first, light, view = self._first, self._light, self._view
        (n_points, n_voxels), n_pixels = first.shape, view.height * view.width
        width = n_points * len(self._shifts)
        pixel = first.new_empty(n_voxels, width)  # memory that is not written is not taken
        weight = light.new_empty(n_voxels, width)
        steps, rows, end = first.new_tensor(self._shifts), [], 0
        for part in chunks(n_voxels, CHUNK_ROWS, first.device):
            if not self._is_lit:
                self._light_up(part)
            # ten times as fast as ``where`` on mixed values
            here, near = F.threshold(light[..., part], nothing, 0), first[:, part]
            enough = here.amax(1) > least.index_select(0, near.flatten()).view_as(near)
            chosen = enough.any(0).nonzero().squeeze(1)
            some = slice(end, end + len(chosen))
            weight[some] = here.flatten(0, 1).index_select(1, chosen).T
            pixels = near.index_select(1, chosen).T[..., None] + steps
            pixel[some] = pixels.clamp_(max=n_pixels - 1).flatten(1)
            rows.append(chosen.add_(part.start))
            end = some.stop
        number = torch.cat(rows)
        return SparseImage(view.height, view.width, pixel[:end], weight[:end], number, n_voxels)

    def _light_up(self, part: slice) -> None:
        for point, light in enumerate(self._light):
            cell, far = self._cell[point, part], self._far[point, part]
            light[:, part] *= self._slabs.at(cell, far, self._shifts)


def _among_painted(image: SparseImage, share: Tensor) -> SparseImage:
    """The map of the voxels with a share alone; no other is seen."""
    assert image.rows is not None
    painted = torch.cumsum(share > 0, 0)
    return replace(image, rows=painted[image.rows] - 1, n_voxels=int(painted[-1]))

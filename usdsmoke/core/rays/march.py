r"""Pictures of smoke that emits and absorbs, by rays through any number of lattices at once.

Between voxel centres every lattice is interpolated trilinearly, and outside it is empty, as in
renderers. A ray is cut at every plane of voxel centres of every lattice, so a segment lies in one
cell of each; its optical depth is exact, and ``rays.segments`` has the rule of its light. Segments
of much optical depth are cut once more. Lattices that overlap add up, and those behind are hidden
by those in front, because all share the segments.

Everything is numpy: a preview loads no torch.

The optimiser's own projection (``views.project``) splats voxels on pixels instead; that is a sparse
linear map with a cheap gradient, but needs pixels as large as voxels and smoke in front of the eye.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from usdsmoke.core.rays.cells import Cells
from usdsmoke.core.rays.columns import Columns, follows_axis
from usdsmoke.core.rays.media import Medium
from usdsmoke.core.smoke.tasks import run_slices
from usdsmoke.core.views.cameras import View, view_rays

_CHUNK = 1 << 18  # numbers of each kind in memory at once, over all rays of a chunk
_SAME = 1e-6  # relative difference of colours that are the same
_MOST_RAYS = 4  # a pixel's rays along each side


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
    if not media:
        return _picture(total, view)
    if rays is None:
        rays = max(_rays_across(medium, view) for medium in media)
    offsets = (np.arange(rays) + 0.5) / rays - 0.5
    colour = _shared_colour(media)
    tracer = _tracer(media, view, clip, with_light=colour is None)

    def draw(part: slice) -> None:
        pixels = np.arange(part.start, part.stop)
        for dy, dx in product(offsets, offsets):
            at = view_rays(view, pixels % view.width + dx, pixels // view.width + dy)
            depth, light = tracer.trace(*at)
            alpha = -np.expm1(-depth)
            if colour is not None:
                light = alpha[:, None] * colour
            total[pixels] += np.column_stack([depth, light, alpha])

    size = max(1, _CHUNK // tracer.numbers_per_ray)
    run_slices(draw, count, size)
    return _picture(total / rays**2, view)


def _picture(mean: np.ndarray, view: View) -> Picture:
    mean = mean.astype(np.float32).reshape(view.height, view.width, 6)
    return Picture(mean[..., 0], mean[..., 1:4], mean[..., 4], np.clip(mean[..., 5], 0.0, 1.0))


def _tracer(
    media: Sequence[Medium], view: View, clip: tuple[float, float], with_light: bool
) -> Columns | Cells:
    if view.focal is not None:
        clip = (max(clip[0], 0.0), clip[1])
    elif len(media) == 1 and not _cuts(clip, media[0], view):
        if follows_axis(media[0], view.forward):
            return Columns(media[0], view.forward, with_light)
    return Cells(media, view.forward, clip, with_light)


def _cuts(clip: tuple[float, float], medium: Medium, view: View) -> bool:
    """Whether part of a medium lies before the nearest or behind the farthest depth."""
    corners = np.array(list(np.ndindex(2, 2, 2))) * (np.array(medium.extinction.shape) - 1)
    places = corners @ medium.index_to_stage[:3, :3] + medium.index_to_stage[3, :3]
    depths = (places - view.centre) @ view.forward
    return bool(depths.min() < clip[0] or depths.max() > clip[1])


def _rays_across(medium: Medium, view: View) -> int:
    """Voxels along a pixel's side, where the medium's middle is."""
    shape = np.array(medium.extinction.shape) - 2
    edges = np.linalg.norm(medium.index_to_stage[:3, :3], axis=1)
    edge = float(np.min(edges[shape > 1])) if (shape > 1).any() else float(edges.min())
    size = view.pixel_size
    if view.focal is not None:
        middle = (shape + 1) / 2 @ medium.index_to_stage[:3, :3] + medium.index_to_stage[3, :3]
        size = max(float((middle - view.centre) @ view.forward), 0.0) / view.focal
    return int(np.clip(np.ceil(size / edge - 0.1), 1, _MOST_RAYS))


def _shared_colour(media: Sequence[Medium]) -> np.ndarray | None:
    """Light over extinction [4] where it is the same in all smoke; None where it is not."""
    densest = max(media, key=lambda medium: float(medium.extinction.max()))
    place = int(densest.extinction.argmax())
    most = float(densest.extinction.ravel()[place])
    if not most > 0:
        return None if any(medium.emission is not None for medium in media) else np.zeros(4)
    emission = np.zeros(3)
    if densest.emission is not None:
        emission = densest.emission.reshape(3, -1)[:, place] / most
    colour: np.ndarray = np.append(emission, densest.grey)
    for medium in media:
        if medium.grey != colour[3] and medium.extinction.any():
            return None
        for channel, share in enumerate(colour[:3]):
            if not _is_share(medium, channel, np.float32(share)):
                return None
    return colour


def _is_share(medium: Medium, channel: int, share: np.float32) -> bool:
    """Whether a channel of the emission is that share of the extinction everywhere."""
    if medium.emission is None:
        return not share or not medium.extinction.any()
    for step in (101, 1):  # a few voxels tell that it is not
        found = medium.emission[channel].ravel()[::step]
        wanted = share * medium.extinction.ravel()[::step]
        if (np.abs(found - wanted) > _SAME * np.abs(wanted)).any():
            return False
    return True

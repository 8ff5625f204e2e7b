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
from itertools import product

import numpy as np
import torch

from usdsmoke.core.smoke.memory import share_rows
from usdsmoke.core.views.cameras import View, view_rays
from usdsmoke.core.views.cells import Cells
from usdsmoke.core.views.columns import Columns, follows_axis
from usdsmoke.core.views.media import EXTINCTION, LIGHT, Medium
from usdsmoke.core.views.optics import attenuation_ratio
from usdsmoke.core.views.segments import Segments, depth_before

_CHUNK = 1 << 20  # numbers of each kind in memory at once, over all rays of a chunk
_THICK = 0.1  # optical depth above which a segment is cut once more
_HIDDEN = 0.25  # of these cuts, where little of a segment's light arrives
_MOST_PARTS = 64
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
    tracer, colour = _tracer(media, view, clip), _shared_colour(media)

    def draw(part: slice) -> None:
        pixels = np.arange(part.start, part.stop)
        for dy, dx in product(offsets, offsets):
            at = view_rays(view, pixels % view.width + dx, pixels // view.width + dy)
            depth, segments = tracer.cut(*at, with_light=colour is None)
            alpha = -np.expm1(-depth)
            if segments is not None:
                light = _light(segments, len(pixels))
            else:
                light = alpha[:, None] * colour
            total[pixels] += np.column_stack([depth, light, alpha])

    size = max(1, _CHUNK // tracer.numbers_per_ray)
    share_rows(draw, count, size, torch.device("cpu"))
    return _picture(total / rays**2, view)


def _picture(mean: np.ndarray, view: View) -> Picture:
    mean = mean.astype(np.float32).reshape(view.height, view.width, 6)
    return Picture(mean[..., 0], mean[..., 1:4], mean[..., 4], np.clip(mean[..., 5], 0.0, 1.0))


def _tracer(media: Sequence[Medium], view: View, clip: tuple[float, float]) -> Columns | Cells:
    if view.focal is not None:
        clip = (max(clip[0], 0.0), clip[1])
    elif len(media) == 1 and not _cuts(clip, media[0], view):
        if follows_axis(media[0], view.forward):
            return Columns(media[0], view.forward)
    return Cells(media, view.forward, clip)


def _cuts(clip: tuple[float, float], medium: Medium, view: View) -> bool:
    """Whether part of a medium lies before the nearest or behind the farthest depth."""
    corners = np.array(list(np.ndindex(2, 2, 2))) * (np.array(medium.values.shape[:3]) - 1)
    places = corners @ medium.index_to_stage[:3, :3] + medium.index_to_stage[3, :3]
    depths = (places - view.centre) @ view.forward
    return bool(depths.min() < clip[0] or depths.max() > clip[1])


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


def _shared_colour(media: Sequence[Medium]) -> np.ndarray | None:
    """Light over extinction [4] where it is the same in all smoke; None where it is not."""
    light, extinction = (
        np.max([medium.values[..., part].reshape(-1, n).max(axis=0) for medium in media], axis=0)
        for part, n in ((LIGHT, 4), (slice(EXTINCTION, EXTINCTION + 1), 1))
    )
    if not extinction > 0:
        return None
    colour: np.ndarray = light / extinction
    for values in (medium.values for medium in media):
        for channel, share in zip(range(values.shape[3])[LIGHT], colour, strict=True):
            wanted = share * values[..., EXTINCTION] if share else np.float32(0)
            if (np.abs(values[..., channel] - wanted) > _SAME * np.abs(wanted)).any():
                return None
    return colour


def _light(segments: Segments, n_rays: int) -> np.ndarray:
    """Light of rays, [n_rays 4] float64, front to back along every ray."""
    # light that is lost within a segment is only known to second order
    arriving = np.exp(depth_before(segments.ray, segments.thickness) * -0.5)
    parts = segments.thickness / _THICK * np.maximum(arriving, _HIDDEN)
    parts = np.ceil(parts).clip(1, _MOST_PARTS).astype(np.int64)
    index = np.repeat(np.arange(len(parts)), parts)
    number = np.arange(len(index)) - np.repeat(np.cumsum(parts) - parts, parts)
    share = 1 / parts[index]
    values = segments.sample(index, number * share, (number + 1) * share)
    half = torch.from_numpy(segments.length[index] * share / 2).repeat_interleave(2)
    ray = np.repeat(segments.ray[index], 2)
    pieces = values.flatten(0, 1)
    depth = pieces[:, EXTINCTION].double() * half
    before = torch.from_numpy(depth_before(ray, depth.numpy()))
    weight = half * attenuation_ratio(depth) * torch.exp(-before)
    light = [
        np.bincount(ray, (pieces[:, channel] * weight).numpy(), minlength=n_rays)
        for channel in range(pieces.shape[1])[LIGHT]
    ]
    return np.stack(light, axis=1)

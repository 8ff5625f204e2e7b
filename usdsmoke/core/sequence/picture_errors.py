"""How far a finished frame's picture is from that of rays, of pixels' means, of finer voxels."""

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.volume import DenseField
from usdsmoke.core.fields.resample import upsample
from usdsmoke.core.fields.richardson import StepError, step_error
from usdsmoke.core.rays.march import march
from usdsmoke.core.rays.media import Medium, make_media
from usdsmoke.core.smoke.active import ActiveSmoke, coarsen, densify
from usdsmoke.core.smoke.memory import run_on
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.optics import opacity
from usdsmoke.core.views.project import colour_map, column_map

MOST_RAYS = 4096  # of one picture
_BLOCK = 4  # pixels along a side, which coarser pictures have one of
MOST_VOXELS = 2**23  # of a dense box with five numbers a voxel


@dataclass(frozen=True)
class Painted:
    """Smoke with what it shines: linear colours [N 3], each times the share that is shown.

    None is grey smoke, whose picture is its opacity.
    """

    smoke: ActiveSmoke
    colours: Tensor | None

    def picture(self, view: View, gamma_w: float) -> Tensor:
        """Scene-linear colour premultiplied by alpha, and alpha, [H W 4]; alpha [H W 1] in grey."""
        if self.colours is None:
            image = column_map(self.smoke.positions, self.smoke.edges, view)
            return opacity(gamma_w * image.apply(self.smoke.density[:, None]))
        image, alpha = colour_map(
            self.smoke.positions, self.smoke.density, self.smoke.edges, gamma_w, view,
            self.smoke.voxel_size,
        )  # fmt: skip
        return torch.cat([image.apply(self.colours), alpha[..., None]], dim=-1)

    def halved(self) -> "Painted":
        """At half the resolution: density and what it shines are averaged over blocks of voxels."""
        smoke, density = coarsen(self.smoke), self.smoke.density
        if self.colours is None:
            return Painted(smoke, None)
        light = [
            coarsen(replace(self.smoke, density=density * channel)).density / smoke.density
            for channel in self.colours.unbind(1)
        ]
        return Painted(smoke, torch.stack(light, 1))


def fit_blocks(view: View) -> View:
    """The view, a little larger, so that its sides are multiples of four pixels."""
    height, width = (-(-side // _BLOCK) * _BLOCK for side in (view.height, view.width))
    return replace(view, height=height, width=width)


def quadrature_error(
    painted: Painted, view: View, gamma_w: float, picture: Tensor | None = None
) -> float:
    """How far the picture is from rays through the smoke, relative to their picture.

    Rays see voxels interpolated trilinearly, as renderers do, and sum along themselves accurately
    (``rays.march``). The optimiser spreads voxels over pixels, and over slabs a voxel thick.

    Args:
        painted: the frame, with colours.
        view: one of its views; some thousand of its pixels are compared.
        gamma_w: extinction per density, 1/stage unit.
        picture: ``painted.picture(view, gamma_w)``, if it is made already.
    """
    middle = _middle(painted)
    every = math.ceil(math.sqrt(view.height * view.width / MOST_RAYS))
    if picture is None or middle is not painted:
        picture = middle.picture(view, gamma_w)
    seen = picture[every // 2 :: every, every // 2 :: every]
    height, width = seen.shape[:2]
    offset = [  # of the first pixel that is compared, with the centre of the picture as origin
        ((side - 1) / 2 + shift - every // 2) / every - (count - 1) / 2
        for side, shift, count in zip(
            (view.width, view.height), view.shift, (width, height), strict=True
        )
    ]
    fewer = replace(
        view,
        height=height,
        width=width,
        pixel_size=view.pixel_size * every,
        focal=None if view.focal is None else view.focal / every,
        shift=(offset[0], offset[1]),
    )
    traced = march(_media(middle, gamma_w), fewer, rays=1).rgba
    size = float(np.abs(traced).sum())
    return float(np.abs(seen.cpu().numpy() - traced).sum()) / size if size > 0 else 0.0


def _middle(painted: Painted) -> Painted:
    """Of large smoke a part around its middle, whose dense box fits in memory."""
    while True:
        low, high = painted.smoke.box
        if np.prod(high - low + 1.0) <= MOST_VOXELS or painted.colours is None:
            return painted
        axis = int(np.argmax(high - low))
        index = painted.smoke.ijk[:, axis]
        kept = (index - index.median()).abs() <= (high[axis] - low[axis]) // 4
        painted = Painted(painted.smoke.take(kept), painted.colours[kept])


def _media(painted: Painted, gamma_w: float) -> list[Medium]:
    """The smoke as rays take it."""
    smoke, colours = painted.smoke, painted.colours
    assert colours is not None
    low, high = smoke.box
    light = colours.to(smoke.density) * (gamma_w * smoke.density)[:, None]
    both = torch.cat([smoke.density[:, None], light], 1)
    dense = densify(smoke.ijk, both, torch.as_tensor(low).to(smoke.ijk), high - low + 1)
    values, first = dense.cpu().numpy(), (int(low[0]), int(low[1]), int(low[2]))
    density = DenseField("density", values[..., 0], first, smoke.index_to_stage)
    emission = DenseField("emission", values[..., 1:], first, smoke.index_to_stage)
    return make_media(density, emission, np.eye(4), np.eye(4), gamma_w, 0.0)


def pixel_filter_error(
    painted: Painted, view: View, gamma_w: float, picture: Tensor | None = None
) -> float:
    """How far pixels that are sampled at their centres are from averages over them, relative.

    The optimiser sees the smoke at the centres of pixels; renderers average over pixels. The mean
    of four samples, a quarter of a pixel from the centre each way, stands for the average.

    Args:
        painted: the frame.
        view: one of its views.
        gamma_w: extinction per density, 1/stage unit.
        picture: as of ``quadrature_error``.
    """
    sampled = painted.picture(view, gamma_w) if picture is None else picture
    offsets = [(x, y) for x in (-0.25, 0.25) for y in (-0.25, 0.25)]
    moved = [replace(view, shift=(view.shift[0] + x, view.shift[1] + y)) for x, y in offsets]
    pictures = run_on(sampled.device, [partial(painted.picture, other, gamma_w) for other in moved])
    averaged = torch.stack(pictures).mean(0)
    size = float(averaged.abs().sum())
    return float((sampled - averaged).abs().sum()) / size if size > 0 else 0.0


def resolution_error(
    painted: Painted, view: View, gamma_w: float, picture: Tensor | None = None
) -> StepError:
    """Of voxels and pixels, relative to the picture: what infinitely many more would still change.

    Voxels, slabs and pixels are made 2 and 4 times as large, and the coarser pictures are brought
    to the finest one's pixels by cubic interpolation. Detail that the coarser pictures cannot hold
    counts in full.

    Args:
        painted: the frame.
        view: orthographic, from ``fit_blocks``.
        gamma_w: extinction per density, 1/stage unit.
        picture: as of ``quadrature_error``.
    """
    if picture is None:
        picture = painted.picture(view, gamma_w)
    pictures, here = [picture], painted
    for factor in (2, 4):
        here = here.halved()
        larger = replace(
            view,
            height=view.height // factor,
            width=view.width // factor,
            pixel_size=view.pixel_size * factor,
        )
        flat = here.picture(larger, gamma_w)[:, :, None]
        pictures.append(upsample(flat, (view.height, view.width, 1))[:, :, 0])
    return step_error(pictures)

"""How far a finished frame's picture is from that of finer slabs and of finer voxels."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from usdsmoke.core.fields.resample import upsample
from usdsmoke.core.fields.richardson import StepError, step_error
from usdsmoke.core.smoke.active import ActiveSmoke, coarsen
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.optics import opacity
from usdsmoke.core.views.project import colour_map, column_map


@dataclass(frozen=True)
class Painted:
    """Smoke with what it shines: linear colours [N 3], each times the share that is shown.

    None is grey smoke, whose picture is its opacity.
    """

    smoke: ActiveSmoke
    colours: Tensor | None

    def picture(self, view: View, gamma_w: float, step: float | None = None) -> Tensor:
        """Scene-linear colour premultiplied by alpha, and alpha, [H W 4]; alpha [H W 1] in grey.

        ``step`` is as in ``project.colour_map``; None takes the voxel's size.
        """
        if self.colours is None:
            image = column_map(self.smoke.positions, self.smoke.edges, view)
            return opacity(gamma_w * image.apply(self.smoke.density[:, None]))
        image, alpha = colour_map(
            self.smoke.positions, self.smoke.density, self.smoke.edges, gamma_w, view,
            step or self.smoke.voxel_size,
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


def fit_blocks(view: View, block: int = 4) -> View:
    """The view, a little larger, so that its sides are multiples of ``block`` pixels."""
    height, width = (-(-side // block) * block for side in (view.height, view.width))
    return replace(view, height=height, width=width)


def quadrature_error(painted: Painted, view: View, gamma_w: float, step: float) -> StepError:
    """Of the sums along the rays, relative to the picture: slabs of 1, 2 and 4 times the step.

    The opacity is exact whatever the slabs; what depends on them is which colour hides which.

    Args:
        painted: the frame.
        view: one of its views.
        gamma_w: extinction per density, 1/stage unit.
        step: thickness of the slabs, stage units.
    """
    pictures = [painted.picture(view, gamma_w, factor * step) for factor in (1, 2, 4)]
    return step_error(pictures)


def pixel_filter_error(painted: Painted, view: View, gamma_w: float) -> float:
    """How far pixels that are sampled at their centres are from averages over them, relative.

    The optimiser sees the smoke at the centres of pixels; renderers average over pixels. The mean
    of four samples, a quarter of a pixel from the centre each way, stands for the average.

    Args:
        painted: the frame.
        view: one of its views.
        gamma_w: extinction per density, 1/stage unit.
    """
    sampled = painted.picture(view, gamma_w)
    offsets = [(x, y) for x in (-0.25, 0.25) for y in (-0.25, 0.25)]
    moved = [replace(view, shift=(view.shift[0] + x, view.shift[1] + y)) for x, y in offsets]
    averaged = torch.stack([painted.picture(other, gamma_w) for other in moved]).mean(0)
    size = float(averaged.abs().sum())
    return float((sampled - averaged).abs().sum()) / size if size > 0 else 0.0


def resolution_error(painted: Painted, view: View, gamma_w: float) -> StepError:
    """Of voxels and pixels, relative to the picture: what infinitely many more would still change.

    Voxels, slabs and pixels are made 2 and 4 times as large, and the coarser pictures are brought
    to the finest one's pixels by cubic interpolation. Detail that the coarser pictures cannot hold
    counts in full.

    Args:
        painted: the frame.
        view: orthographic, from ``fit_blocks``.
        gamma_w: extinction per density, 1/stage unit.
    """
    pictures, here = [], painted
    for factor in (1, 2, 4):
        here = painted if factor == 1 else here.halved()
        larger = replace(
            view,
            height=view.height // factor,
            width=view.width // factor,
            pixel_size=view.pixel_size * factor,
        )
        flat = here.picture(larger, gamma_w)[:, :, None]
        pictures.append(upsample(flat, (view.height, view.width, 1)))
    return step_error(pictures)

"""Areas of a picture that are darker than those of a style, or have less contrast (decision 089).

Statistics do not tell where marks belong: they gather on some of the smoke, and black on other
parts. Areas of a picture that fall short of most areas of the style cost something; those that have
more do not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.style.style_image import alpha_of, unless_small

AREAS = 24  # radii of an area along the longer side of a picture: standard deviations of a Gaussian
FINE = 3  # of them in a radius: contrast is that of all marks, and that of fine ones alone
LEAST_RADIUS = 1.0  # pixels; finer marks are not looked for
WEIGHTS = (1.0, 0.25)  # of the contrast of all marks, and of fine ones
DARK = 3.0  # of darkness
LOW, DARKEST = 0.25, 0.1  # shares of a style's areas with less contrast, or that are darker
FAINT = 0.03  # a level that is hardly seen: what lacks is a share of this or of the level
_PER_RADIUS = 2.0  # samples along the radius of an area, at least
_CUT = 3.0  # radii after which a Gaussian ends
_LEAST_CONTRAST = 1e-3  # of pictures: a root has no slope at 0


@dataclass(frozen=True)
class AreaLevels:
    """What areas have at least."""

    radius: float  # of an area, pixels
    value: float  # mean of the brightest channel, display-encoded
    contrasts: tuple[float, ...]  # root mean square over all channels of what is finer than an area

    @staticmethod
    def mean(parts: Sequence[tuple[float, "AreaLevels"]]) -> "AreaLevels":
        """Of several styles, with their shares, at one radius."""
        value = sum(share * part.value for share, part in parts)
        by_style = [[share * level for level in part.contrasts] for share, part in parts]
        contrasts = tuple(map(sum, zip(*by_style, strict=True)))
        return AreaLevels(parts[0][1].radius, value, contrasts)


def area_levels(style: Tensor, radius: float) -> AreaLevels:
    """What areas of a style have: nine in ten are as bright, and three in four have the contrast.

    Args:
        style: display-encoded [H W 3], at the size of pictures; or [H W 4], whose alpha is 1 in the
            areas that count.
        radius: of an area, pixels.

    Gradients: none.
    """
    alpha = unless_small(alpha_of(style))
    counts = torch.ones_like(style[..., 0]) if alpha is None else alpha
    with torch.no_grad():
        value, contrasts, weight = _measured(style[..., :3], counts, radius)
    found = [_quantile(contrast, weight, LOW) for contrast in contrasts]
    return AreaLevels(radius, _quantile(value, weight, DARKEST), tuple(found))


def _quantile(values: Tensor, weight: Tensor, share: float) -> float:
    order = values.flatten().argsort()
    below = weight.flatten()[order].cumsum(0) / weight.sum()
    return float(values.flatten()[order[below >= share][0]])


def area_distance(picture: Tensor, guide: Tensor, levels: AreaLevels) -> Tensor:
    """How far areas of a picture are below the levels, scalar; 0 where none is.

    The mean square of what they lack, as a share of each level.

    Args:
        picture: [H W 3], display-encoded.
        guide: [H W] in [0, 1], where the smoke is.
        levels: of the style, at the size of the picture.

    Gradients: through ``picture``.
    """
    value, contrasts, weight = _measured(picture, guide, levels.radius)
    total = DARK * _lacking(value, levels.value)
    weights = WEIGHTS[: len(contrasts)]
    for share, contrast, level in zip(weights, contrasts, levels.contrasts, strict=True):
        total = total + share * _lacking(contrast, level)
    return (weight * total).sum() / weight.sum().clamp_min(torch.finfo(weight.dtype).tiny)


def _lacking(found: Tensor, level: float) -> Tensor:
    return ((level - found) / max(level, FAINT)).clamp_min(0).square()


def _measured(picture: Tensor, guide: Tensor, radius: float) -> tuple[Tensor, Tensor, Tensor]:
    """Value [h w] and contrasts [1 or 2, h w] of areas, and how much of each counts [h w]."""
    pixels, counts = picture.permute(2, 0, 1)[None], guide[None, None]
    area = _Area(counts, radius)
    measured = [pixels.amax(1, keepdim=True), _energy(pixels - area.at_pixels(pixels))]
    if radius / FINE >= LEAST_RADIUS:
        measured.append(_energy(pixels - _Area(counts, radius / FINE).at_pixels(pixels)))
    found = area.mean(torch.cat(measured, 1))[0]
    return found[0], found[1:].clamp_min(_LEAST_CONTRAST**2).sqrt(), area.weight[0, 0]


def _energy(detail: Tensor) -> Tensor:
    return detail.square().sum(1, keepdim=True)


class _Area:
    """Means over Gaussians, of the pixels that count [1 1 H W], in cells of some pixels."""

    def __init__(self, counts: Tensor, radius: float) -> None:
        self._step = max(1, int(radius / _PER_RADIUS))
        self._counts, self._radius = counts, radius / self._step
        self.weight = self._around(counts)

    def mean(self, values: Tensor) -> Tensor:
        """Means of [1 C H W], one for each cell [1 C h w].

        Gradients: through ``values``.
        """
        tiny = torch.finfo(values.dtype).tiny
        return self._around(values * self._counts) / self.weight.clamp_min(tiny)

    def at_pixels(self, values: Tensor) -> Tensor:
        """The same at every pixel [1 C H W], linear between cells."""
        cells, (height, width) = self.mean(values), values.shape[2:]
        if self._step == 1:
            return cells
        size = [side * self._step for side in cells.shape[2:]]
        return F.interpolate(cells, size, mode="bilinear")[..., :height, :width]

    def _around(self, values: Tensor) -> Tensor:
        """Sums over Gaussians; beyond the picture, nothing counts."""
        if self._step > 1:
            height, width = values.shape[2:]
            padding = (0, -width % self._step, 0, -height % self._step)
            values = F.avg_pool2d(F.pad(values, padding), self._step)
        reach = max(1, round(_CUT * self._radius))
        place = torch.arange(-reach, reach + 1, dtype=values.dtype, device=values.device)
        gauss = (-0.5 * (place / self._radius).square()).exp()
        gauss, n = gauss / gauss.sum(), values.shape[1]
        for shape, beyond in (((1, 1, -1, 1), (reach, 0)), ((1, 1, 1, -1), (0, reach))):
            kernel = gauss.view(shape).expand(n, -1, -1, -1)
            values = F.conv2d(values, kernel, padding=beyond, groups=n)
        return values

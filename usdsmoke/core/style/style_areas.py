"""The areas of a style image that looks are painted with: areas with marks, which are not dark.

Statistics do not tell where marks belong. What is dark in the style, or has no marks, gathers in
areas of the smoke, where it looks like holes or haze (decision 088).
"""

import numpy as np

from usdsmoke.base.errors import ShapeError

DARK = 0.55  # of the brightest channel, mean and deviation: an area below it shows no marks
FLAT = 0.2  # of the image's mean contrast: an area with less has no marks
MOST = 1 / 3  # share of the image that is left out
EVEN = 1 / 255  # contrast of even paint: where the flattest third has less, it is part of the style
LONGEST = 1536  # pixels; a larger image is reduced, as pictures are not compared with finer marks
CELLS = 192  # along the shorter side, in which areas are measured
AREAS = 24  # radii of an area along the shorter side


def marked_areas(style: np.ndarray) -> np.ndarray:
    """Where a style image has marks that are not dark, [H W] bool; True somewhere.

    An area is a Gaussian of 1/24 of the shorter side. It is left out where its contrast, of all
    channels and of what is finer than half an area, is less than ``FLAT`` of the mean over the
    image, and where the mean of the brightest channel and its standard deviation add up to less
    than ``DARK``: the flattest areas first, then the darkest, up to ``MOST`` of the image. So a
    dark image stays dark. Areas that are equal to a hundredth are left out together or not at all,
    and graphics of even colours keep their flat areas.

    Args:
        style: display-encoded [H W 3], in [0, 1].

    Raises:
        ShapeError: the image is not [H W 3].
    """
    if style.ndim != 3 or style.shape[2] != 3 or style.size == 0:
        raise ShapeError(f"marked_areas: the style is {list(style.shape)}. Give [H W 3].")
    height, width = style.shape[:2]
    first = -(-max(height, width) // LONGEST)
    pixels = _means(style, first)
    then = max(1, min(pixels.shape[:2]) // CELLS)
    colours, squares, value = (_means(of, then) for of in (pixels, pixels**2, _values(pixels)))
    radius = max(1, min(colours.shape[:2]) // AREAS)

    # a cell's mean square of its pixels less the colour around
    coarse = _around(colours, max(1, radius // 2))
    energy = squares - 2 * colours * coarse + coarse**2
    contrast = np.sqrt(np.maximum(_around(energy.mean(axis=2), radius), 0))
    flattest = np.quantile(contrast, MOST)
    flat = min(FLAT * contrast.mean(), flattest) if flattest >= EVEN else 0.0

    mean, square = np.moveaxis(_around(value, radius), 2, 0)
    bright = (mean + np.sqrt(np.maximum(square - mean**2, 0))).round(2)
    ranked = np.where(contrast < flat, -1.0, bright)  # flat areas are left out first
    left_out = ranked < max(min(DARK, np.quantile(ranked, MOST)), 0.0)

    kept = ~left_out.repeat(first * then, axis=0).repeat(first * then, axis=1)
    return kept[:height, :width]


def _values(pixels: np.ndarray) -> np.ndarray:
    """The brightest channel and its square, [H W 2]."""
    value = pixels.max(axis=2)
    return np.stack([value, value**2], axis=2)


def _means(style: np.ndarray, factor: int) -> np.ndarray:
    """Means of [H W C] over squares of pixels, float64; those at the border may be smaller."""
    for axis, n in enumerate(style.shape[:2]):
        first = np.arange(0, n, factor)
        counts = np.minimum(first + factor, n) - first
        sums = np.add.reduceat(style, first, axis, dtype=np.float64)
        style = sums / counts.reshape([-1 if a == axis else 1 for a in range(3)])
    return style


def _around(values: np.ndarray, radius: int) -> np.ndarray:
    """Means of [H W ...] over squares, three times: a Gaussian of about ``radius`` pixels.

    The border cuts squares off.
    """
    for axis in (0, 1) * 3:
        n = values.shape[axis]
        place = np.arange(n)
        below, above = np.minimum(radius, place), np.minimum(radius, n - 1 - place)
        sums = np.concatenate([np.zeros_like(values.take([0], axis)), values.cumsum(axis)], axis)
        counts = (below + above + 1).reshape([-1 if a == axis else 1 for a in range(values.ndim)])
        values = (sums.take(place + above + 1, axis) - sums.take(place - below, axis)) / counts
    return values

"""The areas of a style image that looks are painted with: areas with marks, which are not dark.

Statistics do not tell where marks belong. What is dark in the style, or has no marks, gathers in
areas of the smoke, where it looks like holes or haze (decision 088).
"""

import numpy as np

from usdsmoke.base.errors import ShapeError

DARK = 0.55  # of the brightest channel, mean and deviation: an area below it shows no marks
FLAT = 0.2  # of the image's mean contrast: an area with less has no marks
MOST = 1 / 3  # share of the image that is left out
MARKS = 0.01  # contrast, of luma: an image with less in the mean has no marks, and is kept
LONGEST = 512  # pixels; a larger image is reduced, as what is finer is no mark
AREAS = 24  # radii of an area along the shorter side of the image

_LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)  # of red, green and blue: Rec. 709


def marked_areas(style: np.ndarray) -> np.ndarray:
    """Where a style image has marks that are not dark, [H W] bool; True somewhere.

    An area is a Gaussian of 1/24 of the shorter side. It is left out where its contrast is less
    than ``FLAT`` of the mean over the image, and where the mean of the brightest channel and its
    standard deviation add up to less than ``DARK``: the flattest areas first, then the darkest, up
    to ``MOST`` of the image. So a dark image stays dark. Of areas that are equal, as in an image of
    few even colours, none is left out.

    Args:
        style: display-encoded [H W 3], in [0, 1].

    Raises:
        ShapeError: the image is not [H W 3].
    """
    if style.ndim != 3 or style.shape[2] != 3 or style.size == 0:
        raise ShapeError(f"marked_areas: the style is {list(style.shape)}. Give [H W 3].")
    factor = -(-max(style.shape[:2]) // LONGEST)
    small = _reduced(style, factor)
    radius = max(1, min(small.shape[:2]) // AREAS)

    value = small.max(axis=2)
    mean = _around(value, radius)
    bright = mean + np.sqrt(np.maximum(_around(value**2, radius) - mean**2, 0))
    light = small @ _LUMA
    marks = light - _around(light, max(1, radius // 2), is_even=True)
    contrast = np.sqrt(np.maximum(_around(marks**2, radius), 0))

    usual = contrast.mean()
    flat = FLAT * usual if usual >= MARKS else 0.0
    is_flat = contrast < min(flat, np.quantile(contrast, MOST))
    ranked = np.where(is_flat, 0, bright)
    is_dark = ranked < min(DARK, np.quantile(ranked, MOST))
    kept = ~(is_dark | is_flat).repeat(factor, axis=0).repeat(factor, axis=1)
    return kept[: style.shape[0], : style.shape[1]]


def _reduced(style: np.ndarray, factor: int) -> np.ndarray:
    """Means over squares of pixels, float64; those at the border may be smaller."""
    for axis, n in enumerate(style.shape[:2]):
        first = np.arange(0, n, factor)
        counts = np.minimum(first + factor, n) - first
        sums = np.add.reduceat(style, first, axis, dtype=np.float64)
        style = sums / counts.reshape([-1 if a == axis else 1 for a in range(3)])
    return style


def _around(values: np.ndarray, radius: int, is_even: bool = False) -> np.ndarray:
    """Means of [H W] over squares, three times: a Gaussian of about ``radius`` pixels.

    Args:
        is_even: squares are smaller at the border instead of cut, so that a slope has its own
            values as means.
    """
    for axis in (0, 1) * 3:
        n = values.shape[axis]
        place = np.arange(n)
        below, above = np.minimum(radius, place), np.minimum(radius, n - 1 - place)
        if is_even:
            below = above = np.minimum(below, above)
        sums = np.concatenate([np.zeros_like(values.take([0], axis)), values.cumsum(axis)], axis)
        counts = np.expand_dims(below + above + 1, 1 - axis)
        values = (sums.take(place + above + 1, axis) - sums.take(place - below, axis)) / counts
    return values

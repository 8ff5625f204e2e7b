"""How large a style has to be for its marks to be as wide as voxels can hold."""

import math
from collections.abc import Sequence

import numpy as np
from PIL import Image

from usdsmoke.config.look_sections import ViewsConfig
from usdsmoke.config.settings import Config, style_shares

LEAST_WAVELENGTH = 3.4  # voxels; finer marks are mottle, as no two views agree on them
SIZES = tuple(2 ** (n / 2) for n in range(5))  # that an unset ``style.size`` is one of
FINE, WIDE = 4.0, 16.0  # voxels: wavelengths of marks that views disagree on, and of all marks
MOST_FINE = 0.45  # share of the fine ones that an enlarged style may have
WORTH_IT = 0.95  # times the fine share at 1: a size with at most that is taken where none suffices
FLAT = 0.01  # deviation of the luminance below which a style has no marks

_LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)  # of red, green and blue: Rec. 709


def find_style_size(styles: Sequence[np.ndarray], voxels: float, config: Config) -> float:
    """The size of the styles of one shot where ``style.size`` is unset; 1 where it is set.

    Of several images, the one that needs the least decides.

    Args:
        styles: display-encoded images [H W 3] in [0, 1].
        voxels: of the source, along the longer side of the picture.
    """
    return _find_size(_used_lights(styles, config), voxels, config)


def refine_for_less(
    styles: Sequence[np.ndarray], voxels: float, config: Config, size: float, most: int
) -> int:
    """The least ``grids.refine`` with which the size is smaller; 0: there is none.

    Args:
        styles, voxels: as in ``find_style_size``.
        size: what that gives.
        most: the largest ``grids.refine`` that is tried.
    """
    if size == 1:
        return 0
    side, lights = side_of_marks(voxels, config), _used_lights(styles, config)
    for refine in range(config.grids.parts + 1, most + 1):
        finer = config.replace(grids=config.grids.replace(refine=refine))
        # on no more voxels, marks are no wider
        if side_of_marks(voxels, finer) > side and _find_size(lights, voxels, finer) < size:
            return refine
    return 0


def side_of_marks(voxels: float, config: Config) -> float:
    """The longer side of the picture in what marks of a style are counted in.

    These are the voxels of the shot or, if these are finer, pixels of the usual
    ``views.image_size``, so that presets agree.

    Args:
        voxels: of the source, along the longer side of the picture.
    """
    voxels = voxels * config.grids.parts
    return voxels / max(1, round(voxels / ViewsConfig().image_size))


def luminance(style: np.ndarray) -> Image.Image:
    """Of an image [H W 3], display-encoded; 32 bits."""
    return Image.fromarray(np.asarray(style, np.float32) @ _LUMA)


def least_size(light: Image.Image, longer_side: float) -> float:
    """The ``style.size`` with which marks are wide enough for voxels; 1 if they are at 1 already.

    Else the least of ``SIZES`` with few fine marks. Of a style that has many at any size, the one
    with the fewest, or 1 if that hardly helps.

    Args:
        light: the style's ``luminance``, in [0, 1].
        longer_side: of the rendered picture, in voxels.
    """
    shares = list[float]()
    for size in SIZES:
        scaled = scaled_light(light, longer_side * size)
        if not shares and mean_wavelength(scaled) >= LEAST_WAVELENGTH:
            return size
        shares.append(fine_share(scaled))
        if shares[-1] <= MOST_FINE:
            return size
    fewest = min(shares)
    return SIZES[shares.index(fewest)] if fewest <= WORTH_IT * shares[0] else SIZES[0]


def mean_wavelength(light: np.ndarray) -> float:
    """Of the slopes of an image's luminance [H W], in pixels; infinite for a flat image.

    1 over the mean spatial frequency, which counts by the power of the slopes. White noise has 2.1.
    """
    power, squares = _spectrum(light)
    slopes = power * squares
    total = float((slopes * np.sqrt(squares)).sum())
    return float(slopes.sum()) / total if total > 0 else math.inf


def fine_share(light: np.ndarray) -> float:
    """Of the amplitude of the marks of a luminance [H W], what is finer than ``FINE`` pixels.

    The root of the power at wavelengths below ``FINE`` over that below ``WIDE``, in [0, 1]; 0 for a
    flat image. White noise has 0.9.
    """
    power, squares = _spectrum(light)
    marks = float(power[squares > WIDE**-2].sum())
    return math.sqrt(float(power[squares > FINE**-2].sum()) / marks) if marks > 0 else 0.0


def scaled_light(light: Image.Image, longer_side: float) -> np.ndarray:
    """A luminance [H W] as pictures are compared with it: by the filter of the style loss, without
    torch.

    Args:
        longer_side: pixels of the result's longer side.
    """
    scale = longer_side / max(light.size)
    width, height = (max(1, round(n * scale)) for n in light.size)
    if (width, height) != light.size:
        light = light.resize((width, height), Image.Resampling.BILINEAR)  # smooths to reduce
    return np.asarray(light, np.float64)


def _used_lights(styles: Sequence[np.ndarray], config: Config) -> list[Image.Image]:
    """The luminance of each style that has a weight; none where the size is set."""
    if not config.style.is_size_open:
        return []
    shares = style_shares(config.style, len(styles))
    return [luminance(style) for style, share in zip(styles, shares, strict=True) if share > 0]


def _find_size(lights: Sequence[Image.Image], voxels: float, config: Config) -> float:
    longer_side = side_of_marks(voxels, config)
    return min((least_size(light, longer_side) for light in lights), default=1.0)


def _spectrum(light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The power of a luminance, and the squared frequency in cycles per pixel, [H W]."""
    light = np.asarray(light, np.float64)
    light = np.zeros_like(light) if light.std() < FLAT else light - light.mean()
    for axis, n in enumerate(light.shape):  # borders of the image are no marks
        light = light * np.expand_dims(np.hanning(n), 1 - axis)
    rows, columns = (np.fft.fftfreq(n) for n in light.shape)
    return np.abs(np.fft.fft2(light)) ** 2, rows[:, None] ** 2 + columns**2

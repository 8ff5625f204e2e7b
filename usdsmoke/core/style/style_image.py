"""The style image at the scale of the rendered picture, its grey levels and its colour axes."""

import math

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.base.sections import StyleConfig
from usdsmoke.core.smoke.srgb import luma

LEAST_WAVELENGTH = 3.4  # voxels; finer marks are mottle, as no two views agree on them
SIZES = tuple(2 ** (n / 2) for n in range(5))  # that an unset ``style.size`` is one of
FINE, WIDE = 4.0, 16.0  # voxels: wavelengths of marks that views disagree on, and of all marks
MOST_FINE = 0.45  # share of the fine ones that an enlarged style may have
WORTH_IT = 0.95  # times the fine share at 1: a size with at most that is taken where none suffices
FLAT = 0.01  # deviation of the luminance below which a style has no marks
SMALLEST = 16  # pixels; smaller styles are enlarged to this, or filters of 7 pixels see only border


def scale_style(style: np.ndarray, longer_side: float, config: StyleConfig, like: Tensor) -> Tensor:
    """The style image tiled and resized for pictures of a given size, [h w 3].

    Args:
        style: [H W 3], display-encoded, in [0, 1].
        longer_side: pixels of the rendered picture's longer side.
        config: ``tiling`` repeats the image, ``size`` enlarges its structures; unset it is 1.
        like: gives dtype and device.
    """
    pixels = torch.as_tensor(np.ascontiguousarray(style)).to(like).permute(2, 0, 1)[None]
    height, width = pixels.shape[-2:]
    scale = longer_side * (config.size or 1.0) / config.tiling / max(height, width)
    size = [max(1, round(height * scale)), max(1, round(width * scale))]
    if size != [height, width]:
        pixels = F.interpolate(
            pixels, size=size, mode="bilinear", antialias=True, align_corners=False
        )
    pixels = pixels.repeat(1, 1, config.tiling, config.tiling)
    height, width = pixels.shape[-2:]
    if min(height, width) < SMALLEST:
        factor = SMALLEST / min(height, width)
        size = [round(height * factor), round(width * factor)]
        pixels = F.interpolate(pixels, size=size, mode="nearest")
    return pixels[0].permute(1, 2, 0).clamp(0, 1).contiguous()


def find_size(style: np.ndarray, longer_side: float) -> float:
    """The ``style.size`` with which marks are wide enough for voxels; 1 if they are at 1 already.

    Else the least of ``SIZES`` with few fine marks. Of a style that has many at any size, the one
    with the fewest, or 1 if that hardly helps.

    Args:
        style: [H W 3], display-encoded, in [0, 1].
        longer_side: of the rendered picture, in voxels.
    """
    shares = list[float]()
    for size in SIZES:
        # float64: rounding is no mark of a flat style
        like = torch.zeros((), dtype=torch.float64)
        scaled = scale_style(style, longer_side, StyleConfig(size=size), like)
        if not shares and mean_wavelength(scaled) >= LEAST_WAVELENGTH:
            return size
        shares.append(fine_share(scaled))
        if shares[-1] <= MOST_FINE:
            return size
    fewest = min(shares)
    return SIZES[shares.index(fewest)] if fewest <= WORTH_IT * shares[0] else SIZES[0]


def mean_wavelength(style: Tensor) -> float:
    """Of the slopes of an image's luminance [H W 3], in pixels; infinite for a flat image.

    1 over the mean spatial frequency, which counts by the power of the slopes. White noise has 2.1.
    """
    power, squares = _spectrum(style)
    slopes = power * squares
    total = float((slopes * squares.sqrt()).sum())
    return float(slopes.sum()) / total if total > 0 else math.inf


def fine_share(style: Tensor) -> float:
    """Of the amplitude of an image's marks [H W 3], what is finer than ``FINE`` pixels, in [0, 1].

    The root of the power at wavelengths below ``FINE`` over that below ``WIDE``; 0 for a flat
    image. White noise has 0.9.
    """
    power, squares = _spectrum(style)
    marks = float(power[squares > WIDE**-2].sum())
    return math.sqrt(float(power[squares > FINE**-2].sum()) / marks) if marks > 0 else 0.0


def _spectrum(style: Tensor) -> tuple[Tensor, Tensor]:
    """The power of an image's luminance, and the squared frequency in cycles per pixel, [H W]."""
    light = luma(style)
    is_flat = light.std(correction=0) < FLAT
    light = torch.zeros_like(light) if is_flat else light - light.mean()
    for axis, n in enumerate(light.shape):  # borders of the image are no marks
        light = light * torch.hann_window(n, periodic=False).to(light).unsqueeze(1 - axis)
    rows, columns = (torch.fft.fftfreq(n).to(light) for n in light.shape)
    return torch.fft.fft2(light).abs().square(), rows[:, None].square() + columns.square()


def adjust_tones(style: np.ndarray, config: StyleConfig) -> np.ndarray:
    """The style image with the amount of colour and the darkest level that are asked for, [H W 3].

    Args:
        style: [H W 3], display-encoded, in [0, 1].
        config: ``colour`` scales the distance of each pixel from its own grey; ``lift`` is what
            black becomes, with white fixed.
    """
    if config.colour == 1 and config.lift == 0:
        return style
    grey = luma(torch.as_tensor(np.ascontiguousarray(style))).numpy()[..., None]
    toned = np.clip(grey + config.colour * (style - grey), 0, 1)
    return (config.lift + (1 - config.lift) * toned).astype(style.dtype)


def match_grey(style: Tensor, mean: float, deviation: float) -> Tensor:
    """The style's luminance with the mean and contrast of the smoke's grey pictures, [H W 3].

    Unmatched, the first Gram losses are huge and the optimiser only chases contrast.

    Args:
        style: [H W 3], display-encoded.
        mean, deviation: of the grey level inside the smoke's silhouette.
    """
    light = luma(style)
    spread = light.std(correction=0).clamp_min(1e-4)
    contrast = max(deviation, 0.2)  # nearly flat smoke still takes visible structure
    matched = (light - light.mean()) / spread * contrast + mean
    return matched.clamp(0, 1)[..., None].expand(-1, -1, 3).contiguous()


def colour_whitening(pixels: Tensor, floor: float, relative: float = 0.0) -> tuple[Tensor, Tensor]:
    """Mean [3] and ZCA matrix [3 3] of colours [... 3].

    W = U diag((e + max(floor, relative * e_max))^-1/2) U^T with the covariance's eigenvalues e and
    eigenvectors U. The floors keep directions that the style hardly has from being blown up:
    without them a two-colour style gets green and yellow tints, and a constant one divides by zero.
    """
    flat = pixels.reshape(-1, 3).double()
    mean = flat.mean(0)
    centred = flat - mean
    covariance = centred.T @ centred / max(len(flat), 1)
    values, vectors = torch.linalg.eigh(covariance)
    values = values.clamp_min(0)
    least = (relative * values[-1]).clamp_min(floor)
    matrix = vectors @ torch.diag((values + least).rsqrt()) @ vectors.T
    return mean.to(pixels.dtype), matrix.to(pixels.dtype)

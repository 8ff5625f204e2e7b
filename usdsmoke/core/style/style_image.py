"""The style image at the scale of the rendered picture, its tones and its grey levels."""

import math

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.config.look_sections import StyleConfig
from usdsmoke.core.smoke.srgb import luma

SMALLEST = 16  # pixels; smaller styles are enlarged to this, or filters of 7 pixels see only border
# A dark area reads as a hole in the smoke, and a dark line as a mark (decision 086)
_AREA = 1 / 24  # of the style's shorter side: deviation of the mean around a pixel
_AREA_PIXELS = 2  # of the deviation, where the mean is taken
_STEEPEST = 4.0  # times as bright: more shows noise
_LIFTED_AT_ONCE = 2**20  # pixels


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


def adjust_tones(style: np.ndarray, config: StyleConfig) -> np.ndarray:
    """The style image with the amount of colour and lifted dark areas that are asked for, [H W 3].

    Args:
        style: [H W 3], display-encoded, in [0, 1].
        config: ``colour`` scales the distance of each pixel from its own grey; ``lift`` is the
            value (the brightest channel) to which areas are lifted, see ``_lift_areas``.
    """
    if config.colour != 1:
        grey = luma(torch.as_tensor(np.ascontiguousarray(style))).numpy()[..., None]
        style = np.clip(grey + config.colour * (style - grey), 0, 1).astype(style.dtype)
    return style if config.lift == 0 else _lift_areas(style, config.lift)


def _lift_areas(style: np.ndarray, level: float) -> np.ndarray:
    """Make areas brighter that are darker than a level, with the marks in them, [H W 3].

    The value of a colour is its brightest channel: dark red is dark to the eye, but no hole. A
    curve that keeps black and white takes the mean value around a pixel to the level, or as far as
    its slope at black allows. So dark marks in bright areas stay, and so does black without marks.
    The level is at most the mean of the image, so a style that is dark as a whole stays dark.
    Hues stay; saturation falls by the root of the gain, because colours near black are mostly
    noise.

    Args:
        style: display-encoded, in [0, 1].
        level: display-encoded, in (0, 1).
    """
    pixels = torch.as_tensor(np.ascontiguousarray(style))
    value = pixels.amax(-1)
    level = min(level, float(value.mean(dtype=torch.float64)))
    around, lifted = _mean_around(value), torch.empty_like(pixels)
    n_rows = max(1, _LIFTED_AT_ONCE // pixels.shape[1])
    for part in (slice(row, row + n_rows) for row in range(0, len(pixels), n_rows)):
        mean, here = around[part], value[part]
        slope = level * (1 - mean) / (mean * max(1 - level, 1e-6)).clamp_min(1e-6)
        slope = slope.clamp(1, _STEEPEST)
        gain = slope / (1 + (slope - 1) * here)
        whiteness = (here[..., None] - pixels[part]) * gain.rsqrt()[..., None]
        lifted[part] = ((here[..., None] - whiteness) * gain[..., None]).clamp_(0, 1)
    return lifted.numpy()


def _mean_around(values: Tensor) -> Tensor:
    """Gaussian mean around each pixel, [H W], whose deviation is ``_AREA``."""
    shorter = min(values.shape)
    scale = min(1.0, _AREA_PIXELS / (_AREA * shorter))
    size = [max(1, round(scale * side)) for side in values.shape]
    small = F.interpolate(
        values[None, None], size=size, mode="bilinear", antialias=True, align_corners=False
    )
    deviation = _AREA * shorter * scale
    reach = math.ceil(3 * deviation)
    steps = torch.arange(-reach, reach + 1).to(values)
    kernel = (-0.5 * (steps / deviation).square()).exp()
    kernel /= kernel.sum()
    small = F.conv2d(F.pad(small, (reach, reach, 0, 0), "replicate"), kernel[None, None, None])
    small = F.conv2d(F.pad(small, (0, 0, reach, reach), "replicate"), kernel[None, None, :, None])
    mean = F.interpolate(small, size=list(values.shape), mode="bilinear", align_corners=False)
    return mean[0, 0]


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

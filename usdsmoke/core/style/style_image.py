"""The style image at the scale of the rendered picture, its tones and its grey levels."""

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.config.look_sections import StyleConfig
from usdsmoke.core.smoke.srgb import luma

SMALLEST = 16  # pixels; smaller styles are enlarged to this, or filters of 7 pixels see only border


def scale_style(style: np.ndarray, longer_side: float, config: StyleConfig, like: Tensor) -> Tensor:
    """The style image tiled and resized for pictures of a given size, [h w C].

    Args:
        style: [H W C], display-encoded, in [0, 1], with alpha or without.
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


def alpha_of(style: Tensor) -> Tensor | None:
    """Alpha [H W] of an image [H W 4]; None of one without, [H W 3]."""
    return style[..., 3] if style.shape[-1] == 4 else None


def in_areas(values: Tensor, areas: Tensor | None) -> Tensor:
    """Those of values [P ...] that lie in areas, any shape of P numbers in [0, 1], by half or more.

    All of them where areas are None, or smaller than a pixel each.
    """
    seen = unless_small(areas)
    return values if seen is None else values[seen.flatten() >= 0.5]


def unless_small(areas: Tensor | None) -> Tensor | None:
    """Areas in [0, 1] of any shape; None where they are smaller than a pixel each."""
    return areas if areas is not None and bool((areas >= 0.5).any()) else None


def counted_pixels(style: Tensor) -> Tensor:
    """The pixels [P 3] of an image [H W 3] or, of one with alpha, those that count."""
    return in_areas(style[..., :3].flatten(0, 1), alpha_of(style))


def adjust_tones(style: np.ndarray, config: StyleConfig) -> np.ndarray:
    """The style image with the amount of colour that is asked for, [H W 3].

    Args:
        style: [H W 3], display-encoded, in [0, 1].
        config: ``colour`` scales the distance of each pixel from its own grey.
    """
    if config.colour == 1:
        return style
    grey = luma(torch.as_tensor(np.ascontiguousarray(style))).numpy()[..., None]
    return np.clip(grey + config.colour * (style - grey), 0, 1).astype(style.dtype)


def match_grey(style: Tensor, mean: float, deviation: float) -> Tensor:
    """The style's luminance with the mean and contrast of the smoke's grey pictures, same shape.

    Unmatched, the first Gram losses are huge and the optimiser only chases contrast.

    Args:
        style: [H W 3], display-encoded; or [H W 4], whose alpha is 1 in the areas that count.
        mean, deviation: of the grey level inside the smoke's silhouette.
    """
    light = luma(style[..., :3])
    counted = in_areas(light.flatten(), alpha_of(style))
    spread = counted.std(correction=0).clamp_min(1e-4)
    contrast = max(deviation, 0.2)  # nearly flat smoke still takes visible structure
    matched = (light - counted.mean()) / spread * contrast + mean
    grey = matched.clamp(0, 1)[..., None].expand(-1, -1, 3)
    return torch.cat([grey, style[..., 3:]], dim=-1)

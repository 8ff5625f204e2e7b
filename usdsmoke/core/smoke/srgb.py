"""Display-encoded and scene-linear colours, and luminance."""

import torch
from torch import Tensor


def encode_srgb(linear: Tensor) -> Tensor:
    """Display-encoded sRGB of scene-linear values [...], clipped below 0. [IEC 61966-2-1]

    Gradients: through ``linear``; finite everywhere.
    """
    linear = linear.clamp_min(0.0)
    curve = 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, 12.92 * linear, curve)


def decode_srgb(encoded: Tensor) -> Tensor:
    """Scene-linear values of display-encoded sRGB [...]; the inverse of ``encode_srgb``."""
    curve = ((encoded.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4
    return torch.where(encoded <= 0.04045, encoded / 12.92, curve)


def luminance(picture: Tensor) -> Tensor:
    """Rec.709 luma [...] of display-encoded colours [... 3]."""
    return picture @ picture.new_tensor([0.2126, 0.7152, 0.0722])

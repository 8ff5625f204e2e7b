"""Between scene-linear and display-encoded pictures, and a picture over a plain background."""

import numpy as np

__all__ = ["composite", "decode_display", "encode_display", "mean_colour"]


def encode_display(linear: np.ndarray) -> np.ndarray:
    """Scene-linear values in [0, 1], clipped to it, as sRGB display values (IEC 61966-2-1)."""
    clipped = np.clip(linear, 0.0, 1.0)
    curved = 1.055 * np.maximum(clipped, 1e-9) ** (1 / 2.4) - 0.055
    return np.where(clipped <= 0.0031308, 12.92 * clipped, curved).astype(np.float32)


def decode_display(encoded: np.ndarray) -> np.ndarray:
    """sRGB display values in [0, 1] as scene-linear values; the inverse of `encode_display`."""
    curved = (np.maximum(encoded, 0.0) + 0.055) / 1.055
    return np.where(encoded <= 0.04045, encoded / 12.92, curved**2.4).astype(np.float32)


def mean_colour(style: np.ndarray) -> np.ndarray:
    """The style's mean colour [3], averaged in linear light and display-encoded."""
    return encode_display(decode_display(style).reshape(-1, 3).mean(axis=0))


def composite(premultiplied: np.ndarray, alpha: np.ndarray, fill: np.ndarray) -> np.ndarray:
    """A picture [H W 3] over a plain background, display-encoded.

    Args:
        premultiplied: scene-linear colour times alpha [H W 3], as an emission integral gives it.
        alpha: opacity [H W] in [0, 1].
        fill: the background's display-encoded colour [3].
    """
    return encode_display(premultiplied + (1.0 - alpha[..., None]) * decode_display(fill))

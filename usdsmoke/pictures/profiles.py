"""Embedded colour profiles (ICC) of images: their colours in sRGB."""

import io

import numpy as np
from PIL import Image, ImageCms

_MODES = {"RGB": "RGB", "GRAY": "L", "CMYK": "CMYK"}  # of Pillow, by the profile's colour space
_SAME = 2  # levels of 255 by which profiles of sRGB by different makers differ
_FLAGS = ImageCms.Flags.BLACKPOINTCOMPENSATION
_INTENT = ImageCms.Intent.RELATIVE_COLORIMETRIC


def to_srgb(image: Image.Image) -> tuple[Image.Image, str]:
    """Convert an image from its embedded profile to sRGB, as picture viewers do.

    Relative colorimetric with black point compensation, by Little CMS. Colours outside sRGB are
    clipped to it. Images without a profile, and those whose profile is sRGB, are left as they are.

    Args:
        image: of 8 bits a channel; others have no profile that Little CMS applies through Pillow.

    Returns:
        the image, with its transparency; and "", or why its profile is not applied.
    """
    stored = image.info.get("icc_profile")
    if not stored:
        return image, ""
    if image.mode.startswith(("I", "F")):
        return image, f"its colour profile does not apply to pixels of mode {image.mode}"
    try:
        profile = ImageCms.ImageCmsProfile(io.BytesIO(stored))
        mode = _MODES[profile.profile.xcolor_space.strip()]
        transform = ImageCms.buildTransform(
            profile, ImageCms.createProfile("sRGB"), mode, "RGB", _INTENT, _FLAGS
        )
        if mode == "RGB" and _changes_little(transform):
            return image, ""
        alpha = image.convert("RGBA").getchannel("A") if image.has_transparency_data else None
        converted = ImageCms.applyTransform(image.convert(mode), transform)
    except (ImageCms.PyCMSError, KeyError, OSError, TypeError, ValueError, ImportError):
        return image, "its colour profile cannot be applied, and it is read as sRGB"
    assert converted is not None  # as it is not done in place
    if alpha is not None:
        converted.putalpha(alpha)
    return converted, ""


def _changes_little(transform: ImageCms.ImageCmsTransform) -> bool:
    """True if a chart of 9 x 9 x 9 colours stays as it is."""
    levels = np.linspace(0, 255, 9).round().astype(np.uint8)
    chart = np.stack(np.meshgrid(levels, levels, levels), axis=-1).reshape(27, 27, 3)
    found = ImageCms.applyTransform(Image.fromarray(chart), transform)
    return int(np.abs(np.asarray(found).astype(int) - chart).max()) <= _SAME

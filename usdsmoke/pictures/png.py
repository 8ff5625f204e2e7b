"""Images: the style image in, previews out.

Style images are pictures made for display, so their pixels are display-encoded (sRGB). OpenEXR
files are scene-linear; they are clipped to [0, 1] and encoded, so that the network sees them as a
screen would show them. Embedded colour profiles are applied; images without one are sRGB.
"""

import math
import os
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from usdsmoke.base.errors import ImageError, WriteFailed, count_text
from usdsmoke.base.publish import publish_file
from usdsmoke.base.record_format import hash_stream
from usdsmoke.pictures.exr_channels import check_size, read_exr_channels
from usdsmoke.pictures.profiles import to_srgb

# Pillow's readers that are tried: common ones, and none that starts another program (as EPS does).
_FORMATS = ("PNG", "JPEG", "TIFF", "WEBP", "BMP", "GIF", "TGA", "PPM", "JPEG2000")
_SRGB_GAMMA = 0.45455  # of a PNG file that holds sRGB
_EXR_MAGIC = b"\x76\x2f\x31\x01"
# chromaticities of red, green, blue and white, x and y of each [ITU-R BT.709-6]
_REC709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
_ONE_COLOUR = 1.5 / 255  # less than two levels between the least and the greatest value
_DARK = 0.1  # display-encoded; a hundredth of white's light
_MOST_WHITE = 0.5  # of a linear image's values
_BLACK = -0.01  # values above it are colours outside the gamut, or filters that undershoot
_WHITE = 1.5  # the brightest value of an image that is white, apart from filters that overshoot
_MAX_PIXELS = 100_000_000  # a 10 000 x 10 000 image; its pixels take 1.2 GB
_MOST_KEPT = 2**24  # pixels; of more, torch finds no quantiles
_FAINT = 1e-6  # alpha: what is divided by less may overflow

# What Pillow raises on files that it cannot take.
_READ_ERRORS = (OSError, RuntimeError, SyntaxError, TypeError, ValueError, EOFError, MemoryError)


@dataclass(frozen=True)
class StyleImage:
    """A picture to take the style from."""

    name: str  # the file's name
    pixels: np.ndarray  # [H W 3] float32, display-encoded sRGB in [0, 1], row 0 at the top
    sha256: str  # of the file's bytes, 64 hexadecimal digits
    file_path: str = ""  # absolute
    note: str = ""  # what of the file is not read or of no use, a sentence; "" for nothing


def read_style_image(file_path: str | os.PathLike[str]) -> StyleImage:
    """The style image, whatever its format, as display-encoded RGB.

    Grey, palette, CMYK and alpha are converted, and the camera's orientation is applied; 16-bit
    grey keeps its precision, 16-bit RGB is taken in 8 bits. Of several pages or frames the first
    is read; of an OpenEXR file the first part, R, G and B or else Y. Transparent pixels take the
    mean colour of the visible ones, so that what nobody sees is no part of the style.

    Raises:
        ImageError: the file is missing or a pipe, of no format that can be read, damaged, larger
            than 100 megapixels, has pixels that are NaN or infinite, or is fully transparent.
    """
    where = Path(file_path)
    if where.exists() and not where.is_file() and not where.is_dir():
        raise ImageError(
            f"the style image {where} is a device or a pipe, which may never end. Give a file."
        )
    try:
        with open(where, "rb") as stream:
            is_exr = stream.read(4) == _EXR_MAGIC
            stream.seek(0)
            sha256 = hash_stream(stream)
    except OSError as error:
        raise ImageError(
            f"cannot read the style image {where}: {error.strerror or error}. Check the path and "
            "its permissions."
        ) from None
    if is_exr:
        pixels, alpha, note = _read_exr(where)
    else:
        pixels, alpha, note = _read_pillow(where)
    if alpha is not None:
        if alpha.max() <= 0.0:
            raise ImageError(
                f"the style image {where} is fully transparent. Save it without its alpha channel."
            )
        share = alpha[..., None].astype(np.float64)
        mean = (pixels * share).sum(axis=(0, 1)) / share.sum()
        pixels = pixels * share + mean * (1.0 - share)
    pixels, reduced = _reduced(where, np.ascontiguousarray(pixels, np.float32))
    notes = "; ".join(filter(None, (_without_strokes(where, pixels), note, reduced)))
    return StyleImage(where.name, pixels, sha256, str(where.absolute()), notes)


def _reduced(where: Path, pixels: np.ndarray) -> tuple[np.ndarray, str]:
    """Pixels [H W 3] of at most ``_MOST_KEPT``, by whole blocks, and a note where they are fewer.

    Pictures have some hundred pixels: more of the style only take memory.
    """
    height, width = pixels.shape[:2]
    times = math.ceil(math.sqrt(height * width / _MOST_KEPT))
    if times == 1:
        return pixels, ""
    channels = (Image.fromarray(pixels[..., number]).reduce(times) for number in range(3))
    fewer = np.stack([np.asarray(channel) for channel in channels], axis=-1)
    return fewer, (
        f"the style image {where.name} has {width} x {height} pixels, and is reduced to "
        f"{fewer.shape[1]} x {fewer.shape[0]}"
    )


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """Display-encoded values of linear light, by IEC 61966-2-1.

    12.92 x up to 0.0031308, 1.055 x^(1/2.4) - 0.055 above. Nothing is clipped; negative values stay
    on the straight part.
    """
    bent = np.maximum(linear, 0.0031308)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * bent ** (1.0 / 2.4) - 0.055)


def write_png(file_path: str | os.PathLike[str], pixels: np.ndarray) -> None:
    """Write display-encoded pixels as an 8-bit PNG, in one step.

    Args:
        file_path: path of the file; its folder must exist. An old file is replaced.
        pixels: [H W 3] or [H W 4] (straight alpha) in [0, 1]; values outside are clipped.

    Raises:
        ImageError: another shape, or numbers that are NaN or infinite.
        WriteFailed: the operating system refused, or the file came back different.
    """
    _check_pixels(file_path, pixels, (3, 4))
    levels = np.rint(np.clip(pixels, 0.0, 1.0) * 255.0).astype(np.uint8)

    def check(temporary: Path) -> None:
        with Image.open(temporary) as image:
            _check_same(file_path, levels, np.asarray(image))

    publish_file(
        Path(file_path), lambda temporary: Image.fromarray(levels).save(temporary, "PNG"), check
    )


def _read_pillow(where: Path) -> tuple[np.ndarray, np.ndarray | None, str]:
    Image.init()
    formats = [name for name in _FORMATS if name in Image.OPEN]
    try:
        with warnings.catch_warnings():
            # Pillow warns about large images; our own limit is checked below.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(where, formats=formats) as image:
                check_size(where, image.width, image.height, _MAX_PIXELS)
                note = _unread(where, image)
                upright, unapplied = to_srgb(ImageOps.exif_transpose(image))
                if unapplied:
                    note = f"the style image {where.name}: {unapplied}"
                return *_pillow_pixels(where, upright), note
    except UnidentifiedImageError:
        raise ImageError(
            f"the style image {where} is not a supported image (EXR, {', '.join(formats)}). "
            "Save it as PNG."
        ) from None
    except Image.DecompressionBombError as error:
        raise ImageError(f"the style image {where} is too large: {error}. Scale it down.") from None
    except _READ_ERRORS as error:
        raise ImageError(
            f"the style image {where} cannot be decoded: {error}. Save it again, as PNG."
        ) from None


def _unread(where: Path, image: Image.Image) -> str:
    """What an opened image has that its pixels do not tell; see ``StyleImage.note``."""
    if (n_frames := getattr(image, "n_frames", 1)) > 1:
        return f"the style image {where.name} has {n_frames} frames; only the first is used"
    gamma = image.info.get("gamma", _SRGB_GAMMA)
    if not {"srgb", "icc_profile"} & image.info.keys() and abs(gamma - _SRGB_GAMMA) > 0.05:
        return (
            f"the style image {where.name} states a gamma of {gamma:.3g} and is read as sRGB "
            f"({_SRGB_GAMMA:.3g}). Convert it if it looks too dark or too bright"
        )
    return ""


def _without_strokes(where: Path, pixels: np.ndarray) -> str:
    """That there is nothing in the pixels that could be painted; "" where there is."""
    if np.ptp(pixels, axis=(0, 1)).max() < _ONE_COLOUR:
        return f"the style image {where.name} has one colour: there are no strokes to paint"
    if (brightest := float(np.quantile(pixels.max(axis=2), 0.99))) < _DARK:
        return (
            f"the style image {where.name} is nearly black (brightest values {brightest:.2g} of "
            "1): its strokes are hardly seen, and errors relative to it are large. Brighten it"
        )
    return ""


def _pillow_pixels(where: Path, image: Image.Image) -> tuple[np.ndarray, np.ndarray | None]:
    if image.mode.startswith("I"):  # whole numbers of 16 bits, also where Pillow keeps 32
        grey = np.asarray(image).astype(np.float32)
        if grey.min() < 0.0 or grey.max() > 65535.0:
            raise ImageError(
                f"the style image {where} has values from {grey.min():g} to {grey.max():g}, "
                "outside 0 to 65535. Save it with 8 or 16 bits."
            )
        return _grey_to_rgb(grey / 65535.0), None
    if image.mode == "F":  # floating point means linear light, as in OpenEXR
        return _grey_to_rgb(_encoded(where, np.asarray(image))), None
    if image.has_transparency_data:
        rgba = np.asarray(image.convert("RGBA")).astype(np.float32) / 255.0
        return rgba[..., :3], np.ascontiguousarray(rgba[..., 3])
    return np.asarray(image.convert("RGB")).astype(np.float32) / 255.0, None


def _grey_to_rgb(grey: np.ndarray) -> np.ndarray:
    return np.repeat(grey[..., None].astype(np.float32), 3, axis=-1)


def _read_exr(where: Path) -> tuple[np.ndarray, np.ndarray | None, str]:
    channels, all_names, primaries = read_exr_channels(where, _MAX_PIXELS)
    names = ("R", "G", "B") if {"R", "G", "B"} <= set(all_names) else ("Y", "Y", "Y")
    if names[0] not in channels or {"RY", "BY"} & set(all_names):
        raise ImageError(
            f"the style image {where} has the channels {', '.join(all_names) or 'none'}. "
            "Save it with R, G and B, or with Y alone."
        )
    linear = np.stack([channels[name] for name in names], axis=-1)
    alpha = channels.get("A")
    if alpha is not None:
        alpha = np.clip(alpha, 0.0, 1.0)
        _check_finite(f"the alpha channel of the style image {where}", alpha)
        # stored premultiplied; what is hardly there has no colour
        linear = linear / np.where(alpha > _FAINT, alpha, 1.0)[..., None]
    note = ""
    if names[0] == "R" and any(primaries) and not np.allclose(primaries, _REC709, atol=0.005):
        note = (
            f"the style image {where.name} has other primaries than Rec.709, and is read as if it "
            "had those. Convert it to linear Rec.709 (sRGB primaries)"
        )
    return _encoded(where, linear), alpha, note


def _encoded(where: Path, linear: np.ndarray) -> np.ndarray:
    """Linear light as a screen shows it; an error where most of it would be white or black."""
    _check_finite(f"the style image {where}", linear)
    white = float((linear > 1.0).mean())
    if white > _MOST_WHITE and linear.max() > _WHITE:
        raise ImageError(
            f"{white:.0%} of the style image {where} are brighter than 1, up to "
            f"{linear.max():.3g}, and would be plain white. Scale its linear light to 0 to 1, or "
            "save it as a display-encoded PNG."
        )
    black = float((linear < _BLACK).mean())
    if black > _MOST_WHITE:
        raise ImageError(
            f"{black:.0%} of the style image {where} are below 0, down to {linear.min():.3g}, and "
            "would be plain black. Scale its linear light to 0 to 1, or save it as a "
            "display-encoded PNG."
        )
    return encode_srgb(np.clip(linear, 0.0, 1.0)).astype(np.float32)


def _check_finite(what: str, values: np.ndarray, remedy: str = "Repair it in a compositor") -> None:
    count = int((~np.isfinite(values)).sum())
    if count:
        raise ImageError(f"{what} has {count_text(count, 'NaN or infinite number')}. {remedy}.")


def _check_pixels(
    file_path: str | os.PathLike[str], pixels: np.ndarray, components: tuple[int, ...]
) -> None:
    if pixels.ndim != 3 or pixels.shape[2] not in components or 0 in pixels.shape:
        raise ImageError(
            f"cannot write {os.fspath(file_path)}: the pixels have the shape "
            f"{list(pixels.shape)}, not [H W C] with C one of {', '.join(map(str, components))}. "
            "This is a bug in usdsmoke. Please report it."
        )
    what = f"cannot write {os.fspath(file_path)}: it"
    _check_finite(what, pixels, "Check the values of the grids")


def _check_same(file_path: str | os.PathLike[str], written: np.ndarray, found: np.ndarray) -> None:
    """Compare what came back from disk: the library does not report a short write for certain."""
    if not np.array_equal(written, found):
        raise WriteFailed(
            f"{os.fspath(file_path)} read back differently from what was written. Check "
            "whether the disk is full, and write it again."
        )

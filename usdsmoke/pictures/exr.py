"""OpenEXR out: scene-linear pictures in the parts of one file."""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import OpenEXR

from usdsmoke.base.errors import ImageError, WriteFailed, count_text
from usdsmoke.base.publish import publish_file

# Red, green, blue and white of Rec.709 [ITU-R BT.709].
_REC709 = (0.640, 0.330, 0.300, 0.600, 0.150, 0.060, 0.3127, 0.3290)

# What OpenEXR raises on what it cannot write or read.
_ERRORS = (RuntimeError, TypeError, ValueError)


def write_exr(
    file_path: str | os.PathLike[str],
    parts: Mapping[str, tuple[str, np.ndarray]],
    attributes: Mapping[str, str] | None = None,
) -> None:
    """Write 32-bit float parts as one OpenEXR file, in one step.

    Args:
        file_path: path of the file; its folder must exist. An old file is replaced.
        parts: by name; channel letters such as "RGBA" or "Y", and [H W] or [H W C] of all the same
            height and width. Readers that know one part only take the first.
        attributes: texts that go into every part's header.

    Raises:
        ImageError: shapes that do not fit, or numbers that are NaN or infinite.
        WriteFailed: the operating system refused, or the file came back different.
    """
    where = os.fspath(file_path)
    pixels = {name: _checked(where, name, *part) for name, part in parts.items()}
    if len({array.shape[:2] for array in pixels.values()}) != 1:
        raise ImageError(
            f"cannot write {where}: its parts differ in size, or there are none. "
            "This is a bug in usdsmoke. Please report it."
        )

    def write(temporary: Path) -> None:
        made = [_part(name, parts[name][0], array, attributes) for name, array in pixels.items()]
        try:
            OpenEXR.File(made).write(os.fspath(temporary))
        except _ERRORS as error:
            raise WriteFailed(
                f"cannot write {where}: {error}. Check the folder and the disk's space."
            ) from None

    def check(temporary: Path) -> None:
        if not _holds(temporary, {name: (part[0], pixels[name]) for name, part in parts.items()}):
            raise WriteFailed(
                f"{where} read back differently from what was written. Check whether the disk is "
                "full, and write it again."
            )

    publish_file(Path(file_path), write, check)


def _part(
    name: str, letters: str, array: np.ndarray, attributes: Mapping[str, str] | None
) -> OpenEXR.Part:
    header = {
        **(attributes or {}),
        "name": name,
        "type": OpenEXR.scanlineimage,
        "compression": OpenEXR.ZIP_COMPRESSION,
        "chromaticities": _REC709,
    }
    channels = {letter: np.ascontiguousarray(array[..., n]) for n, letter in enumerate(letters)}
    return OpenEXR.Part(header, channels, name)


def _checked(where: str, name: str, letters: str, array: np.ndarray) -> np.ndarray:
    """[H W C] float32."""
    found = np.asarray(array, np.float32)
    found = found[..., None] if found.ndim == 2 else found
    if found.ndim != 3 or found.shape[2] != len(letters) or 0 in found.shape:
        raise ImageError(
            f"cannot write {where}: the part {name} has the shape {list(np.shape(array))}, not "
            f"[H W {len(letters)}] for the channels {', '.join(letters)}. "
            "This is a bug in usdsmoke. Please report it."
        )
    count = int((~np.isfinite(found)).sum())
    if count:
        raise ImageError(
            f"cannot write {where}: the part {name} has "
            f"{count_text(count, 'NaN or infinite number')}. "
            "Check the values of the grids."
        )
    return found


def _holds(file_path: Path, parts: Mapping[str, tuple[str, np.ndarray]]) -> bool:
    try:
        with OpenEXR.File(os.fspath(file_path), separate_channels=True) as image:
            found = {
                part.name(): {key: channel.pixels for key, channel in part.channels.items()}
                for part in image.parts
            }
    except _ERRORS:
        return False
    return list(found) == list(parts) and all(
        set(found[name]) == set(letters)
        and all(np.array_equal(found[name][key], array[..., n]) for n, key in enumerate(letters))
        for name, (letters, array) in parts.items()
    )

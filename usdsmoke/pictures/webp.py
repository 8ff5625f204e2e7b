"""Animations out: WebP, which browsers show."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, features

from usdsmoke.base.errors import ImageError, WriteFailed
from usdsmoke.base.publish import publish_file

_QUALITY = 90  # of 100; a lossless picture of the example plume is five times as large


def write_webp(
    file_path: str | os.PathLike[str],
    pictures: Sequence[np.ndarray],
    milliseconds: Sequence[int],
) -> None:
    """Write pictures as one animated WebP that repeats for ever, in one step.

    Args:
        file_path: path of the file; its folder must exist. An old file is replaced.
        pictures: [H W 3] of one size, display-encoded in [0, 1]; at least one.
        milliseconds: how long each stays.

    Raises:
        ImageError: this Pillow writes no WebP.
        WriteFailed: the operating system refused, or the file came back different.
    """
    where = os.fspath(file_path)
    if not features.check("webp"):
        raise ImageError(f"cannot write {where}: this Pillow has no WebP. Write .png instead.")
    images = [
        Image.fromarray(np.rint(np.clip(picture, 0.0, 1.0) * 255.0).astype(np.uint8))
        for picture in pictures
    ]

    def write(temporary: Path) -> None:
        images[0].save(
            temporary, "WEBP", save_all=True, append_images=images[1:],
            duration=list(milliseconds), loop=0, quality=_QUALITY,
        )  # fmt: skip

    def check(temporary: Path) -> None:
        """Pictures that do not change are stored as one, so that only their size is certain."""
        with Image.open(temporary) as found:
            if found.size != images[0].size:
                raise WriteFailed(
                    f"{where} read back differently from what was written. Check whether the disk "
                    "is full, and write it again."
                )
            found.seek(getattr(found, "n_frames", 1) - 1)
            found.load()

    publish_file(Path(file_path), write, check)

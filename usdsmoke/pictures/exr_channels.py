"""The channels of an OpenEXR file, decoded by a process of its own.

OpenEXR trusts what it reads: a damaged file can make it loop. So a worker process decodes it, under
limits of memory and time, as it does with VDB files (``vdb.child``).
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from usdsmoke.base.errors import ImageError
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb import child

WANTED = ("R", "G", "B", "Y", "A")
_SECONDS, _SECONDS_PER_BYTE = 8.0, 2e-7  # of CPU time
_ERRORS = (OSError, RuntimeError, SyntaxError, TypeError, ValueError, EOFError, MemoryError)


def read_exr_channels(
    file_path: Path, most_pixels: int
) -> tuple[dict[str, np.ndarray], tuple[str, ...], tuple[float, ...]]:
    """The channels R, G, B, Y and A that the first part has, [H W] each, the names of all, and the
    chromaticities of red, green, blue and white, x and y of each; empty where it has none.

    Raises:
        ImageError: the file cannot be decoded, or has more pixels than that.
    """
    request = {
        "action": f"{__name__}:decode",
        "reader": "OpenEXR",
        "file_path": os.fspath(file_path.absolute()),
        "most_pixels": most_pixels,
    }
    seconds = _SECONDS + _SECONDS_PER_BYTE * file_path.stat().st_size
    try:
        answer, arrays = child.run_child(request, [], GridsConfig(time_limit_s=seconds))
    except child.ChildFailure as failure:
        raise _undecodable(file_path, failure) from None
    channels = dict(zip(answer["read"], arrays, strict=True))
    return channels, tuple(answer["names"]), tuple(answer["chromaticities"])


def decode(request: Mapping[str, Any], folder: Path) -> tuple[Any, int]:
    """The worker's side: leaves the channels in ``folder`` and answers with their names."""
    import OpenEXR

    where = Path(request["file_path"])
    try:
        with OpenEXR.File(str(where), header_only=True) as image:
            low, high = image.header()["dataWindow"]
            primaries = [float(number) for number in image.header().get("chromaticities") or ()]
        width, height = (int(b) - int(a) + 1 for a, b in zip(low, high, strict=True))
        check_size(where, width, height, request["most_pixels"])
        with OpenEXR.File(str(where), separate_channels=True) as image:
            channels = image.channels()
            read = [name for name in WANTED if name in channels]
            for number, name in enumerate(read):
                np.save(folder / f"out{number}.npy", np.asarray(channels[name].pixels, np.float32))
            answer = {"names": list(channels), "read": read, "chromaticities": primaries}
            return answer, len(read)
    except _ERRORS as error:
        raise _undecodable(where, error) from None


def check_size(where: Path, width: int, height: int, most_pixels: int) -> None:
    """Refuse a picture that is too large for memory.

    Raises:
        ImageError: it has more pixels than that.
    """
    if width * height > most_pixels:
        raise ImageError(
            f"the style image {where} has {width} x {height} pixels; at most "
            f"{most_pixels // 1_000_000} million are allowed. Scale it down."
        )


def _undecodable(where: Path, why: object) -> ImageError:
    return ImageError(
        f"the style image {where} cannot be decoded: {why}. Save it again, as PNG or EXR."
    )

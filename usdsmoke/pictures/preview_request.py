"""What a preview is asked to be: checked before anything is opened."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from usdsmoke.base.errors import ConfigError, WriteFailed
from usdsmoke.base.time_codes import parse_frames

__all__ = ["BACKGROUNDS", "MOST_PIXELS", "PreviewRequest", "check_pixels", "make_request"]

BACKGROUNDS = ("grey", "black", "none")
MOST_PIXELS = 16_000_000  # of a picture: a minute or two of drawing
_MOST_SHEET_PIXELS = 64_000_000  # of all pictures of a contact sheet
_LONGEST_SIDE = 512  # where no size is asked for
_SUFFIXES = (".png", ".exr")


@dataclass(frozen=True)
class PreviewRequest:
    """A checked request; see ``preview_stage.preview`` for the meanings."""

    stage: str
    output: Path
    camera: str
    frames: str
    compare: bool
    prims: tuple[str, ...]
    width: int | None
    size: tuple[int, int] | None  # width and height
    background: str

    @property
    def is_exr(self) -> bool:
        """Whether scene-linear parts are wanted instead of a picture for a screen."""
        return self.output.suffix.lower() == ".exr"

    def pixels(self, aspect: float) -> tuple[int, int]:
        """Height and width of a picture whose width is ``aspect`` times its height.

        Raises:
            ConfigError: that would be too large.
        """
        if self.size is not None:
            width, height = self.size
        elif self.width is not None:
            width, height = self.width, _round(self.width / aspect)
        elif aspect >= 1:
            width, height = _LONGEST_SIDE, _round(_LONGEST_SIDE / aspect)
        else:
            width, height = _round(_LONGEST_SIDE * aspect), _LONGEST_SIDE
        check_pixels(width, height)
        return height, width


def make_request(
    stage: str | os.PathLike[str],
    output: str | os.PathLike[str],
    camera: str = "",
    frames: str = "",
    compare: bool = False,
    prims: Sequence[str] | None = None,
    width: int | None = None,
    size: tuple[int, int] | None = None,
    background: str = BACKGROUNDS[0],
) -> PreviewRequest:
    """The request, if it can be fulfilled as far as it tells by itself.

    Raises:
        ConfigError: another file type, background, size or selection of frames than there are.
        WriteFailed: the output's folder does not exist, or the output is one.
    """
    target = Path(output)
    if target.suffix.lower() not in _SUFFIXES:
        found = f"the suffix {target.suffix!r}" if target.suffix else "no suffix"
        raise ConfigError(
            f"the preview {target} has {found}; wanted .png for a picture, or .exr for "
            "scene-linear layers"
        )
    if background not in BACKGROUNDS:
        raise ConfigError(f"no background {background!r}; wanted one of {', '.join(BACKGROUNDS)}")
    if width is not None and size is not None:
        raise ConfigError("both a width and a size were given; wanted one of them")
    parse_frames(frames)
    if width is not None:
        check_pixels(width, 1)
    if size is not None:
        check_pixels(*size)
    if target.is_dir():
        raise WriteFailed(f"cannot write {target}: it is a folder; choose another name")
    if not target.absolute().parent.is_dir():
        raise WriteFailed(
            f"cannot write {target.name}: there is no folder {target.parent}; make the folder first"
        )
    return PreviewRequest(
        os.fspath(stage), target.absolute(), camera, frames, compare, tuple(prims or ()), width,
        size, background,
    )  # fmt: skip


def check_pixels(width: int, height: int, n_pictures: int = 1) -> None:
    """Refuse pictures of no pixels or too many.

    Args:
        width, height: of one picture.
        n_pictures: on one sheet.

    Raises:
        ConfigError: with what is allowed.
    """
    if width < 1 or height < 1:
        raise ConfigError(
            f"a preview of {width} x {height} pixels was asked for; wanted at least one each way"
        )
    if width * height > MOST_PIXELS:
        raise ConfigError(
            f"the preview would have {width} x {height} pixels; wanted at most "
            f"{MOST_PIXELS // 1_000_000} million: lower --width or --size"
        )
    if width * height * n_pictures > _MOST_SHEET_PIXELS:
        raise ConfigError(
            f"the contact sheet would have {n_pictures} pictures of {width} x {height} pixels; "
            f"wanted at most {_MOST_SHEET_PIXELS // 1_000_000} million pixels: select fewer frames "
            "(--frames 1-100x10), lower --width, or write .exr, which is one file a frame"
        )


def _round(number: float) -> int:
    return max(1, math.floor(number + 0.5))

"""The request for a preview, checked before anything is opened."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

from pxr import Usd

from usdsmoke.base.errors import ConfigError, WriteFailed
from usdsmoke.base.machine import check_packages
from usdsmoke.base.time_codes import parse_frames
from usdsmoke.config.resolve import Settings, resolve_settings
from usdsmoke.config.run_sections import StageConfig
from usdsmoke.pictures.animations import WRITERS
from usdsmoke.usd.stage import StageOrFile

BACKGROUNDS = ("grey", "black", "none")
MOST_PIXELS = 16_000_000  # of a picture: a minute or two of drawing
_MOST_SHEET_PIXELS = 64_000_000  # of all pictures of a contact sheet or an animation
_LONGEST_SIDE = 512  # if no size is given
_SUFFIXES = (".png", ".exr", *WRITERS)


class PreviewOptions(TypedDict, total=False):
    """The options of ``usdsmoke.preview``; see ``PreviewRequest``."""

    camera: str
    frames: str
    allow_missing: bool
    compare: bool
    prims: Sequence[str] | None
    look: str
    beside: Sequence[StageOrFile]
    width: int | None
    size: tuple[int, int] | None
    background: str
    turntable: int | None
    threads: int
    settings: Settings


@dataclass(frozen=True)
class PreviewRequest:
    """What to draw; checked as far as possible before anything is opened.

    Raises:
        MissingPackage: PyAV, for an MP4.
        ConfigError: the file type, the background, the size or the selection of frames is wrong.
        WriteFailed: the output is a folder, or its folder does not exist.
    """

    stage: StageOrFile  # for a look its root layer, NAME_look.usda
    output: Path  # .png, .exr, .webp, .gif or .mp4
    camera: str = ""  # prim path; "" takes a front view that just holds the smoke of all frames
    # timeCodes such as 1-24; "" takes the first, the middle and the last that have colours, for an
    # animation all, and for a turntable the middle
    frames: str = ""
    allow_missing: bool = False  # leave out requested timeCodes that do not exist
    compare: bool = False  # draw the stage without its looks as well
    prims: Sequence[str] | None = None  # Volume prim paths; None means all
    look: str = ""  # of an asset that has several; "" draws the one that is selected
    beside: Sequence[StageOrFile] = ()  # other stages, drawn from the same directions
    width: int | None = None  # pixels; the height follows from the camera's film or the smoke
    size: tuple[int, int] | None = None  # width and height, pixels
    background: str = BACKGROUNDS[0]  # of all but OpenEXR; none is transparent, for one PNG only
    turntable: int | None = (
        None  # pictures of one frame around the up axis; None: one from the front
    )
    threads: int = 1
    settings: Settings = None  # of ``stage`` alone, such as ``stage.density=fog``

    def __post_init__(self) -> None:
        target = Path(self.output).absolute()
        object.__setattr__(self, "output", target)
        if target.suffix.lower() not in _SUFFIXES:
            found = f"cannot be a {target.suffix} file" if target.suffix else "needs a suffix"
            raise ConfigError(
                f"a preview {found} ({target.name}). Use .png for a picture, .webp, .gif or .mp4 "
                "for an animation, or .exr for scene-linear layers."
            )
        if target.suffix.lower() == ".mp4":
            check_packages("av")
        if self.background not in BACKGROUNDS:
            raise ConfigError(
                f"unknown background {self.background!r}. Use one of {', '.join(BACKGROUNDS)}."
            )
        if self.threads < 1:
            raise ConfigError(f"--threads is {self.threads}. Give at least 1.")
        self._check_turntable()
        if self.width is not None and self.size is not None:
            raise ConfigError("--width and --size exclude each other. Give only one.")
        parse_frames(self.stage_config.frames)
        if self.width is not None:
            if self.width < 1:
                raise ConfigError(f"--width is {self.width}. Give at least 1 pixel.")
            check_pixels(self.width, 1)
        if self.size is not None:
            check_pixels(*self.size)
        if target.is_dir():
            raise WriteFailed(f"cannot write {target}: it is a folder. Choose another name.")
        if not target.parent.is_dir():
            raise WriteFailed(
                f"cannot write {target.name}: there is no folder {target.parent}. Create it first."
            )

    def _check_turntable(self) -> None:
        if self.turntable is None:
            return
        if self.turntable < 2:
            raise ConfigError(f"--turntable is {self.turntable}. Give at least 2 pictures.")
        if self.camera:
            raise ConfigError("--turntable and --camera exclude each other. Give only one.")
        if self.is_exr:
            raise ConfigError("a turntable cannot be an .exr file. Use .png for a sheet, or .webp.")

    @property
    def stage_config(self) -> StageConfig:
        """What is read of the stage.

        Raises:
            ConfigError: the settings are wrong, or of another section.
        """
        config = resolve_settings(self.settings)
        if others := sorted(n for n in config.explicit if not n.startswith("stage.")):
            raise ConfigError(
                f"a preview does not use {', '.join(others)}. Give only settings of stage."
            )
        found = config.stage.replace(frames=self.frames or config.stage.frames)
        return found.replace(
            prims=list(self.prims or found.prims),
            allow_missing=self.allow_missing or found.allow_missing,
        )

    @property
    def stage_name(self) -> str:
        """The file name of the stage."""
        return _file_of(self.stage).name

    @property
    def names(self) -> list[str]:
        """What the stage and those beside it are called: without suffix, with the folder if two
        have the same name, with a number if that does not help."""
        files = [_file_of(stage) for stage in (self.stage, *self.beside)]
        found = [file.stem for file in files]
        if len({*found}) < len(found):
            found = [f"{file.absolute().parent.name}_{file.stem}" for file in files]
        if len({*found}) < len(found):
            found = [f"{name}_{number}" for number, name in enumerate(found, 1)]
        return found

    @property
    def is_exr(self) -> bool:
        """True for scene-linear layers, False for a picture for a screen."""
        return self.output.suffix.lower() == ".exr"

    @property
    def is_animation(self) -> bool:
        """True for pictures one after the other in time."""
        return self.output.suffix.lower() in WRITERS

    @property
    def angles(self) -> tuple[float, ...]:
        """Degrees around the up axis from the front, one for each picture of a frame."""
        count = self.turntable or 1
        return tuple(360.0 * number / count for number in range(count))

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


def _file_of(stage: StageOrFile) -> Path:
    if isinstance(stage, Usd.Stage):
        layer = stage.GetRootLayer()
        return Path(layer.realPath or layer.GetDisplayName())
    return Path(stage)


def check_pixels(width: int, height: int, n_pictures: int = 1) -> None:
    """Refuse pictures of no pixels or too many.

    Args:
        width, height: of one picture.
        n_pictures: on one sheet.

    Raises:
        ConfigError: with what is allowed.
    """
    if width < 1 or height < 1:
        raise ConfigError(f"--size is {width}x{height}. Give at least 1 pixel in each direction.")
    if width * height > MOST_PIXELS:
        raise ConfigError(
            f"the preview would have {width} x {height} pixels; at most "
            f"{MOST_PIXELS // 1_000_000} million are allowed. Lower --width or --size."
        )
    if width * height * n_pictures > _MOST_SHEET_PIXELS:
        raise ConfigError(
            f"the preview would have {n_pictures} pictures of {width} x {height} pixels; "
            f"at most {_MOST_SHEET_PIXELS // 1_000_000} million pixels in all are allowed. "
            "Select fewer frames (--frames 1-100x10), lower --width, or write .exr, which is one "
            "file a frame."
        )


def _round(number: float) -> int:
    return max(1, math.floor(number + 0.5))

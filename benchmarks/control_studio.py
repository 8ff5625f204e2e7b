"""Stylizes the control pictures' frames, each variant once, and draws them as labelled grids."""

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from benchmarks.control_scenes import fading_mask
from benchmarks.display import encode_display
from benchmarks.splats import display_picture, grey_picture, render_view
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.config.resolve import resolve_config
from usdsmoke.core.sequence.stylize import StylizedFrame, stylize_window
from usdsmoke.core.style.losses import StyleTarget
from usdsmoke.core.views.scene import Scene, measure_scene
from usdsmoke.pictures import find_style_size

__all__ = ["Grid", "Look", "Panel", "Studio", "draw_grid", "save_grid"]

SIDE = 256  # pixels of a panel's longer side
GAP, MARGIN = 10, 14
LINE = 16  # pixels of a line of text
PAPER, INK, DIM = (24, 24, 26), (226, 226, 222), (160, 160, 156)
COLOURS = 224  # of the saved palette: a third of the file's size, and nobody sees it


@dataclass(frozen=True)
class Panel:
    """A picture and what is written under it, one or two lines."""

    picture: np.ndarray  # [H W 3] display-encoded in [0, 1]
    label: str


@dataclass(frozen=True)
class Grid:
    """Rows of panels under a title."""

    name: str  # of the file
    title: str
    rows: Sequence[Sequence[Panel]]


@dataclass(frozen=True)
class Look:
    """A stylized frame and what is needed to draw it."""

    frame: StylizedFrame
    scene: Scene
    source: VolumeFrame

    def colour(self, exposed: bool = False, background: float = 0.0) -> np.ndarray:
        """The finished picture, [H W 3] display-encoded.

        Args:
            exposed: divide by the largest opacity, as the paper divides by the picture's maximum.
            background: linear grey level.
        """
        picture = self._picture(self.scene.gamma_w)
        return display_picture(picture / picture[..., 3].max() if exposed else picture, background)

    def grey(self, exposed: bool = False) -> np.ndarray:
        """The moved density as the shape step sees it: opacity as grey level, [H W 3]."""
        picture = self._picture(self.scene.gamma_w_shape, coloured=False)
        return grey_picture(picture / picture[..., 3].max() if exposed else picture)

    def source_grey(self) -> np.ndarray:
        """The unmoved density, drawn as `grey` draws the moved one."""
        return grey_picture(
            self._draw(self.source.density, None, self.scene.gamma_w_shape),
        )

    def straight(self) -> tuple[np.ndarray, np.ndarray]:
        """The smoke's own colour [H W 3], its opacity divided out, and where there is smoke."""
        picture = self._picture(self.scene.gamma_w)
        alpha = picture[..., 3]
        own = encode_display(picture[..., :3] / np.maximum(alpha, 1e-6)[..., None])
        return own, alpha > 0.5 * alpha.max()

    def _picture(self, gamma_w: float, coloured: bool = True) -> np.ndarray:
        """Premultiplied and linear, [H W 4]."""
        return self._draw(self.frame.density, self.frame.emission if coloured else None, gamma_w)

    def _draw(self, density: DenseField, emission: DenseField | None, gamma_w: float) -> np.ndarray:
        up_axis = self.scene.up_axis
        return render_view(density, emission, np.eye(4), gamma_w, up_axis, image_size=SIDE)


class Studio:
    """Stylizes on demand and remembers.

    Args:
        frames: by kind, "2-D" and "3-D".
        styles: display-encoded images [H W 3] by name.
        settings: assignments that all variants share, by kind.
    """

    def __init__(
        self,
        frames: Mapping[str, VolumeFrame],
        styles: Mapping[str, np.ndarray],
        settings: Mapping[str, Sequence[str]],
    ) -> None:
        self.frames, self.styles, self._settings = frames, styles, settings
        self._made: dict[tuple[Any, ...], Look] = {}

    def look(
        self, kind: str, style: str, *settings: str, masked: bool = False, guided: bool = True
    ) -> Look:
        """A frame after a style, with settings such as ``"style.tiling=2"``.

        Args:
            masked: with a mask field that fades from 1 to 0, see ``fading_mask``.
            guided: False takes the guidance mask T of eq. 7 out of the style loss, which no setting
                does.
        """
        key = (kind, style, settings, masked, guided)
        if key not in self._made:
            started = time.perf_counter()
            self._made[key] = self._stylize(kind, style, settings, masked, guided)
            seconds = time.perf_counter() - started
            words = " ".join([kind, style, *settings, "masked" * masked, "unguided" * (not guided)])
            print(f"{seconds:5.1f} s  {words}", file=sys.stderr, flush=True)
        return self._made[key]

    def _stylize(
        self, kind: str, style: str, settings: Sequence[str], masked: bool, guided: bool
    ) -> Look:
        frame = fading_mask(self.frames[kind]) if masked else self.frames[kind]
        config = resolve_config([*self._settings[kind], *settings])
        scene = measure_scene([frame], config.views, config.optics, "Y", config.grids.parts)
        images = [self.styles[style]]
        scene = replace(scene, style_size=find_style_size(images, scene.voxels, config))
        with _guidance(guided):
            (stylized,) = stylize_window([frame], images, scene, config)
        return Look(stylized, scene, frame)


@contextmanager
def _guidance(wanted: bool) -> Iterator[None]:
    """Replaces the guide of every style loss by ones while it is not wanted."""
    real = StyleTarget.loss
    if not wanted:
        StyleTarget.loss = lambda self, picture, guide, draw=0: real(self, picture, None, draw)  # type: ignore[method-assign]
    try:
        yield
    finally:
        StyleTarget.loss = real  # type: ignore[method-assign]


def draw_grid(grid: Grid) -> Image.Image:
    """The grid as one picture: the title above, each panel over its label.

    Raises:
        ValueError: a row without panels.
    """
    if not grid.rows or not all(grid.rows):
        raise ValueError(f"grid {grid.name!r} has an empty row; wanted a panel in each")
    font, title = ImageFont.load_default(12), ImageFont.load_default(15)
    n_lines = max(panel.label.count("\n") for row in grid.rows for panel in row) + 1
    heights = [max(len(panel.picture) for panel in row) for row in grid.rows]
    widths = _column_widths(grid.rows, font)
    width = max(sum(widths) + GAP * (len(widths) - 1), round(title.getlength(grid.title)))
    below = 6 + LINE * n_lines + GAP
    height = 2 * MARGIN + LINE + GAP + sum(heights) + below * len(heights)
    sheet = Image.new("RGB", (width + 2 * MARGIN, height), PAPER)
    pen = ImageDraw.Draw(sheet)
    pen.text((MARGIN, MARGIN - 2), grid.title, INK, title)
    top = MARGIN + LINE + GAP
    for row, row_height in zip(grid.rows, heights, strict=True):
        left = MARGIN
        for panel, room in zip(row, widths, strict=False):
            pixels = np.rint(np.clip(panel.picture, 0.0, 1.0) * 255.0).astype(np.uint8)
            across = left + (room - pixels.shape[1]) // 2
            sheet.paste(Image.fromarray(pixels), (across, top + row_height - pixels.shape[0]))
            for number, line in enumerate(panel.label.split("\n")):
                at = left + (room - font.getlength(line)) / 2
                pen.text(
                    (at, top + row_height + 6 + LINE * number), line, DIM if number else INK, font
                )
            left += room + GAP
        top += row_height + below
    return sheet


def _column_widths(rows: Sequence[Sequence[Panel]], font: Any) -> list[int]:
    """Of each column the width of its widest picture or line."""
    widths = [0] * max(len(row) for row in rows)
    for row in rows:
        for number, panel in enumerate(row):
            text = max(round(font.getlength(line)) for line in panel.label.split("\n"))
            widths[number] = max(widths[number], panel.picture.shape[1], text)
    return widths


def save_grid(grid: Grid, folder: Path) -> Path:
    """Draws the grid into ``folder/controls_NAME.png`` with a palette, and gives the file."""
    folder.mkdir(parents=True, exist_ok=True)
    file_path = folder / f"controls_{grid.name}.png"
    draw_grid(grid).quantize(COLOURS, dither=Image.Dither.NONE).save(file_path, optimize=True)
    return file_path

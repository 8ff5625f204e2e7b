"""The contact sheet: a few frames of source and result beside the style, in one picture."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from usdsmoke.base.errors import ShapeError
from usdsmoke.base.naming import DEFAULT_LOOK, look_suffix

_CELL = 256  # pixels of a picture's cell along each side, at most
_GAP = 8
_LABEL = 24  # pixels of a line of text
_TEXT_SIZE = 14
_PAPER, _INK = (24, 24, 26), (220, 220, 216)
_MARGIN = 2 * _GAP


def sheet_files(stems: Sequence[str], output: Path, look: str = DEFAULT_LOOK) -> tuple[Path, ...]:
    """Where the contact sheets go, one for each Volume.

    Args:
        stems: of the Volumes' VDB files.
        output: the output folder.
        look: the look's name; it comes first, so that no Volume's name can be taken for it.
    """
    before = f"look{look_suffix(look)}_" if look_suffix(look) else ""
    if len(stems) == 1:
        return (Path(output) / f"{before}contact_sheet.png",)
    return tuple(Path(output) / f"{before}contact_sheet_{stem}.png" for stem in stems)


def compose_sheet(
    title: str,
    columns: Sequence[str],
    rows: Sequence[tuple[str, Sequence[np.ndarray]]],
    styles: Sequence[np.ndarray],
) -> np.ndarray:
    """Pictures in rows and columns with their names, and the style images at the right.

    Every picture is scaled into its cell without changing its proportions.

    Args:
        title: above everything.
        columns: a heading for each column of pictures.
        rows: name and pictures, [H W 3] display-encoded in [0, 1], one for each column.
        styles: style images, of the same kind; they share the last column.

    Returns:
        [H W 3] float32, display-encoded, in [0, 1].

    Raises:
        ShapeError: a row has another number of pictures than there are columns, or one is no
            picture.
    """
    for name, pictures in rows:
        if len(pictures) != len(columns):
            raise ShapeError(
                f"row {name!r} has {len(pictures)} pictures for {len(columns)} columns. "
                "Give one for each column."
            )
    cells = [
        [
            (f"{name}, {heading}", picture)
            for heading, picture in zip(columns, pictures, strict=True)
        ]
        for name, pictures in rows
    ]
    return compose_cells(title, cells, styles, n_columns=len(columns))


def compose_cells(
    title: str,
    rows: Sequence[Sequence[tuple[str, np.ndarray]]],
    styles: Sequence[np.ndarray] = (),
    cell: tuple[int, int] = (_CELL, _CELL),
    n_columns: int | None = None,
) -> np.ndarray:
    """Labelled pictures in rows, and style images, if there are any, at the right.

    Args:
        title: above everything.
        rows: labels and pictures, [H W 3] display-encoded in [0, 1]; scaled into their cells
            without changing their proportions.
        styles: of the same kind; they share the last column.
        cell: height and width of a picture's cell, pixels.
        n_columns: None takes the longest row's.

    Returns:
        [H W 3] float32, display-encoded, in [0, 1].

    Raises:
        ShapeError: one is no picture.
    """
    tall, wide = cell
    if n_columns is None:
        n_columns = max((len(row) for row in rows), default=0)
    width = 2 * _MARGIN + n_columns * (wide + _GAP) + bool(styles) * (_CELL + _GAP) - _GAP
    height = 2 * _MARGIN + _LABEL + max(len(rows), 1) * (tall + _LABEL + _GAP)
    sheet = Image.new("RGB", (width, height), _PAPER)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(_TEXT_SIZE)
    draw.text((_MARGIN, _MARGIN), title, _INK, font)
    for number, row in enumerate(rows):
        top = _MARGIN + _LABEL + number * (tall + _LABEL + _GAP)
        for column, (label, picture) in enumerate(row):
            left = _MARGIN + column * (wide + _GAP)
            draw.text((left, top), label, _INK, font)
            _paste(sheet, picture, left, top + _LABEL, wide, tall)
    if styles:
        left = _MARGIN + n_columns * (wide + _GAP)
        _paste_styles(sheet, draw, font, styles, left, height)
    return np.asarray(sheet, np.float32) / 255.0


def _paste_styles(
    sheet: Image.Image,
    draw: ImageDraw.ImageDraw,
    font: ImageFont.ImageFont | ImageFont.FreeTypeFont,
    styles: Sequence[np.ndarray],
    left: int,
    height: int,
) -> None:
    top = _MARGIN + _LABEL
    draw.text((left, top), "style", _INK, font)
    top += _LABEL
    each = min(_CELL, (height - _MARGIN - top) // len(styles) - _GAP)
    for number, style in enumerate(styles):
        _paste(sheet, style, left, top + number * (each + _GAP), _CELL, max(each, 1))


def _paste(
    sheet: Image.Image, picture: np.ndarray, left: int, top: int, width: int, height: int
) -> None:
    """Scale a picture into a box, upper left corner fixed, and put it on the sheet."""
    if picture.ndim != 3 or picture.shape[2] != 3 or 0 in picture.shape:
        raise ShapeError(
            f"a picture has the shape {list(picture.shape)}, not [H W 3]. "
            "This is a bug in usdsmoke. Please report it."
        )
    levels = np.rint(np.clip(picture, 0.0, 1.0) * 255.0).astype(np.uint8)
    scale = min(width / levels.shape[1], height / levels.shape[0])
    size = (max(1, round(levels.shape[1] * scale)), max(1, round(levels.shape[0] * scale)))
    sheet.paste(Image.fromarray(levels).resize(size, Image.Resampling.LANCZOS), (left, top))

"""Contact sheets: pictures with labels in rows, beside the style images, in one picture."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from usdsmoke.base.errors import ShapeError
from usdsmoke.base.naming import DEFAULT_LOOK, look_suffix

_STYLE = 256  # pixels of a style image along each side, at most, in a column of its own
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
    rows: Sequence[Sequence[tuple[str, np.ndarray]]],
    styles: Sequence[np.ndarray] = (),
) -> np.ndarray:
    """Labelled pictures in rows, and style images, if there are any, at the right.

    Pictures are shown pixel by pixel. Style images are scaled without changing their proportions.
    If the first or the last rows are shorter than the longest one, style images stand beside these
    rows, unless a column of their own shows them larger.

    Args:
        title: above everything.
        rows: labels and pictures, [H W 3] display-encoded in [0, 1].
        styles: of the same kind; they share one column.

    Returns:
        [H W 3] float32, display-encoded, in [0, 1].

    Raises:
        ShapeError: one is no picture.
    """
    from PIL import ImageDraw, ImageFont  # a single picture needs no text

    pictures = [picture for row in rows for _, picture in row]
    for picture in (*pictures, *styles):
        _check_picture(picture)
    tall = max((picture.shape[0] for picture in pictures), default=_STYLE)
    font = ImageFont.load_default(_TEXT_SIZE)
    wide = max((picture.shape[1] for picture in pictures), default=_STYLE)
    labels = [math.ceil(font.getlength(label)) for row in rows for label, _ in row]
    wide = max([wide, *labels])
    n_columns = max((len(row) for row in rows), default=0)
    beside = _short_rows([len(row) for row in rows])
    there, own = (
        (side, (max(n_rows, 1) * (tall + _LABEL + _GAP) - _LABEL) // max(len(styles), 1) - _GAP)
        for side, n_rows in ((wide, len(beside)), (_STYLE, len(rows)))
    )
    if min(there) < min(own):
        beside = range(0)
    width = 2 * _MARGIN + n_columns * (wide + _GAP) - _GAP
    width += (_STYLE + _GAP) if styles and not beside else 0
    width = max(width, 2 * _MARGIN + math.ceil(font.getlength(title)))
    height = 2 * _MARGIN + _LABEL + max(len(rows), 1) * (tall + _LABEL + _GAP)
    sheet = Image.new("RGB", (width, height), _PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((_MARGIN, _MARGIN), title, _INK, font)
    for number, row in enumerate(rows):
        top = _MARGIN + _LABEL + number * (tall + _LABEL + _GAP)
        for column, (label, picture) in enumerate(row):
            left = _MARGIN + column * (wide + _GAP)
            draw.text((left, top), label, _INK, font)
            sheet.paste(_image(picture), (left, top + _LABEL))
    if styles:
        column = max((len(rows[number]) for number in beside), default=n_columns)
        top = _MARGIN + _LABEL + beside.start * (tall + _LABEL + _GAP)
        place = (_MARGIN + column * (wide + _GAP), top)
        draw.text(place, "style", _INK, font)
        _paste_styles(sheet, styles, (place[0], place[1] + _LABEL), there if beside else own)
    return np.asarray(sheet, np.float32) / 255.0


def _short_rows(lengths: Sequence[int]) -> range:
    """The first rows that are shorter than the longest one; if there are none, the last such."""
    is_short = [length < max(lengths) for length in lengths]
    if not any(is_short):
        return range(0)
    if is_short[0]:
        return range(is_short.index(False))
    return range(len(lengths) - is_short[::-1].index(False), len(lengths))


def _paste_styles(
    sheet: Image.Image,
    styles: Sequence[np.ndarray],
    place: tuple[int, int],
    room: tuple[int, int],
) -> None:
    """Style images below each other, each as large as fits.

    Args:
        place: left and top of the first.
        room: width and height for each.
    """
    (left, top), (wide, tall) = place, room
    for style in styles:
        image = _image(style)
        scale = min(wide / image.width, tall / image.height)
        size = (max(1, round(image.width * scale)), max(1, round(image.height * scale)))
        image = image.resize(size, Image.Resampling.LANCZOS)
        sheet.paste(image, (left, top))
        top += image.height + _GAP


def _image(picture: np.ndarray) -> Image.Image:
    return Image.fromarray(np.rint(np.clip(picture, 0.0, 1.0) * 255.0).astype(np.uint8))


def _check_picture(picture: np.ndarray) -> None:
    if picture.ndim != 3 or picture.shape[2] != 3 or 0 in picture.shape:
        raise ShapeError(
            f"a picture has the shape {list(picture.shape)}, not [H W 3]. "
            "This is a bug in usdsmoke. Please report it."
        )

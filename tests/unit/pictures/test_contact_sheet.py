"""The contact sheet: every picture in its place, proportions kept, nothing cut off."""

from pathlib import Path

import numpy as np
import pytest

from usdsmoke.base.errors import ShapeError
from usdsmoke.pictures import compose_sheet, sheet_files


def flat(colour: tuple[float, float, float], height: int = 40, width: int = 40) -> np.ndarray:
    return np.full((height, width, 3), colour, np.float32)


def where(sheet: np.ndarray, colour: tuple[float, float, float]) -> tuple[slice, slice]:
    """The rows and columns of the box that holds every pixel of a colour."""
    hits = np.argwhere(np.abs(sheet - colour).max(axis=-1) < 0.01)
    (top, left), (bottom, right) = hits.min(0), hits.max(0) + 1
    return slice(top, bottom), slice(left, right)


RED, GREEN, BLUE, WHITE = (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)


def test_rows_columns_and_style_stand_in_their_order() -> None:
    rows = [
        [("source, 1", flat(RED)), ("source, 2", flat(GREEN))],
        [("result, 1", flat(BLUE)), ("result, 2", flat((1, 1, 0)))],
    ]
    sheet = compose_sheet("plume", rows, [flat((1, 0, 1))])
    red, green, blue = (where(sheet, colour) for colour in (RED, GREEN, BLUE))
    style = where(sheet, (1, 0, 1))
    assert red[0] == green[0] and red[1].stop < green[1].start
    assert red[1] == blue[1] and red[0].stop < blue[0].start
    assert style[1].start > green[1].stop and style[0].start == red[0].start
    assert sheet.dtype == np.float32 and 0 <= sheet.min() and sheet.max() <= 1


@pytest.mark.parametrize("size", [(10, 40), (40, 10), (700, 300), (1, 1)])
def test_a_picture_is_shown_pixel_by_pixel_and_a_style_in_its_proportions(
    size: tuple[int, int],
) -> None:
    sheet = compose_sheet("", [[("a", flat(RED, *size))]], [flat(BLUE, *size)])
    rows, columns = where(sheet, RED)
    assert (rows.stop - rows.start, columns.stop - columns.start) == size
    assert columns.stop < sheet.shape[1] and rows.stop < sheet.shape[0]
    rows, columns = where(sheet, BLUE)
    shown = (rows.stop - rows.start, columns.stop - columns.start)
    assert shown[0] / shown[1] == pytest.approx(size[0] / size[1], rel=0.02, abs=0.01)
    assert columns.stop < sheet.shape[1] and rows.stop < sheet.shape[0]


def test_several_styles_share_the_column_without_overlap() -> None:
    sheet = compose_sheet("", [[("a", flat(WHITE))]], [flat(RED), flat(GREEN), flat(BLUE)])
    tops = [where(sheet, colour)[0] for colour in (RED, GREEN, BLUE)]
    assert tops[0].stop <= tops[1].start and tops[1].stop <= tops[2].start
    assert tops[2].stop < sheet.shape[0]


def test_styles_fill_the_room_beside_short_rows() -> None:
    """Source and result of three frames above a turn of four: no column is half empty."""
    rows = [[("", flat(WHITE, 450, 300))] * n for n in (3, 3, 4)]
    sheet = compose_sheet("", rows, [flat(RED), flat(GREEN, 20, 40)])
    plain = compose_sheet("", rows)
    red, green, white = (where(sheet, colour) for colour in (RED, GREEN, WHITE))
    assert sheet.shape == plain.shape
    assert red[1].stop - red[1].start == green[1].stop - green[1].start == 300
    assert red[1].stop == green[1].stop == white[1].stop  # in the last picture's column
    last_row = np.argwhere(plain[:, red[1].start + 1].min(axis=-1) > 0.99)[0, 0]
    assert red[0].stop < green[0].start and green[0].stop < last_row


def test_a_style_stands_in_the_last_row_where_that_alone_is_short() -> None:
    """Source and result of four frames above a turn of three."""
    rows = [[("", flat(WHITE, 450, 300))] * n for n in (4, 4, 3)]
    sheet, plain = compose_sheet("", rows, [flat(RED)]), compose_sheet("", rows)
    red, white = where(sheet, RED), where(sheet, WHITE)
    assert sheet.shape == plain.shape
    assert red[1].stop == white[1].stop and red[1].stop - red[1].start == 300
    last_row = np.flatnonzero((plain == 1).all(axis=-1)[:, white[1].start])[-450]
    assert red[0].start == last_row


@pytest.mark.parametrize(
    ("lengths", "size", "n_styles"),
    [((3, 3, 4), (40, 40), 1), ((1, 4), (450, 300), 3), ((4, 4), (450, 300), 1)],
    ids=["small pictures", "several styles", "no short row"],
)
def test_styles_have_a_column_of_their_own_where_they_are_larger_there(
    lengths: tuple[int, ...], size: tuple[int, int], n_styles: int
) -> None:
    rows = [[("", flat(WHITE, *size))] * n for n in lengths]
    sheet = compose_sheet("", rows, [flat(RED), flat(GREEN), flat(BLUE)][:n_styles])
    red, white = (where(sheet, colour) for colour in (RED, WHITE))
    assert red[1].start > white[1].stop and red[1].stop - red[1].start > 80
    assert sheet.shape[1] > compose_sheet("", rows).shape[1]


def test_a_sheet_without_frames_is_still_a_picture() -> None:
    sheet = compose_sheet("nothing but empty frames", [], [flat(RED)])
    assert where(sheet, RED)[0].stop < sheet.shape[0]


def test_what_is_no_picture_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"shape \[4, 4\]"):
        compose_sheet("", [[("a", np.zeros((4, 4)))]])


def test_one_volume_has_one_plain_name_and_several_have_their_own() -> None:
    assert sheet_files(["plume"], Path("out")) == (Path("out/contact_sheet.png"),)
    names = [path.name for path in sheet_files(["a", "b"], Path("out"))]
    assert names == ["contact_sheet_a.png", "contact_sheet_b.png"]


def test_labels_wider_than_their_pictures_do_not_run_into_each_other() -> None:
    row = [("a label that is longer than its picture is wide", flat(RED)), ("b", flat(GREEN))]
    sheet = compose_sheet("", [row])
    top, left = where(sheet, RED)[0].start, where(sheet, GREEN)[1].start
    ink = (sheet[top - 20 : top, :left].max(axis=(0, 2)) > 0.5).nonzero()[0]
    assert ink.max() < left - 4

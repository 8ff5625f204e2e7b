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
    rows = [("source", [flat(RED), flat(GREEN)]), ("stylized", [flat(BLUE), flat((1, 1, 0))])]
    sheet = compose_sheet("plume", ["timeCode 1", "timeCode 2"], rows, [flat((1, 0, 1))])
    red, green, blue = (where(sheet, colour) for colour in (RED, GREEN, BLUE))
    style = where(sheet, (1, 0, 1))
    assert red[0] == green[0] and red[1].stop < green[1].start
    assert red[1] == blue[1] and red[0].stop < blue[0].start
    assert style[1].start > green[1].stop and style[0].start == red[0].start
    assert sheet.dtype == np.float32 and 0 <= sheet.min() and sheet.max() <= 1


@pytest.mark.parametrize(("height", "width"), [(10, 40), (40, 10), (700, 300), (1, 1)])
def test_a_picture_keeps_its_proportions_and_stays_in_its_cell(height: int, width: int) -> None:
    sheet = compose_sheet("", ["a"], [("row", [flat(RED, height, width)])], [])
    rows, columns = where(sheet, RED)
    shown = (rows.stop - rows.start, columns.stop - columns.start)
    assert max(shown) == 256
    assert shown[0] / shown[1] == pytest.approx(height / width, rel=0.02)
    assert columns.stop < sheet.shape[1] and rows.stop < sheet.shape[0]


def test_several_styles_share_the_column_without_overlap() -> None:
    rows = [("row", [flat(WHITE)])]
    sheet = compose_sheet("", ["a"], rows, [flat(RED), flat(GREEN), flat(BLUE)])
    tops = [where(sheet, colour)[0] for colour in (RED, GREEN, BLUE)]
    assert tops[0].stop <= tops[1].start and tops[1].stop <= tops[2].start
    assert tops[2].stop < sheet.shape[0]


def test_a_sheet_without_frames_is_still_a_picture() -> None:
    sheet = compose_sheet("nothing but empty frames", [], [], [flat(RED)])
    assert where(sheet, RED)[0].stop < sheet.shape[0]


def test_what_does_not_fit_together_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"row 'source' has 1 pictures for 2 columns"):
        compose_sheet("", ["a", "b"], [("source", [flat(RED)])], [])
    with pytest.raises(ShapeError, match=r"shape \[4, 4\]"):
        compose_sheet("", ["a"], [("source", [np.zeros((4, 4))])], [])


def test_one_volume_has_one_plain_name_and_several_have_their_own() -> None:
    assert sheet_files(["plume"], Path("out")) == (Path("out/contact_sheet.png"),)
    names = [path.name for path in sheet_files(["a", "b"], Path("out"))]
    assert names == ["contact_sheet_a.png", "contact_sheet_b.png"]

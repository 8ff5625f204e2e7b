"""The pictures of the controls: every grid can be made, from the smoke to the file."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks import control_pictures, control_studio
from benchmarks.control_pictures import GRIDS, KINDS
from benchmarks.control_scenes import fading_mask, frame_of
from benchmarks.control_studio import Studio, draw_grid, save_grid
from benchmarks.gallery import Cell, keep_cell, kept_cell, write_page
from tests.fixtures.smoke_fixtures import puff, random_style
from usdsmoke.core.style.losses import StyleTarget

QUICK = [
    "shape.iterations=[1]",
    "colour.iterations=[2]",
    "views.image_size=24",
    "views.pool=2",
    "features.layers=[oriented1]",
]


@pytest.fixture
def studio(monkeypatch: pytest.MonkeyPatch) -> Studio:
    monkeypatch.setattr(control_pictures, "SMALL_STEPS", ("colour.learning_rate=0.004",))
    monkeypatch.setattr(control_pictures, "ONE_OCTAVE", ("shape.iterations=[2]",))
    monkeypatch.setattr(control_pictures, "DEPTHS", (1, 2))
    monkeypatch.setattr(control_pictures, "FEW", ())
    monkeypatch.setattr(control_pictures, "WORDS", {"style.colour": ("1", "0")})
    monkeypatch.setattr(control_studio, "SIDE", 64)
    ball = puff(10)
    frames = {"2-D": frame_of(ball.sum(axis=2, keepdims=True)), "3-D": frame_of(ball)}
    styles = {"waves": random_style(24, 24), "strokes": random_style(24, 20, seed=3)}
    return Studio(frames, styles, dict.fromkeys(KINDS, QUICK))


@pytest.mark.parametrize("name", GRIDS)
def test_every_grid_is_made_of_pictures_that_show_smoke(name, studio, tmp_path: Path):
    grid = GRIDS[name](studio)
    assert grid.name == name
    for panel in (panel for row in grid.rows for panel in row):
        assert panel.picture.min() >= 0 and panel.picture.max() <= 1
        assert np.ptp(panel.picture) > 0.03, panel.label
    file_path = save_grid(grid, tmp_path)
    with Image.open(file_path) as written:
        assert written.size == draw_grid(grid).size


def test_the_guidance_mask_is_taken_out_of_one_run_only(studio):
    real = StyleTarget.loss
    plain = studio.look("2-D", "waves").colour()
    free = studio.look("2-D", "waves", guided=False).colour()
    assert StyleTarget.loss is real
    assert not np.array_equal(plain, free)


def test_the_mask_field_falls_from_one_to_zero_across_the_smoke():
    frame = fading_mask(frame_of(puff(24)))
    assert frame.mask is not None
    across = frame.mask.values[:, 5, 7]
    assert across[0] == 1.0 and across[-1] == 0.0
    assert (np.diff(across) <= 0).all()
    assert across[11:13].mean() == pytest.approx(0.5)


def test_a_cell_of_the_gallery_is_kept_and_found_again(tmp_path):
    pictures = [np.full((3, 2, 3), value, np.float32) for value in (0.25, 0.5)]
    cell = Cell("real", pictures, 12.5, {"patch": 0.75, "outliers": 0.0})
    keep_cell(cell, tmp_path / "cells" / "dabs_real.npz")
    found = kept_cell(tmp_path / "cells" / "dabs_real.npz")
    assert (found.kind, found.cpu_s, found.scores) == (cell.kind, cell.cpu_s, cell.scores)
    assert len(found.pictures) == 2
    assert all(map(np.array_equal, found.pictures, pictures))


def test_the_gallery_has_pictures_in_rows_that_a_page_is_wide_enough_for(tmp_path):
    scores = dict.fromkeys(("patch", "colour", "spectrum", "edges", "outliers"), 0.5)
    cell = Cell("3-D", [np.ones((400, 350, 3), np.float32)] * 2, 1.0, scores)
    write_page(tmp_path / "g.md", {"dabs": [cell, cell]}, {"dabs": np.ones((9, 9, 3))}, "command")
    with Image.open(tmp_path / "pictures" / "gallery" / "dabs.webp") as sheet:
        assert sheet.height > 2 * 400 and 2 * 350 < sheet.width <= 1280
    assert "pictures/gallery/dabs.webp" in (tmp_path / "g.md").read_text()

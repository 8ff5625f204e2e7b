"""Images that are written come back from disk as they were, or it is said that they did not."""

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from usdsmoke.base.errors import ImageError, WriteFailed
from usdsmoke.pictures import read_style_image, write_png

LEVELS = np.random.default_rng(0).integers(0, 256, (4, 5, 3), dtype=np.uint8)


def test_png_comes_back_as_it_was_written(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", LEVELS / 255.0)
    with Image.open(tmp_path / "a.png") as image:
        assert np.array_equal(np.asarray(image), LEVELS)
    assert np.array_equal(np.rint(read_style_image(tmp_path / "a.png").pixels * 255), LEVELS)
    alpha = np.linspace(-0.5, 1.5, 20).reshape(4, 5)
    write_png(tmp_path / "a.png", np.dstack([LEVELS / 255.0, alpha]))
    with Image.open(tmp_path / "a.png") as image:
        assert image.mode == "RGBA"
        levels = np.asarray(image)
    assert np.array_equal(levels[..., :3], LEVELS)
    assert np.array_equal(levels[..., 3], np.rint(alpha.clip(0, 1) * 255))
    assert os.listdir(tmp_path) == ["a.png"]


@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 2), (0, 5, 3)])
def test_pixels_of_another_shape_are_refused(tmp_path: Path, shape: tuple[int, ...]) -> None:
    with pytest.raises(ImageError, match=r"\[H W C\].*3, 4"):
        write_png(tmp_path / "a.png", np.zeros(shape))


def test_numbers_that_are_not_finite_are_not_written(tmp_path: Path) -> None:
    pixels = np.full((2, 2, 3), np.nan)
    with pytest.raises(ImageError, match="12 NaN"):
        write_png(tmp_path / "a.png", pixels)
    assert os.listdir(tmp_path) == []


def test_image_that_came_back_different_is_found_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Saved without complaint, but not what was asked for: a disk that drops what it is given."""
    save = Image.Image.save
    monkeypatch.setattr(
        Image.Image, "save", lambda image, *rest: save(image.transpose(Image.ROTATE_180), *rest)
    )
    with pytest.raises(WriteFailed, match=r"a\.png read back"):
        write_png(tmp_path / "a.png", LEVELS / 255.0)
    assert os.listdir(tmp_path) == []


def test_missing_folder_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(WriteFailed, match=r"cannot write a\.png.*folder first"):
        write_png(tmp_path / "none" / "a.png", LEVELS / 255.0)

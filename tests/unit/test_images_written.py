"""Images that are written come back from disk as they were, or it is said that they did not."""

import os
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from usdsmoke import images
from usdsmoke.errors import ImageError, WriteFailed
from usdsmoke.images import read_style_image, write_exr, write_png

LEVELS = np.random.default_rng(0).integers(0, 256, (4, 5, 3), dtype=np.uint8)
LINEAR = np.random.default_rng(1).random((4, 5, 3), dtype=np.float32)


def rgb_channels(pixels: np.ndarray) -> dict[str, np.ndarray]:
    return {name: np.ascontiguousarray(pixels[..., n]) for n, name in enumerate("RGB")}


def test_png_comes_back_as_it_was_written(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", LEVELS / 255.0)
    with Image.open(tmp_path / "a.png") as image:
        assert np.array_equal(np.asarray(image), LEVELS)
    rgba = np.dstack([LEVELS / 255.0, np.linspace(-0.5, 1.5, 20).reshape(4, 5)])
    write_png(tmp_path / "a.png", rgba)
    with Image.open(tmp_path / "a.png") as image:
        assert image.mode == "RGBA"
    assert np.array_equal(np.rint(read_style_image(tmp_path / "a.png").pixels * 255), LEVELS)
    assert os.listdir(tmp_path) == ["a.png"]


def test_exr_comes_back_bit_for_bit(tmp_path: Path) -> None:
    channels = {
        **rgb_channels(LINEAR * 100 - 7),
        "A": LINEAR[..., 0].astype(np.float16),
        "depth.Z": LINEAR[..., 1].astype(np.float64),
    }
    write_exr(tmp_path / "a.exr", channels)
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as image:
        found = {name: channel.pixels for name, channel in image.channels().items()}
    assert set(found) == set(channels)
    assert found["A"].dtype == np.float16
    assert found["depth.Z"].dtype == np.float32
    for name, values in channels.items():
        assert np.array_equal(found[name], values), name


@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 2), (0, 5, 3)])
def test_pixels_of_another_shape_are_refused(tmp_path: Path, shape: tuple[int, ...]) -> None:
    with pytest.raises(ImageError, match=r"wanted \[H W C\] with C one of 3, 4"):
        write_png(tmp_path / "a.png", np.zeros(shape))


@pytest.mark.parametrize(
    "channels",
    [{}, {"R": np.zeros((2, 2)), "G": np.zeros((2, 3))}, {"R": np.zeros((2, 2, 3))}],
    ids=["none", "different sizes", "not flat"],
)
def test_channels_of_other_shapes_are_refused(
    tmp_path: Path, channels: dict[str, np.ndarray]
) -> None:
    with pytest.raises(ImageError, match=r"wanted one shape \[H W\] for all"):
        write_exr(tmp_path / "a.exr", channels)


def test_numbers_that_are_not_finite_are_not_written(tmp_path: Path) -> None:
    pixels = np.full((2, 2, 3), np.nan)
    with pytest.raises(ImageError, match="12 numbers that are NaN"):
        write_png(tmp_path / "a.png", pixels)
    with pytest.raises(ImageError, match="channel R has 4 numbers that are NaN"):
        write_exr(tmp_path / "a.exr", rgb_channels(pixels))
    assert os.listdir(tmp_path) == []


def test_image_that_came_back_different_is_found_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(images, "_exr_channels", lambda path: rgb_channels(LINEAR + 1))
    with pytest.raises(WriteFailed, match=r"a\.exr did not come back"):
        write_exr(tmp_path / "a.exr", rgb_channels(LINEAR))
    assert os.listdir(tmp_path) == []


def test_missing_folder_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(WriteFailed, match=r"cannot write a\.png.*make the folder first"):
        write_png(tmp_path / "none" / "a.png", LEVELS / 255.0)
    with pytest.raises(WriteFailed, match=r"cannot write a\.exr"):
        write_exr(tmp_path / "none" / "a.exr", rgb_channels(LINEAR))

"""Embedded colour profiles of style images, written here byte by byte."""

import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from usdsmoke.pictures import encode_srgb, read_style_image

# Colorants of sRGB, adapted to D50 (IEC 61966-2-1 with a Bradford matrix): columns R, G, B.
SRGB = np.array(
    [(0.43607, 0.22249, 0.01392), (0.38515, 0.71687, 0.09708), (0.14307, 0.06061, 0.7141)]
)
PIXELS = np.array([[(250, 40, 90), (128, 128, 128), (20, 200, 60), (0, 0, 255)]], np.uint8)


def profile(colorants: np.ndarray = SRGB, gamma: float = 1.0) -> bytes:
    """A display profile of ICC version 2 from three colorants and one gamma."""

    def xyz(values: tuple[float, ...] | np.ndarray) -> bytes:
        return b"XYZ \0\0\0\0" + struct.pack(">3i", *(round(v * 65536) for v in values))

    curve = b"curv\0\0\0\0" + struct.pack(">IH", 1, round(gamma * 256)) + b"\0\0"
    text = b"text\0\0\0\0none\0\0\0\0"
    name = b"desc\0\0\0\0" + struct.pack(">I", 5) + b"test\0" + bytes(4 + 4 + 2 + 1 + 67 + 3)
    tags = {b"desc": name, b"cprt": text, b"wtpt": xyz((0.9642, 1.0, 0.82491))}
    for letter, colorant in zip((b"r", b"g", b"b"), colorants, strict=True):
        tags |= {letter + b"XYZ": xyz(colorant), letter + b"TRC": curve}
    table, data, start = struct.pack(">I", len(tags)), b"", 128 + 4 + 12 * len(tags)
    for key, value in tags.items():
        value += bytes(-len(value) % 4)
        table += key + struct.pack(">2I", start + len(data), len(value))
        data += value
    head = struct.pack(
        ">I4sI4s4s4s", start + len(data), b"none", 0x02400000, b"mntr", b"RGB ", b"XYZ "
    )
    head += struct.pack(">6H", 2026, 1, 1, 0, 0, 0) + b"acsp" + bytes(28)
    head += struct.pack(">3i", *(round(v * 65536) for v in (0.9642, 1.0, 0.82491)))
    return head + bytes(128 - len(head)) + table + data


def read(tmp_path: Path, icc: bytes, **options: object) -> np.ndarray:
    Image.fromarray(PIXELS).save(tmp_path / "a.png", icc_profile=icc, **options)
    style = read_style_image(tmp_path / "a.png")
    assert style.note == ""
    return style.pixels


def test_a_profile_of_linear_light_is_encoded(tmp_path: Path) -> None:
    expected = encode_srgb(PIXELS / 255.0)
    assert np.abs(expected - PIXELS / 255.0).max() > 0.2  # not what the file holds
    np.testing.assert_allclose(read(tmp_path, profile()), expected, atol=1.5 / 255)


def test_a_profile_with_other_primaries_turns_the_colours(tmp_path: Path) -> None:
    found = read(tmp_path, profile(SRGB[[1, 2, 0]]))
    np.testing.assert_allclose(found, encode_srgb(PIXELS[..., [2, 0, 1]] / 255.0), atol=1.5 / 255)


def test_transparency_and_orientation_stay(tmp_path: Path) -> None:
    alpha = np.array([[255, 255, 255, 0]], np.uint8)
    image = Image.fromarray(np.dstack([PIXELS, alpha]))
    image.getexif()[0x0112] = 6  # to be turned by 90 degrees clockwise
    image.save(tmp_path / "a.png", icc_profile=profile(), exif=image.getexif())
    found = read_style_image(tmp_path / "a.png").pixels
    assert found.shape == (4, 1, 3)
    expected = encode_srgb(PIXELS[0, :3] / 255.0)
    np.testing.assert_allclose(found[:3, 0], expected, atol=1.5 / 255)
    np.testing.assert_allclose(found[3, 0], expected.mean(axis=0), atol=1.5 / 255)


@pytest.mark.parametrize("icc", [b"no profile" * 20, profile()[:-60]])
def test_a_damaged_profile_is_noted(tmp_path: Path, icc: bytes) -> None:
    Image.fromarray(PIXELS).save(tmp_path / "a.png", icc_profile=icc)
    style = read_style_image(tmp_path / "a.png")
    assert "colour profile" in style.note
    np.testing.assert_array_equal(style.pixels, (PIXELS / 255.0).astype(np.float32))

"""Style images of every kind arrive as display-encoded RGB; what cannot be one is refused."""

import hashlib
import io
import os
import struct
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from usdsmoke.base.errors import ImageError
from usdsmoke.pictures import encode_srgb, exr_channels, read_style_image
from usdsmoke.pictures import png as images

LEVELS = np.random.default_rng(0).integers(0, 256, (4, 5, 3), dtype=np.uint8)
LINEAR = np.random.default_rng(1).random((4, 5, 3), dtype=np.float32)


def save_exr(file_path: Path, channels: dict[str, np.ndarray]) -> Path:
    with OpenEXR.File({}, channels) as image:
        image.write(str(file_path))
    return file_path


def rgb_channels(pixels: np.ndarray) -> dict[str, np.ndarray]:
    return {name: np.ascontiguousarray(pixels[..., n]) for n, name in enumerate("RGB")}


# -- the display's curve


def test_curve_meets_the_standards_landmarks() -> None:
    assert encode_srgb(np.array([0.0, 1.0])).tolist() == pytest.approx([0.0, 1.0], abs=1e-15)
    assert encode_srgb(np.array(0.0031308)) == pytest.approx(0.04045, abs=1e-6)
    assert encode_srgb(np.array(0.001)) == pytest.approx(0.01292)
    assert encode_srgb(np.array(0.21404114048223255)) == pytest.approx(0.5)


# -- reading


@pytest.mark.parametrize("suffix", ["png", "tif", "bmp", "webp", "tga", "ppm"])
def test_eight_bit_pixels_keep_their_levels(tmp_path: Path, suffix: str) -> None:
    file_path = tmp_path / f"style.{suffix}"
    Image.fromarray(LEVELS).save(file_path, **({"lossless": True} if suffix == "webp" else {}))
    style = read_style_image(file_path)
    assert style.name == f"style.{suffix}"
    assert style.pixels.dtype == np.float32
    assert style.pixels.flags.c_contiguous
    assert np.array_equal(np.rint(style.pixels * 255), LEVELS)
    assert style.sha256 == hashlib.sha256(file_path.read_bytes()).hexdigest()


def test_what_a_style_image_has_beside_its_pixels_is_noted(tmp_path: Path) -> None:
    grey = [Image.linear_gradient("L").point(lambda level, k=k: level // k) for k in (1, 2)]
    grey[0].save(tmp_path / "one.png")
    grey[0].save(tmp_path / "two.gif", save_all=True, append_images=grey[1:])
    assert read_style_image(tmp_path / "one.png").note == ""
    assert "2 frames" in read_style_image(tmp_path / "two.gif").note
    dark = [grey[0].point(lambda level: 0), grey[0]]
    dark[0].save(tmp_path / "dark.gif", save_all=True, append_images=dark[1:])
    first, second = read_style_image(tmp_path / "dark.gif").note.split("; ", 1)
    assert "one colour" in first and "2 frames" in second  # only the first is always shown
    chunks = PngInfo()
    chunks.add(b"gAMA", (100000).to_bytes(4, "big"))
    grey[0].save(tmp_path / "linear.png", pnginfo=chunks)
    assert "gamma of 1" in read_style_image(tmp_path / "linear.png").note


@pytest.mark.parametrize(
    ("levels", "is_plain"), [((0, 0), True), ((9, 10), True), ((9, 11), False)]
)
def test_a_style_of_one_colour_is_noted(
    tmp_path: Path, levels: tuple[int, int], is_plain: bool
) -> None:
    pixels = np.full((4, 4, 3), levels[0], np.uint8)
    pixels[1, 2] = levels[1]
    Image.fromarray(pixels).save(tmp_path / "a.png")
    assert ("one colour" in read_style_image(tmp_path / "a.png").note) is is_plain


@pytest.mark.parametrize(("brightest", "is_dark"), [(6, True), (60, False)])
def test_a_nearly_black_style_is_noted(tmp_path: Path, brightest: int, is_dark: bool) -> None:
    levels = np.linspace(0, brightest, 16).round().astype(np.uint8)
    Image.fromarray(np.tile(levels[:, None, None], (1, 16, 3))).save(tmp_path / "a.png")
    assert ("nearly black" in read_style_image(tmp_path / "a.png").note) is is_dark


@pytest.mark.parametrize(("share", "is_refused"), [(0.75, True), (0.25, False)])
def test_an_image_of_negative_light_is_refused(
    tmp_path: Path, share: float, is_refused: bool
) -> None:
    pixels = np.full((4, 8, 3), 0.5, np.float32)
    pixels[:, : round(8 * share)] = -1.0
    file_path = save_exr(tmp_path / "a.exr", rgb_channels(pixels))
    if is_refused:
        with pytest.raises(ImageError, match=r"75%.*below 0"):
            read_style_image(file_path)
    else:
        assert read_style_image(file_path).pixels.min() == 0


def test_jpeg_is_read(tmp_path: Path) -> None:
    Image.new("RGB", (16, 8), (200, 100, 50)).save(tmp_path / "a.jpg", quality=95)
    pixels = read_style_image(tmp_path / "a.jpg").pixels
    assert pixels.shape == (8, 16, 3)
    assert np.allclose(pixels * 255, (200, 100, 50), atol=2)


@pytest.mark.parametrize("mode", ["1", "L", "P", "RGB", "RGBA", "LA", "CMYK", "YCbCr"])
def test_every_colour_mode_becomes_rgb(tmp_path: Path, mode: str) -> None:
    white = Image.new("RGB", (3, 2), (255, 255, 255)).convert(mode)
    white.save(tmp_path / "a.tif")
    style = read_style_image(tmp_path / "a.tif")
    assert style.pixels.shape == (2, 3, 3)
    assert np.allclose(style.pixels, 1.0, atol=0.01)


def test_palette_gives_its_colours(tmp_path: Path) -> None:
    image = Image.new("P", (2, 1))
    image.putpalette([10, 20, 30, 200, 100, 50])
    image.putdata([1, 0])
    image.save(tmp_path / "a.png")
    pixels = read_style_image(tmp_path / "a.png").pixels
    assert np.rint(pixels * 255).tolist() == [[[200, 100, 50], [10, 20, 30]]]


@pytest.mark.parametrize("suffix", ["png", "tif", "pgm"])
def test_sixteen_bit_grey_keeps_its_precision(tmp_path: Path, suffix: str) -> None:
    grey = np.array([[0, 1, 257], [32768, 65534, 65535]], np.uint16)
    file_path = tmp_path / f"a.{suffix}"
    if suffix == "pgm":
        file_path.write_bytes(b"P5 3 2 65535\n" + grey.astype(">u2").tobytes())
    else:
        Image.fromarray(grey).save(file_path)
    pixels = read_style_image(file_path).pixels
    assert np.allclose(pixels, np.repeat(grey[..., None] / 65535, 3, -1), atol=1e-7)


def test_sixteen_bit_colour_is_scaled_not_cut_off(tmp_path: Path) -> None:
    chunks = [
        (b"IHDR", struct.pack(">2I5B", 2, 1, 16, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(b"\0" + struct.pack(">6H", 65535, 32896, 0, 65535, 16448, 8224))),
        (b"IEND", b""),
    ]
    packed = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks
    )
    (tmp_path / "a.png").write_bytes(packed)
    pixels = read_style_image(tmp_path / "a.png").pixels
    assert np.allclose(pixels, [[[1, 128 / 255, 0], [1, 64 / 255, 32 / 255]]], atol=1e-6)


def test_transparent_pixels_take_the_mean_of_the_visible_ones(tmp_path: Path) -> None:
    rgba = np.dstack([LEVELS, np.full((4, 5), 255, np.uint8)])
    rgba[0, 0, 3] = 0
    rgba[1, 1, 3] = 51
    Image.fromarray(rgba).save(tmp_path / "a.png")
    pixels = read_style_image(tmp_path / "a.png").pixels
    share = rgba[..., 3:] / 255
    mean = (LEVELS / 255 * share).sum(axis=(0, 1)) / share.sum()
    assert np.allclose(pixels[0, 0], mean, atol=1e-6)
    assert np.allclose(pixels[1, 1], 0.2 * LEVELS[1, 1] / 255 + 0.8 * mean, atol=1e-6)
    assert np.array_equal(np.rint(pixels[2:] * 255), LEVELS[2:])


def test_transparent_palette_entry_does_not_count(tmp_path: Path) -> None:
    image = Image.new("P", (2, 1))
    image.putpalette([10, 20, 30, 200, 100, 50])
    image.putdata([0, 1])
    image.save(tmp_path / "a.gif", transparency=1)
    pixels = read_style_image(tmp_path / "a.gif").pixels
    assert np.rint(pixels * 255).tolist() == [[[10, 20, 30], [10, 20, 30]]]


def test_camera_orientation_is_applied(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6  # turn by 90 degrees clockwise to see it upright
    Image.fromarray(LEVELS).save(tmp_path / "a.png", exif=exif)
    pixels = read_style_image(tmp_path / "a.png").pixels
    assert np.array_equal(np.rint(pixels * 255), np.rot90(LEVELS, -1))


@pytest.mark.parametrize("colour", [(0, 0, 0), (17, 200, 255)])
@pytest.mark.parametrize("size", [(1, 1), (7, 3)])
def test_single_pixels_and_plain_colours_are_images_too(
    tmp_path: Path, size: tuple[int, int], colour: tuple[int, int, int]
) -> None:
    Image.new("RGB", size, colour).save(tmp_path / "a.png")
    pixels = read_style_image(tmp_path / "a.png").pixels
    assert pixels.shape == (size[1], size[0], 3)
    assert np.allclose(pixels * 255, colour)


def test_exr_is_linear_light_that_gets_clipped_and_encoded(tmp_path: Path) -> None:
    linear = LINEAR.copy()
    linear[0, 0] = (-0.5, 7.0, 0.21404114)
    style = read_style_image(save_exr(tmp_path / "a.exr", rgb_channels(linear)))
    assert np.allclose(style.pixels, encode_srgb(np.clip(linear, 0, 1)), atol=1e-6)
    assert style.pixels[0, 0].tolist() == pytest.approx([0.0, 1.0, 0.5], abs=1e-6)


@pytest.mark.parametrize(
    ("primaries", "is_told"),
    [
        ((0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329), False),
        ((0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767), True),  # ACEScg
    ],
)
def test_an_exr_of_other_primaries_is_read_with_a_note(
    tmp_path: Path, primaries: tuple[float, ...], is_told: bool
) -> None:
    file_path = tmp_path / "a.exr"
    with OpenEXR.File({"chromaticities": primaries}, rgb_channels(LINEAR)) as image:
        image.write(str(file_path))
    style = read_style_image(file_path)
    assert style.pixels == pytest.approx(encode_srgb(LINEAR), abs=1e-6)
    assert ("Rec.709" in style.note) is is_told


def test_exr_is_known_by_its_first_bytes_and_half_is_read(tmp_path: Path) -> None:
    save_exr(tmp_path / "a.exr", rgb_channels(LINEAR.astype(np.float16)))
    os.rename(tmp_path / "a.exr", tmp_path / "a.png")
    pixels = read_style_image(tmp_path / "a.png").pixels
    assert np.allclose(pixels, encode_srgb(LINEAR), atol=1e-3)


def test_exr_of_luminance_is_grey_and_alpha_is_taken_out(tmp_path: Path) -> None:
    grey = LINEAR[..., 0]
    assert np.allclose(
        read_style_image(save_exr(tmp_path / "y.exr", {"Y": grey.copy()})).pixels,
        encode_srgb(grey)[..., None].repeat(3, -1),
        atol=1e-6,
    )
    alpha = np.ones((4, 5), np.float32)
    alpha[0, 0] = 0.0
    premultiplied = LINEAR * alpha[..., None]
    style = read_style_image(
        save_exr(tmp_path / "a.exr", {**rgb_channels(premultiplied), "A": alpha})
    )
    encoded = encode_srgb(LINEAR)
    assert np.allclose(style.pixels[1:], encoded[1:], atol=1e-6)
    assert np.allclose(style.pixels[0, 0], encoded.reshape(-1, 3)[1:].mean(axis=0), atol=1e-6)


# -- refusing


def test_missing_image_is_named(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match=r"none\.png:"):
        read_style_image(tmp_path / "none.png")
    with pytest.raises(ImageError, match="a directory"):
        read_style_image(tmp_path)


@pytest.mark.parametrize("packed", [b"", b"not an image\n" * 9, b"%!PS-Adobe-3.0 EPSF-3.0\n"])
def test_other_files_are_refused_with_the_formats_that_are_read(
    tmp_path: Path, packed: bytes
) -> None:
    (tmp_path / "a.png").write_bytes(packed)
    with pytest.raises(ImageError, match=r"a\.png.*EXR, PNG, JPEG, TIFF"):
        read_style_image(tmp_path / "a.png")


def test_cut_off_images_are_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    buffer = io.BytesIO()
    Image.effect_noise((64, 64), 90).save(buffer, "PNG")
    (tmp_path / "a.png").write_bytes(buffer.getvalue()[:-1500])
    with pytest.raises(ImageError, match=r"a\.png"):
        read_style_image(tmp_path / "a.png")
    packed = save_exr(tmp_path / "a.exr", rgb_channels(LINEAR)).read_bytes()
    for length in (40, len(packed) - 40):
        (tmp_path / "a.exr").write_bytes(packed[:length])
        with pytest.raises(ImageError, match=r"a\.exr"):
            read_style_image(tmp_path / "a.exr")


def test_an_exr_that_takes_too_long_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_exr(tmp_path / "a.exr", rgb_channels(LINEAR))
    monkeypatch.setattr(exr_channels, "_SECONDS", 1e-3)
    with pytest.raises(ImageError, match=r"a\.exr.* was stopped"):
        read_style_image(tmp_path / "a.exr")


@pytest.mark.parametrize("brightness", [255.0, 1.0])
def test_linear_images_that_would_be_plain_white_are_refused(
    tmp_path: Path, brightness: float
) -> None:
    grey = brightness * np.linspace(0.1, 1.0, 64, dtype=np.float32).reshape(8, 8)
    Image.fromarray(grey).save(tmp_path / "a.tif")
    save_exr(tmp_path / "a.exr", rgb_channels(np.repeat(grey[..., None], 3, 2)))
    for name in ("a.tif", "a.exr"):
        if brightness > 1:
            with pytest.raises(ImageError, match=r"100% of .* up to 255"):
                read_style_image(tmp_path / name)
        else:
            assert 0.3 < read_style_image(tmp_path / name).pixels.min() < 0.4


def test_nan_pixels_are_counted(tmp_path: Path) -> None:
    linear = LINEAR.copy()
    linear[0, 0, 0], linear[1, 1, 2] = np.nan, np.inf
    save_exr(tmp_path / "a.exr", rgb_channels(linear))
    with pytest.raises(ImageError, match=r"a\.exr has 2 NaN or infinite"):
        read_style_image(tmp_path / "a.exr")


def test_exr_without_colour_lists_its_channels(tmp_path: Path) -> None:
    save_exr(tmp_path / "a.exr", {"Z": LINEAR[..., 0].copy(), "id": LINEAR[..., 1].copy()})
    with pytest.raises(ImageError, match="Z, id"):
        read_style_image(tmp_path / "a.exr")


def test_fully_transparent_image_is_refused(tmp_path: Path) -> None:
    Image.new("RGBA", (3, 3), (255, 0, 0, 0)).save(tmp_path / "a.png")
    with pytest.raises(ImageError, match="fully transparent"):
        read_style_image(tmp_path / "a.png")


@pytest.mark.parametrize("suffix", ["png", "exr"])
def test_huge_image_is_refused_by_its_header(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    file_path = tmp_path / f"a.{suffix}"
    if suffix == "exr":
        save_exr(file_path, rgb_channels(LINEAR))
    else:
        Image.fromarray(LEVELS).save(file_path)
    monkeypatch.setattr(images, "_MAX_PIXELS", 19)
    with pytest.raises(ImageError, match="5 x 4 pixels"):
        read_style_image(file_path)


def test_decompression_bomb_is_refused_without_unpacking_it(tmp_path: Path) -> None:
    """Two kilobytes that claim 60 000 x 60 000 pixels."""
    header = struct.pack(">2I5B", 60_000, 60_000, 8, 2, 0, 0, 0)
    packed = b"\x89PNG\r\n\x1a\n"
    for name, data in ((b"IHDR", header), (b"IDAT", zlib.compress(bytes(10**6))), (b"IEND", b"")):
        packed += struct.pack(">I", len(data)) + name + data
        packed += struct.pack(">I", zlib.crc32(name + data))
    (tmp_path / "bomb.png").write_bytes(packed)
    with pytest.raises(ImageError, match=r"bomb\.png"):
        read_style_image(tmp_path / "bomb.png")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
def test_a_pipe_is_refused_before_it_is_waited_for(tmp_path: Path) -> None:
    pipe = tmp_path / "style.png"
    os.mkfifo(pipe)
    with pytest.raises(ImageError, match="a device"):
        read_style_image(pipe)


def test_an_image_of_many_pixels_is_reduced_and_says_so(tmp_path: Path) -> None:
    rows = np.arange(4200, dtype=np.uint8)[:, None]
    Image.fromarray(np.broadcast_to(rows, (4200, 4200)).copy()).save(tmp_path / "large.png")
    style = read_style_image(tmp_path / "large.png")
    assert style.pixels.shape == (2100, 2100, 3)
    pairs = np.arange(4200).reshape(-1, 2).astype(np.uint8).mean(axis=1)
    assert np.allclose(style.pixels[:, 7, 0] * 255, pairs, atol=1e-3)
    assert "4200" in style.note and "2100" in style.note
    Image.fromarray(LEVELS).save(tmp_path / "small.png")
    assert read_style_image(tmp_path / "small.png").note == ""

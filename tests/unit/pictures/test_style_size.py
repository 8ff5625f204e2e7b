"""The size of a style whose marks are too fine for voxels."""

import math

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import frame_of, puff, random_style
from usdsmoke.config.look_sections import StyleConfig
from usdsmoke.config.presets import preset_file
from usdsmoke.config.resolve import resolve_config
from usdsmoke.core.smoke.srgb import luma
from usdsmoke.core.style.style_image import scale_style
from usdsmoke.core.views.scene import measure_scene
from usdsmoke.pictures.style_size import (
    FINE,
    LEAST_WAVELENGTH,
    MOST_FINE,
    SIZES,
    find_style_size,
    fine_share,
    least_size,
    luminance,
    mean_wavelength,
    scaled_light,
)

LIKE = torch.zeros(())


def stripes(wavelength: float, finer: int = 4) -> np.ndarray:
    """Stripes that are ``wavelength`` wide where the image is reduced to 96 pixels."""
    phase = 2 * np.pi / (wavelength * finer) * np.arange(96 * finer)
    light = (0.5 + 0.4 * np.sin(phase)).astype(np.float32)
    return np.broadcast_to(light[None, :, None], (96 * finer, 96 * finer, 3)).copy()


@pytest.mark.parametrize("longer_side", [40, 96, 150, 333])
def test_marks_are_measured_on_the_image_that_pictures_are_compared_with(longer_side):
    style = random_style(90, 150)
    compared = luma(scale_style(style, longer_side, StyleConfig(), LIKE)).numpy()
    measured = scaled_light(luminance(style), longer_side)
    assert measured == pytest.approx(compared, abs=1e-5)


@pytest.mark.parametrize("wavelength", [2.5, 4.0, 9.7])
def test_the_mean_wavelength_of_stripes_is_theirs(wavelength):
    turned = stripes(wavelength, finer=1)[..., 0].T
    assert mean_wavelength(turned) == pytest.approx(wavelength, rel=0.02)


def test_the_mean_wavelength_of_noise_and_of_one_colour():
    noise = np.random.default_rng(0).random((200, 200))
    assert mean_wavelength(noise) == pytest.approx(2.1, abs=0.1)
    # power below 4 pixels over that below 16: parts of the plane of frequencies
    assert fine_share(noise) ** 2 == pytest.approx((1 - np.pi / 16) / (1 - np.pi / 256), abs=0.02)
    assert mean_wavelength(np.full((20, 30), 0.3)) == float("inf")


@pytest.mark.parametrize(
    ("wavelength", "pixels"), [(2.6, 96), (3.7, 96), (5.2, 48), (5.2, 96), (9.0, 96)]
)
def test_marks_are_enlarged_to_what_voxels_hold_and_not_further(wavelength, pixels):
    style = stripes(wavelength)
    size = least_size(luminance(style), pixels)
    here = wavelength * pixels / 96
    enlarged = next(size for size in SIZES if here * size > FINE)
    assert size == (1 if here >= LEAST_WAVELENGTH else enlarged)


def test_more_voxels_need_smaller_sizes_step_by_step():
    style = (stripes(2.6) + stripes(17.0)) / 2  # the wide ones do not hide the fine ones
    steps = [SIZES.index(least_size(luminance(style), side)) for side in range(80, 150)]
    assert steps[0] >= 2 and steps[-1] == 0
    assert set(np.diff(steps)) == {0, -1}


def test_a_style_as_fine_at_every_size_keeps_its_size():
    pixels = np.random.default_rng(0).random((1024, 1024, 1), dtype=np.float32)
    noise = np.broadcast_to(pixels, (1024, 1024, 3))
    assert {least_size(luminance(noise), side) for side in (60, 100, 200)} == {1.0}


@pytest.mark.parametrize("amplitude", [0.1, 0.5, 0.9])
def test_the_fine_share_is_that_of_amplitudes(amplitude):
    fine, wide, broad = (stripes(width, finer=1) - 0.5 for width in (3.0, 9.0, 40.0))
    mixed = 0.5 + 0.3 * (amplitude * fine + 0.5 * wide + broad)  # broad stripes are no marks
    expected = amplitude / math.hypot(amplitude, 0.5)
    assert fine_share(mixed[..., 0]) == pytest.approx(expected, rel=0.05)
    assert fine_share(np.full((20, 30), 0.3)) == 0


def test_a_fine_style_is_enlarged_until_few_of_its_marks_are_fine():
    style = 0.5 + 0.45 * (stripes(2.1) - 0.5) + 0.45 * (stripes(3.2) - 0.5)
    # 1.41 times as large, its mean wavelength is wide enough, but half of it is finer than 4
    enlarged = luma(scale_style(style, 96, StyleConfig(size=math.sqrt(2)), LIKE)).numpy()
    assert mean_wavelength(enlarged) > LEAST_WAVELENGTH and fine_share(enlarged) > MOST_FINE
    assert least_size(luminance(style), 96) == 2


def test_a_style_that_stays_too_fine_has_the_size_with_the_fewest_fine_marks():
    pixels = np.random.default_rng(0).random((300, 300, 1), dtype=np.float32)
    noise = np.broadcast_to(pixels, (300, 300, 3))
    assert least_size(luminance(noise), 96) == SIZES[-1]  # only there is it finer than the image
    largest = luma(scale_style(noise, 96, StyleConfig(size=SIZES[-1]), LIKE)).numpy()
    assert fine_share(largest) > MOST_FINE


@pytest.mark.parametrize("amplitude", [0.0, 1e-6, 0.005])
def test_a_flat_style_keeps_its_size(amplitude):
    style = 0.5 + amplitude * (stripes(2.6) - 0.5)
    assert least_size(luminance(style), 96) == 1 < least_size(luminance(stripes(2.6)), 96)


def shot_size(styles: list[np.ndarray], changes: dict) -> float:
    return find_style_size(styles, 96, resolve_config(changes))


def test_a_set_size_and_a_tiled_image_are_left_alone():
    fine = [stripes(2.6)]
    assert shot_size(fine, {}) > 1
    assert shot_size(fine, {"style": {"size": 0.5}}) == 1
    assert shot_size(fine, {"style": {"tiling": 2}}) == 1


def test_the_image_that_needs_least_decides_and_one_without_weight_does_not_count():
    fine, wide = stripes(2.6), stripes(9.0)
    assert shot_size([fine, wide], {}) == 1
    assert shot_size([fine, wide], {"style": {"weights": [1, 0]}}) == shot_size([fine], {})


def test_all_presets_see_marks_of_the_same_size():
    frame, found = frame_of(np.ones((150, 16, 16), np.float32)), []
    for name in ("draft", "daily", "final"):
        config = resolve_config(preset_file(name))
        scene = measure_scene([frame], config.views, config.optics, "Y", config.grids.parts)
        found.append((scene.image_size, find_style_size([stripes(1.8)], scene.voxels, config)))
    images, sizes = zip(*found, strict=True)
    assert len(set(images)) > 1 and len(set(sizes)) == 1 and sizes[0] > 1


def test_finer_voxels_need_less():
    scenes = {}
    for refine in (1, 2):
        config = resolve_config({"grids": {"refine": refine}})
        frame = frame_of(puff(100))
        scene = measure_scene([frame], config.views, config.optics, "Y", refine)
        scenes[refine] = find_style_size([stripes(2.6)], scene.voxels, config)
    assert scenes[2] < scenes[1]

"""Colour spaces, and style images at the scale of the picture."""

import math

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import frame_of, puff, random_style
from usdsmoke.base.presets import preset_file
from usdsmoke.base.resolve import resolve_config
from usdsmoke.base.sections import StyleConfig
from usdsmoke.core.smoke.srgb import decode_srgb, encode_srgb, luma
from usdsmoke.core.steps.targets import find_style_size
from usdsmoke.core.style.style_image import (
    FINE,
    LEAST_WAVELENGTH,
    MOST_FINE,
    SIZES,
    SMALLEST,
    adjust_tones,
    find_size,
    fine_share,
    match_grey,
    mean_wavelength,
    scale_style,
)
from usdsmoke.core.views.scene import Scene, measure_scene

LIKE = torch.zeros(())


def test_srgb_has_the_values_of_the_standard():
    linear = torch.tensor([0.0, 0.0031308, 0.005, 0.18, 0.5, 1.0], dtype=torch.float64)
    wanted = [0.0, 0.04045, 0.0610065, 0.4613561, 0.7353570, 1.0]
    assert encode_srgb(linear).tolist() == pytest.approx(wanted, abs=1e-5)


def test_decoding_inverts_encoding():
    linear = torch.linspace(0, 4, 400, dtype=torch.float64)
    assert torch.allclose(decode_srgb(encode_srgb(linear)), linear, atol=1e-7)


def test_encoding_has_finite_slopes_and_clips_below_zero():
    linear = torch.tensor([-1.0, 0.0, 1e-30, 0.0031308, 1.0, 1e30], requires_grad=True)
    encoded = encode_srgb(linear)
    (slope,) = torch.autograd.grad(encoded.sum(), linear)
    assert torch.isfinite(slope).all() and encoded[0].item() == 0.0
    code = torch.tensor([0.0, 0.04045, 1.0], requires_grad=True)
    (slope,) = torch.autograd.grad(decode_srgb(code).sum(), code)
    assert torch.isfinite(slope).all() and (slope > 0).all()


def test_style_gets_the_picture_s_longer_side_and_keeps_its_shape():
    scaled = scale_style(random_style(24, 48), 100, StyleConfig(), LIKE)
    assert scaled.shape == (50, 100, 3)
    assert scale_style(random_style(24, 48), 48, StyleConfig(), LIKE).numpy() == pytest.approx(
        random_style(24, 48)
    )


def test_tiling_repeats_the_image_at_a_part_of_its_size():
    once = scale_style(random_style(24, 24), 30, StyleConfig(), LIKE)
    tiled = scale_style(random_style(24, 24), 90, StyleConfig(tiling=3), LIKE)
    assert tiled.shape == (90, 90, 3)
    assert torch.equal(tiled, once.repeat(3, 3, 1))


def test_size_enlarges_the_structures():
    assert scale_style(random_style(20, 20), 40, StyleConfig(size=2.0), LIKE).shape[0] == 80


def test_colour_scales_the_distance_from_grey_and_lift_raises_black():
    style = np.float32([[[0, 0, 0], [0.6, 0.4, 0.5]], [[1, 1, 1], [0.9, 0, 0]]])
    assert np.array_equal(adjust_tones(style, StyleConfig()), style)
    grey = adjust_tones(style, StyleConfig(colour=0.0))
    assert np.ptp(grey, axis=-1).max() < 1e-6
    assert np.allclose(luma(torch.tensor(grey)), luma(torch.tensor(style)), atol=1e-6)
    more = adjust_tones(style, StyleConfig(colour=1.5))
    assert np.ptp(more[0, 1]) == pytest.approx(0.3) and more.min() >= 0 and more.max() <= 1
    lifted = adjust_tones(style, StyleConfig(lift=0.25))
    assert np.allclose(lifted[0, 0], 0.25) and np.allclose(lifted[1, 0], 1.0)


@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (300, 1), (3, 2)])
@pytest.mark.parametrize("tiling", [1, 4])
def test_tiny_and_narrow_styles_become_large_enough_for_the_filters(shape, tiling):
    style = np.full((*shape, 3), 0.25, np.float32)
    scaled = scale_style(style, 20, StyleConfig(tiling=tiling), LIKE)
    assert min(scaled.shape[:2]) >= SMALLEST
    assert torch.allclose(scaled, torch.full_like(scaled, 0.25), atol=1e-6)


def test_grey_style_gets_the_mean_and_contrast_of_the_smoke():
    matched = match_grey(torch.from_numpy(random_style(64, 64)), 0.5, 0.22)
    assert matched.shape == (64, 64, 3)
    assert torch.equal(matched[..., 0], matched[..., 2])
    assert matched.mean().item() == pytest.approx(0.5, abs=0.02)
    assert matched[..., 0].std().item() == pytest.approx(0.22, abs=0.02)


@pytest.mark.parametrize("mean", [0.0, 0.3, 1.0])
def test_constant_style_becomes_the_smoke_s_grey(mean):
    matched = match_grey(torch.full((8, 8, 3), 0.7), mean, 0.2)
    assert torch.allclose(matched, torch.full_like(matched, mean), atol=1e-3)


def stripes(wavelength: float, finer: int = 4) -> np.ndarray:
    """Stripes that are ``wavelength`` wide where the image is reduced to 96 pixels."""
    phase = 2 * np.pi / (wavelength * finer) * np.arange(96 * finer)
    light = (0.5 + 0.4 * np.sin(phase)).astype(np.float32)
    return np.broadcast_to(light[None, :, None], (96 * finer, 96 * finer, 3)).copy()


@pytest.mark.parametrize("wavelength", [2.5, 4.0, 9.7])
def test_the_mean_wavelength_of_stripes_is_theirs(wavelength):
    turned = torch.tensor(stripes(wavelength, finer=1)).transpose(0, 1)
    assert mean_wavelength(turned) == pytest.approx(wavelength, rel=0.02)


def test_the_mean_wavelength_of_noise_and_of_one_colour():
    noise = torch.rand(200, 200, 1, generator=torch.Generator().manual_seed(0)).expand(-1, -1, 3)
    assert mean_wavelength(noise) == pytest.approx(2.1, abs=0.1)
    # power below 4 pixels over that below 16: parts of the plane of frequencies
    assert fine_share(noise) ** 2 == pytest.approx((1 - np.pi / 16) / (1 - np.pi / 256), abs=0.02)
    assert mean_wavelength(torch.full((20, 30, 3), 0.3)) == float("inf")


@pytest.mark.parametrize(
    ("wavelength", "pixels"), [(2.6, 96), (3.7, 96), (5.2, 48), (5.2, 96), (9.0, 96)]
)
def test_marks_are_enlarged_to_what_voxels_hold_and_not_further(wavelength, pixels):
    style = stripes(wavelength)
    size = find_size(style, pixels)
    here = wavelength * pixels / 96
    enlarged = next(size for size in SIZES if here * size > FINE)
    assert size == (1 if here >= LEAST_WAVELENGTH else enlarged)


def test_more_voxels_need_smaller_sizes_step_by_step():
    style = (stripes(2.6) + stripes(17.0)) / 2  # the wide ones do not hide the fine ones
    steps = [SIZES.index(find_size(style, side)) for side in range(80, 150)]
    assert steps[0] >= 2 and steps[-1] == 0
    assert set(np.diff(steps)) == {0, -1}


def test_a_style_as_fine_at_every_size_keeps_its_size():
    pixels = np.random.default_rng(0).random((1024, 1024, 1), dtype=np.float32)
    noise = np.broadcast_to(pixels, (1024, 1024, 3))
    assert {find_size(noise, side) for side in (60, 100, 200)} == {1.0}


@pytest.mark.parametrize("amplitude", [0.1, 0.5, 0.9])
def test_the_fine_share_is_that_of_amplitudes(amplitude):
    fine, wide, broad = (stripes(width, finer=1) - 0.5 for width in (3.0, 9.0, 40.0))
    mixed = 0.5 + 0.3 * (amplitude * fine + 0.5 * wide + broad)  # broad stripes are no marks
    expected = amplitude / math.hypot(amplitude, 0.5)
    assert fine_share(torch.tensor(mixed)) == pytest.approx(expected, rel=0.05)
    assert fine_share(torch.full((20, 30, 3), 0.3)) == 0


def test_a_fine_style_is_enlarged_until_few_of_its_marks_are_fine():
    style = 0.5 + 0.45 * (stripes(2.1) - 0.5) + 0.45 * (stripes(3.2) - 0.5)
    # 1.41 times as large, its mean wavelength is wide enough, but half of it is finer than 4
    enlarged = scale_style(style, 96, StyleConfig(size=math.sqrt(2)), torch.zeros(()))
    assert mean_wavelength(enlarged) > LEAST_WAVELENGTH and fine_share(enlarged) > MOST_FINE
    assert find_size(style, 96) == 2


def test_a_style_that_stays_too_fine_has_the_size_with_the_fewest_fine_marks():
    pixels = np.random.default_rng(0).random((300, 300, 1), dtype=np.float32)
    noise = np.broadcast_to(pixels, (300, 300, 3))
    assert find_size(noise, 96) == SIZES[-1]  # only there is it finer than the image
    largest = scale_style(noise, 96, StyleConfig(size=SIZES[-1]), LIKE)
    assert fine_share(largest) > MOST_FINE


@pytest.mark.parametrize("amplitude", [0.0, 1e-6, 0.005])
def test_a_flat_style_keeps_its_size(amplitude):
    style = 0.5 + amplitude * (stripes(2.6) - 0.5)
    assert find_size(style, 96) == 1 < find_size(stripes(2.6), 96)


def shot_size(styles: list[np.ndarray], changes: dict, **scene) -> float:
    scene = Scene(1, 1, 1, "Y", 1, 96, **scene)
    return find_style_size(styles, scene, resolve_config(changes))


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
        scene = measure_scene([frame], config.views, config.optics, "Y", config.grids.refine)
        found.append((scene.image_size, find_style_size([stripes(1.8)], scene, config)))
    images, sizes = zip(*found, strict=True)
    assert len(set(images)) > 1 and len(set(sizes)) == 1 and sizes[0] > 1


def test_finer_voxels_need_less():
    scenes = {}
    for refine in (1, 2):
        config = resolve_config({"grids": {"refine": refine}})
        frame = frame_of(puff(100))
        scene = measure_scene([frame], config.views, config.optics, "Y", refine)
        scenes[refine] = find_style_size([stripes(2.6)], scene, config)
    assert scenes[2] < scenes[1]

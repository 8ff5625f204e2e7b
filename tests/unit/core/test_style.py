"""Colour spaces, and style images at the scale of the picture."""

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import random_style
from usdsmoke.config.look_sections import StyleConfig
from usdsmoke.core.smoke.srgb import decode_srgb, encode_srgb, luma
from usdsmoke.core.style.style_image import SMALLEST, adjust_tones, match_grey, scale_style

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


def test_colour_scales_the_distance_from_grey():
    style = np.float32([[[0, 0, 0], [0.6, 0.4, 0.5]], [[1, 1, 1], [0.9, 0, 0]]])
    assert np.array_equal(adjust_tones(style, StyleConfig()), style)
    grey = adjust_tones(style, StyleConfig(colour=0.0))
    assert np.ptp(grey, axis=-1).max() < 1e-6
    assert np.allclose(luma(torch.tensor(grey)), luma(torch.tensor(style)), atol=1e-6)
    more = adjust_tones(style, StyleConfig(colour=1.5))
    assert np.ptp(more[0, 1]) == pytest.approx(0.3) and more.min() >= 0 and more.max() <= 1


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

"""Pictures of finished fields."""

import numpy as np
import pytest
import torch

from benchmarks.splats import (
    MOST_PIXELS,
    display_picture,
    grey_picture,
    render_fields,
    render_view,
)
from tests.smoke_fixtures import affine, puff
from usdsmoke.base.volume import DenseField
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.srgb import encode_srgb
from usdsmoke.core.views.cameras import View, orbit_view
from usdsmoke.core.views.scene import fit_view

GAMMA_W = 0.4
DENSITY = puff(10)
COLOUR = np.array([0.8, 0.3, 0.1], np.float32)


def field(values: np.ndarray, ijk_min: tuple[int, int, int] = (0, 0, 0)) -> DenseField:
    background = (0.0, 0.0, 0.0) if values.ndim == 4 else 0.0
    return DenseField("density", values.astype(np.float32), ijk_min, affine(0), background)


def glowing(density: np.ndarray) -> np.ndarray:
    return GAMMA_W * density[..., None] * COLOUR


def middle_view(size: int = 20, pixel_size: float = 1.0, azimuth: float = 20.0) -> View:
    middle = (np.full(3, 4.5) @ affine(0)[:3, :3]) + affine(0)[3, :3]
    return orbit_view(azimuth, 10.0, "Y", middle, size, size, pixel_size)


@pytest.mark.parametrize("pixel_size", [0.6, 1.0, 1.7])
def test_smoke_of_one_colour_has_that_colour_times_its_opacity(pixel_size):
    picture = render_fields(
        field(DENSITY), field(glowing(DENSITY)), np.eye(4), GAMMA_W, middle_view(24, pixel_size)
    )
    assert picture.dtype == np.float32 and 0.3 < picture[..., 3].max() <= 1
    assert picture[..., :3] == pytest.approx(picture[..., 3:] * COLOUR, abs=2e-5)


def test_without_emission_smoke_is_white():
    picture = render_fields(field(DENSITY), None, np.eye(4), GAMMA_W, middle_view())
    assert picture[..., :3] == pytest.approx(np.repeat(picture[..., 3:], 3, -1), abs=1e-5)


def test_emission_may_have_a_smaller_box_than_the_density():
    """Black voxels are background to a file, so its box of emission shrinks."""
    emission = glowing(DENSITY)
    emission[:5] = 0
    wanted = render_fields(field(DENSITY), field(emission), np.eye(4), GAMMA_W, middle_view())
    found = render_fields(
        field(DENSITY), field(emission[5:], (5, 0, 0)), np.eye(4), GAMMA_W, middle_view()
    )
    assert np.array_equal(found, wanted) and 0 < found[..., 0].max()


def test_emission_where_there_is_no_density_is_not_seen():
    emission = glowing(DENSITY) + 5.0 * (DENSITY == 0)[..., None]
    view = middle_view(16, 1.7)
    picture = render_fields(field(DENSITY), field(emission), np.eye(4), GAMMA_W, view)
    assert picture[..., :3].max() <= 0.8 + 1e-5


def test_subdividing_for_small_pixels_keeps_the_picture():
    """The mean over blocks of small pixels is what large pixels show, a voxel's blur apart."""
    coarse, fine = (
        render_fields(field(DENSITY), None, np.eye(4), 0.05, middle_view(16 * n, 1.2 / n))
        for n in (1, 3)
    )
    blocks = fine.reshape(16, 3, 16, 3, 4).mean(axis=(1, 3))
    assert np.abs(blocks - coarse).max() < 0.08 * coarse.max()
    assert blocks.sum() == pytest.approx(coarse.sum(), rel=0.01)


@pytest.mark.parametrize("values", [np.zeros((0, 0, 0)), np.zeros((3, 3, 3)), -np.ones((2, 2, 2))])
def test_nothing_to_see_gives_an_empty_picture(values):
    assert not render_fields(field(values), None, np.eye(4), 1.0, middle_view(6)).any()
    picture = render_view(field(values), None, np.eye(4), 1.0, "Y", image_size=12)
    assert picture.shape == (12, 12, 4) and not picture.any()


@pytest.mark.parametrize("image_size", [16, 40, 100])
@pytest.mark.parametrize("shape", [(10, 10, 10), (1, 1, 1), (7, 9, 1), (40, 2, 3)])
def test_a_view_has_the_size_asked_for_whatever_the_smoke(image_size, shape):
    picture = render_view(field(np.ones(shape)), None, np.eye(4), 1.0, "Z", image_size=image_size)
    assert max(picture.shape[:2]) == image_size
    assert np.isfinite(picture).all() and picture[..., 3].max() > 0.3


def test_two_voxels_far_apart_are_drawn_without_the_emptiness_between(monkeypatch):
    density = np.zeros((5_000, 1, 2))
    density[0, 0, 0] = density[-1, 0, 1] = 1e9
    sizes = []

    def noted(view: View, smoke: ActiveSmoke, margin: int = 2) -> View:
        made = fit_view(view, smoke, margin)
        sizes.append(max(made.height, made.width))
        return made

    monkeypatch.setattr("benchmarks.splats.fit_view", noted)
    monkeypatch.setattr("usdsmoke.core.views.project.MOST_CELLS", 2**20)
    picture = render_view(field(density), None, np.eye(4), 1.0, "Y", 20.0, image_size=16)
    assert sizes[-1] <= 2 * MOST_PIXELS * 16 + 8
    assert np.isfinite(picture).all() and picture[..., 3].max() > 0.01


def test_display_puts_the_background_behind_and_encodes():
    picture = np.array([[[0.2, 0.1, 0.0, 0.5], [0.0, 0.0, 0.0, 0.0]]], np.float32)
    shown = display_picture(picture, (0.4, 0.4, 1.0))
    wanted = encode_srgb(torch.tensor([[[0.4, 0.3, 0.5], [0.4, 0.4, 1.0]]])).numpy()
    assert shown == pytest.approx(wanted, abs=1e-6)
    assert display_picture(np.full((1, 1, 4), 7.0, np.float32)).max() == 1.0


def test_grey_picture_is_the_opacity():
    picture = np.random.default_rng(0).random((3, 4, 4)).astype(np.float32)
    assert np.array_equal(grey_picture(picture)[..., 1], picture[..., 3])

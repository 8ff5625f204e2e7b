"""The renderers that judge results, against closed forms and against each other."""

import numpy as np
import pytest

from benchmarks.raymarch import march_rays
from benchmarks.splats import render_fields
from tests.fixtures.smoke_fixtures import affine, puff
from usdsmoke.base.volume import DenseField
from usdsmoke.core.views.cameras import View, orbit_view

BOX = (24, 20, 16)
MIDDLE = np.array([-0.3, 0.2, 0.1])


def view_of(azimuth: float = 0.0) -> View:
    return orbit_view(azimuth, 0.0, "Y", MIDDLE, 12, 16, 0.05)


def transform(voxel: float) -> np.ndarray:
    """Index to stage, so that the box's middle lies where the views look."""
    matrix = np.diag([voxel, voxel, voxel, 1.0])
    matrix[3, :3] = MIDDLE - voxel * (np.array(BOX) - 1) / 2
    return matrix


@pytest.mark.parametrize("gamma_w", [1e-9, 0.7, 30.0])
def test_a_homogeneous_slab_has_its_exact_opacity_and_colour(gamma_w: float) -> None:
    density, colour = np.full(BOX, 2.0), np.array([0.8, 0.3, 0.1])
    emission = np.broadcast_to(colour * gamma_w * 2.0, (*BOX, 3))
    picture, alpha = march_rays(density, emission, transform(0.1), gamma_w, view_of(), 8.0)
    # trilinear ends: 15 voxels between centres, and half a voxel of fading on either side
    expected = -np.expm1(-gamma_w * 2.0 * 0.1 * 16)
    assert np.allclose(alpha, expected, rtol=2e-3, atol=1e-7)
    assert np.allclose(picture, expected * colour, rtol=2e-3, atol=1e-7)


def test_the_nearer_of_two_sheets_hides_the_other_and_turns_with_the_view() -> None:
    density, emission = np.zeros(BOX), np.zeros((*BOX, 3))
    density[..., 3] = density[..., 12] = 100.0
    emission[..., 12, 0], emission[..., 3, 2] = 100.0, 100.0  # red at +Z, blue behind it
    front, _ = march_rays(density, emission, transform(0.1), 1.0, view_of())
    back, _ = march_rays(density, emission, transform(0.1), 1.0, view_of(180.0))
    assert front[6, 8, 0] > 0.99 and front[6, 8, 2] < 0.01
    assert back[6, 8, 2] > 0.99 and back[6, 8, 0] < 0.01


def test_perspective_shows_a_voxel_where_the_pinhole_equation_puts_it() -> None:
    density = np.zeros(BOX)
    density[20, 15, 8] = 50.0
    matrix = transform(0.1)
    place = np.array([20, 15, 8]) @ matrix[:3, :3] + matrix[3, :3]
    eye, axes = np.array([-0.3, 0.2, 6.1]), np.eye(3)
    view = View(axes[0], axes[1], -axes[2], eye, 80, 80, 1.0, focal=150.0)
    _, alpha = march_rays(density, np.zeros((*BOX, 3)), matrix, 1.0, view)
    y, x = (np.average(grid, weights=alpha) for grid in np.mgrid[:80, :80])
    scale = 150.0 / (eye[2] - place[2])
    assert x == pytest.approx(39.5 + scale * (place[0] - eye[0]), abs=0.1)
    assert y == pytest.approx(39.5 - scale * (place[1] - eye[1]), abs=0.1)


def test_finer_steps_converge_in_second_order() -> None:
    i, j, k = np.indices(BOX)
    density = 1.0 + np.sin(0.4 * i + 0.3 * k) * np.cos(0.2 * j + 0.5 * k)
    emission = np.stack([density, density**2, np.ones(BOX)], axis=-1)

    def drawn(steps: float) -> np.ndarray:
        return march_rays(density, emission, transform(0.1), 1.0, view_of(30.0), steps)[0]

    coarse, fine = (np.abs(drawn(steps) - drawn(64.0)).max() for steps in (2.0, 8.0))
    assert coarse < 0.01 and fine < coarse / 8.0


@pytest.mark.parametrize("pixel_size", [0.6, 1.7])
def test_splats_of_one_colour_show_it_times_the_opacity_and_nothing_outside(
    pixel_size: float,
) -> None:
    density, colour, gamma_w = puff(10), np.array([0.8, 0.3, 0.1], np.float32), 0.4
    emission = gamma_w * density[..., None] * colour
    if pixel_size > 1:  # finer pixels subdivide the voxels, emission and all
        emission += 5.0 * (density == 0)[..., None]
    matrix = affine(0)
    fields = (
        DenseField("density", density, (0, 0, 0), matrix),
        DenseField("emission", emission.astype(np.float32), (0, 0, 0), matrix, (0.0, 0.0, 0.0)),
    )
    middle = np.full(3, 4.5) @ matrix[:3, :3] + matrix[3, :3]
    view = orbit_view(20.0, 10.0, "Y", middle, 24, 24, pixel_size)
    picture = render_fields(*fields, np.eye(4), gamma_w, view)
    assert 0.3 < picture[..., 3].max() <= 1
    assert picture[..., :3] == pytest.approx(picture[..., 3:] * colour, abs=2e-5)
    white = render_fields(fields[0], None, np.eye(4), gamma_w, view)
    assert white[..., :3] == pytest.approx(np.repeat(picture[..., 3:], 3, -1), abs=1e-5)

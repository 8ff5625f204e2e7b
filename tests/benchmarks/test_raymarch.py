"""The benchmark's second renderer against closed forms."""

import numpy as np
import pytest

from benchmarks.raymarch import march_rays
from usdsmoke.core.views.cameras import View, orbit_view

BOX = (24, 20, 16)


def view_of(azimuth: float = 0.0, pixel_size: float = 0.05) -> View:
    middle = np.array([-0.3, 0.2, 0.1])
    return orbit_view(azimuth, 0.0, "Y", middle, 12, 16, pixel_size)


def transform(voxel: float) -> np.ndarray:
    """Index to stage, so that the box's middle lies where the views look."""
    matrix = np.diag([voxel, voxel, voxel, 1.0])
    matrix[3, :3] = np.array([-0.3, 0.2, 0.1]) - voxel * (np.array(BOX) - 1) / 2
    return matrix


@pytest.mark.parametrize("gamma_w", [1e-9, 0.7, 30.0])
def test_a_homogeneous_slab_has_its_exact_opacity_and_colour(gamma_w: float):
    density = np.full(BOX, 2.0)
    colour = np.array([0.8, 0.3, 0.1])
    emission = np.broadcast_to(colour * gamma_w * 2.0, (*BOX, 3))
    picture, alpha = march_rays(density, emission, transform(0.1), gamma_w, view_of(), 8.0)
    # Trilinear ends: the box is 15 voxels between centres and fades over one voxel on either side.
    wanted = -np.expm1(-gamma_w * 2.0 * 0.1 * 16)
    assert np.allclose(alpha, wanted, rtol=2e-3, atol=1e-7)
    assert np.allclose(picture, wanted * colour, rtol=2e-3, atol=1e-7)


def test_the_nearer_of_two_sheets_hides_the_other_and_turns_with_the_view():
    density, emission = np.zeros(BOX), np.zeros((*BOX, 3))
    density[..., 3] = density[..., 12] = 100.0
    emission[..., 12, 0], emission[..., 3, 2] = 100.0, 100.0  # red at +Z, blue behind it
    front, _ = march_rays(density, emission, transform(0.1), 1.0, view_of())
    back, _ = march_rays(density, emission, transform(0.1), 1.0, view_of(180.0))
    assert front[6, 8, 0] > 0.99 and front[6, 8, 2] < 0.01
    assert back[6, 8, 2] > 0.99 and back[6, 8, 0] < 0.01


def test_perspective_shows_a_voxel_where_the_pinhole_equation_puts_it():
    density = np.zeros(BOX)
    density[20, 15, 8] = 50.0
    matrix = transform(0.1)
    place = np.array([20, 15, 8]) @ matrix[:3, :3] + matrix[3, :3]
    eye = np.array([-0.3, 0.2, 6.1])
    axes = np.eye(3)
    view = View(axes[0], axes[1], -axes[2], eye, 80, 80, 1.0, focal=150.0)
    _, alpha = march_rays(density, np.zeros((*BOX, 3)), matrix, 1.0, view)
    y, x = (np.average(grid, weights=alpha) for grid in np.mgrid[:80, :80])
    scale = 150.0 / (eye[2] - place[2])
    assert x == pytest.approx(39.5 + scale * (place[0] - eye[0]), abs=0.1)
    assert y == pytest.approx(39.5 - scale * (place[1] - eye[1]), abs=0.1)


def test_finer_steps_converge_in_second_order():
    i, j, k = np.indices(BOX)
    density = 1.0 + np.sin(0.4 * i + 0.3 * k) * np.cos(0.2 * j + 0.5 * k)
    emission = np.stack([density, density**2, np.ones(BOX)], axis=-1)

    def error(steps: float) -> float:
        picture, _ = march_rays(density, emission, transform(0.1), 1.0, view_of(30.0), steps)
        return float(np.abs(picture - finest).max())

    finest, _ = march_rays(density, emission, transform(0.1), 1.0, view_of(30.0), 64.0)
    assert error(2.0) < 0.01
    assert error(8.0) < error(2.0) / 8.0

"""Views: rigid, where they were asked for, and for every count and range."""

from collections import Counter

import numpy as np
import pytest
import torch

from tests.fixtures.camera_fixtures import camera_picture
from usdsmoke.base.volume import CameraSource
from usdsmoke.config.look_sections import ViewsConfig
from usdsmoke.core.views.cameras import (
    View,
    draw_views,
    frame_points,
    orbit_view,
    sample_angles,
    view_of_camera,
)
from usdsmoke.core.views.project import Projector

SAMPLINGS = ["fixed", "uniform", "poisson"]
RANGES = [(12.0, 6.0), (180.0, 0.0), (180.0, 90.0), (0.0, 6.0), (0.0, 0.0), (1e-3, 90.0)]


def orbit(azimuth: float, elevation: float, up_axis: str = "Y") -> View:
    return orbit_view(azimuth, elevation, up_axis, np.zeros(3), 8, 8, 1.0)


def seen_at(view: View, point: list[float]) -> tuple[float, float]:
    """Across and up in the picture, stage units."""
    return float(np.dot(point, view.right)), float(np.dot(point, view.up))


@pytest.mark.parametrize("up_axis", ["Y", "Z"])
@pytest.mark.parametrize("azimuth", [-400.0, -90.0, 0.0, 33.0, 180.0])
@pytest.mark.parametrize("elevation", [-90.0, -7.0, 0.0, 45.0, 90.0])
def test_axes_are_orthonormal_with_one_handedness(azimuth, elevation, up_axis):
    view = orbit(azimuth, elevation, up_axis)
    axes = np.stack([view.right, view.up, view.forward])
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-14)
    assert np.cross(view.right, view.forward) == pytest.approx(view.up, abs=1e-14)


def test_conventions_of_both_up_axes_at_zero():
    y_up, z_up = orbit(0, 0, "Y"), orbit(0, 0, "Z")
    assert y_up.forward == pytest.approx([0, 0, -1]) and y_up.up == pytest.approx([0, 1, 0])
    assert z_up.forward == pytest.approx([0, 1, 0]) and z_up.up == pytest.approx([0, 0, 1])
    assert y_up.right == pytest.approx([1, 0, 0]) and z_up.right == pytest.approx([1, 0, 0])


@pytest.mark.parametrize("up_axis", ["Y", "Z"])
def test_positive_elevation_looks_down_from_above(up_axis):
    view = orbit(20.0, 30.0, up_axis)
    up = [0.0, 1.0, 0.0] if up_axis == "Y" else [0.0, 0.0, 1.0]
    assert float(np.dot(view.forward, up)) == pytest.approx(-0.5)
    assert seen_at(view, up)[1] == pytest.approx(np.cos(np.radians(30)))
    assert seen_at(view, up)[0] == pytest.approx(0, abs=1e-14)


def test_positive_azimuth_walks_around_to_the_right():
    """From +90 degrees one stands on +X and has what was nearest, at +Z, on the left."""
    view = orbit(90.0, 0.0)
    assert view.forward == pytest.approx([-1, 0, 0], abs=1e-15)
    assert seen_at(view, [0, 0, 1])[0] == pytest.approx(-1)


def test_a_full_turn_is_the_same_view():
    for name in ("right", "up", "forward"):
        assert getattr(orbit(360 + 17.0, 5.0), name) == pytest.approx(
            getattr(orbit(17.0, 5.0), name), abs=1e-14
        )


def test_a_camera_looks_along_its_own_minus_z_whatever_its_scale():
    place = np.diag([3.0, 3.0, 3.0, 1.0])
    place[3, :3] = [1, 2, 3]
    view = camera_picture(place, 50.0, 25.0, 90, 160)
    assert view.forward == pytest.approx([0, 0, -1]) and view.up == pytest.approx([0, 1, 0])
    assert view.centre == pytest.approx([1, 2, 3])
    assert view.focal == pytest.approx(320.0)  # twice the width


def lens(across=0.0, above=0.0, parallel=False):
    """At (1, 2, 30), twice as long as its film of 20 x 10 is wide; looks along -Z."""
    place = np.eye(4)
    place[3, :3] = [1, 2, 30]
    return CameraSource("/camera", place, 40.0, 20.0, 10.0, across, above, (1.0, 100.0), parallel)


def pixel_of(view, point):
    """Mean of the pixels that a point is splatted on."""
    points = torch.tensor([point], dtype=torch.float64)
    projector = Projector(points, view)
    (foot,) = projector.footprints(points)
    pixel, weight = foot.first + torch.tensor(projector.shifts), foot.weights[:, 0]
    x, y = pixel % view.width, pixel // view.width
    assert float(weight.sum()) == pytest.approx(1.0)
    return float((x * weight).sum()), float((y * weight).sum())


@pytest.mark.parametrize(
    ("camera", "shape", "wanted"),
    [
        # 10 in front: 1 stage unit is 2/10 of the width, 20 pixels of 100
        (lens(), (50, 100), (69.5, 4.5)),
        (lens(), (100, 100), (69.5, 29.5)),  # higher than the film: more above and below
        (lens(across=2.0), (50, 100), (59.5, 4.5)),  # the film a tenth further to the right
        (lens(above=1.0), (50, 100), (69.5, 9.5)),  # and a twentieth of the width further up
        # film of 2 stage units on 100 pixels: 50 pixels a stage unit
        (lens(across=5.0, parallel=True), (200, 100), (74.5, 49.5)),
        (lens(across=5.0, above=2.0, parallel=True), (100, 100), (74.5, 9.5)),
    ],
)
def test_a_point_lands_on_the_pixel_that_film_and_lens_give(camera, shape, wanted):
    """The point lies 1 to the right of, 1 above and 10 in front of the camera."""
    view = view_of_camera(camera, *shape)
    assert pixel_of(view, [2.0, 3.0, 20.0]) == pytest.approx(wanted)


@pytest.mark.parametrize("sampling", SAMPLINGS)
@pytest.mark.parametrize(("azimuth", "elevation"), RANGES)
def test_every_count_and_range_gives_that_many_angles_inside_the_range(
    sampling, azimuth, elevation
):
    config = ViewsConfig(
        sampling=sampling,
        azimuth=azimuth,
        elevation=elevation,
        centre_azimuth=40.0,
        centre_elevation=-10.0,
    )
    for n in [*range(1, 20), 33, 64]:
        angles = sample_angles(config, n, seed=3)
        assert angles.shape == (n, 2)
        off = np.abs(angles - [40.0, -10.0])
        assert np.all(off <= np.array([azimuth, elevation]) + 1e-12)


@pytest.mark.parametrize("sampling", ["fixed", "uniform"])
@pytest.mark.parametrize(("azimuth", "elevation"), [r for r in RANGES if max(r) > 0])
def test_lattices_hold_no_angle_twice(sampling, azimuth, elevation):
    config = ViewsConfig(sampling=sampling, azimuth=azimuth, elevation=elevation)
    for n in range(2, 65):
        angles = sample_angles(config, n, seed=0)
        angles[:, 0] = np.mod(angles[:, 0] + 180, 360)  # -180 and 180 are one azimuth
        assert len(np.unique(angles.round(9), axis=0)) == n


def test_fixed_angles_start_with_the_middle_and_one_view_is_the_middle():
    for sampling in ("fixed", "uniform"):
        assert not sample_angles(ViewsConfig(sampling=sampling), 1, 0).any()
    for n in range(2, 20):
        assert not sample_angles(ViewsConfig(sampling="fixed"), n, 0)[0].any()


def test_lattices_reach_the_ends_of_the_range():
    angles = sample_angles(ViewsConfig(sampling="uniform", azimuth=20, elevation=10), 12, 0)
    assert angles.min(0) == pytest.approx([-20, -10]) and angles.max(0) == pytest.approx([20, 10])


def test_poisson_angles_follow_the_seed():
    config = ViewsConfig(sampling="poisson")
    first, again, other = (sample_angles(config, 9, seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_larger_poisson_set_starts_with_the_smaller_one():
    config = ViewsConfig(sampling="poisson")
    assert np.array_equal(sample_angles(config, 20, 5)[:8], sample_angles(config, 8, 5))


def smallest_gap(angles: np.ndarray, turn: bool = False) -> float:
    gaps = angles[:, None] - angles[None]
    if turn:
        gaps[..., 0] -= 360 * np.round(gaps[..., 0] / 360)
    distances = np.linalg.norm(gaps, axis=-1)
    return float(distances[~np.eye(len(angles), dtype=bool)].min())


def test_all_round_the_ends_of_the_range_are_neighbours():
    """The second of two angles stands opposite the first, wherever that is."""
    config = ViewsConfig(sampling="poisson", azimuth=180.0, elevation=0.0)
    assert min(smallest_gap(sample_angles(config, 2, seed), turn=True) for seed in range(12)) > 120


@pytest.mark.parametrize(("azimuth", "elevation"), [(12.0, 6.0), (180.0, 0.0)])
def test_poisson_angles_lie_farther_apart_than_random_ones(azimuth, elevation):
    config = ViewsConfig(sampling="poisson", azimuth=azimuth, elevation=elevation)
    turn = azimuth == 180
    spread, loose = [], []
    for seed in range(8):
        spread.append(smallest_gap(sample_angles(config, 16, seed), turn))
        generator = np.random.default_rng(seed)
        loose.append(smallest_gap(generator.uniform(-1, 1, (16, 2)) * [azimuth, elevation], turn))
    assert np.mean(spread) > 3 * np.mean(loose)


def drawn(n: int, count: int, pool: int, seed: int = 0) -> list[int]:
    """All views of the first n iterations, one after the other."""
    return [view for iteration in range(n) for view in draw_views(iteration, count, pool, seed)]


@pytest.mark.parametrize(("count", "pool"), [(1, 1), (1, 7), (3, 7), (7, 7), (9, 4), (5, 1)])
def test_every_passage_through_the_pool_shows_every_view_once(count, pool):
    assert len(draw_views(5, count, pool, 0)) == count
    turns = drawn(4 * pool, count, pool)
    passages = [sorted(turns[n : n + pool]) for n in range(0, len(turns), pool)]
    assert passages == [list(range(pool))] * (4 * count)


def test_how_many_views_an_iteration_takes_does_not_change_their_order():
    assert drawn(12, 1, 5) == drawn(4, 3, 5) == drawn(1, 12, 5)


def test_the_same_arguments_give_the_same_views_and_another_seed_others():
    far = 10**6
    assert draw_views(far, 3, 16, 4) == draw_views(far, 3, 16, 4)
    assert draw_views(far, 16, 16, 4) != draw_views(far, 16, 16, 5)
    assert drawn(10, 4, 16, seed=2**63 - 1) != drawn(10, 4, 16, seed=0)


def test_every_order_of_the_pool_occurs_so_no_view_has_a_fixed_neighbour():
    """Of three views, in 120 passages: each of the six orders about 20 times."""
    turns = drawn(120, 3, 3, seed=1)
    orders = Counter(tuple(turns[n : n + 3]) for n in range(0, len(turns), 3))
    assert len(orders) == 6 and min(orders.values()) >= 8


@pytest.mark.parametrize(("height", "width"), [(None, 90), (120, None), (40, 300)])
def test_a_fitted_view_holds_all_points_and_little_more(
    height: int | None, width: int | None
) -> None:
    points = np.random.default_rng(3).normal(size=(50, 3)) * [1, 2, 3] + 100
    view = frame_points(orbit_view(25.0, 10.0, "Y", np.zeros(3), 1, 1, 1.0), points, height, width)
    offset = points - view.centre
    x = (view.width - 1) / 2 + offset @ view.right / view.pixel_size
    y = (view.height - 1) / 2 - offset @ view.up / view.pixel_size
    for found, side in ((x, view.width), (y, view.height)):
        assert found.min() >= -0.5 and found.max() <= side - 0.5
        assert found.min() + found.max() == pytest.approx(side - 1)  # in the middle
    assert max(np.ptp(x) / view.width, np.ptp(y) / view.height) > 0.9
    assert (height or view.height, width or view.width) == (view.height, view.width)

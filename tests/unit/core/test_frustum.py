"""A camera's frustum: against brute force, closed forms, and for all kinds of cameras."""

import dataclasses

import numpy as np
import pytest

from usdsmoke.base.volume import CameraSource
from usdsmoke.core.views.cameras import view_of_camera
from usdsmoke.core.views.frustum import frustum_of, pixel_footprint

MARGIN = 0.05


def camera_at(parallel: bool = False, turned: bool = True) -> CameraSource:
    """Off-centre film of 30 x 20, somewhere in the room."""
    place = np.eye(4)
    if turned:
        place[:3, :3], _ = np.linalg.qr(np.random.default_rng(8).normal(size=(3, 3)))
        place[:3, :3] *= np.sign(np.linalg.det(place[:3, :3]))
        place[3, :3] = [3, -4, 5]
    return CameraSource("/camera", place, 45.0, 30.0, 20.0, 4.0, -3.0, (2.0, 9.0), parallel)


def brute_force(camera: CameraSource, points: np.ndarray) -> np.ndarray:
    """Which points a picture of the film shows between the clipping planes, by ``View``."""
    view = view_of_camera(camera, 200, 300)  # as the film: 30 x 20
    away = points - view.centre
    depth = away @ view.forward
    scale = 1 / view.pixel_size if view.focal is None else view.focal / depth
    x = 149.5 + view.shift[0] + scale * (away @ view.right)
    y = 99.5 + view.shift[1] - scale * (away @ view.up)
    if view.focal is None:
        depth = (points - camera.camera_to_stage[3, :3]) @ view.forward
    near, far = camera.clipping_range
    inside = (depth >= near) & (depth <= far) & (x >= -0.5) & (x <= 299.5)
    return inside & (y >= -0.5) & (y <= 199.5)


@pytest.mark.parametrize("parallel", [False, True])
def test_a_share_of_one_is_what_the_picture_shows(parallel):
    camera = camera_at(parallel)
    frustum = frustum_of(camera, 1e-9)
    points = np.random.default_rng(1).uniform(-12, 12, (200_000, 3)) + frustum.eye
    wanted = brute_force(camera, points)
    assert wanted.sum() > 100
    assert np.array_equal(frustum.shares(points) == 1, wanted)
    assert np.array_equal(frustum.shares(points) == 0, ~wanted)  # no border to speak of


@pytest.mark.parametrize("parallel", [False, True])
def test_the_border_falls_smoothly_from_one_to_zero_and_lies_outside(parallel):
    camera = camera_at(parallel, turned=False)
    frustum = frustum_of(camera, MARGIN)
    depth = 5.0
    width = 3.0 if parallel else 30 / 45 * depth
    edge = (0.4 + 1.5) if parallel else (4 + 15) / 45 * depth
    t = np.linspace(-0.5, 1.5, 40)  # 1 itself is not among them
    points = np.stack([edge + t * MARGIN * width, 0 * t, 0 * t - depth], 1)
    s = t.clip(0, 1)
    assert frustum.shares(points) == pytest.approx(1 - 3 * s**2 + 2 * s**3, abs=1e-9)
    distances = frustum.distances(points)
    assert np.all((distances < 0) == (t < 1))
    slant = 1.0 if parallel else np.hypot(1, 19 / 45 + MARGIN * 30 / 45)
    assert distances[-1] == pytest.approx(0.5 * MARGIN * width / slant)


@pytest.mark.parametrize("voxel", [0.0, 1.5])
@pytest.mark.parametrize("parallel", [False, True])
def test_where_a_distance_is_not_negative_the_share_is_zero(parallel, voxel):
    frustum = frustum_of(camera_at(parallel), 0.2, voxel)
    points = np.random.default_rng(2).uniform(-12, 12, (100_000, 3)) + frustum.eye
    outside = frustum.distances(points) >= 0
    assert 0.01 < outside.mean() < 0.999
    assert not frustum.shares(points)[outside].any()
    assert frustum.shares(points)[~outside].all()


def test_the_clipping_planes_cut_with_a_border():
    frustum = frustum_of(camera_at(turned=False), MARGIN)
    middle = np.array([4 / 45, -3 / 45, -1.0])
    border = MARGIN * 30 / 45
    depths = np.array([2 * (1 - border), 2.0, 9.0, 9 * (1 + border), 9 * (1 + border / 2)])
    assert frustum.shares(depths[:, None] * middle) == pytest.approx([0, 1, 1, 0, 0.5], abs=1e-9)


@pytest.mark.parametrize("parallel", [False, True])
def test_voxels_around_an_eye_in_the_smoke_are_seen(parallel):
    """Renderers interpolate between them: along all axes a border is at least two voxels wide."""
    camera = dataclasses.replace(camera_at(parallel, turned=False), clipping_range=(1e-6, 9.0))
    camera = dataclasses.replace(camera, horizontal_offset=0.0, vertical_offset=0.0)
    around = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), -1).reshape(-1, 3)
    frustum = frustum_of(camera, MARGIN, 1.0)
    assert frustum.shares(around).min() > 0.5
    assert frustum.distances(around).max() < 0
    assert not frustum.misses(around)
    assert not frustum.shares(np.array([[0, 0, 2.1], [0, 4.0, -0.1], [-4.0, 0, -0.1]])).any()
    wide = np.array([[0.0, 0.0, -8.0], [2.0, 1.0, -8.0], [3.0, 0.0, -8.5]])
    far = frustum_of(camera, 1.0)  # where its border is wider than that, nothing changes
    assert np.array_equal(frustum_of(camera, 1.0, 1.0).shares(wide), far.shares(wide))


def test_nothing_behind_a_pinhole_is_seen_whatever_its_clipping_range():
    camera = dataclasses.replace(camera_at(turned=False), clipping_range=(-10.0, 10.0))
    points = np.array([[0.0, 0, 1], [0, 0, 0], [0, 0, -1]])
    assert list(frustum_of(camera, MARGIN).shares(points)) == [0, 0, 1]
    parallel = dataclasses.replace(camera, is_orthographic=True)
    assert list(frustum_of(parallel, MARGIN).shares(points)) == [1, 1, 1]


@pytest.mark.parametrize("voxel", [0.0, 1.0])
@pytest.mark.parametrize("parallel", [False, True])
def test_a_body_that_surely_lies_outside_has_no_point_inside(parallel, voxel):
    frustum = frustum_of(camera_at(parallel), MARGIN, voxel)
    generator = np.random.default_rng(4)
    cube = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), -1).reshape(-1, 3)
    dense = generator.uniform(0, 1, (400, 3))
    missed = 0
    for _ in range(300):
        low, size = frustum.eye + generator.uniform(-9, 9, 3), generator.uniform(0.1, 4, 3)
        misses = frustum.misses(low + size * cube)
        missed += misses
        assert not (misses and frustum.shares(low + size * dense).any())
    assert 50 < missed < 300


def test_a_pixel_covers_what_film_and_lens_give():
    camera = camera_at()
    assert pixel_footprint(camera, 90.0, 600) == pytest.approx(0.1)  # 60 wide at 90
    parallel = dataclasses.replace(camera, is_orthographic=True)
    assert pixel_footprint(parallel, 90.0, 600) == pytest.approx(0.005)  # 3 wide everywhere


@pytest.mark.parametrize("parallel", [False, True])
def test_without_a_far_plane_smoke_is_seen_as_with_one_far_away(parallel):
    camera = camera_at(parallel)
    points = np.random.default_rng(1).uniform(-12, 12, (10_000, 3)) + camera.camera_to_stage[3, :3]
    ends = [frustum_of(dataclasses.replace(camera, clipping_range=(2.0, far)), MARGIN)
            for far in (1e6, np.inf)]  # fmt: skip
    shares = [frustum.shares(points) for frustum in ends]
    assert (shares[0] > 0).sum() > 30
    assert np.array_equal(*shares)
    assert not ends[1].misses(points)

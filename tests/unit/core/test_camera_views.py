"""From where a camera's frames are looked at, how large, and what is measured on what it sees."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch

from tests.fixtures.camera_fixtures import DENSITY, FRAME, MIDDLE, N, looking, seen_by
from tests.fixtures.smoke_fixtures import affine, frame_of, puff, smoke_of
from tests.fixtures.stylize_fixtures import quick_config, scene_of
from usdsmoke.base.volume import CameraSource
from usdsmoke.core.views.cameras import orbit_view
from usdsmoke.core.views.frustum import frustum_of
from usdsmoke.core.views.scene import crop_view, frame_views
from usdsmoke.core.views.visibility import Visibility


@pytest.mark.parametrize("matrix", [np.eye(4), affine(3), affine(5, mirrored=True)])
def test_a_cropped_view_holds_every_voxel_and_not_a_pixel_more(matrix):
    smoke = smoke_of(DENSITY, matrix)
    smoke = smoke.take(smoke.ijk.sum(1) < 40)  # a diagonal cut
    ijk = smoke.ijk.numpy()
    low, high = ijk.min(0) - 0.5, ijk.max(0) + 0.5
    for azimuth in (0.0, 30.0, 77.0):
        view = crop_view(orbit_view(azimuth, 20.0, "Y", np.zeros(3), 1, 1, 0.5), smoke, 0)
        axes = np.stack([view.right, view.up], 1)
        offsets = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), -1).reshape(-1, 1, 3)
        corners = (ijk[None] + offsets).reshape(-1, 3) @ matrix[:3, :3] + matrix[3, :3]
        seen = (corners - view.centre) @ axes / view.pixel_size
        assert seen.max(0) == pytest.approx(-seen.min(0))
        assert np.array_equal(np.ceil(np.ptp(seen, axis=0) - 1e-6), [view.width, view.height])
    assert np.all(high - low > 5)


def views_from(camera: CameraSource, **views: Any) -> list[Any]:
    config = quick_config(views={"pool": 6, **views})
    scene = dataclasses.replace(scene_of([FRAME], config, "Y"), camera=camera)
    seen = Visibility(frustum_of(camera, config.views.camera_margin), 0.0)
    smoke = seen.visible(smoke_of(DENSITY))
    return frame_views(smoke, config.views, scene, seed=3)


def test_views_lie_around_the_cameras_direction_within_the_ranges():
    camera = looking(np.add(MIDDLE, [70, 30, -20]), MIDDLE, roll_up=(0.3, 1, 0))
    towards = -np.array([70, 30, -20]) / np.linalg.norm([70, 30, -20])
    (straight,) = views_from(camera, pool=1, azimuth=0.0, elevation=0.0)
    assert straight.forward == pytest.approx(towards, abs=1e-3)  # the puff's mass has lumps
    assert straight.right == pytest.approx(camera.camera_to_stage[0, :3], abs=2e-3)
    views = views_from(camera, azimuth=12.0, elevation=6.0)
    off = [float(np.degrees(np.arccos(view.forward @ straight.forward))) for view in views]
    assert max(off) < np.hypot(12, 6) + 1e-6 and np.mean(off) > 3
    for view in views:
        axes = np.stack([view.right, view.up, view.forward])
        assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.cross(view.right, view.forward) == pytest.approx(view.up, abs=1e-12)


def test_a_camera_that_goes_around_changes_its_views_smoothly():
    """A degree and a half a frame, the smoke half out of the picture: no view jumps."""
    before = None
    for angle in np.radians(np.arange(0.0, 90.0, 1.5)):
        eye = MIDDLE + 50 * np.array([np.sin(angle), 0.2, np.cos(angle)])
        camera = dataclasses.replace(looking(eye, MIDDLE, film=24.0), horizontal_offset=12.0)
        views = views_from(camera)
        if before is not None:
            turns = [
                float(np.degrees(np.arccos(min(1.0, a.forward @ b.forward))))
                for a, b in zip(views, before, strict=True)
            ]
            assert 0.5 < min(turns) and max(turns) < 2.5
            assert all(
                a.up @ b.up > np.cos(np.radians(2.5)) for a, b in zip(views, before, strict=True)
            )
        before = views


def test_no_pixel_is_finer_than_the_cameras_at_the_nearest_smoke_it_sees():
    config = quick_config(views={"image_size": 512, "camera_width": 100})
    density = puff(4 * N)
    middle = np.full(3, 2 * N - 0.5)
    camera = looking(np.add(middle, [0, 0, 500]), middle)
    seen = seen_by(camera, frame_of(density))
    nearest = 500 - (np.argwhere(density > 0)[:, 2].max() - middle[2])
    assert scene_of([seen], config, "Y").pixel_size == np.ceil(nearest / 100) == 5.0
    assert scene_of([frame_of(density)], config, "Y").pixel_size == 1.0
    wide = quick_config(views={"image_size": 512, "camera_width": 8192})
    assert scene_of([seen], wide, "Y").pixel_size == 1.0


def test_extinction_is_measured_on_what_the_camera_sees():
    """Two puffs, one ten times as thick, which only the second camera sees."""
    density = np.concatenate([DENSITY, np.zeros_like(DENSITY), 10 * DENSITY])
    frame = frame_of(density)
    thin, thick = (
        scene_of(
            [seen_by(looking([x, 11.5, 300.0], [x, 11.5, 0.0], 3.6), frame)], quick_config(), "Y"
        )
        for x in (11.5, 2 * N + 11.5)
    )
    assert thin.gamma_w == pytest.approx(10 * thick.gamma_w, rel=1e-3)
    assert thin.pixel_size == thick.pixel_size
    nowhere = scene_of([seen_by(looking([0, 0, -9], [0, 0, -99]), frame)], quick_config(), "Y")
    assert torch.isfinite(torch.tensor(nowhere.gamma_w)) and nowhere.gamma_w != 1.0

"""What a frame with a camera becomes: only what is seen is worked on, and the rest stays."""

import dataclasses

import numpy as np
import pytest

from tests.fixtures.camera_fixtures import DENSITY, FRAME, MIDDLE, N, looking, seen_by
from tests.fixtures.counters import Elements
from tests.fixtures.smoke_fixtures import frame_of, masked, puff, smoke_of
from tests.fixtures.stylize_fixtures import MOST_LIGHT, by_voxel, quick_config, run_core, scene_of
from usdsmoke.base.volume import CameraSource, VolumeFrame
from usdsmoke.core.sequence.coarse import coarse_frames
from usdsmoke.core.sequence.stylize import StylizedFrame
from usdsmoke.core.views.frustum import frustum_of
from usdsmoke.core.views.visibility import sight_of


def half_camera(distance: float = 60.0) -> CameraSource:
    """In front, its picture's left edge through the middle of the smoke."""
    camera = looking(np.add(MIDDLE, [0, 0, distance]), MIDDLE, film=24.0)
    return dataclasses.replace(camera, horizontal_offset=12.0)


def shares(camera: CameraSource, frame: VolumeFrame = FRAME) -> dict[tuple[int, ...], float]:
    """The frustum's share by voxel of the smoke."""
    margin = quick_config().views.camera_margin
    index = np.argwhere(frame.density.values > 0)
    found = frustum_of(camera, margin, 1.0).shares(index.astype(float))
    return {tuple(i): float(s) for i, s in zip(index.tolist(), found, strict=True)}


@pytest.fixture(scope="module")
def half() -> StylizedFrame:
    config = quick_config(shape={"learning_rate": 1.0, "reach": 0.1})
    return run_core([seen_by(half_camera())], config)[0]


def assert_bitwise(one: StylizedFrame, other: StylizedFrame) -> None:
    assert by_voxel(one.density) == by_voxel(other.density)
    assert by_voxel(one.emission) == by_voxel(other.emission)


def test_a_parallel_camera_in_front_that_sees_all_changes_no_bit():
    """The same views, nothing left out; from the very front, where box and voxels end together."""
    config = quick_config(views={"pool": 1, "azimuth": 0.0, "elevation": 0.0})
    camera = looking(np.add(MIDDLE, [0, 0, 500]), MIDDLE, film=10.0 * 4 * N, parallel=True)
    result = run_core([seen_by(camera)], config)[0]
    assert_bitwise(result, run_core([FRAME], config)[0])
    assert result.report.voxels_outside_camera is None


def test_outside_the_frustum_the_source_stays_bit_for_bit_and_has_no_colour(half):
    share = shares(half_camera())
    found, emission, source = (
        by_voxel(field) for field in (half.density, half.emission, FRAME.density)
    )
    outside = [voxel for voxel, s in share.items() if s == 0]
    inside = [voxel for voxel, s in share.items() if s == 1]
    assert len(outside) > 0.3 * len(share) and len(inside) > 0.3 * len(share)
    assert all(found[voxel] == source[voxel] for voxel in outside)
    assert not any(voxel in emission for voxel in outside)
    changed = sum(found.get(voxel) != source[voxel] for voxel in inside)
    assert changed > 0.5 * len(inside)
    assert sum(voxel in emission for voxel in inside) > 0.9 * len(inside)
    assert half.report.voxels_outside_camera == len(outside)
    assert half.report.voxels == len(share)


def test_nothing_grows_outside_where_there_was_no_smoke(half):
    camera, source = half_camera(), by_voxel(FRAME.density)
    new = np.array([voxel for voxel in by_voxel(half.density) if voxel not in source], float)
    assert len(new) and frustum_of(camera, 0.05, 1.0).shares(new).all()


def test_mass_is_kept_among_what_is_seen(half):
    assert half.density.values.sum() == pytest.approx(DENSITY.sum(), rel=1e-5)


def test_colours_end_softly_at_the_border(half):
    """At full strength emission over extinction is at most MOST_LIGHT, at a share s at most s
    times that."""
    share, density = shares(half_camera()), by_voxel(half.density)
    scene = scene_of([seen_by(half_camera())], quick_config(), "Y")
    for voxel, light in by_voxel(half.emission).items():
        if voxel in share:
            limit = MOST_LIGHT * share[voxel] * scene.gamma_w * density[voxel][0]
            assert max(light) <= limit * (1 + 1e-5)


def iterations_of(step: str, frame: VolumeFrame) -> tuple[int, int]:
    """Elements that two iterations of a step make, and those of them that convolutions make."""
    works = []
    for number in (2, 4):
        views = {"pool": 2, "image_size": 32, "camera": "/camera"}
        settings = {step: {"iterations": [number]}, "views": views}
        config = quick_config(optimize={"steps": [step]}, **settings)
        with Elements(views=False) as work:
            run_core([frame], config)
        works.append(work)
    few, more = works
    return more.made - few.made, more.convolved - few.convolved


@pytest.mark.parametrize("step", ["shape", "colour"])
def test_less_voxels_and_pixels_are_worked_on(step):
    frame = frame_of(puff(2 * N))
    middle = np.full(3, N - 0.5)
    straight = looking(np.add(middle, [0, 0, 120]), middle, film=24.0)
    beside = dataclasses.replace(straight, horizontal_offset=12.0)
    whole, part = (iterations_of(step, seen_by(camera, frame)) for camera in (straight, beside))
    assert part[0] < 0.8 * whole[0] and part[1] < 0.8 * whole[1], (part, whole)


def test_a_frame_wholly_outside_is_left_out_and_stays_as_it_is():
    behind = looking(np.add(MIDDLE, [0, 0, 60]), np.add(MIDDLE, [0, 0, 120]))
    result = run_core([seen_by(behind)])[0]
    assert result.report.left_out == "outside the camera's frustum"
    assert by_voxel(result.density) == by_voxel(FRAME.density)
    assert not result.emission.values.any()


@pytest.mark.parametrize("depth", [0.0, 6.0])
def test_a_camera_in_the_smoke_sees_colours_and_the_report_tells_how_close_it_is(depth):
    """In the middle, and where it touches the smoke: the voxels around it are painted."""
    eye = np.add(MIDDLE, [0, 0, depth])
    camera = dataclasses.replace(looking(eye, np.add(eye, [0, 0, -30])), clipping_range=(0.01, 1e4))
    result = run_core([seen_by(camera)])[0]
    emission = by_voxel(result.emission)
    around = [tuple(v) for v in np.argwhere(DENSITY > 0) if np.abs(v - eye).max() < 1]
    assert len(around) == 8
    assert all(max(emission.get(voxel, (0.0,))) > 0 for voxel in around)
    assert result.report.sight.close > 0.95


def test_a_camera_before_the_smoke_has_nothing_in_its_way(half):
    assert half.report.sight.close == half.report.sight.clipped == 0


@pytest.mark.parametrize("parallel", [False, True])
def test_smoke_before_the_near_clipping_plane_is_counted(parallel):
    eye = np.add(MIDDLE, [0, 0, 40])
    camera = looking(eye, MIDDLE, film=400.0 if parallel else 72.0, parallel=parallel)
    for near in (40.2, 38.2):
        cut = dataclasses.replace(camera, clipping_range=(near, 1e4))
        k = np.arange(N)[None, None, :]
        wanted = (DENSITY * (eye[2] - k < near)).sum() / DENSITY.sum()
        found = sight_of(smoke_of(DENSITY), cut, 1.0)
        assert 0.1 < wanted < 0.9 and found.clipped == pytest.approx(wanted, rel=1e-4)


def test_a_frame_beyond_the_clipping_planes_is_left_out_and_says_so():
    camera = looking(np.add(MIDDLE, [0, 0, 60]), MIDDLE)
    for clip in ((200.0, 1e4), (0.1, 20.0)):
        result = run_core([seen_by(dataclasses.replace(camera, clipping_range=clip))])[0]
        assert "clipping planes" in result.report.left_out


def test_a_camera_and_a_mask_multiply():
    ramp = np.broadcast_to(np.linspace(0, 1, N)[None, :, None], DENSITY.shape)
    both = run_core([seen_by(half_camera(), masked(ramp, FRAME))])[0]
    share, source = shares(half_camera()), by_voxel(FRAME.density)
    found, emission = by_voxel(both.density), by_voxel(both.emission)
    still = [voxel for voxel, s in share.items() if s * ramp[voxel] == 0]
    assert len(still) > len(share) / 3
    assert all(found[voxel] == source[voxel] and voxel not in emission for voxel in still)
    elsewhere = masked(np.broadcast_to(np.arange(N) < 8, (N, N, N)).swapaxes(0, 2), FRAME)
    away = run_core([seen_by(half_camera(), elsewhere)])[0]
    assert {"mask", "camera"} <= set(away.report.left_out.split())


@pytest.mark.parametrize("edge", [-6.0, -4.0, -2.0, 0.0, 3.0, 8.0])
def test_every_sliver_in_sight_gives_finite_smoke(edge):
    """The picture's edge wanders over the smoke's own, corner first."""
    turned = np.array([1.0, 1.0, 1.0]) / np.sqrt(3)
    camera = looking(MIDDLE + 60 * np.array([0, 0, 1.0]), MIDDLE, film=10.0, parallel=True)
    place = camera.camera_to_stage.copy()
    place[3, :3] += turned * (N / 2 + edge)
    camera = dataclasses.replace(camera, camera_to_stage=place, horizontal_aperture=30.0)
    result = run_core([seen_by(camera)])[0]
    assert np.isfinite(result.density.values).all() and np.isfinite(result.emission.values).all()


def test_a_window_under_a_panning_camera_follows_and_keeps_what_is_outside():
    """The coarse step too; smoke comes into the picture, goes out of it, and is out of it."""
    config = quick_config(windows={"size": 4, "shared_octaves": 1})
    frames = []
    for number, turn in enumerate((0.0, 0.1, 0.2, 1.5)):
        eye = np.add(MIDDLE, [0, 0, 60])
        at = eye + 60 * np.array([np.sin(turn + 0.15), 0, -np.cos(turn + 0.15)])
        camera = looking(eye, at, film=14.0)
        frames.append(seen_by(camera, frame_of(DENSITY, 1.0 + number, np.array([1.0, 0, 0]))))
    scene = scene_of(frames, config, "Y")
    style = np.random.default_rng(0).uniform(size=(24, 24, 3)).astype(np.float32)
    starts = {start.time_code: start for start in coarse_frames(frames, [style], scene, config)}
    assert starts[4.0].colours is None and starts[1.0].colours is not None
    for result, frame in zip(run_core(frames, config, scene), frames, strict=True):
        found, source = by_voxel(result.density), by_voxel(frame.density)
        share = shares(frame.camera, frame)
        outside = [voxel for voxel, s in share.items() if s == 0]
        assert outside and all(found[voxel] == source[voxel] for voxel in outside)
        assert bool(result.report.left_out) == (not any(share.values()))


@pytest.mark.parametrize(
    "camera",
    [
        looking(MIDDLE, np.add(MIDDLE, [0, 0, -1])),  # the eye in the midst of the smoke
        looking(np.add(MIDDLE, [0, 0, 3]), MIDDLE, film=2000.0),
        looking(np.add(MIDDLE, [0, 0, 60]), MIDDLE, film=0.5),
        dataclasses.replace(
            looking(np.add(MIDDLE, [0, 0, 1e12]), MIDDLE), clipping_range=(1.0, 1e20)
        ),
        dataclasses.replace(looking(np.add(MIDDLE, [0, 0, 6]), MIDDLE), clipping_range=(-60, 1e30)),
        dataclasses.replace(looking(np.add(MIDDLE, [0, 0, 60]), MIDDLE), clipping_range=(60, 61)),
    ],
    ids=["inside", "wide", "narrow", "far", "behind", "thin"],
)
def test_extreme_cameras_give_finite_smoke_and_sixteen_pixels_at_least(camera):
    scene = scene_of([seen_by(camera)], quick_config(), "Y")
    assert scene.image_size >= 16
    result = run_core([seen_by(camera)], scene=scene)[0]
    assert np.isfinite(result.density.values).all() and np.isfinite(result.emission.values).all()
    assert result.emission.values.any()

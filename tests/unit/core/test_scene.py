"""What is measured on a shot, and the views of its frames."""

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import affine, frame_of, puff, smoke_of
from tests.fixtures.stylize_fixtures import scene_of
from usdsmoke.base.errors import ConfigError
from usdsmoke.config.look_sections import OpticsConfig, ViewsConfig
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.schedule import pool_size
from usdsmoke.core.views.cameras import View, orbit_view
from usdsmoke.core.views.project import column_map
from usdsmoke.core.views.scene import Scene, face_view, fit_view, frame_views, measure_scene

DENSITY = puff(12)


def thick_column(density: np.ndarray, index_to_world: np.ndarray, config: Config) -> float:
    """The configured percentile of the columns, seen along -Z at a voxel a pixel."""
    smoke = smoke_of(density, index_to_world)
    view = fit_view(orbit_view(0, 0, "Y", np.zeros(3), 1, 1, smoke.voxel_size), smoke)
    image = column_map(smoke.positions, smoke.edges, view)
    columns = image.apply(smoke.density[:, None]).numpy()
    seen = columns[columns > 1e-3 * columns.max()]
    return float(np.percentile(seen, config.optics.percentile))


def test_an_unset_gamma_gives_the_thick_columns_their_optical_depth():
    config = resolve_config({"optics": {"depth": 3.0, "depth_shape": 0.7, "thicken": 1}})
    scene = scene_of([frame_of(DENSITY)], config, "Y")
    thick = thick_column(DENSITY, np.eye(4), config)
    assert scene.gamma_w * thick == pytest.approx(3.0, rel=1e-5)
    assert scene.gamma_w_shape * thick == pytest.approx(0.7, rel=1e-5)


@pytest.mark.parametrize(
    "matrix", [np.eye(4), np.diag([0.1, 0.2, 0.4, 1.0]), np.diag([-1.0, 1, 2, 1]), affine(1)],
    ids=["cubes", "bricks", "mirrored", "turned"],
)  # fmt: skip
def test_columns_are_those_of_the_optimisers_projection(matrix: np.ndarray) -> None:
    config = resolve_config({"optics": {"depth": 3.0, "thicken": 1}})
    scene = scene_of([frame_of(DENSITY, index_to_world=matrix)], config, "Y")
    smoke = smoke_of(DENSITY, matrix)
    pixel = max(scene.pixel_size, smoke.voxel_size)
    view = fit_view(orbit_view(0, 0, "Y", np.zeros(3), 1, 1, pixel), smoke)
    image = column_map(smoke.positions, smoke.edges, view, torch.float64)
    columns = image.apply(smoke.density.double()[:, None]).numpy()
    columns = np.sort(columns[columns > 0])
    dense = columns[int(0.95 * (len(columns) - 1))]
    thick = np.percentile(columns[columns > 1e-3 * dense], config.optics.percentile)
    assert scene.gamma_w * thick == pytest.approx(3.0, rel=1e-12)


def test_a_set_gamma_is_per_voxel_and_becomes_per_length():
    matrix = np.diag([0.1, 0.2, 0.4, 1.0])
    config = resolve_config({"optics": {"gamma": 0.5, "gamma_shape": 0.1}})
    scene = scene_of([frame_of(DENSITY, index_to_world=matrix)], config, "Y")
    assert scene.reference_voxel_size == pytest.approx(0.2)
    assert scene.gamma_w == pytest.approx(2.5) and scene.gamma_w_shape == pytest.approx(0.5)


@pytest.mark.parametrize("gamma", [1e-9, 1e-3, 0.1])
def test_a_gamma_that_leaves_thick_columns_faint_is_exposed_to_seven_tenths(gamma):
    config = resolve_config({"optics": {"gamma": gamma, "gamma_shape": 0.5 * gamma, "thicken": 1}})
    scene = scene_of([frame_of(DENSITY)], config, "Y")
    thick = thick_column(DENSITY, np.eye(4), config)
    for gamma_w, exposure in (
        (scene.gamma_w, scene.exposure),
        (scene.gamma_w_shape, scene.exposure_shape),
    ):
        assert exposure * -np.expm1(-gamma_w * thick) == pytest.approx(0.7, rel=1e-5)
    assert 0.3 < scene.grey_mean < 0.8 and scene.grey_deviation > 0.05


@pytest.mark.parametrize("depths", [{}, {"depth": 1.21, "depth_shape": 100.0}])
def test_smoke_that_is_thick_enough_is_not_exposed_at_all(depths):
    scene = scene_of([frame_of(DENSITY)], resolve_config({"optics": depths}), "Y")
    assert scene.exposure == 1.0 and scene.exposure_shape == 1.0


def test_an_optical_depth_of_a_millionth_millionth_is_measured_without_overflow():
    config = resolve_config({"optics": {"depth": 1e-12, "depth_shape": 1e-300}})
    scene = scene_of([frame_of(DENSITY)], config, "Y")
    assert scene.exposure == pytest.approx(7e11, rel=1e-3)
    assert scene.exposure_shape == pytest.approx(7e11, rel=1e-3)  # and no brighter than that
    numbers = [scene.gamma_w, scene.gamma_w_shape, scene.grey_mean, scene.grey_deviation]
    assert np.isfinite(numbers).all()


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("amount", [1e-30, 1.0, 1e30])
def test_units_of_length_and_density_drop_out_of_the_pictures(unit, amount):
    plain = scene_of([frame_of(DENSITY)], Config(), "Y")
    matrix = np.diag([unit, unit, unit, 1.0])
    scene = scene_of([frame_of(DENSITY * amount, index_to_world=matrix)], Config(), "Y")
    assert scene.gamma_w * unit * amount == pytest.approx(plain.gamma_w, rel=1e-4)
    assert scene.pixel_size == pytest.approx(plain.pixel_size * unit)
    assert scene.image_size == plain.image_size
    assert scene.grey_mean == pytest.approx(plain.grey_mean, abs=1e-4)
    assert scene.grey_deviation == pytest.approx(plain.grey_deviation, abs=1e-4)


def test_emptiness_around_the_smoke_changes_nothing():
    padded = np.pad(DENSITY, ((9, 2), (0, 3), (4, 4)))
    frames = [frame_of(DENSITY), frame_of(padded, ijk_min=(-9, 0, -4))]
    scenes = [scene_of([frame], Config(), "Z") for frame in frames]
    assert scenes[0] == scenes[1]


def test_empty_frames_are_passed_over():
    empty = frame_of(np.zeros((0, 0, 0)))
    full = frame_of(DENSITY)
    assert scene_of([empty, full, empty], Config(), "Y") == scene_of([full], Config(), "Y")


@pytest.mark.parametrize("frames", [[], [frame_of(np.zeros((4, 4, 4)))]])
def test_nothing_but_emptiness_gives_harmless_numbers(frames):
    scene = scene_of(frames, Config(), "Y")
    assert isinstance(scene, Scene)
    assert scene.gamma_w > 0 and scene.pixel_size > 0 and scene.image_size >= 1


def test_one_voxel_can_be_measured():
    scene = scene_of([frame_of(np.ones((1, 1, 1)))], Config(), "Y")
    assert np.isfinite([scene.gamma_w, scene.gamma_w_shape, scene.grey_mean]).all()
    assert scene.gamma_w > 0 and scene.image_size >= 1


@pytest.mark.parametrize("image_size", [16, 40, 200])
@pytest.mark.parametrize("refine", [1, 3])
def test_pixels_are_whole_voxels_and_the_picture_has_about_the_size_asked_for(image_size, refine):
    config = resolve_config({"views": {"image_size": image_size}, "grids": {"refine": refine}})
    density = np.ones((90, 20, 20), np.float32)
    scene = scene_of([frame_of(density)], config, "Y")
    voxels = scene.pixel_size * refine
    assert voxels == pytest.approx(max(1, round(voxels)))
    finest = 90 * refine
    assert scene.image_size == pytest.approx(min(image_size, finest), rel=0.5)


def assert_holds(view: View, positions: np.ndarray, margin: float) -> None:
    x = (view.width - 1) / 2 + (positions - view.centre) @ view.right / view.pixel_size
    y = (view.height - 1) / 2 - (positions - view.centre) @ view.up / view.pixel_size
    assert x.min() >= margin and x.max() <= view.width - 1 - margin
    assert y.min() >= margin and y.max() <= view.height - 1 - margin
    assert x.min() < margin + 3 and y.min() < margin + 3  # and not much more room than that


def test_smoke_that_is_long_in_depth_has_pictures_of_the_size_asked_for_from_the_side():
    long = np.diag([1.0, 1.0, 1000.0, 1.0])
    views = ViewsConfig(image_size=64, pool=8)
    scene = measure_scene([frame_of(puff(8), index_to_world=long)], views, OpticsConfig(), "Y")
    pool = frame_views(smoke_of(puff(8), long), views, scene, 0)
    longest = max(max(view.height, view.width) for view in pool)
    assert 32 < longest < 96


@pytest.mark.parametrize("factor", [1, 2])
@pytest.mark.parametrize("up_axis", ["Y", "Z"])
def test_every_view_of_the_pool_just_holds_the_smoke(up_axis, factor):
    smoke = smoke_of(np.ones((12, 7, 9)), affine(1))
    config = Config(views=ViewsConfig(pool=7, azimuth=180, elevation=60))
    scene = Scene(1.0, 1.0, 0.9, up_axis, 1.0, 20)
    views = frame_views(smoke, config.views, scene, 3, factor)
    assert len(views) == 7
    assert len({view.azimuth for view in views}) == 7
    for view in views:
        assert view.pixel_size == pytest.approx(0.9 * factor)
        assert_holds(view, smoke.positions.numpy(), margin=1.5)


@pytest.mark.parametrize(("axis", "up_axis"), [(2, "Y"), (0, "Y"), (1, "Z"), (0, "Z")])
def test_a_slab_is_seen_face_on_with_its_rows_in_the_picture_s_columns(axis, up_axis):
    """An upright slab: world up is up in the picture, and every voxel is one pixel."""
    values = np.arange(1.0, 31.0, dtype=np.float32).reshape(5, 6)
    smoke = smoke_of(np.expand_dims(values, axis))
    assert smoke.thin_axis == axis
    view = face_view(smoke, up_axis, 1.0)
    image = column_map(smoke.positions, smoke.edges, view)
    picture = image.apply(smoke.density[:, None])[2:-2, 2:-2, 0].numpy()
    up = 1 if up_axis == "Y" else 2
    first = min({0, 1, 2} - {axis})  # of the axes of ``values``
    wanted = values.T[::-1] if first != up else values[::-1]
    assert picture == pytest.approx(wanted, rel=1e-5)


def test_a_lying_slab_is_seen_face_on_too():
    smoke = smoke_of(np.ones((5, 1, 7)))
    view = face_view(smoke, "Y", 1.0)
    assert abs(view.forward) == pytest.approx([0, 1, 0])
    axes = np.stack([view.right, view.up, view.forward])
    assert axes @ axes.T == pytest.approx(np.eye(3))
    columns = column_map(smoke.positions, np.eye(3), view).apply(smoke.density[:, None])
    assert float(columns.sum()) == pytest.approx(35.0) and float(columns.max()) <= 1.0 + 1e-6


def test_a_slab_has_one_view_whatever_is_asked_for():
    smoke = smoke_of(np.ones((5, 6, 1)))
    config = Config(views=ViewsConfig(pool=24))
    assert len(frame_views(smoke, config.views, Scene(1, 1, 1, "Y", 1, 6), 0)) == 1


@pytest.mark.parametrize("shape", [(5, 6, 1), (5, 6, 4)])
@pytest.mark.parametrize("views", [{}, {"pool": 3, "count": 9}, {"azimuth": 0, "elevation": 0}])
def test_there_are_as_many_views_as_the_plan_says(shape, views):
    smoke, config = smoke_of(np.ones(shape)), ViewsConfig(**views)
    found = frame_views(smoke, config, Scene(1, 1, 1, "Y", 1, 6), 0)
    assert len(found) == pool_size(config, 1 in shape)


def test_face_view_of_a_volume_is_a_programming_error():
    with pytest.raises(ValueError, match="voxel thick"):
        face_view(smoke_of(np.ones((2, 2, 2))), "Y", 1.0)


def test_a_slab_s_extinction_counts_its_thickness():
    """Two slabs with equal column integrals look alike, whatever their voxels' depth."""
    config = Config(optics=OpticsConfig(depth=2.0))
    flat = np.random.default_rng(0).random((8, 8, 1)).astype(np.float32) + 0.5
    scenes = [
        scene_of([frame_of(flat / deep, index_to_world=np.diag([1, 1, deep, 1.0]))], config, "Y")
        for deep in (1.0, 10.0)
    ]
    assert scenes[0].pixel_size == scenes[1].pixel_size == pytest.approx(1.0)
    assert scenes[0].gamma_w == pytest.approx(scenes[1].gamma_w)


def test_the_share_of_columns_that_gamma_rests_on_tells_a_core_from_its_wisps() -> None:
    even = puff(16)
    core = np.full((40, 4, 40), 1e-5, np.float32)
    core[14:26, :, 14:26] = np.random.default_rng(0).uniform(0.5, 1.0, (12, 4, 12))
    i, _, k = np.indices(core.shape) - 19.5
    core[i**2 + k**2 > 20**2] = 0  # what fills its box is a floor
    seen = Config().views.replace(elevation=0, azimuth=0, centre_elevation=90)
    shares = [
        measure_scene([frame_of(density)], seen, Config().optics, "Y").thick_share
        for density in (even, core)
    ]
    assert shares[0] > 0.05 and shares[1] < 0.02


@pytest.mark.parametrize(("shape", "refine", "most"), [((5, 6, 4), 2, 960), ((5, 6, 1), 3, 270)])
def test_the_largest_frame_is_counted_in_refined_voxels(shape, refine, most):
    frames = [frame_of(np.ones(shape)), frame_of(np.ones((2, 2, 2)))]
    for order in (frames, frames[::-1]):
        scene = measure_scene(order, ViewsConfig(), OpticsConfig(), "Y", refine)
        assert scene.most_voxels == most and scene.refine == refine
    nothing = measure_scene([frame_of(np.zeros(shape))], ViewsConfig(), OpticsConfig(), "Y", refine)
    assert nothing.refine == refine
    assert scene_of([frame_of(np.ones((8, 8, 8)))], Config()).coarser(2).most_voxels == 4**3


@pytest.mark.parametrize(
    "optics",
    [OpticsConfig(gamma=1e30), OpticsConfig(gamma_shape=1e30), OpticsConfig(knee=1e-300)],
)
def test_extinctions_beyond_32_bits_are_refused_with_their_number(optics: OpticsConfig) -> None:
    tiny = frame_of(puff(8), index_to_world=np.diag([1e-12, 1e-12, 1e-12, 1.0]))
    with pytest.raises(ConfigError, match=r"e\+\d+"):
        measure_scene([tiny], ViewsConfig(), optics.replace(thicken=10.0), "Y")

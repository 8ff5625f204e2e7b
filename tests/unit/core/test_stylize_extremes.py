"""The stiff and extreme set: a sound result or one named error; never NaN, never silence."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import affine, frame_of, puff, random_style
from tests.fixtures.stylize_fixtures import MOST_LIGHT, by_voxel, quick_config, run_core, scene_of
from usdsmoke.base.errors import NonFiniteError, PlanError
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.sequence.stylize import StylizedFrame
from usdsmoke.core.smoke.thicken import Thickening

DENSITY = puff(10)
COLOUR_ONLY = {"optimize": {"steps": ["colour"], "threads": 1}}


def assert_sound(result: StylizedFrame, source: np.ndarray, gamma_w: float | None = None) -> None:
    """Finite, not empty, of the source's mass, no brighter than it may be."""
    density, emission = result.density.values.astype(float), result.emission.values.astype(float)
    assert np.isfinite(density).all() and np.isfinite(emission).all()
    assert density.min() >= 0 and emission.min() >= 0
    assert density.sum() == pytest.approx(np.clip(source.astype(float), 0, None).sum(), rel=1e-4)
    assert emission.any() or gamma_w == 0
    if gamma_w is not None:
        assert (emission <= MOST_LIGHT * gamma_w * density[..., None] * (1 + 1e-5)).all()
    for step in result.report.steps.values():
        assert np.isfinite(step.loss).all()


@pytest.mark.parametrize(
    "shape", [(1, 1, 1), (6, 1, 1), (1, 2, 1), (2, 2, 2), (1, 9, 8), (40, 2, 1)]
)
def test_few_voxels_in_any_arrangement(shape):
    density = np.random.default_rng(0).uniform(0.2, 1.0, shape)
    assert_sound(run_core([frame_of(density)])[0], density)


@pytest.mark.parametrize("amount", [1e-30, 1e-6, 1e6, 1e30])
def test_density_of_any_amount_looks_the_same(amount):
    """The extinction follows it, so the colours are those of ordinary smoke."""
    plain, scaled = (
        run_core([frame_of(DENSITY * np.float32(a))], quick_config(**COLOUR_ONLY))[0]
        for a in (1.0, amount)
    )
    assert_sound(scaled, DENSITY * np.float32(amount))
    assert scaled.emission.values == pytest.approx(plain.emission.values, abs=1e-2)


@pytest.mark.parametrize("amount", [1e-30, 1e30])
def test_density_of_any_amount_is_moved_like_ordinary_smoke(amount):
    result = run_core([frame_of(DENSITY * np.float32(amount))])[0]
    assert_sound(result, DENSITY * np.float32(amount))
    assert result.report.transport.largest_displacement > 0


@pytest.mark.parametrize("largest", [1e33, 2e38])
def test_densities_whose_sums_overflow_are_refused_by_name(largest):
    density = DENSITY * np.float32(largest / DENSITY.max())
    with pytest.raises(NonFiniteError, match=r"timeCode 3 .*1e\+32"):
        run_core([frame_of(density, 3.0)], scene=scene_of([frame_of(DENSITY, 3.0)], quick_config()))


def test_density_over_sixty_orders_of_magnitude():
    density = DENSITY * np.float32(10.0) ** np.random.default_rng(0).uniform(-30, 30, DENSITY.shape)
    assert_sound(run_core([frame_of(density)])[0], density)


def test_no_voxel_is_lost_behind_the_curve_that_thickens():
    """Also over sixty orders of magnitude, which ratios of 32 bits do not hold."""
    values = np.float32(10.0) ** np.arange(-37, 31, dtype=np.float32)
    for knee in (1e-30, 1.0, 1e20):
        found = Thickening(10.0, knee)(values)
        assert np.isfinite(found).all() and (found > 0).all() and (np.diff(found) >= 0).all()


def test_denormal_density_counts_as_none():
    result = run_core([frame_of(np.full((3, 3, 3), 1e-40))])[0]
    assert result.report.left_out == "empty frame"


def test_negative_density_counts_as_none_where_smoke_is_moved():
    density = DENSITY - 0.2 * (DENSITY == 0)
    result = run_core([frame_of(density)])[0]
    assert_sound(result, density)
    assert "negative" in result.report.warnings[0]


@pytest.mark.parametrize("beside", [0.5, 1e-4])
def test_densities_of_inactive_voxels_beside_the_box_are_told(beside: float) -> None:
    frame = frame_of(DENSITY)
    density = dataclasses.replace(frame.density, beside=beside)
    (result,) = run_core([dataclasses.replace(frame, density=density)])
    assert ["inactive" in text and "0.5" in text for text in result.report.warnings] == (
        [True] if beside == 0.5 else []
    )


def test_densities_that_are_too_faint_to_count_are_told():
    result = run_core([frame_of(DENSITY * np.float32(1e-39))])[0]
    assert result.report.left_out and "count as empty" in result.report.warnings[0]
    assert run_core([frame_of(0 * DENSITY)])[0].report.warnings == ()


@pytest.mark.parametrize("background", [0.5, -1.0])
def test_a_background_other_than_zero_fills_the_box_only(background):
    """Beyond the box nothing counts: smoke without end could not be drawn."""
    frame = frame_of(np.where(DENSITY > 0, DENSITY, np.float32(background)))
    field = dataclasses.replace(frame.density, background=background)
    result = run_core([dataclasses.replace(frame, density=field)])[0]
    assert_sound(result, frame.density.values)
    assert result.density.background == background


@pytest.mark.parametrize("gamma", [1e-12, 1e-3, 1.0, 1e6, 1e12])
def test_any_extinction(gamma):
    config = quick_config(optics={"gamma": gamma, "gamma_shape": gamma})
    frame = frame_of(DENSITY)
    scene = scene_of([frame], config, "Y")
    assert scene.gamma_w == pytest.approx(gamma)
    assert_sound(run_core([frame], config, scene)[0], DENSITY, gamma)


def test_no_extinction_gives_no_light_and_no_motion_but_a_finite_result():
    """The settings refuse it; a scene of one's own making can hold it."""
    frame = frame_of(DENSITY)
    scene = dataclasses.replace(
        scene_of([frame], quick_config(), "Y"), gamma_w=0.0, gamma_w_shape=0.0
    )
    result = run_core([frame], scene=scene)[0]
    assert_sound(result, DENSITY, gamma_w=0)
    assert not result.emission.values.any()


@pytest.mark.parametrize("voxel", [2.0**-20, 2.0**20])
def test_stages_in_microns_and_in_megametres_have_the_same_bits(voxel):
    """Powers of two, which round nothing: no length has an absolute bound."""
    matrix = np.diag([voxel, voxel, voxel, 1.0])
    plain = run_core([frame_of(DENSITY)])[0]
    scaled = run_core([frame_of(DENSITY, index_to_world=matrix)])[0]
    assert np.array_equal(scaled.density.values, plain.density.values)
    assert np.array_equal(scaled.emission.values * np.float32(voxel), plain.emission.values)


@pytest.mark.parametrize("voxel", [1e-6, 1e6])
def test_powers_of_ten_differ_by_round_off(voxel):
    """It decides which voxels count as faint in a view, and iterations let it grow."""
    matrix = np.diag([voxel, voxel, voxel, 1.0])
    plain = run_core([frame_of(DENSITY)])[0]
    scaled = run_core([frame_of(DENSITY, index_to_world=matrix)])[0]
    moved = np.abs(scaled.density.values - plain.density.values)
    assert moved.mean() < 1e-4 and moved.max() < 1e-2
    off = np.abs(scaled.emission.values * voxel - plain.emission.values)
    assert off.mean() < 1e-3 and off.max() < 0.1


def test_smoke_a_million_units_from_the_origin():
    matrix = np.eye(4)
    matrix[3, :3] = [1e6, -1e6, 3e6]
    near, far = (run_core([frame_of(DENSITY, index_to_world=m)])[0] for m in (np.eye(4), matrix))
    assert far.density.values == pytest.approx(near.density.values, abs=1e-4)
    assert far.emission.values == pytest.approx(near.emission.values, abs=1e-3)


def test_voxels_a_thousand_times_longer_than_wide():
    matrix = np.diag([1.0, 1.0, 1000.0, 1.0])
    assert_sound(run_core([frame_of(DENSITY, index_to_world=matrix)])[0], DENSITY)


def test_the_field_prim_s_place_counts_like_the_grid_s_own():
    matrix = affine(1, mirrored=True)
    inside = run_core([frame_of(DENSITY, index_to_world=matrix)])[0]
    placed = dataclasses.replace(frame_of(DENSITY), density_to_stage=matrix)
    outside = run_core([placed])[0]
    assert outside.density.values == pytest.approx(inside.density.values, abs=1e-6)
    assert outside.emission.values == pytest.approx(inside.emission.values, abs=1e-5)
    assert np.array_equal(outside.density.index_to_world, np.eye(4))


@pytest.mark.parametrize("up_axis", ["Y", "Z"])
def test_smoke_is_stylized_with_either_axis_up(up_axis):
    frame = frame_of(DENSITY)
    scene = scene_of([frame], quick_config(), up_axis)
    assert scene.up_axis == up_axis
    assert_sound(run_core([frame], scene=scene)[0], DENSITY)


def far_apart(n: int) -> VolumeFrame:
    density = np.zeros((n, 1, 1))
    density[0] = density[-1] = 1.0
    return frame_of(density)


def test_two_voxels_a_million_apart_are_painted():
    result = run_core([far_apart(1_000_000)], quick_config(**COLOUR_ONLY))[0]
    assert set(by_voxel(result.emission)) == {(0, 0, 0), (999_999, 0, 0)}


def test_two_voxels_a_million_apart_are_not_moved_but_refused_by_name():
    with pytest.raises(PlanError, match=r"optimize\.steps=\[colour\]"):
        run_core([far_apart(1_000_000)])


@pytest.mark.parametrize("cfl", [0.0, 0.3, 50.0])
def test_velocities_up_to_fifty_voxels_a_frame(cfl):
    velocity = 24.0 * cfl * np.array([1.0, -1.0, 0.5])
    for result in run_core([frame_of(DENSITY, k, velocity) for k in (1.0, 2.0)]):
        assert_sound(result, DENSITY)


def test_velocity_on_some_frames_only():
    moving = frame_of(DENSITY, 2.0, np.array([24.0, 0.0, 0.0]))
    for result in run_core([frame_of(DENSITY, 1.0), moving, frame_of(DENSITY, 3.0)]):
        assert_sound(result, DENSITY)


def test_velocity_in_a_box_that_does_not_meet_the_smoke():
    away = DenseField("velocity", np.ones((2, 2, 2, 3), np.float32), (500, 0, 0), np.eye(4))
    frames = [
        dataclasses.replace(frame_of(DENSITY, k), velocity=away, velocity_to_stage=np.eye(4))
        for k in (1.0, 2.0)
    ]
    assert_sound(run_core(frames)[1], DENSITY)


@pytest.mark.parametrize("time_codes", [(-3.0, -2.5, 0.0), (0.0, 100.0), (1.0,)])
def test_any_time_codes(time_codes):
    velocity = np.array([6.0, 0.0, 0.0])
    results = run_core([frame_of(DENSITY, t, velocity) for t in time_codes])
    assert tuple(result.time_code for result in results) == time_codes
    for result in results:
        assert_sound(result, DENSITY)


def test_a_grid_that_changes_place_and_voxel_size_from_frame_to_frame():
    """Smoke that stands still in space keeps its colours though its voxels are others."""
    config = quick_config(colour={"iterations": [0], "occlusion": 0.0}, **COLOUR_ONLY)
    finer = np.diag([0.5, 0.5, 0.5, 1.0])
    finer[3, :3] = -0.25
    first = frame_of(np.ones((6, 6, 6)), 1.0)
    second = frame_of(np.ones((12, 12, 12)), 2.0, index_to_world=finer)
    scene = scene_of([first], config, "Y")
    coarse, fine = (r.emission.values for r in run_core([first, second], config, scene))
    inside = fine[2:-2, 2:-2, 2:-2].reshape(4, 2, 4, 2, 4, 2, 3).mean(axis=(1, 3, 5))
    correlation = np.corrcoef(inside.ravel(), coarse[1:-1, 1:-1, 1:-1].ravel())[0, 1]
    assert correlation > 0.8


STYLES = {
    "one pixel": np.full((1, 1, 3), 0.6, np.float32),
    "one colour": np.full((16, 16, 3), 0.3, np.float32),
    "black": np.zeros((8, 8, 3), np.float32),
    "white": np.ones((8, 8, 3), np.float32),
    "grey": np.repeat(random_style()[..., :1], 3, axis=-1),
    "narrow": random_style(1, 200),
}


@pytest.mark.parametrize("name", STYLES)
def test_any_style_image(name):
    config = quick_config(features={"layers": []})
    assert_sound_or_black(run_core([frame_of(DENSITY)], config, styles=[STYLES[name]])[0])


def assert_sound_or_black(result: StylizedFrame) -> None:
    assert np.isfinite(result.density.values).all() and np.isfinite(result.emission.values).all()


@pytest.mark.parametrize(
    "sections",
    [
        {"losses": {"style": 1e12}},
        {"losses": {"style": 1e-12}},
        {"losses": {"keep": 1e12}},
        {"losses": {"keep": 0.0, "total_variation": 1e12}},
        {"features": {"layers": ["oriented1", "learned1"], "weights": [0.0, 1e12]}},
    ],
)
def test_loss_weights_of_any_size(sections):
    assert_sound(run_core([frame_of(DENSITY)], quick_config(**sections))[0], DENSITY)


@pytest.mark.parametrize("step", ["shape", "colour"])
def test_a_learning_rate_a_hundred_times_too_large_ends_no_worse_than_it_began(step):
    rate = {"shape": 8.5, "colour": 6.0}[step]
    config = quick_config(
        optimize={"steps": [step], "threads": 1, "tolerance": 0.0},
        views={"pool": 1},  # whose losses can be compared
        # blended hues at the end have less contrast than the noise at the start
        losses={"local_contrast": 0.0},
        **{step: {"learning_rate": rate, "iterations": [40]}},
    )
    told: list[Any] = []
    result = run_core([frame_of(DENSITY)], config, watch=told)[0]
    assert np.isfinite(result.density.values).all()
    assert result.report.steps[step].loss[0] <= 1.05 * told[0].loss


def test_features_that_overflow_are_a_named_error(monkeypatch):
    def infinite(picture: torch.Tensor, wanted: frozenset[str]) -> dict[str, torch.Tensor]:
        maps = picture.permute(2, 0, 1)[None]
        return {name: maps * (1 + 1e38) * 1e38 for name in wanted}

    monkeypatch.setattr(
        "usdsmoke.core.steps.targets.build_network", lambda *_: lambda style: infinite
    )
    with pytest.raises(NonFiniteError, match="extreme values"):
        run_core([frame_of(DENSITY)], quick_config(**COLOUR_ONLY))

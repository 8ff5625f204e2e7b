"""Thin smoke made more opaque: the curve, what it keeps, and where it acts."""

import numpy as np
import pytest

from tests.fixtures.smoke_fixtures import frame_of, masked, puff
from tests.fixtures.stylize_fixtures import by_voxel, quick_config, run_core, scene_of
from usdsmoke.base.errors import ConfigError
from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.thicken import Thickening, find_thickening

COLOUR = {"optimize": {"steps": ["colour"], "threads": 1}}


def thin_and_thick() -> np.ndarray:
    """A ball, and a veil around it that is a thousand times thinner."""
    ball = puff(16)
    return np.where(ball > 0.3, ball, np.where(ball > 0, 1e-3 * ball, 0)).astype(np.float32)


DENSITY = thin_and_thick()
FRAME = frame_of(DENSITY)


def config_of(thicken: float, **sections: object) -> Config:
    return quick_config(**{**COLOUR, **sections, "optics": {"thicken": thicken}})


def unset() -> Config:
    return quick_config(**COLOUR, optics={"thicken": None})


def columns(density: np.ndarray, source: np.ndarray = DENSITY) -> np.ndarray:
    """Along k, where the source has smoke beyond its fringe."""
    found = source.astype(float).sum(2)
    return density.astype(float).sum(2)[found > 1e-3 * np.percentile(found[found > 0], 95)]


def test_the_curve_has_its_slope_at_nothing_and_a_logarithm_far_above_the_knee():
    curve = Thickening(10.0, 0.1)
    faint = np.array([1e-9, 1e-6])
    np.testing.assert_allclose(curve(faint), 10 * faint, rtol=1e-5)
    np.testing.assert_allclose(curve(np.array([0.1])), 10 * 0.1 * np.log(2))
    high = curve(np.array([1e3, 1e4, 1e5]))
    np.testing.assert_allclose(np.diff(high), 10 * 0.1 * np.log(10), rtol=1e-3)


def test_the_curve_keeps_order_type_and_what_is_no_smoke():
    curve, values = Thickening(30.0, 0.01), np.float32([-2.0, 0.0, 1e-30, 1e-3, 1.0, 1e6])
    found = curve(values)
    assert found.dtype == np.float32 and (np.diff(found) > 0).all()
    assert found[:2].tolist() == [-2.0, 0.0]


@pytest.mark.parametrize("unit", [1e-20, 1.0, 1e20])
@pytest.mark.parametrize("times", [1.5, 10.0, 1000.0])
def test_the_knee_is_found_for_any_unit_of_density(unit: float, times: float) -> None:
    values = unit * np.geomspace(1e-6, 1, 100)
    wanted = float(values.sum())
    curve = find_thickening(times, unit, lambda curve: float(curve(values).sum()), wanted)
    assert curve is not None and curve.times == times
    assert float(curve(values).sum()) == pytest.approx(wanted, rel=2e-3)


@pytest.mark.parametrize("end", [0.8, 1.25])
def test_a_knee_where_the_search_begins_is_found(end: float) -> None:
    curve = find_thickening(2.0, 1.0, lambda curve: curve.knee, end)
    assert curve is not None and curve.knee == pytest.approx(end)


def test_even_smoke_stays_as_it_is():
    values = np.full(10, 0.5)
    curve = find_thickening(10.0, 0.5, lambda curve: float(curve(values).sum()), 5.0)
    np.testing.assert_allclose(curve(values), values, rtol=2e-3)


def test_there_is_nothing_to_find_without_smoke():
    assert find_thickening(10.0, 0.0, lambda curve: 0.0, 0.0) is None


def test_thick_columns_keep_what_they_have_and_thin_ones_gain():
    plain, thick = (scene_of([FRAME], config_of(times)) for times in (1.0, 10.0))
    assert plain.thickening is None and thick.thickening is not None
    assert thick.gamma_w == pytest.approx(plain.gamma_w, rel=5e-3)
    found = thick.thickening(DENSITY)
    percentile = np.percentile(columns(found), 90)
    assert percentile == pytest.approx(np.percentile(columns(DENSITY), 90), rel=5e-4)
    veil = (DENSITY > 0) & (DENSITY < 1e-3)
    assert veil.sum() > 100
    assert (found[veil] > 8 * DENSITY[veil]).all() and (found[veil] <= 10 * DENSITY[veil]).all()


def test_unset_smoke_that_is_thick_in_most_columns_is_left_as_it_is():
    ball = (puff(16) > 0.2).astype(np.float32)
    assert scene_of([frame_of(ball)], unset()).thickening is None


@pytest.mark.parametrize("thinner", [0.03, 0.01, 2e-3])
def test_unset_thin_smoke_is_thickened_as_far_as_it_needs_or_ten_times(thinner: float) -> None:
    """Two slabs beside each other: a thick one, and one that is so much thinner."""
    density = np.ones((16, 16, 8), np.float32)
    density[:8] = thinner
    share = np.percentile(columns(density, density), 25) / np.percentile(
        columns(density, density), 90
    )
    curve = scene_of([frame_of(density)], unset()).thickening
    assert share < 0.13 and curve is not None
    found = curve(density)
    reached = np.percentile(columns(found, density), 25) / np.percentile(
        columns(found, density), 90
    )
    assert curve.times == pytest.approx(10) if reached < 0.13 else 1 < curve.times < 10
    if curve.times < 10:
        less = scene_of([frame_of(density)], config_of(0.8 * curve.times)).thickening
        assert less is not None and reached >= 0.13
        fewer = less(density)
        assert np.percentile(columns(fewer, density), 25) < 0.13 * np.percentile(
            columns(fewer, density), 90
        )


def test_a_knee_of_ones_own_is_taken_and_the_extinction_follows_it():
    config = quick_config(**COLOUR, optics={"thicken": 10.0, "knee": 0.5})
    scene = scene_of([FRAME], config)
    curve = scene.thickening
    assert curve == Thickening(10.0, 0.5)
    depth = scene.gamma_w * np.percentile(columns(curve(DENSITY)), 90)
    assert depth == pytest.approx(config.optics.depth, rel=5e-3)


def test_the_scene_is_the_same_in_any_unit_of_density():
    one, other = (scene_of([frame_of(unit * DENSITY)], config_of(10.0)) for unit in (1, 1e6))
    assert other.knee == pytest.approx(1e6 * one.knee, rel=1e-3)
    assert 1e6 * other.gamma_w == pytest.approx(one.gamma_w, rel=1e-3)


def test_what_is_written_is_the_thickened_density():
    config = config_of(10.0)
    result = run_core([FRAME], config)[0]
    curve = scene_of([FRAME], config).thickening
    assert curve is not None
    assert by_voxel(result.density) == by_voxel(frame_of(curve(DENSITY)).density)


def test_density_stays_bit_for_bit_for_times_one():
    result = run_core([FRAME], config_of(1.0))[0]
    assert by_voxel(result.density) == by_voxel(FRAME.density)


def test_density_stays_bit_for_bit_without_strength():
    config = quick_config(optimize={"strength": 0.0, "threads": 1}, optics={"thicken": 10.0})
    assert by_voxel(run_core([FRAME], config)[0].density) == by_voxel(FRAME.density)


def test_strength_and_mask_scale_the_gain():
    """A mask of 0 in one half and 1 in the other; then half the strength everywhere."""
    config = config_of(10.0)
    curve = scene_of([FRAME], config).thickening
    assert curve is not None
    gain = curve(DENSITY) - DENSITY
    ramp = np.broadcast_to((np.arange(16) > 7)[:, None, None], DENSITY.shape).astype(np.float32)
    half = quick_config(
        optimize={"steps": ["colour"], "threads": 1, "strength": 0.5}, optics={"thicken": 10.0}
    )
    found = (
        run_core([masked(ramp, FRAME)], config)[0].density,
        run_core([FRAME], half)[0].density,
    )
    for share, field in zip((ramp, 0.5), found, strict=True):
        wanted = DENSITY + share * gain
        values = by_voxel(field)
        for voxel in np.argwhere(DENSITY > 0):
            at = tuple(int(n) for n in voxel)
            assert values[at] == pytest.approx((float(wanted[at]),), rel=1e-6)


def test_all_frames_have_one_curve():
    """A frame with half the smoke is thickened by the shot's curve, not by one of its own."""
    later = frame_of(0.5 * DENSITY, time_code=2.0)
    config = config_of(10.0)
    results = run_core([FRAME, later], config)
    curve = scene_of([FRAME, later], config).thickening
    assert curve is not None
    assert by_voxel(results[1].density) == by_voxel(frame_of(curve(0.5 * DENSITY)).density)


def test_moving_keeps_the_mass_of_thickened_smoke():
    config = quick_config(
        optimize={"steps": ["shape"], "threads": 1}, shape={"iterations": [4]},
        optics={"thicken": 10.0},
    )  # fmt: skip
    result = run_core([FRAME], config)[0]
    curve = scene_of([FRAME], config).thickening
    assert curve is not None
    before, after = curve(DENSITY).astype(float).sum(), result.density.values.astype(float).sum()
    assert after == pytest.approx(before, rel=1e-5)
    assert before > 1.01 * DENSITY.astype(float).sum()


def test_a_veil_that_only_a_curve_makes_visible_does_not_count():
    """The columns that count are those of the source, so the thick ones keep their depth."""
    ball = np.exp(-((np.indices((32, 32, 32)) - 15.5) ** 2).sum(0) / 30).astype(np.float32)
    density = np.maximum(ball, 1e-6)
    plain, thick = (scene_of([frame_of(density)], config_of(times)) for times in (1.0, 10.0))
    assert thick.gamma_w == pytest.approx(plain.gamma_w, rel=1e-3)


def test_a_floor_is_not_thickened():
    density = np.maximum(puff(24), 0.01).astype(np.float32)
    curve = scene_of([frame_of(density)], config_of(10.0)).thickening
    assert curve is not None
    found = curve.of_field(frame_of(density).density).values
    assert (found[density == np.float32(0.01)] == np.float32(0.01)).all()
    smoke = (density > 0.011) & (density < 0.03)
    assert (found[smoke] > 1.5 * density[smoke]).all()


@pytest.mark.parametrize("dense", [1e8, 1e30])
def test_a_mask_of_one_keeps_a_voxel_that_is_far_denser_than_its_thickened_density(dense: float):
    density = DENSITY.copy()
    density[8, 8, 8] = dense
    frame, config = frame_of(density), config_of(10.0)
    curve = scene_of([frame], config).thickening
    assert curve is not None
    result = run_core([masked(np.ones((1, 1, 1)), frame, background=1.0)], config)[0]
    wanted = float(curve.of_frame(frame).density.values[8, 8, 8])
    assert by_voxel(result.density)[8, 8, 8][0] == pytest.approx(wanted, rel=1e-6)


def test_half_floats_are_checked_against_the_thickened_density():
    config = quick_config(**COLOUR, optics={"thicken": 30.0, "knee": 1e6}, grids={"half": True})
    with pytest.raises(ConfigError, match="16-bit"):
        run_core([frame_of(2600 * DENSITY)], config)

"""One frame through both steps, on tiny smoke."""

import dataclasses

import numpy as np
import pytest

from tests.fixtures.counters import Elements
from tests.fixtures.smoke_fixtures import affine, frame_of, puff
from tests.fixtures.stylize_fixtures import (
    MOST_LIGHT,
    by_voxel,
    quick_config,
    run_core,
    scene_of,
)
from usdsmoke.base.errors import FeatureError, NonFiniteError
from usdsmoke.base.frame_report import FrameReport, Progress
from usdsmoke.base.volume import FrameControls, VolumeFrame
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.core.sequence.stylize import StylizedFrame
from usdsmoke.core.views.scene import Scene

DENSITY = puff(12)
FRAME = frame_of(DENSITY)
SHAPE = {"optimize": {"steps": ["shape"], "threads": 1}}
COLOUR = {"optimize": {"steps": ["colour"], "threads": 1}}


@pytest.fixture(scope="module")
def stylized() -> StylizedFrame:
    return run_core([FRAME])[0]


def mass(values: np.ndarray) -> float:
    return float(values.astype(float).sum())


def test_both_steps_change_something_and_say_what_they_did(stylized):
    assert stylized.time_code == 1.0
    assert stylized.emission is not None
    assert by_voxel(stylized.density) != by_voxel(FRAME.density)
    assert stylized.report.voxels == np.count_nonzero(DENSITY)
    for step in ("shape", "colour"):
        report = stylized.report.steps[step]
        assert report.iterations == (2, 2) and report.ended == ("iterations",) * 2
        assert report.rollbacks == 0 and report.seconds > 0
        assert np.isfinite(report.loss).all()
    moved = stylized.report.transport
    assert moved.largest_displacement > 0 and None not in (
        moved.mass_error,
        moved.linear_difference,
    )


@pytest.mark.parametrize("step", ["shape", "colour"])
def test_the_loss_falls(step):
    config = quick_config(
        shape={"iterations": [30]}, colour={"iterations": [30]}, views={"pool": 1},
        optimize={"steps": [step], "threads": 1},
    )  # fmt: skip
    told: list[Progress] = []
    run_core([FRAME], config, watch=told)
    assert [record.iteration for record in told] == list(range(30))
    assert {record.step for record in told} == {step}
    assert told[-1].loss < 0.95 * told[0].loss


def test_the_same_run_gives_the_same_bits(stylized):
    again = run_core([FRAME])[0]
    assert np.array_equal(again.density.values, stylized.density.values)
    assert np.array_equal(again.emission.values, stylized.emission.values)


def test_another_seed_gives_another_result(stylized):
    other = run_core([FRAME], quick_config(optimize={"seed": 1, "threads": 1}))[0]
    assert not np.array_equal(other.emission.values, stylized.emission.values)


def test_three_threads_give_the_same_bits_as_one(stylized):
    other = run_core([FRAME], quick_config(optimize={"threads": 3}))[0]
    assert np.array_equal(other.density.values, stylized.density.values)
    assert np.array_equal(other.emission.values, stylized.emission.values)


@pytest.mark.parametrize(
    ("sections", "reason"),
    [
        ({"optimize": {"strength": 0.0, "threads": 1}}, "optimize.strength is 0"),
        ({"losses": {"style": 0.0}}, "losses.style is 0"),
    ],
)
def test_no_strength_or_no_style_gives_the_source_back_and_asks_for_no_features(sections, reason):
    config = quick_config(**sections)
    result = run_without_work(FRAME, config, scene_of([FRAME], config))
    assert result.density is FRAME.density
    assert result.emission.values.shape == (*DENSITY.shape, 3) and not result.emission.values.any()
    assert result.report.left_out == reason


def run_without_work(frame: VolumeFrame, config: Config, scene: Scene) -> StylizedFrame:
    """One frame whose run convolves no picture and computes next to nothing."""
    with Elements() as full:
        run_core([FRAME])
    with Elements() as work:
        (result,) = run_core([frame], config, scene)
    assert work.convolved == 0 < full.convolved
    assert work.made < 1e-3 * full.made
    return result


@pytest.mark.parametrize("values", [np.zeros((0, 0, 0)), np.zeros((4, 4, 4)), -np.ones((2, 2, 2))])
def test_an_empty_frame_is_passed_through_without_renderer_or_network(values):
    frame = frame_of(values)
    scene = scene_of([FRAME], quick_config(), "Y")
    result = run_without_work(frame, quick_config(), scene)
    assert result.density is frame.density
    assert result.emission.values.shape == (*values.shape, 3)
    told = dataclasses.replace(result.report, warnings=())  # of what is negative
    assert told == FrameReport(left_out="empty frame", extinction=scene.gamma_w)


def test_a_window_of_empty_frames_reads_no_vgg19_and_smoke_without_the_file_is_refused():
    config = quick_config(features={"network": "vgg19", "layers": [], "vgg19_file": "/nowhere.pth"})
    scene = Scene(1.0, 1.0, 1.0, "Y", 1.0, 16)
    assert len(run_core([frame_of(np.zeros((2, 2, 2)))] * 2, config, scene)) == 2
    with pytest.raises(FeatureError, match=r"no VGG-19 weights at /nowhere\.pth"):
        run_core([FRAME], config, scene)


def test_without_a_colour_step_there_is_no_emission():
    assert run_core([FRAME], quick_config(**SHAPE))[0].emission is None
    empty = run_core([frame_of(np.zeros((2, 2, 2)))], quick_config(**SHAPE))[0]
    assert empty.emission is None


def test_without_a_shape_step_the_density_is_the_source_s_own():
    result = run_core([FRAME], quick_config(**COLOUR))[0]
    assert result.density is FRAME.density
    assert result.report.to_json().keys() == {
        "voxels", "extinction", "depth", "depth_by_side", "colour", "look"
    }  # fmt: skip


def test_emission_is_colour_times_extinction_and_zero_where_no_smoke_is(stylized):
    scene = scene_of([FRAME], quick_config(), "Y")
    emission, density = stylized.emission, stylized.density
    assert emission.values.shape == (*density.values.shape, 3)
    assert emission.ijk_min == density.ijk_min
    assert np.array_equal(emission.index_to_world, density.index_to_world)
    assert not emission.values[density.values <= 0].any()
    assert (emission.values >= 0).all()
    most = MOST_LIGHT * scene.gamma_w * density.values[..., None] * (1 + 1e-5)
    assert (emission.values <= most).all() and emission.values.any()


def test_strength_scales_the_light():
    full, half = (
        run_core(
            [FRAME], quick_config(optimize={"steps": ["colour"], "strength": s, "threads": 1})
        )[0].emission.values
        for s in (1.0, 0.5)
    )
    assert half == pytest.approx(0.5 * full, rel=1e-5)


@pytest.mark.parametrize("displacement", ["stream", "potential", "mixed"])
@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_smoke_moves_less_than_its_reach_and_keeps_its_mass(displacement, interpolation):
    config = quick_config(
        shape={
            "displacement": displacement,
            "interpolation": interpolation,
            "reach": 0.1,
            "learning_rate": 0.1,
            "iterations": [0, 4],
        },
        losses={"statistic": "gram"},  # steps so long would be taken back, as no descent
        **SHAPE,
    )
    result = run_core([FRAME], config)[0]
    low, high = (f(np.argwhere(DENSITY > 0), axis=0) for f in (np.min, np.max))
    cap = 0.1 * (high - low + 1).max()
    report = result.report.transport
    assert report.cap == pytest.approx(cap)
    assert 0.3 * cap < report.largest_displacement <= cap * (1 + 1e-6)
    assert mass(result.density.values) == pytest.approx(mass(DENSITY), rel=1e-5)
    assert (result.density.values >= 0).all()


def test_mass_is_left_as_transport_leaves_it_when_no_correction_is_asked_for():
    config = quick_config(
        shape={"mass_correction": False, "displacement": "potential", "learning_rate": 1.0}, **SHAPE
    )
    result = run_core([FRAME], config)[0]
    error = mass(result.density.values) / mass(DENSITY) - 1
    assert error == pytest.approx(result.report.transport.mass_error, abs=1e-5) and error != 0


def test_no_iterations_leave_the_density_in_place_and_the_colours_noise():
    config = quick_config(shape={"iterations": [0, 0]}, colour={"iterations": [0]})
    result = run_core([FRAME], config)[0]
    found, wanted = by_voxel(result.density), by_voxel(FRAME.density)
    assert found.keys() == wanted.keys()
    assert np.array(list(found.values())) == pytest.approx(np.array(list(wanted.values())))
    assert result.report.shape.iterations == ()
    light = np.array(list(by_voxel(result.emission).values()))
    assert 0.2 < (light / np.array(list(wanted.values()))).std() / light.mean()


def test_emptiness_around_the_smoke_changes_nothing():
    padded = frame_of(np.pad(DENSITY, ((5, 3), (0, 4), (2, 2))), ijk_min=(-5, 0, -2))
    results = [run_core([frame])[0] for frame in (FRAME, padded)]
    for name in ("density", "emission"):
        one, other = (by_voxel(getattr(result, name)) for result in results)
        assert one.keys() == other.keys()
        assert all(other[voxel] == pytest.approx(one[voxel], rel=1e-5) for voxel in one)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_slab_stays_one_voxel_thick_and_is_seen_from_one_side(axis):
    rng = np.random.default_rng(0)
    flat = np.expand_dims(rng.uniform(0.5, 1.0, (12, 14)), axis)
    config = quick_config(shape={"iterations": [3, 3], "reach": 0.1})
    result = run_core([frame_of(flat)], config)[0]
    assert result.density.values.shape[axis] == 1 and result.emission.values.shape[axis] == 1
    assert mass(result.density.values) == pytest.approx(mass(flat), rel=1e-5)
    moved = by_voxel(result.density)
    assert (
        max(abs(value[0] - flat[voxel]) for voxel, value in moved.items() if voxel in moved) > 1e-3
    )
    assert result.emission.values.any()


def test_refinement_gives_finer_voxels_of_the_same_smoke():
    config = quick_config(
        grids={"refine": 2}, shape={"iterations": [0]}, colour={"iterations": [0]}
    )
    result = run_core([FRAME], config)[0]
    assert np.linalg.det(result.density.index_to_world) == pytest.approx(1 / 8)
    assert mass(result.density.values) / 8 == pytest.approx(mass(DENSITY), rel=1e-4)
    assert result.emission.values.shape == (*result.density.values.shape, 3)


def test_frames_without_an_effect_keep_the_voxels_of_the_source():
    config = quick_config(grids={"refine": 2}, optimize={"threads": 1, "iterations": 2})
    unseen = dataclasses.replace(FRAME, controls=FrameControls(strength=0.0))
    before, seen, behind = run_core(
        [unseen, dataclasses.replace(FRAME, time_code=2.0),
         dataclasses.replace(unseen, time_code=3.0)], config
    )  # fmt: skip
    assert before.density is unseen.density and behind.density is unseen.density
    assert before.emission.values.shape == (*DENSITY.shape, 3) and not before.emission.values.any()
    assert seen.density.values.size > 4 * DENSITY.size
    (whole,) = run_core([FRAME], quick_config(optimize={"threads": 1, "iterations": 2}))
    assert before.report.voxels == whole.report.voxels < seen.report.voxels


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_density_that_is_not_finite_is_refused_by_time_code_and_name(bad):
    spoiled = DENSITY.copy()
    spoiled[6, 6, 6] = bad
    with pytest.raises(NonFiniteError, match=r'1.*"density" at timeCode 7 .*grids\.repair_nan'):
        run_core([frame_of(spoiled, 7.0)], scene=Scene(1.0, 1.0, 1.0, "Y", 1.0, 16))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_velocity_that_is_not_finite_is_refused_by_time_code_and_name(bad):
    frame = frame_of(DENSITY, 2.5, np.array([0.0, bad, 0.0]))
    with pytest.raises(NonFiniteError, match=r'grid "velocity" at timeCode 2\.5'):
        run_core([frame], scene=Scene(1.0, 1.0, 1.0, "Y", 1.0, 16))


@pytest.mark.parametrize(("seed", "mirrored"), [(0, False), (2, True)])
def test_turned_sheared_and_mirrored_grids_keep_their_transform(seed, mirrored):
    matrix = affine(seed, mirrored)
    result = run_core([frame_of(DENSITY, index_to_world=matrix)])[0]
    assert np.array_equal(result.density.index_to_world, matrix)
    assert np.isfinite(result.emission.values).all() and result.emission.values.any()
    assert mass(result.density.values) == pytest.approx(mass(DENSITY), rel=1e-5)


def test_defaults_run_on_tiny_smoke():
    """Nothing in the default settings needs more than a handful of voxels."""
    config = resolve_config({"optimize": {"iterations": 3, "threads": 1}})
    assert run_core([frame_of(puff(8))], config)[0].emission.values.any()

"""Frames whose smoke comes from where there was none: nothing is carried, compared or averaged."""

import dataclasses

import numpy as np
import pytest

from tests.fixtures.smoke_fixtures import frame_of, puff
from tests.fixtures.stylize_fixtures import by_voxel, quick_config, run_core, scene_of
from usdsmoke.base.volume import DenseField, VolumeFrame

CONFIG = quick_config(shape={"iterations": [2, 3]}, colour={"iterations": [2, 3]})


def pair(voxels_a_frame: float) -> list[VolumeFrame]:
    """Two equal frames; the velocity says that smoke comes from so many voxels away."""
    velocity = np.array([24.0 * voxels_a_frame, 0.0, 0.0])
    return [frame_of(puff(12), time_code=float(code), velocity=velocity) for code in (1, 2)]


def test_a_velocity_that_is_too_fast_to_be_followed_is_told_with_its_voxels():
    second = run_core(pair(2000.0), CONFIG)[1]
    assert not second.report.warnings  # nothing is carried, so no share of it can be told
    doubt = second.report.velocity_doubt
    assert "2000 voxels" in doubt and "starts anew" in doubt and "unit" in doubt
    assert second.report.temporal.colour is None


@pytest.mark.parametrize("steps", [["shape", "colour"], ["colour"]])
def test_a_frame_whose_smoke_comes_from_nowhere_starts_anew_and_warns(steps):
    config = quick_config(
        shape={"iterations": [2, 3]}, colour={"iterations": [2, 3]}, optimize={"steps": steps}
    )
    first, second = run_core(pair(200.0), config)
    assert not first.report.warnings
    (jump,), doubt = second.report.warnings, second.report.velocity_doubt
    assert "100%" in jump and "timeCode 2" in jump and "starts anew" in jump
    assert "without any" in doubt and "unit" in doubt
    assert all(step.iterations == (2, 3) for step in second.report.steps.values())
    assert second.report.temporal.colour is None
    assert second.report.temporal.displacement is None


def test_a_frame_before_unlike_smoke_is_as_if_it_were_alone():
    alone = run_core(pair(200.0)[:1], CONFIG)[0]
    first = run_core(pair(200.0), CONFIG)[0]
    for name in ("density", "emission"):
        assert by_voxel(getattr(first, name)) == by_voxel(getattr(alone, name))


@pytest.mark.parametrize("voxels", [0.0, 1.0])
def test_smoke_that_hardly_moves_follows_the_frame_before(voxels):
    second = run_core(pair(voxels), CONFIG)[1]
    assert not any("anew" in text for text in second.report.warnings)
    assert len(second.report.colour.iterations) == 1
    assert 0 <= second.report.temporal.colour < 1
    assert 0 <= second.report.temporal.displacement < 1


def test_smoke_that_jumps_without_a_velocity_starts_anew_too():
    first, second = (frame_of(puff(12), time_code=float(code)) for code in (1, 2))
    far = dataclasses.replace(second.density, ijk_min=(40, 0, 0))
    results = run_core([first, dataclasses.replace(second, density=far)], CONFIG)
    assert "starts anew" in results[1].report.warnings[0]


def plume(seed: int, place: int = 0) -> VolumeFrame:
    """Smoke like no other: lumps at random places in the same box."""
    generator = np.random.default_rng(seed)
    places = np.stack(np.meshgrid(*[np.arange(20.0)] * 3, indexing="ij"), axis=-1)
    lumps = [np.exp(-(((places - generator.uniform(4, 16, 3)) / 3) ** 2).sum(-1)) for _ in range(5)]
    density = sum(lumps)
    return frame_of(np.where(density > 0.1, density, 0), time_code=float(place))


def test_a_jump_is_a_cut() -> None:
    """Two plumes that have nothing to do with each other wear no ghosts."""
    shot = [plume(0, 1), plume(0, 2), plume(7, 3), plume(7, 4)]
    scene = scene_of(shot, CONFIG)
    results = run_core(shot, CONFIG, scene)
    assert [len(frame.report.warnings) for frame in results] == [0, 0, 1, 0]
    assert "timeCode 3" in results[2].report.warnings[0]
    alone = run_core(shot[2:], CONFIG, scene)
    for found, wanted in zip(results[2:], alone, strict=True):
        for name in ("density", "emission"):
            assert by_voxel(getattr(found, name)) == by_voxel(getattr(wanted, name))


def drifting(number: int, factor: float = 1.0) -> VolumeFrame:
    """A plume that moves by two voxels a frame; its velocity says so, or is off by a factor."""
    frame = plume(1, number)
    speed = np.zeros((40, 24, 24, 3), np.float32)
    speed[..., 0] = 2 * 24.0 * factor
    field = DenseField("vel", speed, (-4, -2, -2), np.eye(4), (0.0, 0.0, 0.0))
    density = dataclasses.replace(frame.density, ijk_min=(2 * number, 0, 0))
    return dataclasses.replace(frame, density=density, velocity=field, velocity_to_stage=np.eye(4))


@pytest.mark.parametrize(
    ("factor", "cure"),
    [
        (1.0, ""),
        (1 / 24, "as if it were per frame"),
        (24.0, "with 0.0417 times of it. Check the program"),
        (-1.0, "against it"),
    ],
)
def test_a_velocity_that_does_not_explain_the_smoke_is_named(factor: float, cure: str) -> None:
    second = run_core([drifting(1, factor), drifting(2, factor)], CONFIG)[1]
    doubt = second.report.velocity_doubt
    assert bool(doubt) == bool(cure) and cure in doubt


@pytest.mark.parametrize(("factor", "cure"), [(1.0, ""), (-1.0, "against it")])
def test_a_dense_nozzle_at_rest_says_nothing_about_the_smoke_that_leaves_it(
    factor: float, cure: str
) -> None:
    """Ten times the mass of all other smoke, in a hundredth of the voxels."""
    frames = []
    for number in (1, 2):
        frame = drifting(number, factor)
        values = frame.density.values.copy()
        start = 10 - 2 * number
        values[start : start + 3, 9:12, 9:12] = 300.0
        density = dataclasses.replace(frame.density, values=values)
        frames.append(dataclasses.replace(frame, density=density))
    doubt = run_core(frames, CONFIG)[1].report.velocity_doubt
    assert bool(doubt) == bool(cure) and cure in doubt


def test_a_density_that_blinks_is_told_from_a_jump() -> None:
    dim, bright = drifting(1), drifting(2)
    density = dataclasses.replace(dim.density, values=dim.density.values / 12)
    second = run_core([dataclasses.replace(dim, density=density), bright], CONFIG)[1]
    (warning,) = second.report.warnings
    assert "jumps" in warning and "12 times that density" in warning


@pytest.mark.parametrize("goes_on", [True, False])
def test_a_velocity_that_ends_within_the_smoke_is_named(goes_on: bool) -> None:
    """Without a velocity in its lower part, the smoke moves on, or rests there."""
    frames = []
    wide = np.pad(plume(1, 1).density.values, ((4, 4), (0, 0), (0, 0)))
    for number in (1, 2):
        speed = np.zeros((*wide.shape, 3), np.float32)
        speed[:, 10:, :, 0] = 2 * 24.0
        density = np.roll(wide, 2 * number, axis=0)
        if not goes_on:
            density[:, :10] = wide[:, :10]
        field = DenseField("vel", speed, (0, 0, 0), np.eye(4), (0.0, 0.0, 0.0))
        frame = frame_of(density, time_code=float(number))
        frames.append(dataclasses.replace(frame, velocity=field, velocity_to_stage=np.eye(4)))
    doubt = run_core(frames, CONFIG)[1].report.velocity_doubt
    assert bool(doubt) == goes_on
    if goes_on:
        assert "velocity is 0 in" in doubt and "stage.motion=estimate" in doubt


def creeping(number: int, velocity: tuple[float, float, float]) -> VolumeFrame:
    """Smoke that moves by a third of a voxel a frame along i, with a velocity of its own.

    Args:
        velocity: voxels a frame.
    """
    generator = np.random.default_rng(1)
    places = np.stack(np.meshgrid(*[np.arange(20.0)] * 3, indexing="ij"), axis=-1)
    centres = generator.uniform(5, 15, (5, 3)) + np.array([number / 3, 0, 0])
    density = sum(np.exp(-(((places - centre) / 2) ** 2).sum(-1)) for centre in centres)
    frame = frame_of(np.where(density > 0.05, density, 0), time_code=float(number))
    speed = np.broadcast_to(24.0 * np.float32(velocity), (20, 20, 20, 3)).astype(np.float32)
    field = DenseField("vel", speed, (0, 0, 0), np.eye(4), (0.0, 0.0, 0.0))
    return dataclasses.replace(frame, velocity=field, velocity_to_stage=np.eye(4))


@pytest.mark.parametrize(
    ("velocity", "cure"),
    [
        ((1 / 3, 0.0, 0.0), ""),
        ((-1 / 3, 0.0, 0.0), "against it"),
        ((0.0, 1.0, 0.0), "without any"),
        ((1 / 72, 0.0, 0.0), "as if it were per frame"),
    ],
)
def test_a_wrong_velocity_of_slow_smoke_is_named(velocity, cure) -> None:
    second = run_core([creeping(1, velocity), creeping(2, velocity)], CONFIG)[1]
    doubt = second.report.velocity_doubt
    assert bool(doubt) == bool(cure) and cure in doubt


@pytest.mark.parametrize(
    ("factor", "cure"),
    [
        (0.0, "stage.motion=estimate"),
        (0.001, "stage.motion=estimate"),
        (0.3, "with 2 times of it"),
        (2.0, "with 0.5 times of it"),
    ],
)
def test_a_velocity_that_is_too_slow_for_its_smoke_is_named(factor: float, cure: str) -> None:
    second = run_core([drifting(1, factor), drifting(2, factor)], CONFIG)[1]
    assert cure in second.report.velocity_doubt


def test_an_empty_velocity_grid_is_a_velocity_of_0() -> None:
    """With the smoke moving in its Volume, which rests, and in one that is moved as well."""
    empty = DenseField("vel", np.zeros((0, 0, 0, 3), np.float32), (0, 0, 0), np.eye(4))
    moves, rides = [], []
    for number in (1, 2):
        frame = dataclasses.replace(drifting(number), velocity=empty)
        moves.append(frame)
        place = np.eye(4)
        place[3] = [-2.0 * number, 5.0 * number, 0, 1]
        rides.append(dataclasses.replace(frame, density_to_stage=place, velocity_to_stage=place))
    assert "stage.motion=estimate" in run_core(moves, CONFIG)[1].report.velocity_doubt
    assert "stage.motion=estimate" in run_core(rides, CONFIG)[1].report.velocity_doubt


@pytest.mark.parametrize("change", ["fades", "dissolves", "flickers"])
def test_smoke_that_changes_where_it_is_rests(change: str) -> None:
    noise = np.random.default_rng(3).normal(size=(20, 20, 20))
    changed = {
        "fades": lambda values: 0.7 * values,
        "dissolves": lambda values: np.clip(values - 0.1, 0, None),
        "flickers": lambda values: values * np.exp(0.3 * noise),
    }[change]
    first, second = drifting(1, 0.0), drifting(2, 0.0)
    density = dataclasses.replace(
        first.density, values=changed(first.density.values).astype(np.float32)
    )
    results = run_core([first, dataclasses.replace(second, density=density)], CONFIG)
    assert results[1].report.velocity_doubt == ""

"""Several frames of one window: what later ones take from earlier ones."""

from collections.abc import Iterator

import numpy as np
import pytest

from tests.fixtures.smoke_fixtures import frame_of, puff, random_style
from tests.fixtures.stylize_fixtures import by_voxel, quick_config, run_core, scene_of
from usdsmoke.base.frame_report import Progress
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.sequence.stylize import stylize_window

DENSITY = puff(12)
FRAME = frame_of(DENSITY)
SHAPE = {"optimize": {"steps": ["shape"], "threads": 1}}
COLOUR = {"optimize": {"steps": ["colour"], "threads": 1}}


def moving_frames(n: int, step: int, velocity: float | None) -> list[VolumeFrame]:
    """Smoke that moves by whole voxels along i from frame to frame, at 24 frames a second."""
    speed = None if velocity is None else np.array([velocity, 0.0, 0.0])
    return [frame_of(DENSITY, 1.0 + k, speed, ijk_min=(k * step, 0, 0)) for k in range(n)]


def test_colours_follow_the_velocity_from_frame_to_frame():
    config = quick_config(colour={"iterations": [0]}, **COLOUR)
    first, *later = run_core(moving_frames(3, 2, 48.0), config)
    for k, result in enumerate(later, start=1):
        assert result.emission.values == pytest.approx(first.emission.values, abs=1e-4), k
    *_, stuck = run_core(moving_frames(3, 2, None), config)
    assert np.abs(stuck.emission.values - first.emission.values).max() > 0.05


def difference(first: DenseField, other: DenseField, step: int) -> float:
    """Largest, where ``other`` is ``first`` moved by some voxels along i."""
    values, moved = by_voxel(first), by_voxel(other)
    voxels = values.keys() | {(i - step, j, k) for i, j, k in moved}
    return max(
        abs(values.get((i, j, k), (0.0,))[0] - moved.get((i + step, j, k), (0.0,))[0])
        for i, j, k in voxels
    )


def test_displacements_follow_the_velocity_from_frame_to_frame():
    """The one warm iteration changes little of what the neighbour's potential brings along."""
    config = quick_config(
        shape={"iterations": [24], "learning_rate": 0.1, "reach": 0.1, "warm_rate": 0.01},
        windows={"warm_iterations": 1e-9},
        **SHAPE,
    )
    first, followed = (result.density for result in run_core(moving_frames(2, 2, 48.0), config))
    _, stuck = (result.density for result in run_core(moving_frames(2, 2, None), config))
    assert difference(first, followed, 2) < 0.9 * difference(first, stuck, 2)


def test_later_frames_take_the_warm_share_of_the_finest_octave():
    iterations = {"iterations": [4, 10]}
    config = quick_config(colour=iterations, shape=iterations, windows={"warm_iterations": 0.3})
    cold, warm = run_core(moving_frames(2, 1, 24.0), config)
    for step in ("shape", "colour"):
        assert cold.report.steps[step].iterations == (4, 10)
        assert warm.report.steps[step].iterations == (3,)


def test_an_empty_frame_in_between_does_not_break_the_chain():
    """Time runs on: after two frames at one voxel a frame the smoke is two voxels further."""
    config = quick_config(colour={"iterations": [0]}, **COLOUR)
    frames = moving_frames(3, 1, 24.0)
    frames[1] = frame_of(np.zeros((3, 3, 3)), 2.0)
    first, empty, last = run_core(frames, config)
    assert empty.report.left_out == "empty frame"
    assert last.emission.values == pytest.approx(first.emission.values, abs=1e-4)


def test_progress_counts_over_octaves_and_frames():
    told: list[Progress] = []
    run_core([FRAME, frame_of(DENSITY, 2.0)], quick_config(**COLOUR), watch=told)
    cold, warm = [r for r in told if r.frame == 0], [r for r in told if r.frame == 1]
    assert [(r.octave, r.iteration) for r in cold] == [(0, 0), (0, 1), (1, 2), (1, 3)]
    assert [(r.octave, r.iteration, r.n_iterations) for r in warm] == [(1, 0, 2), (1, 1, 2)]
    assert {(r.n_frames, r.n_octaves) for r in told} == {(2, 2)}
    assert {r.time_code for r in warm} == {2.0}


@pytest.mark.parametrize(("steps", "ahead"), [(["colour"], 1), (["shape", "colour"], 2)])
def test_frames_are_taken_one_at_a_time(steps: list[str], ahead: int):
    """However long the window: each step waits for one frame more, to average with it."""
    pulled: list[float] = []

    def frames() -> Iterator[VolumeFrame]:
        for k in range(1, 7):
            pulled.append(float(k))
            yield frame_of(DENSITY, float(k))

    config = quick_config(optimize={"steps": steps, "threads": 1})
    window = stylize_window(frames(), [random_style()], scene_of([FRAME], config, "Y"), config)
    for done in range(1, 4):
        next(window)
        assert len(pulled) == done + ahead

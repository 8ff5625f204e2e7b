"""Velocity estimated from two densities: known motions come back, and smoke lands where it was."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch

from usdsmoke.base.errors import NonFiniteError
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.sequence.motion import MotionOptions, estimate_velocity
from usdsmoke.core.sequence.transit import Transit

SECONDS = 1 / 24
Move = Callable[[np.ndarray], np.ndarray]


def lumps(points: np.ndarray, scale: float = 1.0, flat: bool = False) -> np.ndarray:
    """A ball of thirty blobs around the origin, about 20 units wide, at points [... 3]."""
    generator = np.random.default_rng(5)
    centres = generator.uniform(-1.0, 1.0, (250, 3))
    centres = 9.0 * scale * centres[(centres**2).sum(-1) < 1][:30]
    widths, heights = generator.uniform(1.2, 2.5, 30) * scale, generator.uniform(0.3, 1.0, 30)
    if flat:
        centres[:, 2] = 0.0
    total = np.zeros(points.shape[:-1])
    for centre, width, height in zip(centres, widths, heights, strict=True):
        total += height * np.exp(-((points - centre) ** 2).sum(-1) / (2 * width**2))
    return np.where(total > 0.01, total, 0.0)


def centred(size: float = 1.0, turn: np.ndarray | None = None) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = size * (np.eye(3) if turn is None else turn)
    return matrix


def frame_of(
    where_from: Move,
    matrix: np.ndarray,
    half: tuple[int, int, int] = (20, 20, 20),
    middle: tuple[int, int, int] = (0, 0, 0),
    to_stage: np.ndarray | None = None,
    strength: float = 1.0,
    **shape: float | bool,
) -> VolumeFrame:
    """A frame of the cloud as it is at ``where_from`` of each voxel's place in grid world."""
    low = np.array(middle) - half
    ranges = [np.arange(2 * n + 1) + start for n, start in zip(half, low, strict=True)]
    ijk = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1)
    density = strength * lumps(where_from(ijk @ matrix[:3, :3] + matrix[3, :3]), **shape)
    field = DenseField("density", density.astype(np.float32), tuple(low.tolist()), matrix)
    return VolumeFrame(1.0, field, np.eye(4) if to_stage is None else to_stage)


def carried(after: VolumeFrame, velocity: DenseField) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Grid-world places of the smoke's voxels [N 3], how far they came [N 3], and weights [N]."""
    moving = VolumeFrame(1.0, after.density, after.density_to_stage, velocity, np.eye(4))
    matrix = after.density.index_to_world
    ijk = np.argwhere(after.density.values > 0.05)
    weights = after.density.values[tuple(ijk.T)]
    places = (ijk + np.array(after.density.ijk_min)) @ matrix[:3, :3] + matrix[3, :3]
    came_from = Transit(moving, SECONDS).origins(torch.from_numpy(places)).numpy()
    return places, places - came_from, weights


def rms_error(after: VolumeFrame, velocity: DenseField, where_from: Move) -> float:
    """Density-weighted, of the way that ``Transit`` finds; grid-world units."""
    places, way, weights = carried(after, velocity)
    error = way - (places - where_from(places))
    return float(np.sqrt((weights * (error**2).sum(-1)).sum() / weights.sum()))


def still(places: np.ndarray) -> np.ndarray:
    return places


def moved_by(shift: tuple[float, float, float]) -> Move:
    return lambda places: places - np.array(shift)


def turned(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("shift", "error"),
    [((0.3, -0.2, 0.4), 0.12), ((1.5, 2.0, -1.0), 0.12), ((5.0, -4.0, 3.0), 0.25)],
)
def test_a_translation_comes_back_within_a_fraction_of_a_voxel(shift, error):
    before, after = frame_of(still, centred()), frame_of(moved_by(shift), centred())
    velocity = estimate_velocity(before, after, SECONDS)
    assert velocity.name == "vel" and velocity.values.dtype == np.float32
    assert rms_error(after, velocity, moved_by(shift)) < error


def test_motion_is_in_grid_world_units_on_turned_voxels_of_another_size():
    matrix = centred(0.25, turned(0.6))
    shift = (0.9, -0.4, 0.3)
    before = frame_of(still, matrix, scale=0.25)
    after = frame_of(moved_by(shift), matrix, scale=0.25)
    velocity = estimate_velocity(before, after, SECONDS)
    assert rms_error(after, velocity, moved_by(shift)) < 0.15 * 0.25


def test_frames_on_different_voxels_boxes_and_places_are_compared_in_stage_space():
    """The cloud does not move on the stage; grid, box and field prim all do."""
    to_stage = np.eye(4)
    to_stage[:3, :3] = 0.8 * turned(-0.3)
    to_stage[3, :3] = [3.0, -2.0, 1.0]
    there = np.linalg.inv(to_stage)

    def on_stage(places: np.ndarray) -> np.ndarray:
        return places @ to_stage[:3, :3] + to_stage[3, :3]

    before = frame_of(still, centred(0.8), half=(22, 22, 22))
    middle = tuple(round(n) for n in there[3, :3])
    after = frame_of(on_stage, np.eye(4), (24, 24, 24), middle, to_stage)
    velocity = estimate_velocity(before, after, SECONDS)
    moving = VolumeFrame(1.0, after.density, to_stage, velocity, to_stage)
    places = np.random.default_rng(0).normal(0, 4, (500, 3))
    came_from = Transit(moving, SECONDS).origins(torch.from_numpy(places)).numpy()
    assert np.sqrt(((came_from - places) ** 2).sum(-1).mean()) < 0.1 * 0.8


def test_the_box_may_follow_the_smoke():
    shift = (6.0, 0.0, -3.0)
    before = frame_of(still, centred())
    after = frame_of(moved_by(shift), centred(), middle=(6, 0, -3))
    velocity = estimate_velocity(before, after, SECONDS)
    assert rms_error(after, velocity, moved_by(shift)) < 0.25


def test_a_rotation_comes_back_but_for_what_no_density_shows():
    """The smoke is found where it came from; the way along its surfaces is a guess."""
    turn = turned(-0.33)

    def where_from(places: np.ndarray) -> np.ndarray:
        return np.asarray(places @ turn)

    before, after = frame_of(still, centred()), frame_of(where_from, centred())
    velocity = estimate_velocity(before, after, SECONDS)
    places, way, weights = carried(after, velocity)
    length = np.sqrt((weights * ((places - places @ turn) ** 2).sum(-1)).sum() / weights.sum())
    assert length > 2.0
    assert rms_error(after, velocity, where_from) < 0.27 * length
    assert np.linalg.norm(lumps(places - way) - weights) < 0.05 * np.linalg.norm(weights)


def test_curved_paths_end_where_they_should():
    """What is found is steady along its path: a displacement taken for it would overshoot."""
    turn = turned(-0.5)
    before = frame_of(still, centred(), (24, 24, 0), flat=True)
    after = frame_of(lambda places: places @ turn, centred(), (24, 24, 0), flat=True)
    velocity = estimate_velocity(before, after, SECONDS)
    places, way, weights = carried(after, velocity)
    assert np.linalg.norm(lumps(places - way, flat=True) - weights) < 0.1 * np.linalg.norm(weights)


def test_smoke_that_stands_still_has_no_velocity_at_all():
    frame = frame_of(still, centred())
    assert not estimate_velocity(frame, frame, SECONDS).values.any()


@pytest.mark.parametrize(("strength", "error"), [(0.95, 0.03), (0.8, 0.12), (1.2, 0.12)])
def test_smoke_that_fades_or_thickens_hardly_moves(strength, error):
    before, after = frame_of(still, centred()), frame_of(still, centred(), strength=strength)
    velocity = estimate_velocity(before, after, SECONDS)
    assert rms_error(after, velocity, still) < error


def test_smoke_that_fades_while_it_moves_is_followed():
    shift = (2.0, 1.0, 0.0)
    before = frame_of(still, centred())
    after = frame_of(moved_by(shift), centred(), strength=0.9)
    velocity = estimate_velocity(before, after, SECONDS)
    assert rms_error(after, velocity, moved_by(shift)) < 0.1


def test_the_unit_of_density_changes_nothing():
    frames = [
        [
            frame_of(still, centred(), strength=s),
            frame_of(moved_by((1, 2, 0)), centred(), strength=s),
        ]
        for s in (1.0, 1024.0)
    ]
    one, other = (estimate_velocity(*pair, SECONDS).values for pair in frames)
    assert np.allclose(one, other, rtol=1e-4, atol=1e-4 * np.abs(one).max())


def test_a_slab_moves_in_its_plane():
    shift = (2.5, -3.0, 0.0)
    half = (24, 24, 0)
    before = frame_of(still, centred(), half, flat=True)
    after = frame_of(moved_by(shift), centred(), half, flat=True)
    velocity = estimate_velocity(before, after, SECONDS)
    assert velocity.values.shape[2] == 1
    assert not velocity.values[..., 2].any()
    assert rms_error(after, velocity, moved_by(shift)) < 0.12


def test_empty_frames_give_no_motion():
    smoke = frame_of(still, centred())
    nothing = DenseField("density", np.zeros((0, 0, 0), np.float32), (0, 0, 0), np.eye(4))
    empty = VolumeFrame(0.0, nothing, np.eye(4))
    blank = DenseField("density", np.zeros((4, 4, 4), np.float32), (0, 0, 0), np.eye(4))
    assert estimate_velocity(smoke, empty, SECONDS).is_empty
    assert estimate_velocity(empty, empty, SECONDS).is_empty
    for other in (empty, VolumeFrame(0.0, blank, np.eye(4))):
        velocity = estimate_velocity(other, smoke, SECONDS)
        assert velocity.values.ndim == 4 and not velocity.values.any()
    assert not estimate_velocity(smoke, VolumeFrame(0.0, blank, np.eye(4)), SECONDS).values.any()


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 1, 3), (5, 3, 1)])
def test_boxes_of_a_few_voxels_are_no_special_case(shape):
    values = np.random.default_rng(1).uniform(0.1, 1.0, shape).astype(np.float32)
    frames = [
        VolumeFrame(1.0, DenseField("density", field, (0, 0, 0), np.eye(4)), np.eye(4))
        for field in (values, values[::-1].copy())
    ]
    assert np.isfinite(estimate_velocity(*frames, SECONDS).values).all()


def test_the_same_frames_give_the_same_bits_whatever_the_threads():
    before, after = frame_of(still, centred()), frame_of(moved_by((1, 2, 0)), centred())
    threads = torch.get_num_threads()
    results = []
    try:
        for n in (1, 2, 1):
            torch.set_num_threads(n)
            results.append(estimate_velocity(before, after, SECONDS).values.tobytes())
    finally:
        torch.set_num_threads(threads)
    assert results[0] == results[1] == results[2]


def test_looking_ahead_reverses_time_and_not_the_velocity():
    shift = (2.0, 0.0, 1.0)
    now, later = frame_of(still, centred()), frame_of(moved_by(shift), centred())
    velocity = estimate_velocity(later, now, -SECONDS)
    moving = VolumeFrame(1.0, now.density, np.eye(4), velocity, np.eye(4))
    places = torch.from_numpy(np.random.default_rng(0).normal(0, 3, (200, 3)))
    went_to = Transit(moving, SECONDS).reverse.origins(places)
    assert (went_to - places - torch.tensor(shift)).norm(dim=1).mean() < 0.1


def test_more_smoothness_gives_a_smoother_motion():
    turn = turned(-0.2)
    before = frame_of(still, centred())
    after = frame_of(lambda places: places @ turn, centred())
    rough = estimate_velocity(before, after, SECONDS).values
    smooth = estimate_velocity(before, after, SECONDS, MotionOptions(smoothness=1.0)).values
    steps = [np.square(np.diff(v, axis=0)).sum() for v in (rough, smooth)]
    assert steps[1] < 0.5 * steps[0]


@pytest.mark.parametrize("seconds", [0.0, math.nan, math.inf])
def test_no_time_between_frames_is_refused(seconds):
    frame = frame_of(still, centred())
    with pytest.raises(NonFiniteError, match="seconds"):
        estimate_velocity(frame, frame, seconds)


def test_nan_in_a_density_is_refused():
    frame = frame_of(still, centred())
    broken = frame.density.values.copy()
    broken[0, 0, 0] = np.nan
    other = VolumeFrame(1.0, DenseField("density", broken, (0, 0, 0), np.eye(4)), np.eye(4))
    with pytest.raises(NonFiniteError, match="density"):
        estimate_velocity(frame, other, SECONDS)

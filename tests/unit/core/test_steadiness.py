"""The temporal error: what moves with the smoke counts for nothing, however sharp or soft it is."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.fixtures.smoke_fixtures import frame_of
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.sequence.steadiness import LAGS, Steadiness
from usdsmoke.core.sequence.transit import Transit
from usdsmoke.core.smoke.active import ActiveSmoke, activate, sample_colours

N, RATE, SPEED, N_FRAMES = 26, 24.0, 3.0, 9
MIDDLE = (N - 1) / 2
Pattern = Callable[[int, ActiveSmoke], Tensor]


def _turn(places: np.ndarray, angle: np.ndarray) -> np.ndarray:
    x, y, z = places.T
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([x * c - y * s, x * s + y * c, z], axis=-1)


def _rates(places: np.ndarray) -> np.ndarray:
    """Radians a second: a ball that turns faster inside, so that its patterns are sheared."""
    return SPEED * np.exp(-((np.linalg.norm(places, axis=-1) / 8) ** 2))


def _ball() -> VolumeFrame:
    places = np.stack(np.meshgrid(*[np.arange(N) - MIDDLE] * 3, indexing="ij"), axis=-1)
    radius, rates = np.linalg.norm(places, axis=-1), _rates(places)
    density = np.where(radius < 11, 1 - radius / 20, 0)
    velocity = np.stack([-rates * places[..., 1], rates * places[..., 0], 0 * rates], axis=-1)
    frame = frame_of(density)
    field = DenseField("vel", velocity.astype(np.float32), (0, 0, 0), np.eye(4), (0.0, 0.0, 0.0))
    return VolumeFrame(1.0, frame.density, np.eye(4), field, np.eye(4))


BALL = _ball()
STEP = Transit(BALL, 1 / RATE)
SMOKE = activate(BALL.density, np.eye(4), torch.device("cpu"))


def waves(length: float, seed: int = 0) -> Callable[[np.ndarray], Tensor]:
    """A pattern of six waves of one length, voxels, in all directions."""
    generator = np.random.default_rng(seed)
    directions = generator.normal(size=(6, 3))
    directions *= 2 * np.pi / length / np.linalg.norm(directions, axis=1, keepdims=True)
    phases, colours = generator.uniform(0, 6.28, 6), generator.normal(0, 0.1, (6, 3))
    return lambda places: torch.from_numpy(
        (0.5 + np.sin(places @ directions.T + phases) @ colours).astype(np.float32)
    )


def moving(length: float, speed: float = 1.0) -> Pattern:
    """Waves that turn with the ball, or at a share of its speed."""
    pattern = waves(length)

    def at(number: int, smoke: ActiveSmoke) -> Tensor:
        places = smoke.positions.numpy() - MIDDLE
        return pattern(_turn(places, -speed * number / RATE * _rates(places)))

    return at


def errors_of(pattern: Pattern) -> dict[int, float]:
    """Means by the number of frames in between."""
    measure, found = Steadiness(), dict[int, list[float]]()
    for number in range(N_FRAMES):
        transit = STEP if number else None
        for lag, error in measure.compare(SMOKE, pattern(number, SMOKE), transit).items():
            found.setdefault(lag, []).append(error)
    assert tuple(found) == LAGS
    assert [len(errors) for errors in found.values()] == [N_FRAMES - lag for lag in LAGS]
    return {lag: float(np.mean(errors)) for lag, errors in found.items()}


@pytest.mark.parametrize("length", [3, 4, 8, 16])
def test_an_exactly_carried_pattern_has_no_error_whatever_its_sharpness(length: float) -> None:
    errors = errors_of(moving(length))
    assert errors[1] < 0.03 and errors[4] < 0.1 and errors[8] < 0.15


@pytest.mark.parametrize("length", [0, 4, 12])
def test_a_pattern_drawn_anew_has_an_error_of_one(length: float) -> None:
    def fresh(number: int, smoke: ActiveSmoke) -> Tensor:
        if length == 0:
            return torch.rand(len(smoke.ijk), 3, generator=torch.Generator().manual_seed(number))
        return waves(length, number)(smoke.positions.numpy())

    for error in errors_of(fresh).values():
        assert error == pytest.approx(1, abs=0.15)


def test_drift_is_told_from_boil() -> None:
    """Half the speed: the longer the worse. Boil: as bad at once."""
    still = moving(8)

    def boiling(number: int, smoke: ActiveSmoke) -> Tensor:
        return still(number, smoke) + 0.3 * waves(8, 99 + number)(smoke.positions.numpy())

    drift, boil = errors_of(moving(8, speed=0.5)), errors_of(boiling)
    assert drift[8] > 3.5 * drift[1] and drift[8] > 1.6 * drift[4]
    assert boil[8] == pytest.approx(boil[1], rel=0.2)


def test_blur_is_not_taken_for_steadiness() -> None:
    """A pattern with as much noise in proportion scores alike, sharp or soft in its contrast."""

    def noisy(contrast: float) -> Pattern:
        sharp = moving(4)

        def at(number: int, smoke: ActiveSmoke) -> Tensor:
            own = sharp(number, smoke) + 0.5 * waves(4, 7 + number)(smoke.positions.numpy())
            return 0.5 + contrast * (own - 0.75)

        return at

    assert errors_of(noisy(0.1))[1] == pytest.approx(errors_of(noisy(1.0))[1], rel=0.01)


def test_one_exact_look_up_is_below_the_floor() -> None:
    """White noise, carried frame by frame as the chain carries it."""
    kept = torch.rand(len(SMOKE.ijk), 3, generator=torch.Generator().manual_seed(0))
    departures = STEP.origins(SMOKE.positions)
    measure = Steadiness()
    measure.compare(SMOKE, kept, None)
    once, _ = sample_colours(SMOKE, kept, departures)
    assert measure.compare(SMOKE, once, STEP)[1] < 0.03


def test_a_change_of_everything_counts() -> None:
    """Light that flickers as a whole has no pattern, but it is not steady."""
    errors = errors_of(
        lambda number, smoke: torch.full((len(smoke.ijk), 3), 0.5 + 0.2 * (number % 2))
    )
    assert errors[1] > 1 and errors[4] == 0
    assert errors_of(lambda number, smoke: torch.full((len(smoke.ijk), 3), 0.5))[1] == 0


def test_frames_without_smoke_in_common_are_not_compared() -> None:
    far = ActiveSmoke(SMOKE.ijk + 100, SMOKE.density, SMOKE.index_to_stage)
    measure, values = Steadiness(), moving(8)(0, SMOKE)
    measure.compare(SMOKE, values, None)
    assert measure.compare(far, values, STEP) == {}


def test_vectors_turn_and_grow_with_their_volume() -> None:
    matrix = np.eye(4)
    matrix[:3, :3] = [[0, 5, 0], [-5, 0, 0], [0, 0, 5]]  # by 90 degrees, five times as large
    grown = activate(BALL.density, matrix, torch.device("cpu"))
    ride = Transit(frame_of(np.zeros((2, 2, 2))), 0.0, matrix)
    vectors = torch.rand(len(SMOKE.ijk), 3, generator=torch.Generator().manual_seed(0)) - 0.5
    moved = vectors @ torch.as_tensor(matrix[:3, :3], dtype=torch.float32)
    measure = Steadiness(is_vector=True)
    measure.compare(SMOKE, vectors, None)
    assert measure.compare(grown, moved, ride)[1] < 1e-3
    measure.restart()
    measure.compare(SMOKE, vectors, None)
    assert measure.compare(grown, vectors, ride)[1] > 0.5  # they stay behind


def test_a_slab_is_measured_in_its_plane() -> None:
    slab = SMOKE.take(SMOKE.ijk[:, 2] == N // 2)
    still = Transit(frame_of(np.zeros((2, 2, 2))), 0.1)
    measure, values = Steadiness(), torch.rand(len(slab.ijk), 3)
    measure.compare(slab, values, None)
    assert measure.compare(slab, values, still)[1] == 0
    assert measure.compare(slab, torch.rand(len(slab.ijk), 3), still)[1] > 0.7

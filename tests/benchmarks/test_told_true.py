"""The study of told and true errors: what counts as within a factor of 2, and the true ones."""

import math

import numpy as np
import pytest

from benchmarks.control_scenes import frame_of
from benchmarks.told_true import Row
from benchmarks.told_true_scenes import Scene
from benchmarks.true_errors import FOLDED, UNREAD, transport_error, unevenness
from usdsmoke.base.volume import DenseField

SIDE = 20


def blob(places: np.ndarray) -> np.ndarray:
    return np.exp(-((places - (SIDE - 1) / 2) ** 2).sum(-1) / 20)


def places(n: int = SIDE) -> np.ndarray:
    return np.stack(np.meshgrid(*[np.arange(float(n))] * 3, indexing="ij"), axis=-1)


@pytest.mark.parametrize(
    ("told", "true", "wanted"),
    [
        (0.10, 0.10, True),
        (0.10, 0.19, True),
        (0.10, 0.21, False),
        (0.10, 0.049, False),
        (0.10, 0.0, False),
        (4e-4, 9e-4, True),  # both too small to matter
        (4e-4, 2e-3, False),
        (0.10, math.nan, False),
    ],
)
def test_a_row_is_right_within_a_factor_of_two(told: float, true: float, wanted: bool) -> None:
    assert Row("scene", "row", told, true).within is wanted


@pytest.mark.parametrize(("off", "least", "most"), [(0.0, 0.0, 1e-6), (0.5, 0.1, 0.3)])
def test_the_transport_s_error_is_the_distance_from_the_smoke_at_its_departure_points(
    off: float, least: float, most: float
) -> None:
    way, low = np.array([1.5, 0.25, 0.0]), (2, 3, 4)
    moved = blob(places() - way - [off, 0, 0]).astype(np.float32)
    scene = Scene(frame_of(blob(places())), blob)
    u = np.broadcast_to(way, (14, 12, 10, 3))
    error = transport_error(scene, u, low, DenseField("density", moved, (0, 0, 0), np.eye(4)))
    assert least <= error <= most


def test_smoke_at_rest_is_the_mean_of_the_finer_smoke() -> None:
    fine = blob(places(2 * SIDE) / 2)
    coarse = fine.reshape([n for _ in range(3) for n in (SIDE, 2)]).mean(axis=(1, 3, 5))
    field = DenseField("density", coarse.astype(np.float32), (0, 0, 0), np.eye(4))
    scene = Scene(frame_of(coarse), fine=fine, factor=2)
    assert transport_error(scene, np.zeros((SIDE, SIDE, SIDE, 3)), (0, 0, 0), field) < 1e-6


def test_a_wave_folds_where_its_slope_is_above_one() -> None:
    """1 - a k cos(k x) <= 0 for a share of arccos(1 / (a k)) / pi of the wave."""
    n, a = 64, 12.0
    u = np.zeros((n, 4, 4, 3))
    u[..., 0] = a * np.sin(2 * np.pi * np.arange(n) / n)[:, None, None]
    found = unevenness(u, np.ones((n, 4, 4)))
    assert found[FOLDED] == pytest.approx(np.arccos(n / (2 * np.pi * a)) / np.pi, abs=0.05)
    assert unevenness(0 * u, np.ones((n, 4, 4)))[UNREAD] == 0

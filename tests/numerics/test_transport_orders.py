"""Errors and fitted orders of transport on problems with known answers."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from tests.numerics.transport_problems import (
    periodic_gaussian,
    rotation_error,
    single_vortex,
    sphere_reversal,
    swirl_warp,
    window_and_back,
    zalesak_disk,
)
from usdsmoke.core.fields.transport import backtrace


def fitted_order(sizes: tuple[int, ...], error_at: Callable[[int], float]) -> float:
    errors = [error_at(n) for n in sizes]
    return float(-np.polyfit(np.log(sizes), np.log(errors), 1)[0])


@pytest.mark.parametrize(
    ("scheme", "limiter", "mark", "reached"),
    [
        ("linear", True, None, 1.35e-2),
        ("cubic", False, 1e-4, 9.45e-5),
        ("cubic", True, None, 1.12e-4),
    ],
)
def test_single_vortex_comes_back(scheme, limiter, mark, reached):
    outcome = single_vortex(128, scheme, limiter)
    assert mark is None or outcome.l1 <= mark
    assert outcome.l1 == pytest.approx(reached, rel=0.02)
    if limiter:
        assert outcome.low >= 0 and outcome.high <= 1


def test_single_vortex_in_float32_is_as_accurate():
    single = single_vortex(64, "cubic", False, dtype=torch.float32).l1
    assert single == pytest.approx(single_vortex(64, "cubic", False).l1, rel=1e-3)


@pytest.mark.parametrize(
    ("scheme", "limiter", "mark", "reached"),
    [
        ("linear", True, None, 1.109),
        ("cubic", False, 0.26, 0.249),
        ("cubic", True, None, 0.264),
    ],
)
def test_zalesak_disk_keeps_its_slot(scheme, limiter, mark, reached):
    outcome = zalesak_disk(scheme, limiter)
    assert mark is None or outcome.relative_l1 <= mark
    assert outcome.relative_l1 == pytest.approx(reached, rel=0.02)
    if limiter:
        assert outcome.low >= 0 and outcome.high <= 1


@pytest.mark.parametrize(
    ("scheme", "limiter", "order"),
    [
        ("linear", True, 1.0),
        ("cubic", False, 3.0),
        ("cubic", True, 3.0),
    ],
)
def test_scheme_has_its_order_over_many_steps(scheme, limiter, order):
    found = fitted_order((32, 64, 128), lambda n: periodic_gaussian(n, scheme, limiter).l1)
    assert found == pytest.approx(order, abs=0.3)


@pytest.mark.parametrize(
    ("scheme", "low", "high"),
    [("linear", 0.7, 1.3), ("cubic", 2.7, 3.3)],
)
def test_orders_hold_in_three_dimensions(scheme, low, high):
    found = fitted_order((16, 24, 32), lambda n: sphere_reversal(n, scheme).l1)
    assert low <= found <= high


def test_back_trace_is_second_order():
    centre = torch.tensor([10.0, 10.0, 0.0], dtype=torch.float64)
    arrivals = torch.tensor([[14, 10, 0], [10, 17, 0], [3, 5, 0]], dtype=torch.float64)
    turn = torch.tensor([[0, 1, 0], [-1, 0, 0], [0, 0, 0]], dtype=torch.float64)
    exact = centre + (arrivals - centre) @ torch.matrix_exp(-2.0 * turn)

    def error(n: int) -> float:
        found = backtrace(lambda p: (p - centre) @ turn, arrivals, 2.0, n)
        return float((found - exact).norm(dim=1).max())

    assert fitted_order((8, 16, 32, 64), error) == pytest.approx(2.0, abs=0.1)


def test_baselines_reach_the_figures_of_decision_006():
    """Schemes that the product does not use: MacCormack and other back-traces."""
    errors = {scheme: swirl_warp(64, scheme).l1 for scheme in ("linear", "maccormack", "cubic")}
    assert errors["cubic"] < 5e-3 * errors["maccormack"]
    assert errors["maccormack"] < errors["linear"]
    assert single_vortex(64, "maccormack", True).l1 == pytest.approx(4.01e-3, rel=0.02)
    for order in (1, 2, 4):
        found = fitted_order((8, 16, 32), lambda n, order=order: rotation_error(order, n))
        assert found == pytest.approx(order, abs=0.15)


@pytest.mark.parametrize(("scheme", "order"), [("linear", 2.0), ("cubic", 4.0)])
def test_single_warp_has_the_order_of_its_interpolation(scheme, order):
    found = fitted_order((48, 64, 96, 128), lambda n: swirl_warp(n, scheme).l1)
    assert found == pytest.approx(order, abs=0.3)


@pytest.mark.parametrize(("scheme", "most"), [("linear", 0.033), ("cubic", 9e-5)])
def test_way_out_and_back_through_a_window_loses_in_proportion_to_its_length(scheme, most):
    short, long = (window_and_back(n, scheme).relative_l1 for n in (2, 8))
    assert long <= most
    assert long / short <= 4.2  # no faster than the number of transports

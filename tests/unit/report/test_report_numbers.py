"""The report's own machinery finds the orders that are known."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.smoke_fixtures import puff
from usdsmoke.base.volume import DenseField
from usdsmoke.core.views.cameras import orbit_view
from usdsmoke.core.views.march import march
from usdsmoke.core.views.media import make_media
from usdsmoke.work_precision.fit import crossing, fitted_order
from usdsmoke.work_precision.footprint import column_depths, footprint
from usdsmoke.work_precision.quadrature import RULES, integrate
from usdsmoke.work_precision.sweep_interpolation import Turn
from usdsmoke.work_precision.sweep_projection import tent_mean


def light(rule: str, n: int, k: float) -> float:
    """A ray whose extinction does not vanish at its ends, and whose colour changes."""
    s = ((torch.arange(n, dtype=torch.float64) + 0.5) / n)[:, None]
    sigma = k * (1 + s**2)
    return float(integrate(rule, (0.5 + 0.5 * torch.sin(7 * s + 0.3)) * sigma, sigma, 1 / n))


@pytest.mark.parametrize("k", [1.0, 20.0])
@pytest.mark.parametrize(
    ("rule", "order"), [("segments", 2.0), ("middle", 2.0), ("inclusive", 1.0), ("exclusive", 1.0)]
)
def test_fitted_orders_of_the_rules(rule: str, order: float, k: float) -> None:
    exact = light("segments", 200_000, k)
    counts = [64, 128, 256, 512]
    errors = [abs(light(rule, n, k) - exact) / exact for n in counts]
    found = fitted_order([1 / n for n in counts], errors)
    assert found == pytest.approx(order, abs=0.1), RULES[rule]


def test_exponential_segments_are_exact_in_a_slab_of_one_colour() -> None:
    sigma = torch.full((4, 1), 30.0, dtype=torch.float64)
    found = float(integrate("segments", 0.25 * sigma, sigma, 0.25))
    assert found == pytest.approx(0.25 * -math.expm1(-30.0), rel=1e-14)


def test_no_order_is_fitted_to_two_points_or_to_round_off() -> None:
    assert fitted_order([1, 0.5], [1, 0.25]) is None
    assert fitted_order([1, 0.5, 0.25, 0.125], [1, 0.25, 1e-16, 1e-16]) is None
    assert fitted_order([1, 0.5, 0.25], [8, 1, 0.125]) == pytest.approx(3)


def test_a_curve_passes_an_error_on_the_straight_line_of_the_logarithms() -> None:
    found = crossing(0.1, [1, 0.01, 5], [1, 100, 0.5])
    assert found is not None and found.cost == pytest.approx(10)
    assert (found.finer, found.rougher) == (1, 0)
    assert crossing(0.001, [1, 0.01], [1, 100]) is None


def test_nothing_lies_between_where_the_finer_point_is_the_cheaper_one() -> None:
    assert crossing(0.1, [1, 0.01], [100, 1]) is None
    assert crossing(0.1, [1, 0.01, 0.001], [1, 100, 2]) is None


def test_a_quarter_turn_in_one_step_meets_its_exact_result() -> None:
    turn = Turn.of(puff(7), 1)  # voxels come to lie on voxels: nothing is interpolated
    for scheme in ("linear", "cubic"):
        assert turn.error(turn.turned(scheme, True, 1)) < 1e-5
    assert turn.error(turn.box) > 0.1


def test_a_better_scheme_has_less_error_after_a_turn() -> None:
    axis = (np.arange(20) - 9.5) / 20
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    turn = Turn.of(np.exp(-((x - 0.1) ** 2 + y**2 + z**2) / 0.02).astype(np.float32), 6)
    linear, cubic = (turn.error(turn.turned(scheme, False, 6)) for scheme in ("linear", "cubic"))
    assert cubic < 0.1 * linear


def test_a_tent_keeps_the_sum_and_is_what_a_splat_leaves() -> None:
    fine = np.zeros((20, 20))
    fine[8, 10] = 25.0  # one sample of a pixel of 5 x 5, at (1.2 + 0.5, 2 + 0.1) - 0.5
    coarse = tent_mean(fine, 5)
    assert coarse.sum() == pytest.approx(1.0)
    y, x = 8.5 / 5 - 0.5, 10.5 / 5 - 0.5
    assert coarse[1, 1] == pytest.approx((2 - y) * (2 - x))
    assert coarse[2, 2] == 0 or coarse[2, 2] == pytest.approx((y - 1) * (x - 1))


def test_a_voxel_s_footprint_is_the_tent_of_tents_that_it_is_along_an_axis() -> None:
    table, size = footprint(np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]))
    n = len(table) // size  # entries a pixel
    assert table.sum() / n**2 == pytest.approx(1, rel=1e-12)
    spline = [2 / 3, 1 / 6, 0.0]  # a hat with a hat is the cubic B-spline
    found = [[table[y * n, x * n] for x in range(3)] for y in range(3)]
    assert np.allclose(found, np.outer(spline, spline), atol=1e-6)


def test_a_footprint_ends_where_voxel_and_pixel_do() -> None:
    edges = np.array([[0.9, 0.1], [-0.2, 0.8], [0.3, -0.4]])
    table, size = footprint(edges)
    offset = np.fft.fftfreq(len(table), 1 / size)
    far = np.abs(offset) > 1 + np.abs(edges).sum(axis=0).max()
    assert np.abs(table[far]).max() < 1e-6 * table.max() and table.min() > -1e-6 * table.max()


def test_columns_agree_with_rays_through_the_same_smoke_as_these_grow_many() -> None:
    density = puff(8, 3)
    field = DenseField("density", density, (0, 0, 0), np.eye(4))
    view = replace(orbit_view(25, 35, "Y", np.full(3, 3.5), 20, 20, 1.0), shift=(0.3, -0.2))
    positions = np.stack(np.nonzero(density), axis=-1).astype(float)
    exact = column_depths(positions, density[density != 0].astype(float), np.eye(3), view)
    assert exact.sum() == pytest.approx(density.sum(dtype=float), rel=1e-5)
    media = make_media(field, None, np.eye(4), None, 1.0, 1.0)
    errors = []
    for n in (4, 8, 16):
        fine = replace(
            view, height=20 * n, width=20 * n, pixel_size=1 / n, shift=(0.3 * n, -0.2 * n)
        )
        found = tent_mean(march(media, fine, rays=1).depth.astype(float), n)
        errors.append(float(np.sqrt(((found - exact) ** 2).mean() / (exact**2).mean())))
    assert fitted_order([1 / 4, 1 / 8, 1 / 16], errors) == pytest.approx(2, abs=0.2)
    assert errors[-1] < 2e-4

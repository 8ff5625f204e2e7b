"""Quadrature of emission and absorption: orders, errors and exact cases along one ray."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from usdsmoke.core.views.optics import attenuation_ratio, transmittance_before

WIDTH = 0.12
COUNTS = (32, 64, 128, 256)
STRENGTHS = (1, 20, 50, 100, 200, 500, 1000, 2000)
MOST = 1.5e-5  # |error| at 256 segments


def composite(t: Tensor, colour: Tensor) -> Tensor:
    """Light at the front of rays, with the functions that ``core.project`` composes."""
    weights = t * attenuation_ratio(t) * transmittance_before(t)
    return (weights[..., None] * colour).sum(dim=0)


def colour(s: Tensor) -> Tensor:
    return 0.5 + 0.5 * torch.sin(7 * s + 0.3)


def extinction(s: Tensor, k: float) -> Tensor:
    return k * torch.exp(-(((s - 0.5) / WIDTH) ** 2))


def middles(n: int) -> Tensor:
    return (torch.arange(n, dtype=torch.float64) + 0.5) / n


def reference(k: float, n: int = 400_001) -> float:
    """Simpson's rule over colour x extinction x transmittance, the depth in closed form."""
    s = torch.linspace(0, 1, n, dtype=torch.float64)
    f = colour(s) * extinction(s, k) * torch.exp(-depth_to(s, k))
    return float(f[0] + f[-1] + 4 * f[1:-1:2].sum() + 2 * f[2:-1:2].sum()) / (3 * (n - 1))


def depth_to(s: Tensor, k: float) -> Tensor:
    """Optical depth of [0, s] in closed form."""
    erf = torch.erf((s - 0.5) / WIDTH) + math.erf(0.5 / WIDTH)
    return k * WIDTH * math.sqrt(math.pi) / 2 * erf


def mean_depths(n: int, k: float) -> Tensor:
    """Of n segments, exact."""
    return depth_to(torch.linspace(0, 1, n + 1, dtype=torch.float64), k).diff()


def point_depths(n: int, k: float) -> Tensor:
    """Of n segments, from the extinction in their middles."""
    return extinction(middles(n), k) / n


def errors_of(depths: Callable[[int, float], Tensor], k: float) -> list[float]:
    wanted = reference(k)
    return [
        abs(float(composite(depths(n, k), colour(middles(n))[:, None])) - wanted) for n in COUNTS
    ]


def order_of(errors: list[float]) -> float:
    return float(-np.polyfit(np.log(COUNTS), np.log(errors), 1)[0])


@pytest.mark.parametrize("k", STRENGTHS)
def test_quadrature_of_segment_means_is_second_order_and_accurate_for_thin_and_thick_smoke(k):
    """What a voxel's density is, and what the projection, which keeps mass, makes of it."""
    errors = errors_of(mean_depths, k)
    assert order_of(errors) >= 1.9
    assert errors[-1] <= MOST


@pytest.mark.parametrize("k", STRENGTHS)
def test_quadrature_of_point_samples_is_second_order_with_a_larger_error(k):
    """The middle's extinction is not the segment's mean: dense smoke is seen by the depth of the
    few segments at its front, where these differences have not evened out yet."""
    errors = errors_of(point_depths, k)
    assert order_of(errors) >= 1.9
    assert errors[-1] <= (5.2e-5 if 200 <= k <= 500 else 5e-5)


@pytest.mark.parametrize("depth", [1e-12, 1e-6, 0.3, 5.0, 1e3, 1e6])
def test_homogeneous_slab_is_exact_for_any_number_of_segments(depth):
    for n in (1, 7, 256):
        t = torch.full((n,), depth / n, dtype=torch.float64)
        found = composite(t, torch.full((n, 1), 0.7, dtype=torch.float64))
        assert float(found) == pytest.approx(-0.7 * math.expm1(-depth), rel=1e-12)


def test_linear_ramp_has_its_exact_opacity():
    """The middle's extinction times the length is the integral of a linear extinction."""
    for n in (1, 8, 64):
        white = composite(6.0 * middles(n) / n, torch.ones(n, 1, dtype=torch.float64))
        assert float(white) == pytest.approx(-math.expm1(-3.0), rel=1e-13)


def two_slabs(n: int, border: float) -> float:
    s = middles(n)
    first = s < border
    t = torch.where(first, s.new_tensor(2.0), s.new_tensor(9.0)) / n
    c = torch.where(first, s.new_tensor(0.9), s.new_tensor(0.2))[:, None]
    return float(composite(t, c))


def test_two_slabs_are_exact_when_they_meet_between_segments():
    near, far = 2.0 * 0.25, 9.0 * 0.75
    wanted = -0.9 * math.expm1(-near) - 0.2 * math.exp(-near) * math.expm1(-far)
    for n in (4, 64, 256):
        assert two_slabs(n, 0.25) == pytest.approx(wanted, rel=1e-13)


def test_two_slabs_that_meet_inside_a_segment_are_first_order():
    near, far = 2.0 / 3, 9.0 * 2 / 3
    wanted = -0.9 * math.expm1(-near) - 0.2 * math.exp(-near) * math.expm1(-far)
    errors = [abs(two_slabs(n, 1 / 3) - wanted) for n in (32, 128, 512)]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:])) / 2
    assert np.all(orders > 0.85) and np.all(orders < 1.15)

"""Opacity, attenuation and weights of segments from vanishing to infinite optical depth."""

from decimal import Decimal, getcontext

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

from usdsmoke.core.views.optics import attenuation_ratio, opacity, transmittance_before

DEPTHS = [10.0**e for e in range(-12, 4)] + [0.9e-4, 1.1e-4, 0.9e-2, 1.1e-2, 0.5, 3.0]


def composite(t: Tensor, colour: Tensor) -> Tensor:
    """Light at the front of rays, with the functions that ``core.project`` composes."""
    weights = t * attenuation_ratio(t) * transmittance_before(t)
    return (weights[..., None] * colour).sum(dim=0)


def exact_ratio(t: float) -> tuple[float, float]:
    """(1 - exp(-t)) / t and its derivative, with 60 digits."""
    getcontext().prec = 60
    depth = Decimal(t)
    passed = (-depth).exp()
    return float((1 - passed) / depth), float((passed * (1 + depth) - 1) / depth**2)


@pytest.mark.parametrize(
    ("dtype", "value_error", "slope_error"),
    [(torch.float64, 1e-13, 5e-12), (torch.float32, 2e-7, 3e-5)],
)
def test_attenuation_ratio_and_its_slope_agree_with_sixty_digits(dtype, value_error, slope_error):
    t = torch.tensor(DEPTHS, dtype=dtype, requires_grad=True)
    ratio = attenuation_ratio(t)
    (slope,) = torch.autograd.grad(ratio.sum(), t)
    for place, found, found_slope in zip(t.tolist(), ratio.tolist(), slope.tolist(), strict=True):
        wanted, wanted_slope = exact_ratio(place)
        assert found == pytest.approx(wanted, rel=value_error)
        assert found_slope == pytest.approx(wanted_slope, rel=slope_error)


def test_attenuation_ratio_is_one_in_empty_segments_with_a_slope_of_minus_a_half():
    t = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    ratio = attenuation_ratio(t)
    (slope,) = torch.autograd.grad(ratio.sum(), t)
    assert ratio.tolist() == [1.0] * 3
    assert slope.tolist() == [-0.5] * 3


@pytest.mark.parametrize("function", [opacity, attenuation_ratio, transmittance_before])
def test_gradients_agree_with_finite_differences(function):
    t = torch.tensor([0.4, 1e-3, 2.0, 0.02, 0.7], dtype=torch.float64, requires_grad=True)
    assert gradcheck(function, (t,), eps=1e-7, atol=1e-7)


def test_composite_gradients_agree_with_finite_differences():
    generator = torch.Generator().manual_seed(0)
    t = torch.rand(5, 2, generator=generator, dtype=torch.float64).requires_grad_()
    colour = torch.rand(5, 2, 3, generator=generator, dtype=torch.float64).requires_grad_()
    assert gradcheck(composite, (t, colour))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("n_segments", [1, 300])
@pytest.mark.parametrize("depth", [0.0, 1e-12, 1e-6, 1.0, 1e3, 1e6, 1e30])
def test_any_optical_depth_gives_finite_values_and_gradients(depth, n_segments, dtype):
    t = torch.full((n_segments, 1), depth / n_segments, dtype=dtype, requires_grad=True)
    colour = torch.full((n_segments, 1, 3), 0.6, dtype=dtype, requires_grad=True)
    picture = composite(t, colour)
    gradients = torch.autograd.grad(picture.sum(), (t, colour))
    wanted = 0.6 * float(opacity(torch.tensor(depth, dtype=torch.float64)))
    assert picture.flatten().tolist() == pytest.approx([wanted] * 3, rel=1e-4)
    assert all(bool(torch.isfinite(g).all()) for g in gradients)


def test_smoke_behind_a_wall_of_infinite_depth_is_not_seen_and_not_nan():
    t = torch.tensor([0.5, float("inf"), 1.0, float("inf"), 2.0])
    assert transmittance_before(t)[2:].tolist() == [0.0, 0.0, 0.0]


def test_weights_of_a_ray_sum_to_its_opacity():
    t = torch.rand(40, 7, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    white = composite(t, torch.ones(40, 7, 1, dtype=torch.float64))[..., 0]
    assert torch.allclose(white, opacity(t.sum(0)), atol=1e-14)


def test_emission_without_density_gives_no_light_and_no_gradient_trouble():
    """Colour is light per extinction: where nothing extinguishes nothing shines."""
    t = torch.zeros(4, 3, requires_grad=True)
    colour = torch.full((4, 3, 3), 5.0, requires_grad=True)
    picture = composite(t, colour)
    by_depth, by_colour = torch.autograd.grad(picture.sum(), (t, colour))
    assert not picture.any() and not by_colour.any()
    assert torch.isfinite(by_depth).all()

"""Displacements against closed forms; discrete identities to round-off; cap, fade and mask."""

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

from tests.fixtures.smoke_fixtures import divergence
from usdsmoke.base.errors import NonFiniteError, ShapeError
from usdsmoke.core.fields.displacement import (
    clamp_displacement,
    curl,
    from_mixed,
    from_potential,
    from_stream,
    smooth_mask,
)

SHAPE = (7, 5, 6)
SPACING = (0.5, 0.2, 1.7)


def random(*shape: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def world(shape: tuple[int, ...] = SHAPE) -> tuple[Tensor, Tensor, Tensor]:
    axes = [torch.arange(n, dtype=torch.float64) * h for n, h in zip(shape, SPACING, strict=True)]
    return torch.meshgrid(*axes, indexing="ij")


@pytest.mark.parametrize("shape", [SHAPE, (7, 5, 1), (7, 1, 6), (1, 5, 6), (2, 2, 2), (7, 1, 1)])
def test_curl_has_no_divergence(shape):
    displacement = from_stream(random(*shape, 3), SPACING)
    scale = displacement.abs().max() / min(SPACING)
    assert divergence(displacement, SPACING).abs().max() <= 1e-14 * scale


@pytest.mark.parametrize("shape", [SHAPE, (7, 5, 1), (7, 1, 6), (1, 5, 6), (2, 2, 2), (7, 1, 1)])
def test_gradient_has_no_curl(shape):
    displacement = from_potential(random(*shape), SPACING)
    scale = displacement.abs().max() / min(SPACING)
    assert curl(displacement, SPACING).abs().max() <= 1e-14 * scale


def test_a_displacement_that_is_no_curl_has_divergence():
    """The identity above is not one of a ``divergence`` that sees nothing."""
    assert divergence(random(*SHAPE, 3), SPACING).abs().max() > 1


def test_curl_of_a_parabola_is_a_rigid_rotation_with_anisotropic_voxels():
    x, y, _ = world()
    psi = torch.stack([torch.zeros_like(x), torch.zeros_like(x), -(x**2 + y**2) / 2], dim=-1)
    expected = torch.stack([-y, x, torch.zeros_like(x)], dim=-1)
    torch.testing.assert_close(from_stream(psi, SPACING), expected, rtol=0, atol=1e-13)


def test_gradient_of_a_quadratic_is_exact_up_to_the_border():
    x, y, z = world()
    phi = x**2 - 3 * x * y + z * y + 0.5 * z**2 - 4 * y
    expected = torch.stack([2 * x - 3 * y, -3 * x + z - 4, y + z], dim=-1)
    torch.testing.assert_close(from_potential(phi, SPACING), expected, rtol=0, atol=1e-12)


def test_derivatives_are_second_order_everywhere():
    sizes, errors = (8, 16, 32), []
    for n in sizes:
        x = torch.arange(n, dtype=torch.float64)[:, None, None] / (n - 1)
        found = from_potential(torch.exp(2 * x), (1 / (n - 1), 1.0, 1.0))[..., 0]
        errors.append(float((found - 2 * torch.exp(2 * x)).abs().max()))
    assert -np.polyfit(np.log(sizes), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("flat", [0, 1, 2])
def test_in_the_plane_only_the_component_across_it_counts(flat):
    shape = tuple(1 if axis == flat else n for axis, n in enumerate(SHAPE))
    psi = random(*shape, 3)
    displacement = from_stream(psi, SPACING)
    assert torch.equal(displacement[..., flat], torch.zeros(shape, dtype=torch.float64))
    across = psi[..., flat : flat + 1]
    assert torch.equal(displacement, from_stream(across, SPACING))
    assert displacement.abs().max() > 0


def test_potential_moves_nothing_across_the_plane():
    displacement = from_potential(random(7, 5, 1), SPACING)
    assert displacement[..., 2].abs().max() == 0
    assert displacement[..., :2].abs().max() > 0


@pytest.mark.parametrize("shape", [(7, 1, 1), (1, 1, 1)])
def test_stream_function_on_a_line_moves_nothing(shape):
    assert from_stream(random(*shape, 3), SPACING).abs().max() == 0


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_mixture_is_the_weighted_sum(share):
    psi, phi = random(*SHAPE, 3), random(*SHAPE, seed=1)
    expected = share * from_potential(phi, SPACING) + (1 - share) * from_stream(psi, SPACING)
    torch.testing.assert_close(from_mixed(psi, phi, SPACING, share), expected)


@pytest.mark.parametrize("shape", [(3, 4, 5), (2, 4, 3), (4, 3, 1)])
def test_gradients_of_the_operators_agree_with_finite_differences(shape):
    psi, phi = random(*shape, 3).requires_grad_(), random(*shape).requires_grad_()
    assert gradcheck(lambda p: from_stream(p, SPACING), (psi,))
    assert gradcheck(lambda p: from_potential(p, SPACING), (phi,))
    assert gradcheck(lambda p, q: from_mixed(p, q, SPACING, 0.4), (psi, phi))


@pytest.mark.parametrize("shape", [SHAPE, (7, 5, 1)])
def test_adjoint_is_exact(shape):
    psi, phi = random(*shape, 3).requires_grad_(), random(*shape).requires_grad_()
    for field, operator in ((psi, from_stream), (phi, from_potential)):
        displacement = operator(field, SPACING)
        weights = random(*displacement.shape, seed=4)
        (adjoint,) = torch.autograd.grad(displacement, field, weights)
        difference = (displacement * weights).sum() - (field * adjoint).sum()
        assert difference.abs().item() <= 1e-13 * (displacement * weights).abs().sum().item()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_cap_is_not_exceeded_and_small_displacements_stay(dtype):
    lengths = torch.tensor([0.0, 1e-30, 1e-3, 0.3, 1.0, 3.0, 1e3, 1e18], dtype=dtype) * 2.5
    direction = torch.tensor([2.0, -1.0, 2.0], dtype=dtype) / 3
    capped = clamp_displacement(lengths[:, None] * direction, 2.5)
    found = capped.norm(dim=1)
    eps = torch.finfo(dtype).eps
    assert (found <= 2.5 * (1 + 4 * eps)).all()
    assert (found[1:] >= found[:-1]).all()
    torch.testing.assert_close(capped[:3], lengths[:3, None] * direction, rtol=1e-6, atol=0)
    torch.testing.assert_close(found[3], lengths[3] / 1.0081**0.25)
    torch.testing.assert_close(found[-1], torch.tensor(2.5, dtype=dtype))
    torch.testing.assert_close(capped[2:] / found[2:, None], direction.expand(6, 3))


def test_cap_has_finite_gradients_at_zero_and_far_out():
    u = torch.tensor([[0.0, 0.0, 0.0], [1e18, 0.0, -1e18]], requires_grad=True)
    clamp_displacement(u, 1.0).sum().backward()
    assert u.grad is not None
    assert torch.equal(u.grad[0], torch.ones(3))
    assert torch.isfinite(u.grad).all()


def test_gradient_of_the_cap_agrees_with_finite_differences():
    assert gradcheck(lambda u: clamp_displacement(u, 0.8), (random(6, 3).requires_grad_(),))


def plume(scale: float = 1.0) -> Tensor:
    density = torch.zeros(24, 20, 18)
    density[8:16, 6:14, 6:12] = 1.0 + torch.rand(
        8, 8, 6, generator=torch.Generator().manual_seed(0)
    )
    return density * scale


def test_mask_is_one_inside_zero_far_outside_and_smooth_between():
    mask = smooth_mask(plume(), 1.5)
    assert mask.min() >= 0 and mask.max() <= 1
    assert mask[12, 10, 9] > 0.9
    # just outside a face: the kernel's sum over the voxels of the full block of 8 x 8 x 6
    kernel = torch.exp(-0.5 * (torch.arange(-6, 7) / 1.5) ** 2)
    kernel = kernel / kernel.sum()
    share = kernel[7:].sum() * kernel[2:10].sum() * kernel[3:9].sum()
    torch.testing.assert_close(mask[7, 10, 9], share)
    assert mask[1, 10, 9] == 0
    assert mask.diff(dim=0).abs().max() < 0.3


@pytest.mark.parametrize("scale", [1e-37, 1e-30, 1e6, 1e30])
def test_mask_does_not_depend_on_the_unit_of_density(scale):
    torch.testing.assert_close(smooth_mask(plume(scale), 1.2), smooth_mask(plume(), 1.2))


def test_mask_of_emptiness_is_empty_and_negative_density_counts_as_none():
    assert smooth_mask(torch.zeros(4, 5, 6), 1.0).abs().max() == 0
    assert smooth_mask(-plume(), 1.0).abs().max() == 0
    dipped = plume()
    dipped[0, 0, 0] = -1e30
    torch.testing.assert_close(smooth_mask(dipped, 1.2), smooth_mask(plume(), 1.2))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: from_stream(random(4, 4, 4), SPACING), r"\[4, 4, 4\].*\[I J K 3\]"),
        (lambda: from_stream(random(4, 4, 4, 1), SPACING), r"\[4, 4, 4, 1\].*\[I J K 3\]"),
        (lambda: from_potential(random(4, 4, 4, 1), SPACING), r"\[4, 4, 4, 1\].*\[I J K\]"),
        (lambda: from_potential(random(4, 4, 4), (1.0, 0.0, 1.0)), "three lengths above 0"),
        (lambda: from_potential(random(4, 4, 4), (1.0, 1.0)), "three lengths above 0"),
        (
            lambda: from_mixed(random(4, 4, 4, 3), random(4, 4, 5), SPACING, 0.5),
            "on the same voxels",
        ),
        (lambda: clamp_displacement(random(4, 3), 0.0), "cap is 0.0"),
        (lambda: smooth_mask(random(4, 4, 4, 3), 1.0), r"\[4, 4, 4, 3\].*\[I J K\]"),
        (lambda: smooth_mask(random(4, 4, 4), -1.0), "one or three numbers from 0"),
        (lambda: smooth_mask(random(4, 4, 4), 1.0, share=0.0), "share is 0.0"),
    ],
)
def test_what_does_not_fit_is_refused(call, message):
    with pytest.raises(ShapeError, match=message):
        call()


def test_mask_refuses_non_finite_density():
    with pytest.raises(NonFiniteError, match="the mask"):
        smooth_mask(torch.tensor([[[1.0, float("nan")]]]), 1.0)

"""Gradients and adjoints of transport, alone and chained with the displacement that drives it."""

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

from usdsmoke.core.fields.displacement import clamp_displacement, from_mixed, from_stream
from usdsmoke.core.fields.pyramid import expand_levels, pyramid_shapes
from usdsmoke.core.fields.sample import sample_cubic, sample_linear, voxel_positions
from usdsmoke.core.fields.transport import SCHEMES, backtrace, warp

SHAPE = (4, 3, 5)


def random(*shape: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(*shape, generator=generator, dtype=torch.float64)


def moving(*shape: int, seed: int = 1) -> Tensor:
    """Far enough from whole voxels that no finite difference crosses a kink."""
    return (random(*shape, 3, seed=seed) - 0.5) * 0.7 + 0.41


@pytest.mark.parametrize("sampler", [sample_linear, sample_cubic])
def test_adjoint_of_the_look_up_is_exact(sampler):
    """Without a limiter each scheme is linear in the values: <Ax, y> = <x, A'y>."""
    values = random(9, 8, 7).requires_grad_()
    departures = voxel_positions(values.shape, values) - moving(9, 8, 7).reshape(-1, 3) * 3
    moved = sampler(values, departures)
    weights = random(9 * 8 * 7, seed=2) - 0.5
    (adjoint,) = torch.autograd.grad(moved, values, weights)
    left, right = (moved * weights).sum(), (values * adjoint).sum()
    assert (left - right).abs().item() <= 1e-13 * (moved * weights).abs().sum().item()
    probe = random(9, 8, 7, seed=3)
    left = (sampler(probe, departures) * weights).sum()
    assert (left - (probe * adjoint).sum()).abs().item() <= 1e-12


@pytest.mark.parametrize("scheme", SCHEMES)
def test_gradients_of_the_warp_agree_with_finite_differences(scheme):
    values, u = random(*SHAPE).requires_grad_(), moving(*SHAPE).requires_grad_()
    assert gradcheck(lambda v, d: warp(v, d, scheme=scheme), (values, u))


def test_gradients_of_the_back_trace_agree_with_finite_differences():
    velocity = moving(*SHAPE).requires_grad_()
    positions = (random(5, 3, seed=4) * 2 + 0.4).requires_grad_()
    assert gradcheck(lambda u, p: backtrace(u, p, 0.9, 2), (velocity, positions))


def test_gradient_reaches_an_active_displacement():
    active = torch.tensor([[1, 1, 2], [2, 1, 3], [0, 2, 4]])
    values, u = random(*SHAPE).requires_grad_(), moving(3).requires_grad_()
    assert gradcheck(lambda v, d: warp(v, d, active_ijk=active), (values, u))


@pytest.mark.parametrize("shape", [(8, 8, 8), (8, 8, 1)])
def test_whole_shape_chain_agrees_with_finite_differences(shape):
    """Pyramid, fade, curl, cap, warp, column sums: the way of the shape step's gradient."""
    density, mask = random(*shape), random(*shape, seed=5)
    spacing = (0.5, 0.25, 1.0)
    n_channels = 3 if shape[2] > 1 else 1
    levels = [
        random(*level, n_channels, seed=n) - 0.5 for n, level in enumerate(pyramid_shapes(shape, 3))
    ]

    def columns(*coefficients: Tensor) -> Tensor:
        psi = expand_levels(coefficients) * mask[..., None]
        u = clamp_displacement(from_stream(psi, spacing), 0.9)
        return warp(density, u / torch.tensor(spacing, dtype=torch.float64)).sum(dim=1)

    step, direction = 1e-6, [random(*level.shape, seed=9) - 0.5 for level in levels]
    weights = random(*columns(*levels).shape, seed=8)
    for level in levels:
        level.requires_grad_()
    (columns(*levels) * weights).sum().backward()
    found = sum(
        (level.grad * way).sum().item() for level, way in zip(levels, direction, strict=True)
    )
    with torch.no_grad():
        ends = [
            (columns(*[a + s * b for a, b in zip(levels, direction, strict=True)]) * weights).sum()
            for s in (step, -step)
        ]
    assert found == pytest.approx((ends[0] - ends[1]).item() / (2 * step), rel=1e-6)


def test_mixture_with_both_parts_has_gradients_for_both():
    psi, phi = random(*SHAPE, 3).requires_grad_(), random(*SHAPE, seed=2).requires_grad_()
    warp(random(*SHAPE), from_mixed(psi, phi, (1.0, 1.0, 1.0), 0.5)).square().sum().backward()
    for field in (psi, phi):
        assert field.grad is not None and field.grad.abs().max() > 0

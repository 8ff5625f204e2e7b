"""The quadratic problem of a motion estimate against its energy written out, and a dense solve."""

import pytest
import torch

from usdsmoke.core.sequence.motion_energy import (
    PAIRS,
    Prior,
    apply_prior,
    central_difference,
    solve_increment,
)

PRIOR = Prior(smoothness=0.3, divergence=0.7, gain_smoothness=0.2, gain_size=0.05)
SPACING = (1.0, 2.0, 0.5)
SHAPES = [(4, 5, 3), (6, 4, 1), (2, 1, 2), (1, 1, 1)]


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def prior_energy(motion: torch.Tensor) -> torch.Tensor:
    """Half the prior's energy, term by term."""
    total = 0.5 * PRIOR.gain_size * motion[3].square().sum()
    for axis in range(3):
        steps = torch.diff(motion, dim=axis + 1) / SPACING[axis]
        total = total + 0.5 * PRIOR.smoothness * steps[:3].square().sum()
        total = total + 0.5 * PRIOR.gain_smoothness * steps[3].square().sum()
    rates = [
        torch.gradient(motion[a], spacing=SPACING[a], dim=a)[0]
        if motion.shape[a + 1] > 1
        else torch.zeros_like(motion[a])
        for a in range(3)
    ]
    # one-sided differences at the border count half, as those of a field that goes on unchanged
    for a, rate in enumerate(rates):
        if motion.shape[a + 1] > 1:
            halves = torch.ones(motion.shape[a + 1], dtype=motion.dtype)
            halves[[0, -1]] = 0.5
            rates[a] = rate * halves.reshape([-1 if b == a else 1 for b in range(3)])
    return total + 0.5 * PRIOR.divergence * (rates[0] + rates[1] + rates[2]).square().sum()


@pytest.mark.parametrize("shape", SHAPES)
def test_the_prior_is_the_slope_of_its_energy(shape):
    motion = random(4, *shape).requires_grad_()
    (slope,) = torch.autograd.grad(prior_energy(motion), motion)
    assert torch.allclose(apply_prior(motion.detach(), PRIOR, SPACING), slope, atol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_increment_is_that_of_a_dense_solve(shape):
    rates, error, motion = random(4, *shape), random(*shape, seed=1), random(4, *shape, seed=2)
    tensor = torch.stack([rates[a] * rates[b] for a, b in PAIRS])
    slope = rates * error
    found = solve_increment(tensor, slope, motion, PRIOR, SPACING, 1000, 1e-10)

    def energy(increment: torch.Tensor) -> torch.Tensor:
        increment = increment.reshape(motion.shape)
        seen = 0.5 * ((rates * increment).sum(dim=0) + error).square().sum()
        return seen + prior_energy(motion + increment)

    start = torch.zeros(motion.numel(), dtype=torch.float64, requires_grad=True)
    hessian = torch.autograd.functional.hessian(energy, start)
    (gradient,) = torch.autograd.grad(energy(start), start)
    # a component along an axis of length 1 is seen by nothing but the data: the least one is taken
    wanted = -torch.linalg.pinv(hessian) @ gradient
    assert abs(energy(found.reshape(-1)) - energy(wanted)) < 1e-9
    if min(shape) > 1:
        assert torch.allclose(found.reshape(-1), wanted, atol=1e-7)


def test_nothing_to_do_is_done_exactly():
    nothing = torch.zeros(4, 3, 3, 3)
    tensor = torch.ones(len(PAIRS), 3, 3, 3)
    assert not solve_increment(tensor, nothing, nothing, PRIOR, SPACING, 10, 0.1).any()


def test_central_differences_are_exact_for_a_slope_inside():
    ramp = torch.arange(5.0)[:, None, None].expand(5, 2, 2).contiguous()
    assert torch.equal(central_difference(ramp, 0)[1:-1], torch.ones(3, 2, 2))
    assert not central_difference(ramp, 1).any()
    assert not central_difference(torch.ones(1, 2, 2), 0).any()

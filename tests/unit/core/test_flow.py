"""The flow of a velocity, and how much of it folds space or reads smoke unevenly."""

import pytest
import torch
from torch import Tensor

from tests.fixtures.smoke_fixtures import puff
from usdsmoke.core.fields.displacement import from_stream
from usdsmoke.core.fields.flow import flow, flow_at
from usdsmoke.core.fields.folding import FoldingPenalty, measure_evenness
from usdsmoke.core.fields.resample import smooth
from usdsmoke.core.fields.sample import voxel_positions
from usdsmoke.core.fields.sparse_map import Nodes

SIDE = 28


def noise(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def turning(length: float, sigma: float = 2.0) -> Tensor:
    """A velocity without divergence that turns within a few voxels, [I J K 3] of a given length."""
    velocity = from_stream(smooth(noise(SIDE, SIDE, SIDE, 3), sigma), (1.0, 1.0, 1.0))
    return velocity * (length / velocity.norm(dim=-1).max())


def wave(amplitude: float, wavelength: float) -> Tensor:
    """u = A sin(2 pi x / wavelength) along x, on 32 x 6 x 6 voxels."""
    u = torch.zeros(32, 6, 6, 3, dtype=torch.float64)
    along = torch.arange(32, dtype=torch.float64)[:, None, None]
    u[..., 0] = amplitude * torch.sin(2 * torch.pi * along / wavelength)
    return u


def test_a_constant_velocity_moves_by_itself_inside_the_box():
    velocity = torch.zeros(20, 20, 20, 3, dtype=torch.float64) + torch.tensor([1.0, -0.5, 0.25])
    middle = flow(velocity)[6:14, 6:14, 6:14]
    assert torch.allclose(middle, velocity[6:14, 6:14, 6:14], atol=1e-12)


def test_a_rotation_is_followed_along_its_circle():
    """The closed form: x - u is x turned back by the angle; first order in the steps."""
    angle, axes = 0.2, torch.arange(SIDE, dtype=torch.float64) - (SIDE - 1) / 2
    x, y, _ = torch.meshgrid(axes, axes, axes, indexing="ij")
    velocity = angle * torch.stack([-y, x, torch.zeros_like(x)], dim=-1)
    c, s = torch.cos(torch.tensor(angle)), torch.sin(torch.tensor(angle))
    wanted = torch.stack([x - (c * x + s * y), y - (c * y - s * x), torch.zeros_like(x)], dim=-1)
    near = slice(8, SIDE - 8)
    found, wanted = (field[near, near, near] for field in (flow(velocity), wanted))
    assert (found - wanted).norm(dim=-1).max() < 0.01 * velocity.norm(dim=-1).max() * 2
    # a single step is further away than the flow is
    at_once = velocity[near, near, near]
    assert (found - wanted).norm(dim=-1).max() < 0.3 * (at_once - wanted).norm(dim=-1).max()


@pytest.mark.parametrize("length", [0.1, 3.0, 20.0])
def test_nothing_moves_further_than_the_velocity_is_long(length):
    assert flow(turning(length)).norm(dim=-1).max() <= length * (1 + 1e-9)


def test_the_flow_at_chosen_voxels_is_the_flow_of_the_box():
    velocity = turning(3.0)
    active = torch.rand(SIDE, SIDE, SIDE, generator=torch.Generator().manual_seed(1)) < 0.4
    velocity[~active] = 0
    places = torch.nonzero(active).double()
    found = flow_at(velocity[active], Nodes.where(active), places)
    assert torch.allclose(found, flow(velocity)[active], atol=1e-12)


def test_slopes_of_the_flow_agree_with_finite_differences():
    active = Nodes.where(torch.ones(4, 3, 3, dtype=torch.bool))
    places = voxel_positions((4, 3, 3), torch.zeros((), dtype=torch.float64))
    velocity = (0.3 * noise(36, 3, seed=2)).requires_grad_()
    weights, direction, step = noise(36, 3, seed=3), noise(36, 3, seed=4), 1e-6

    def total(values: Tensor) -> Tensor:
        return (weights * flow_at(values, active, places)).sum()

    (slope,) = torch.autograd.grad(total(velocity), velocity)
    ahead, behind = (total(velocity + sign * step * direction).item() for sign in (1, -1))
    assert float((slope * direction).sum()) == pytest.approx(
        (ahead - behind) / (2 * step), rel=1e-5
    )


def test_a_field_that_folds_at_once_does_not_fold_when_it_is_followed():
    density = torch.from_numpy(puff(SIDE)).double()
    velocity = turning(6.0, sigma=1.5)
    at_once, followed = (measure_evenness(u, density) for u in (velocity, flow(velocity)))
    assert at_once.folded > 0.02
    assert followed.folded < 0.1 * at_once.folded
    assert followed.unread < 0.2 * at_once.unread + 1e-3


@pytest.mark.parametrize("wavelength", [4, 16])
def test_a_wave_that_folds_is_told_although_it_keeps_the_sum(wavelength):
    """A sum over all voxels sees next to nothing of it."""
    found = measure_evenness(wave(5.0, wavelength), torch.ones(32, 6, 6, dtype=torch.float64))
    assert found.folded > 0.2
    assert found.unread > 0.15 and found.read_twice > 0.05


@pytest.mark.parametrize("u", [wave(0.0, 4), torch.full((32, 6, 6, 3), 0.25).double()])
def test_rest_and_a_shift_fold_nothing(u):
    density = torch.zeros(32, 6, 6, dtype=torch.float64)
    density[4:28, 2:4, 2:4] = 1.0
    found = measure_evenness(u, density)
    assert (found.folded, found.unread, found.read_twice) == (0.0, 0.0, 0.0)


def test_the_penalty_is_zero_for_gentle_fields_and_falls_where_it_leads():
    """Steps against its slope unfold a wave."""
    active = Nodes.where(torch.ones(32, 6, 6, dtype=torch.bool))
    penalty = FoldingPenalty(active, active, torch.zeros((), dtype=torch.float64))
    assert penalty(wave(0.3, 16).reshape(-1, 3)) == 0
    u = wave(3.0, 8).reshape(-1, 3).requires_grad_()
    first = penalty(u)
    assert first > 0.1
    for _ in range(60):
        (slope,) = torch.autograd.grad(penalty(u), u)
        u = (u - 10 * slope).detach().requires_grad_()
    assert penalty(u).item() < 0.2 * first.item()


def test_the_penalty_reads_chosen_voxels_alone():
    """What moves elsewhere does not count, and still voxels around are neighbours."""
    smoke = torch.zeros(32, 6, 6, dtype=torch.bool)
    smoke[10:20, 2:4, 2:4] = True
    active = torch.zeros_like(smoke)
    active[8:22] = True
    penalty = FoldingPenalty(
        Nodes.where(smoke), Nodes.where(active), torch.zeros((), dtype=torch.float64)
    )
    far = torch.zeros(32, 6, 6, 3, dtype=torch.float64)
    far[8:9] = 5.0
    assert penalty(far[active]) == 0
    assert penalty(wave(5.0, 4)[active]) > 0

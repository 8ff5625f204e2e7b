"""Interpolation at index positions against closed forms, torch's grid_sample and SciPy."""

from functools import partial

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import Tensor
from torch.autograd import gradcheck

from usdsmoke.base.errors import NonFiniteError, ShapeError
from usdsmoke.core.fields import gather, sample
from usdsmoke.core.fields.gather import planar
from usdsmoke.core.fields.sample import (
    BOUNDARIES,
    sample_cubic,
    sample_linear,
    voxel_positions,
)
from usdsmoke.core.smoke.tasks import computing_threads

SAMPLERS = (sample_linear, sample_cubic)
LOOK_UPS = (*SAMPLERS, partial(sample_linear, boundary="nearest"))
SHAPE = (5, 4, 7)  # asymmetric, so that exchanged axes cannot go unseen


def random(*shape: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def scattered(n: int, shape: tuple[int, ...] = SHAPE, margin: float = 2.0, seed: int = 1) -> Tensor:
    lengths = torch.tensor(shape, dtype=torch.float64)
    return random(n, 3, seed=seed) * (lengths - 1 + 2 * margin) - margin


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_linear_gives_each_voxel_back_bit_for_bit(boundary, dtype):
    values = random(*SHAPE, dtype=dtype)
    sampled = sample_linear(values, voxel_positions(SHAPE, values), boundary=boundary)
    assert torch.equal(sampled.reshape(SHAPE), values)


def test_cubic_goes_through_every_voxel():
    values = random(*SHAPE)
    sampled = sample_cubic(values, voxel_positions(SHAPE, values))
    torch.testing.assert_close(sampled.reshape(SHAPE), values, rtol=0, atol=1e-14)


def test_linear_is_exact_for_trilinear_functions_on_an_asymmetric_box():
    def function(p: Tensor) -> Tensor:
        i, j, k = p.unbind(dim=-1)
        return 2 + 3 * i - 5 * j + 7 * k + 0.5 * i * j - 0.25 * j * k + 0.125 * i * j * k

    values = function(voxel_positions(SHAPE, torch.empty(0, dtype=torch.float64))).reshape(SHAPE)
    positions = scattered(200, margin=0.0)
    torch.testing.assert_close(
        sample_linear(values, positions), function(positions), rtol=1e-13, atol=1e-13
    )


@pytest.mark.parametrize(("boundary", "padding"), [("zero", "zeros"), ("nearest", "border")])
def test_linear_agrees_with_grid_sample_which_wants_the_axes_reversed(boundary, padding):
    values, positions = random(*SHAPE, 2), scattered(300)
    scaled = 2 * positions / (torch.tensor(SHAPE) - 1) - 1
    expected = torch.nn.functional.grid_sample(
        values.permute(3, 0, 1, 2)[None],
        scaled.flip(-1)[None, None, None],
        padding_mode=padding,
        align_corners=True,
    )
    found = sample_linear(values, positions, boundary=boundary)
    torch.testing.assert_close(found, expected[0, :, 0, 0].T, rtol=0, atol=1e-14)


def test_cubic_agrees_with_scipy():
    values, positions = random(*SHAPE), scattered(300, margin=9.0)
    pad = 40  # SciPy's own spline does not see past the border
    expected = ndimage.map_coordinates(
        np.pad(values.numpy(), pad), positions.numpy().T + pad, order=3, mode="constant"
    )
    np.testing.assert_allclose(sample_cubic(values, positions).numpy(), expected, rtol=0, atol=1e-6)


def test_outside_the_box_the_background_takes_over_within_one_voxel():
    values = torch.full((3, 3, 3), 4.0)
    along = torch.tensor([-3.0, -1.0, -0.75, -0.25, 0.0, 2.0, 2.5, 3.0, 40.0])
    positions = torch.stack([along, torch.ones(9), torch.ones(9)], dim=1)
    expected = torch.tensor([0.0, 0.0, 1.0, 3.0, 4.0, 4.0, 2.0, 0.0, 0.0])
    assert torch.equal(sample_linear(values, positions), expected)
    shifted = sample_linear(values, positions, outside=-1.0)
    torch.testing.assert_close(shifted, expected * 1.25 - 1.0)


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_far_outside_nothing_is_smeared_in(sampler):
    values = torch.ones(4, 5, 6)
    far = torch.tensor([[-1e30, 2, 2], [2, 1e30, 2], [2, 2, 60], [-20, -20, -20]])
    assert torch.equal(sampler(values, far), torch.zeros(4))


def test_far_outside_linear_look_ups_give_what_is_there():
    values = torch.ones(4, 5, 6)
    far = torch.tensor([[-1e30, 2, 2], [2, 1e30, 2], [2, 2, 60], [-20, -20, -20]])
    assert torch.equal(sample_linear(values, far, outside=0.5), torch.full((4,), 0.5))
    assert torch.equal(sample_linear(values, far, boundary="nearest"), torch.ones(4))


@pytest.mark.parametrize("sampler", LOOK_UPS)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_flat_axis_is_constant_across(sampler, axis):
    values = random(4, 5).unsqueeze(axis)
    positions = scattered(50, tuple(values.shape))
    moved = positions.clone()
    moved[:, axis] += 1000.0
    thick = values.expand(*[9 if n == axis else -1 for n in range(3)])
    inside = positions.clone()
    inside[:, axis] = 4.0
    found = sampler(values, positions)
    assert torch.equal(found, sampler(values, moved))
    if sampler is not sample_cubic:
        torch.testing.assert_close(found, sampler(thick, inside), rtol=0, atol=1e-13)


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_one_voxel_is_constant_everywhere(sampler):
    found = sampler(torch.full((1, 1, 1), 2.0), torch.tensor([[0.0, 0, 0], [9.5, -3, 1]]))
    assert torch.equal(found, torch.full((2,), 2.0))


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_channels_are_sampled_as_if_alone(sampler):
    values, positions = random(*SHAPE, 3), scattered(60)
    together = sampler(values, positions)
    alone = [sampler(values[..., c].contiguous(), positions) for c in range(3)]
    torch.testing.assert_close(together, torch.stack(alone, dim=1), rtol=0, atol=1e-15)


def test_many_positions_are_sampled_as_if_alone():
    values, positions = random(*SHAPE), scattered(65536 + 5)
    whole = sample_linear(values, positions)
    parts = torch.cat([sample_linear(values, part) for part in positions.split(10007)])
    torch.testing.assert_close(whole, parts, rtol=0, atol=1e-15)


@pytest.mark.parametrize("sampler", LOOK_UPS)
@pytest.mark.parametrize("shape", [SHAPE, (6, 1, 5), (*SHAPE, 2)])
def test_adjoint_is_exact(sampler, shape):
    values = random(*shape).requires_grad_()
    positions = scattered(500, shape[:3])
    sampled = sampler(values, positions)
    weights = random(*sampled.shape, seed=2) - 0.5
    (adjoint,) = torch.autograd.grad(sampled, values, weights)
    left, right = (sampled * weights).sum(), (values * adjoint).sum()
    assert (left - right).abs().item() <= 1e-14 * sampled.abs().sum().item()


@pytest.mark.parametrize("sampler", [*LOOK_UPS, partial(sample_linear, outside=0.3)])
@pytest.mark.parametrize("shape", [(4, 3, 3), (4, 1, 5), (2, 3, 2, 2)])
def test_gradients_agree_with_finite_differences(sampler, shape):
    values = random(*shape).requires_grad_()
    positions = scattered(6, shape[:3]).requires_grad_()
    assert gradcheck(sampler, (values, positions))


def test_cubic_error_falls_with_the_fourth_power_of_the_voxel_size():
    sizes, errors = (96, 128, 192, 256), []
    for n in sizes:
        bump = torch.exp(-((((torch.arange(n, dtype=torch.float64) + 0.5) / n - 0.5) / 0.12) ** 2))
        values = (bump[:, None] * bump)[:, None, :]
        positions = scattered(2000, (n, 1, n), margin=0.0)
        at = torch.exp(-((((positions + 0.5) / n - 0.5) / 0.12) ** 2))
        exact = at[:, 0] * at[:, 2]
        errors.append(float((sample_cubic(values, positions) - exact).abs().mean()))
    slope = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert slope == pytest.approx(4.0, abs=0.1)


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_no_positions_give_no_values(sampler):
    assert sampler(torch.ones(3, 4, 5, 2), torch.empty(0, 3)).shape == (0, 2)


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize(
    ("values", "positions", "message"),
    [
        (torch.ones(3, 3), torch.zeros(1, 3), r"shape \[3, 3\]"),
        (torch.ones(0, 0, 0), torch.zeros(1, 3), "at least one voxel"),
        (torch.ones(3, 3, 3), torch.zeros(3), r"positions have shape \[3\]"),
        (torch.ones(3, 3, 3), torch.zeros(1, 3).double(), "float64"),
    ],
)
def test_what_does_not_fit_is_refused(sampler, values, positions, message):
    with pytest.raises(ShapeError, match=message):
        sampler(values, positions)


def test_unknown_boundary_is_refused():
    with pytest.raises(ShapeError, match=r"periodic.* zero, nearest"):
        sample_linear(torch.ones(3, 3, 3), torch.zeros(1, 3), boundary="periodic")


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
def test_non_finite_positions_are_counted_and_refused(bad):
    positions = torch.zeros(10, 3)
    positions[[2, 7], 1] = bad
    with pytest.raises(NonFiniteError, match=r"2 of 10.*NaN or infinite"):
        sample_linear(torch.ones(3, 3, 3), positions)


def test_positions_in_the_box_sample_the_same_bits_beside_some_outside():
    """A point beyond the box sends its whole chunk the longer way."""
    generator = torch.Generator().manual_seed(3)
    box = torch.rand(5, 6, 7, generator=generator)
    inside = torch.rand(200, 3, generator=generator) * torch.tensor([4.0, 5.0, 6.0])
    inside[:3] = torch.tensor([[0.0, 0.0, 0.0], [4.0, 5.0, 6.0], [2.0, 3.0, 1.0]])
    found = []
    for beyond in (torch.empty(0, 3), torch.tensor([[-0.5, 2.0, 6.5]])):
        positions = torch.cat([inside, beyond]).requires_grad_()
        sampled = sample_linear(box, positions)[: len(inside)]
        (slopes,) = torch.autograd.grad(sampled.sum(), positions)
        found.append((sampled, slopes[: len(inside)]))
    assert all(torch.equal(one, other) for one, other in zip(*found, strict=True))


@pytest.mark.parametrize("channels", [(), (3,)])
def test_cubic_look_ups_in_chunks_have_the_bits_of_those_at_once(monkeypatch, channels):
    torch.manual_seed(3)
    values = torch.rand(6, 7, 5, *channels)
    positions = torch.rand(50, 3) * 9 - 2
    # with gradients wanted all points are taken together
    at_once = sample_cubic(values, positions.clone().requires_grad_()).detach()
    monkeypatch.setattr(sample, "CUBIC_CHUNK", 8)
    for n_threads in (1, 2):
        with computing_threads(n_threads):
            assert torch.equal(sample_cubic(values, positions), at_once)


def test_planar_values_are_the_same_values_and_are_not_copied_to_be_sampled():
    values = torch.rand(4, 5, 6, 3)
    flat = planar(values)
    positions = torch.rand(20, 3) * 4
    assert torch.equal(flat, values) and flat.movedim(-1, 0).is_contiguous()
    assert torch.equal(sample_linear(flat, positions), sample_linear(values, positions))
    assert gather._planes(gather._flatten(flat)[0]).data_ptr() == flat.data_ptr()

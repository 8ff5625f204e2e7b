"""The optimiser of a training: convolutions turn as a whole, other parameters go by Adam."""

import pytest
import torch

from usdsmoke.core.steps.optimize import Adam
from usdsmoke.core.training.orthogonal import LEAP, Orthogonal, orthogonal


def drawn(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("unit", [1e-18, 1.0, 1e18])
def test_a_matrix_gets_singular_values_of_one_in_any_unit(unit: float) -> None:
    matrix = drawn(54, 4) @ torch.diag(torch.tensor([1.0, 1e-1, 1e-2, 1e-3]))
    u, _, v = torch.linalg.svd(matrix.double(), full_matrices=False)
    torch.testing.assert_close(orthogonal(unit * matrix).double(), u @ v, atol=1e-4, rtol=0)


def test_what_has_no_slope_does_not_move() -> None:
    first, second = drawn(54, 2).T
    matrix = torch.stack([first, second, first + second, 0 * first], 1)
    values = torch.linalg.svdvals(orthogonal(matrix))
    torch.testing.assert_close(values, torch.tensor([1.0, 1.0, 0.0, 0.0]), atol=1e-4, rtol=0)
    assert torch.equal(orthogonal(torch.zeros(5, 3)), torch.zeros(5, 3))


def test_convolutions_turn_and_other_parameters_go_by_adam() -> None:
    weight, bias, plain = torch.zeros(27, 2, 3), torch.zeros(3), torch.zeros(3)
    ours, adam = Orthogonal(), Adam()
    for seed in range(3):
        before, slopes = weight.clone(), drawn(3, seed=seed)
        ours.step([weight, bias], [drawn(27, 2, 3, seed=seed), slopes], 0.01)
        adam.step([plain], [slopes], 0.01)
        moved = torch.linalg.svdvals((weight - before).view(54, 3))
        torch.testing.assert_close(moved, torch.full((3,), 0.01 * LEAP))
    assert torch.equal(bias, plain) and bias.any()


def test_steps_follow_a_running_mean_that_a_copy_has_for_itself() -> None:
    weight, slopes = torch.zeros(27, 2, 3), [drawn(27, 2, 3, seed=seed) for seed in range(4)]
    ours, forgetful = Orthogonal(), Orthogonal()
    ours.step([weight], slopes[:1], 0.01)
    kept, begun = ours.copy(), weight.clone()
    ours.step([weight], slopes[1:2], 0.01)
    expected = weight.clone()
    ours.step([weight], slopes[2:3], 0.01)  # leaves the copy alone
    ours.restore(kept)
    weight.copy_(begun)
    ours.step([weight], slopes[1:2], 0.01)
    assert torch.equal(weight, expected)
    weight.copy_(begun)
    forgetful.step([weight], slopes[1:2], 0.01)
    assert not torch.allclose(weight, expected)

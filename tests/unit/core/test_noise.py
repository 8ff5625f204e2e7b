"""The noise is uniform or normal, uncorrelated, and belongs to the voxel alone."""

import math

import numpy as np
import pytest
import torch
from scipy import stats
from torch import Tensor

from usdsmoke.base.errors import ShapeError
from usdsmoke.core.smoke.noise import white_noise


def box(*ranges: tuple[int, int]) -> Tensor:
    axes = [torch.arange(low, high) for low, high in ranges]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1).reshape(-1, 3)


CUBE = box((-30, 30), (-30, 30), (-30, 30))


def correlation(a: Tensor, b: Tensor) -> float:
    return float(np.corrcoef(a.double().flatten(), b.double().flatten())[0, 1])


def test_white_noise_is_uniform():
    noise = white_noise(CUBE, 3, seed=7).double().flatten().numpy()
    n = noise.size
    assert noise.min() >= 0 and noise.max() < 1
    assert noise.mean() == pytest.approx(0.5, abs=4 * math.sqrt(1 / 12 / n))
    assert noise.var() == pytest.approx(1 / 12, abs=4 * math.sqrt(1 / 180 / n))
    assert stats.kstest(noise, "uniform").pvalue > 1e-3


@pytest.mark.parametrize("shift", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1), (1, -1, 0)])
def test_neighbours_are_uncorrelated(shift):
    noise, moved = white_noise(CUBE, 1, 0), white_noise(CUBE + torch.tensor(shift), 1, 0)
    assert abs(correlation(noise, moved)) < 4 / math.sqrt(len(CUBE))


def test_channels_and_seeds_are_uncorrelated():
    noise = white_noise(CUBE, 3, 0)
    limit = 4 / math.sqrt(noise.numel() / 3)
    assert (
        max(abs(correlation(noise[:, a], noise[:, b])) for a, b in [(0, 1), (0, 2), (1, 2)]) < limit
    )
    for seed in (1, 2, -1, 2**40):
        assert abs(correlation(noise, white_noise(CUBE, 3, seed))) < limit


def test_spectrum_is_flat():
    side = 60
    noise = white_noise(CUBE, 1, 3).double().reshape(side, side, side).numpy() - 0.5
    power = np.abs(np.fft.rfftn(noise)) ** 2 * 12 / side**3
    # The largest of n exponential numbers of mean 1 exceeds log n + 7 once in a thousand draws.
    assert power.max() < math.log(power.size) + 7


def test_crop_order_and_number_do_not_matter():
    whole = white_noise(CUBE, 2, 5).reshape(60, 60, 60, 2)
    crop = white_noise(box((-3, 8), (4, 9), (-30, -1)), 2, 5).reshape(11, 5, 29, 2)
    assert torch.equal(whole[27:38, 34:39, 0:29], crop)
    shuffled = torch.randperm(len(CUBE), generator=torch.Generator().manual_seed(0))
    assert torch.equal(whole.reshape(-1, 2)[shuffled], white_noise(CUBE[shuffled], 2, 5))
    assert torch.equal(whole.reshape(-1, 2)[77:78], white_noise(CUBE[77:78], 2, 5))


def test_number_of_channels_does_not_change_the_first_ones():
    assert torch.equal(white_noise(CUBE[:100], 4, 1)[:, :2], white_noise(CUBE[:100], 2, 1))


def test_number_of_threads_does_not_matter():
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        one = white_noise(CUBE, 3, 2)
        torch.set_num_threads(2)
        assert torch.equal(one, white_noise(CUBE, 3, 2))
    finally:
        torch.set_num_threads(threads)


def test_bits_are_those_of_a_calculation_with_plain_integers():
    mask = 2**64 - 1
    steps = (
        -0x61C8864680B583EB,
        0x5851F42D4C957F2D,
        -0x2EF35C3C0DEDCE2B,
        0x369DEA0F31A53F85,
    )

    def scramble(word: int) -> int:
        word = (word ^ word >> 30) * 0xBF58476D1CE4E5B9 & mask
        word = (word ^ word >> 27) * 0x94D049BB133111EB & mask
        return word ^ word >> 31

    seed = 12345
    key = scramble(scramble(seed + 1))
    for voxel in [(0, 0, 0), (-4, 7, 1_000_000), (2**31, -(2**31), 5)]:
        for channel in range(2):
            word = sum(a * b for a, b in zip((*voxel, channel), steps, strict=True))
            word = scramble(scramble((word + key) & mask) ^ key)
            expected = (word >> 40) / 2**24
            assert float(white_noise(torch.tensor([voxel]), 2, seed)[0, channel]) == expected


def test_no_voxels_give_no_numbers():
    assert white_noise(torch.empty(0, 3, dtype=torch.int64), 3, 0).shape == (0, 3)


@pytest.mark.parametrize(
    ("ijk", "n_channels", "message"),
    [
        (torch.zeros(4, 3), 1, r"torch.float32 of shape \[4, 3\].* int64"),
        (torch.zeros(3, dtype=torch.int64), 1, r"shape \[3\]"),
        (torch.zeros(4, 3, dtype=torch.int64), 0, "0 channels.* 1"),
    ],
)
def test_what_does_not_fit_is_refused(ijk, n_channels, message):
    with pytest.raises(ShapeError, match=message):
        white_noise(ijk, n_channels, 0)

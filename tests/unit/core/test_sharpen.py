"""Detail of voxels, and how much of it is added."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.fixtures.smoke_fixtures import random_style, smoke_of
from tests.fixtures.stylize_fixtures import puff_problem, unseen_loss
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.noise import white_noise
from usdsmoke.core.smoke.spread import Surroundings, luma_detail
from usdsmoke.core.steps import sharpen
from usdsmoke.core.steps.colour import run_colour_step
from usdsmoke.core.steps.sharpen import MOST, lowest, sharpened

START = torch.full((50, 3), 0.5)
DETAIL = torch.linspace(-0.3, 0.3, 50)[:, None]


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("period", [2, 4, 6])
def test_detail_is_what_three_means_over_three_voxels_leave_of_a_wave(axis, period):
    smoke = smoke_of(np.ones((24, 24, 24)))
    ijk = smoke.ijk - smoke.ijk.amin(0)
    wave = 0.1 * torch.cos(2 * math.pi * ijk[:, axis] / period)
    colours = 0.5 + torch.stack([wave, wave, wave], dim=1)
    found = luma_detail(Surroundings(smoke, torch.ones(len(colours))), colours)[:, 0]
    left = 1 - ((1 + 2 * math.cos(2 * math.pi / period)) / 3) ** 3
    inside = (ijk[:, axis] >= 3) & (ijk[:, axis] < 21)  # beyond: no voxel, not a wave
    assert torch.allclose(found[inside], left * wave[inside], atol=1e-5)


def test_even_colours_and_slopes_have_no_detail():
    smoke = smoke_of(np.ones((12, 12, 12)))
    ijk = (smoke.ijk - smoke.ijk.amin(0)).float()
    slope = (0.2 + 0.02 * ijk[:, :1] + 0.01 * ijk[:, 2:]).expand(-1, 3)
    found = luma_detail(Surroundings(smoke, torch.ones(len(slope))), slope)[:, 0]
    inside = ((ijk >= 3) & (ijk < 9)).all(dim=1)
    assert found[inside].abs().max() < 1e-6
    assert luma_detail(Surroundings(smoke, slope[:, 0]), 0 * slope + 0.7).abs().max() < 1e-6


def test_detail_is_the_difference_from_dense_smoke_and_nothing_where_all_around_is_empty():
    smoke = ActiveSmoke(torch.tensor([[0, 0, 0], [0, 0, 1], [9, 9, 9]]), torch.ones(3), np.eye(4))
    colours = torch.tensor([[0.2] * 3, [0.8] * 3, [0.4] * 3])
    found = luma_detail(Surroundings(smoke, torch.tensor([1e6, 1.0, 0.0])), colours)[:, 0]
    # around is .2: two thirds of the luma where detail counts fully
    assert found.tolist() == pytest.approx([0.0, 0.4, 0.0], abs=1e-5)


def test_detail_of_dark_smoke_counts_as_much_less_as_it_is_darker():
    smoke = smoke_of(np.ones((8, 8, 8)))
    noise = 0.02 * (white_noise(smoke.ijk, 1, 0) - 0.5)
    weight = torch.ones(len(noise))
    bright, dark, black = (
        luma_detail(Surroundings(smoke, weight), (level + noise).expand(-1, 3))
        for level in (0.6, 0.15, 0.0)
    )
    assert torch.allclose(dark, 0.5 * bright, atol=5e-4)
    assert black.abs().max() < 0.05 * bright.abs().max()


@pytest.mark.parametrize(
    ("values", "place"),
    [
        ((0.09, 0.04, 0.49), 0.3),  # (x - .3)²
        ((1.0, 2.0, 5.0), 0.0),  # rises from the start
        ((4.0, 2.25, 1.0), 1.0),  # (2 - x)²: lowest beyond the end
        ((3.0, 2.0, 1.0), 1.0),  # a line
        ((1.0, 3.0, 2.0), 0.0),  # bent the other way: the lower end
        ((2.0, 3.0, 1.0), 1.0),
        ((1.0, 1.0, 1.0), 0.0),
        ((math.nan, 1.0, 1.0), 0.0),
        ((1.0, math.nan, 0.0), 0.0),
        ((1.0, 1.0, math.nan), 0.0),
    ],
)
def test_where_a_parabola_is_lowest(values, place):
    assert lowest(*values) == pytest.approx(place)


@pytest.mark.parametrize(("wanted", "added"), [(0.3, 0.3), (0.0, 0.0), (-0.5, 0.0), (3.0, MOST)])
def test_as_much_detail_is_added_as_the_loss_asks_for(wanted, added):
    aim = START + wanted * DETAIL
    found = sharpened(START, DETAIL, 1.0, lambda c: float((c - aim).square().sum()))
    assert torch.allclose(found, START + added * DETAIL, atol=1e-6)


def test_sharpened_colours_stay_in_range_and_the_given_ones_as_they_are():
    before = START.clone()
    found = sharpened(START, 9 * DETAIL, 0.9, lambda c: -float(c.std()))
    assert found.min() == 0.0 and found.max() == pytest.approx(0.9)
    assert torch.equal(START, before)


def judged(monkeypatch, most: float, n_iterations: int = 20) -> tuple[Tensor, float]:
    """Colours after few iterations, and their loss in views that these have not had."""
    monkeypatch.setattr(sharpen, "MOST", most)
    problem = puff_problem(random_style(32, 40, 0))
    colours, _ = run_colour_step(problem, [0, 0, n_iterations])
    return colours, unseen_loss(problem, colours)


def test_the_colour_step_is_nearer_to_a_style_of_pixels_with_it(monkeypatch):
    """Random pixels have all the contrast there is in the finest band."""
    with_it, without = judged(monkeypatch, MOST), judged(monkeypatch, 0.0)
    assert not torch.equal(with_it[0], without[0])
    assert with_it[1] < 0.99 * without[1]


def test_nothing_is_sharpened_that_no_iteration_mends(monkeypatch):
    with_it, without = judged(monkeypatch, MOST, 12), judged(monkeypatch, 0.0, 12)
    assert torch.equal(with_it[0], without[0])

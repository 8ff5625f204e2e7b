"""Colours are brought to the hues that a style has at their luma."""

import pytest
import torch
from torch import Tensor

from tests.fixtures.smoke_fixtures import random_style
from usdsmoke.core.smoke.srgb import BRIGHTEST, luma
from usdsmoke.core.style.hues import NEAR, Hues, count_hues

RED, BLUE = (0.6, 0.1, 0.1), (0.1, 0.15, 0.9)  # of about one luma


def flames(n_blue: int = 0) -> Tensor:
    """100 x 100 pixels from black through red to yellow, with as many blue ones in the middle."""
    heat = torch.linspace(0, 1, 10000)
    pixels = torch.stack([(2 * heat).clamp(max=1), (2 * heat - 1).clamp(min=0), 0 * heat], 1)
    pixels[3000 : 3000 + n_blue] = torch.tensor(BLUE)
    return pixels.view(100, 100, 3)


def hues(*pixels: Tensor) -> Hues:
    return Hues(sum((count_hues(p) / len(pixels) for p in pixels), torch.zeros(())))


def test_a_hue_that_the_style_has_not_becomes_one_of_its():
    green = torch.tensor([[0.1, 0.5, 0.1], [0.05, 0.15, 0.05]])
    found = hues(flames()).nearest(green)
    assert torch.allclose(luma(found), luma(green), atol=0.03)
    assert (found[:, 0] > found[:, 1] + 0.1).all()
    again = hues(flames()).nearest(found)  # where the first way was cut at the ends of the range
    assert (hues(flames()).nearest(again) - again).abs().max() < NEAR


def test_colours_of_the_style_stay():
    pixels = flames()
    inside = pixels.view(-1, 3)[1000:9000:50]
    assert (hues(pixels).nearest(inside) - inside).abs().max() < NEAR


def test_more_saturated_colours_of_a_hue_stay():
    dull = torch.tensor([[0.5, 0.4, 0.4]])
    pixels = dull.expand(400, 3).view(20, 20, 3)
    grey = luma(dull)[:, None]
    style = hues(pixels)
    twice = grey + 1.8 * (dull - grey)
    assert (style.nearest(twice) - twice).abs().max() < NEAR
    often = grey + 6 * (dull - grey)
    assert (style.nearest(often) - often).abs().max() > 0.1


def test_what_has_not_changed_stays():
    colours = torch.tensor([[0.1, 0.5, 0.1], [0.2, 0.6, 0.2]])
    before = colours - torch.tensor([[0.0], [0.1]])
    found = hues(flames()).nearest(colours, before)
    assert torch.equal(found[0], colours[0])
    assert torch.equal(found[1:], hues(flames()).nearest(colours[1:]))


@pytest.mark.parametrize(("n_blue", "stays"), [(10, False), (1000, True)])
def test_rare_hues_stay_and_single_pixels_do_not(n_blue, stays):
    found = hues(flames(n_blue)).nearest(torch.tensor([BLUE]))
    assert (found[0, 2] > 0.8).item() is stays


def test_where_the_style_has_no_such_luma_colours_take_the_hues_of_the_nearest():
    between = torch.tensor([[0.3, 0.4, 0.5], [0.7, 0.85, 0.9]])
    ends = torch.cat([flames() * 0.3, torch.ones(100, 100, 3)])
    found = hues(ends).nearest(between)
    assert torch.allclose(luma(found), luma(between), atol=0.03)
    assert found[0, 0] > found[0, 2] + 0.1  # yellow
    assert (found[1] - luma(found)[1]).abs().max() < NEAR  # white


def test_what_is_brighter_than_the_style_takes_the_hues_of_its_brightest_colours():
    cyan = torch.tensor([[0.2, 0.95, 0.9], [0.5, BRIGHTEST, BRIGHTEST]])
    dull = flames() * 0.6  # yellow of luma 0.56 at the most
    found = hues(dull).nearest(cyan)
    assert torch.allclose(luma(found), luma(cyan), atol=0.03)
    assert (found[:, 0] > found[:, 2] + 0.2).all()


@pytest.mark.parametrize("levels", [(0.0, 1.0), (0.2, 0.5, 0.6)])
def test_a_grey_style_has_no_hues_at_any_luma(levels: tuple[float, ...]) -> None:
    pixels = torch.tensor(levels).repeat_interleave(50)[:, None].expand(-1, 3).reshape(-1, 10, 3)
    tinted = torch.tensor([[0.5, 0.3, 0.4], [0.1, 0.2, 0.1], [0.9, 0.6, 1.0]])
    found = hues(pixels).nearest(tinted)
    assert (found - luma(found)[:, None]).abs().max() < 1e-6


def test_hues_of_two_styles_are_both_there():
    red, blue = (torch.tensor(c).expand(20, 20, 3) for c in (RED, BLUE))
    both = torch.tensor([RED, BLUE])
    assert (hues(red, blue).nearest(both) - both).abs().max() < NEAR
    assert (hues(red).nearest(both[1:]) - both[1:]).abs().max() > 0.2


def test_of_noise_hardly_any_hue_is_missing():
    pixels = torch.as_tensor(random_style(64, 64)).float()
    inside = pixels.view(-1, 3)
    assert ((hues(pixels).nearest(inside) - inside).abs().amax(1) < NEAR).float().mean() > 0.9

"""The ways from patches of a picture to the nearest ones of a style, and back."""

import math

import pytest
import torch
from torch import Tensor

from usdsmoke.core.style import patches
from usdsmoke.core.style.patches import MOST_LOOKED_UP, MOST_STYLE, SIDE, StylePatches


def noise(height: int, width: int, seed: int = 0) -> Tensor:
    return torch.rand(
        height, width, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64
    )


def every_patch(pixels: Tensor) -> Tensor:
    """[P D], row by row."""
    windows = pixels.unfold(0, SIDE, 1).unfold(1, SIDE, 1)  # [h w 3 SIDE SIDE]
    return windows.permute(0, 1, 3, 4, 2).flatten(2).flatten(0, 1)


def spread_of(style: Tensor) -> float:
    return float(every_patch(style).view(-1, 3).std(0, correction=0).mean())


def squares(style: Tensor, picture: Tensor) -> Tensor:
    """Of the ways between all patches, [style picture], without a search along axes."""
    apart = every_patch(style)[:, None] - every_patch(picture)[None]
    return apart.square().mean(2) / spread_of(style) ** 2


def root(square: Tensor) -> float:
    """Rounded at 0."""
    return math.sqrt(float(square) + 1e-8) - 1e-4


@pytest.fixture
def one_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(patches, "BACK", 0.0)


@pytest.mark.usefixtures("one_way")
def test_it_is_the_root_mean_square_way_to_the_nearest_patch() -> None:
    style, picture = noise(9, 10), noise(11, 12, seed=1)
    found = StylePatches(style).loss(picture, None).item()
    assert found == pytest.approx(root(squares(style, picture).amin(0).mean()), rel=1e-6)
    assert StylePatches(style, 3.0).loss(picture, None).item() == pytest.approx(3 * found)


@pytest.mark.usefixtures("one_way")
def test_patches_count_by_how_much_of_them_is_smoke() -> None:
    style, picture = noise(9, 10), noise(11, 20, seed=1)
    guide = torch.zeros(11, 20, dtype=torch.float64)
    guide[:, :10] = 1.0
    share = every_patch(guide[..., None]).mean(1)
    weight = torch.where(share > 0.5, share.square(), 0.0)
    ways = squares(style, picture).amin(0)
    wanted = root((ways * weight).sum() / weight.sum())
    assert StylePatches(style).loss(picture, guide).item() == pytest.approx(wanted, rel=1e-6)
    beyond = picture.clone()
    beyond[:, 14:] = 50.0  # patches that reach so far have less than half of smoke
    assert StylePatches(style).loss(beyond, guide).item() == pytest.approx(wanted, rel=1e-6)


def test_the_style_s_patches_look_back_in_turns() -> None:
    style, picture = noise(9, 11), noise(11, 12, seed=1)  # an odd number of patches
    ways, style_patches = squares(style, picture), StylePatches(style)
    there = root(ways.amin(0).mean())
    backs = [style_patches.loss(picture, None, draw).item() - there for draw in (0, 1)]
    # the two turns share one patch; their numbers are 8 and 8 of 15
    assert 15 <= sum(8 * back**2 for back in backs) / ways.amin(1).mean().item() <= 17
    assert backs[0] != pytest.approx(backs[1], rel=1e-3)


@pytest.mark.usefixtures("one_way")
def test_draws_that_follow_each_other_look_up_all_of_many_patches() -> None:
    side = math.isqrt(2 * MOST_LOOKED_UP) + SIDE - 1
    style, picture = noise(9, 10), noise(side, side, seed=1)
    style_patches = StylePatches(style)
    found = [style_patches.loss(picture, None, draw).item() for draw in range(3)]
    wanted = squares(style, picture).amin(0).mean().item()
    assert (found[0] ** 2 + found[1] ** 2) / 2 == pytest.approx(wanted, rel=1e-3)
    assert found[2] == found[0] != found[1]


def test_the_gradients_lead_to_the_nearest_patches() -> None:
    style, picture = noise(9, 10), noise(9, 9, seed=1).requires_grad_(True)
    guide = torch.linspace(0.8, 1, 81, dtype=torch.float64).view(9, 9)
    style_patches = StylePatches(style)
    assert torch.autograd.gradcheck(lambda p: style_patches.loss(p, guide), picture)


@pytest.mark.parametrize("shape", [(SIDE - 1, 40), (40, SIDE - 1)])
def test_a_picture_smaller_than_a_patch_is_left_alone(shape: tuple[int, int]) -> None:
    picture = noise(*shape).requires_grad_(True)
    loss = StylePatches(noise(20, 20)).loss(picture, None)
    assert loss.item() == 0
    assert not torch.autograd.grad(loss, picture)[0].any()


def test_a_picture_without_smoke_is_left_alone() -> None:
    picture = noise(20, 20).requires_grad_(True)
    loss = StylePatches(noise(20, 20)).loss(picture, torch.zeros(20, 20, dtype=torch.float64))
    assert loss.item() == 0
    assert not torch.autograd.grad(loss, picture)[0].any()


def test_patches_lie_in_the_areas_that_count() -> None:
    style, picture = noise(24, 24), noise(12, 12, seed=1)
    alpha = torch.zeros(24, 24, 1, dtype=torch.float64)
    alpha[:, 12:] = 1.0
    marked = torch.cat([style, alpha], 2)
    part = StylePatches(style[:, 12:])
    assert StylePatches(marked).loss(style[:, 12:], None).item() < 1e-9
    assert StylePatches(marked).loss(style[:, :12], None).item() > 1.0
    # patches are drawn in another order, so other ones look back: both turns together agree
    by_turn = [
        sum(each.loss(picture, None, draw).item() for draw in (0, 1))
        for each in (StylePatches(marked), part)
    ]
    assert by_turn[0] == pytest.approx(by_turn[1], rel=0.02)


def test_areas_narrower_than_a_patch_have_the_patches_around_them() -> None:
    style = noise(24, 24)
    alpha = torch.zeros(24, 24, 1, dtype=torch.float64)
    alpha[:, 12:14] = 1.0
    found = StylePatches(torch.cat([style, alpha], 2)).loss(style[:, 7:19], None).item()
    assert found < StylePatches(style[:, :7]).loss(style[:, 7:19], None).item()


def test_a_style_of_one_colour_pulls_at_all_of_a_picture_alike() -> None:
    style = torch.full((20, 20, 3), 0.25)
    picture = torch.full((20, 20, 3), 0.26).requires_grad_(True)
    loss = StylePatches(style).loss(picture, None)
    assert loss.item() == pytest.approx(0.01 / patches.LEAST_SPREAD, rel=1e-3)
    (slope,) = torch.autograd.grad(loss, picture)
    inner = slope[SIDE:-SIDE, SIDE:-SIDE]
    assert torch.allclose(inner, inner[:1, :1].expand_as(inner), rtol=1e-3)


def test_of_a_large_style_other_seeds_draw_other_patches() -> None:
    side = math.isqrt(2 * MOST_STYLE) + SIDE
    style, picture = noise(side, side), noise(20, 20, seed=1)
    by_seed = [StylePatches(style, seed=seed).loss(picture, None).item() for seed in (0, 0, 1)]
    assert by_seed[0] == by_seed[1] != by_seed[2]
    assert by_seed[0] == pytest.approx(by_seed[2], rel=0.05)


def stripes() -> Tensor:
    light = (torch.arange(64) // 4 % 2).float()
    return light[:, None, None].expand(64, 64, 3) * torch.tensor([0.9, 0.5, 0.1])


def test_a_picture_of_mixtures_is_farther_than_one_of_pieces_of_the_style() -> None:
    style = stripes()
    crossed = 0.5 * (style + style.transpose(0, 1))
    near, far = (StylePatches(style).loss(each, None) for each in (style.roll(8, 0), crossed))
    assert 5 * near < far


def test_a_blurred_picture_is_farther_than_a_sharp_one() -> None:
    style = stripes()
    blurred = torch.stack([style.roll(by, 0) for by in (-1, 0, 1)]).mean(0)
    near, far = (StylePatches(style).loss(each, None) for each in (style.roll(3, 0), blurred))
    assert 5 * near < far


def test_a_picture_of_half_of_the_style_is_farther_than_one_of_all_its_pieces() -> None:
    """Each place of either is a place of the style."""
    rows = torch.arange(64)
    light = torch.where(rows < 32, rows // 2 % 2, rows // 8 % 2).float()
    style = light[:, None, None].expand(64, 64, 3) * torch.tensor([0.9, 0.5, 0.1])
    half = torch.cat([style[32:], style[32:]])
    near, far = (StylePatches(style).loss(each, None) for each in (style.flip(1), half))
    assert 3 * near < far

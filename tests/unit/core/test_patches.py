"""The ways from patches of a picture to the nearest ones of a style, and back."""

import math

import pytest
import torch
from torch import Tensor

from usdsmoke.core.style import patches
from usdsmoke.core.style.patches import (
    FEWEST_STYLE,
    MOST_LOOKED_UP,
    MOST_STYLE,
    SIDE,
    StylePatches,
    patch_shares,
)


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


def loss_of(
    style: Tensor, picture: Tensor, guide: Tensor | None = None, draw: int = 0, seed: int = 0
) -> Tensor:
    shares = patch_shares(torch.ones_like(picture[..., 0]) if guide is None else guide)
    return StylePatches(style, seed=seed).loss(picture, shares, draw)


def root(square: Tensor) -> float:
    """Rounded at 0."""
    return math.sqrt(float(square) + 1e-8) - 1e-4


@pytest.fixture
def one_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(patches, "BACK", 0.0)


@pytest.mark.usefixtures("one_way")
def test_it_is_the_root_mean_square_way_to_the_nearest_patch() -> None:
    style, picture = noise(9, 10), noise(11, 12, seed=1)
    found = loss_of(style, picture).item()
    assert found == pytest.approx(root(squares(style, picture).amin(0).mean()), rel=1e-6)
    heavy = StylePatches(style, 3.0).loss(picture, patch_shares(torch.ones(11, 12).double()))
    assert heavy.item() == pytest.approx(3 * found)


@pytest.mark.usefixtures("one_way")
def test_patches_count_by_how_much_of_them_is_smoke() -> None:
    style, picture = noise(9, 10), noise(11, 20, seed=1)
    guide = torch.zeros(11, 20, dtype=torch.float64)
    guide[:, :10] = 1.0
    share = every_patch(guide[..., None]).mean(1)
    weight = torch.where(share > 0.5, share.square(), 0.0)
    ways = squares(style, picture).amin(0)
    wanted = root((ways * weight).sum() / weight.sum())
    assert loss_of(style, picture, guide).item() == pytest.approx(wanted, rel=1e-6)
    beyond = picture.clone()
    beyond[:, 14:] = 50.0  # patches that reach so far have less than half of smoke
    assert loss_of(style, beyond, guide).item() == pytest.approx(wanted, rel=1e-6)


def test_it_adds_the_way_from_the_style_s_patches_to_the_nearest() -> None:
    style, picture = noise(9, 11), noise(11, 12, seed=1)
    ways = squares(style, picture)
    wanted = root(ways.amin(0).mean()) + root(ways.amin(1).mean())
    assert loss_of(style, picture).item() == pytest.approx(wanted, rel=1e-6)


def test_many_patches_of_a_style_look_back_in_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each meets all patches of the picture, also where there are as many draws as turns."""
    monkeypatch.setattr(patches, "MOST_LOOKING_BACK", 8)
    style, picture = noise(10, 12), noise(11, 12, seed=1)  # 24 patches: three turns
    ways = squares(style, picture)
    there = root(ways.amin(0).mean())
    backs = [loss_of(style, picture, draw=draw).item() - there for draw in range(6)]
    mean = sum((back + 1e-4) ** 2 - 1e-8 for back in backs[:3]) / 3
    assert mean == pytest.approx(ways.amin(1).mean().item(), rel=1e-6)
    turns = [{round(back, 9) for back in part} for part in (backs[:3], backs[3:])]
    assert turns[0] == turns[1] and len(turns[0]) == 3
    for n_draws, most in ((3, 10), (4, 8), (6, 5)):
        monkeypatch.setattr(patches, "MOST_LOOKED_UP", most)  # of 30
        n = 3 * n_draws
        found = {round(loss_of(style, picture, draw=draw).item(), 9) for draw in range(n)}
        assert len(found) == n


@pytest.mark.usefixtures("one_way")
def test_draws_that_follow_each_other_look_up_all_of_many_patches() -> None:
    side = math.isqrt(2 * MOST_LOOKED_UP) + SIDE - 1
    style, picture = noise(9, 10), noise(side, side, seed=1)
    found = [loss_of(style, picture, draw=draw).item() for draw in range(3)]
    wanted = squares(style, picture).amin(0).mean().item()
    assert (found[0] ** 2 + found[1] ** 2) / 2 == pytest.approx(wanted, rel=1e-3)
    assert found[2] == found[0] != found[1]


def test_the_gradients_lead_to_the_nearest_patches() -> None:
    style, picture = noise(9, 10), noise(9, 9, seed=1).requires_grad_(True)
    guide = torch.linspace(0.8, 1, 81, dtype=torch.float64).view(9, 9)
    assert torch.autograd.gradcheck(lambda p: loss_of(style, p, guide), picture)


@pytest.mark.parametrize("shape", [(SIDE - 1, 40), (40, SIDE - 1)])
def test_a_picture_smaller_than_a_patch_is_left_alone(shape: tuple[int, int]) -> None:
    picture = noise(*shape).requires_grad_(True)
    loss = loss_of(noise(20, 20), picture)
    assert loss.item() == 0
    assert not torch.autograd.grad(loss, picture)[0].any()


def test_a_picture_without_smoke_is_left_alone() -> None:
    picture = noise(20, 20).requires_grad_(True)
    loss = loss_of(noise(20, 20), picture, torch.zeros(20, 20, dtype=torch.float64))
    assert loss.item() == 0
    assert not torch.autograd.grad(loss, picture)[0].any()


def with_alpha(style: Tensor, across: slice, value: float = 1.0) -> Tensor:
    alpha = torch.zeros_like(style[..., :1])
    alpha[:, across] = value
    return torch.cat([style, alpha], 2)


@pytest.mark.usefixtures("one_way")
def test_patches_lie_in_the_areas_that_count() -> None:
    style = noise(50, 50)
    marked = with_alpha(style, slice(20, None))
    assert loss_of(marked, style[:, 20:]).item() < 0.2
    assert loss_of(marked, style[:, :20]).item() > 1.0


def test_small_areas_have_the_patches_around_them_too() -> None:
    """Not one patch alone, where it is the only one that is whole."""
    style = noise(40, 40)
    found = loss_of(with_alpha(style, slice(12, 12 + SIDE)), style[:, 4:28])
    assert found < 0.9 * loss_of(style[:, 12 : 12 + SIDE], style[:, 4:28])
    assert found < 0.9 * loss_of(style[:, 33:], style[:, 4:28])
    assert (40 - SIDE + 1) * 4 < FEWEST_STYLE


def test_areas_smaller_than_a_pixel_leave_the_whole_style() -> None:
    style = noise(24, 24)
    assert loss_of(with_alpha(style, slice(8, 16), 0.4), style).item() < 1e-9


@pytest.mark.usefixtures("one_way")
def test_a_draw_sees_nearly_all_of_a_picture() -> None:
    """16 draws of 125 x 64 patches: every 16th along rows alone would see less than half."""
    picture = noise(125 + SIDE - 1, 64 + SIDE - 1).requires_grad_(True)
    (slope,) = torch.autograd.grad(loss_of(noise(20, 20, seed=1), picture), picture)
    assert (slope != 0).any(-1).double().mean() > 0.9


def test_patches_beyond_small_areas_are_left_out() -> None:
    """Also where there are fewer than ``FEWEST_STYLE`` inside."""
    style = noise(60, 60)
    alpha = torch.zeros(60, 60, 1, dtype=torch.float64)
    alpha[40:47, 40:47] = 1.0
    found = loss_of(torch.cat([style, alpha], 2), style[:20, :20])
    assert found > 1.2 * loss_of(style, style[:20, :20])


@pytest.mark.usefixtures("one_way")
def test_one_patch_is_enough() -> None:
    style, picture = noise(9, 10), noise(SIDE, SIDE, seed=1)
    wanted = root(squares(style, picture).min())
    assert loss_of(style, picture).item() == pytest.approx(wanted, rel=1e-6)


def test_no_way_leads_back_to_the_rim_of_smoke() -> None:
    """Where the picture has the style, but little smoke."""
    style = noise(SIDE, SIDE)
    picture = torch.cat([style, noise(SIDE, 2 * SIDE, seed=1)], 1)
    guide = torch.ones(SIDE, 3 * SIDE, dtype=torch.float64)
    whole = loss_of(torch.cat([style, style], 1), picture, guide)
    guide[:, :SIDE] = 0.6
    assert loss_of(torch.cat([style, style], 1), picture, guide) > whole + 0.2


def test_a_style_of_nearly_one_colour_pulls_at_all_of_a_picture_alike() -> None:
    style = 0.25 + 0.01 * noise(20, 20)  # a spread of .003
    picture = torch.full((20, 20, 3), 0.28).double().requires_grad_(True)
    loss = loss_of(style, picture)
    assert loss.item() == pytest.approx(0.025 / patches.LEAST_SPREAD, rel=0.05)
    (slope,) = torch.autograd.grad(loss, picture)
    inner = slope[SIDE:-SIDE, SIDE:-SIDE]
    assert torch.allclose(inner, inner.mean().expand_as(inner), rtol=0.3)


def test_of_a_large_style_other_seeds_draw_other_patches() -> None:
    side = math.isqrt(MOST_STYLE) + 2 * SIDE
    style, picture = noise(side, side), noise(20, 20, seed=1)
    by_seed = [loss_of(style, picture, seed=seed).item() for seed in (0, 0, 1)]
    assert by_seed[0] == by_seed[1] != by_seed[2]
    assert by_seed[0] == pytest.approx(by_seed[2], rel=0.05)


def stripes() -> Tensor:
    light = (torch.arange(64) // 4 % 2).float()
    return light[:, None, None].expand(64, 64, 3) * torch.tensor([0.9, 0.5, 0.1])


def test_a_picture_of_mixtures_is_farther_than_one_of_pieces_of_the_style() -> None:
    style = stripes()
    crossed = 0.5 * (style + style.transpose(0, 1))
    near, far = (loss_of(style, each) for each in (style.roll(8, 0), crossed))
    assert 5 * near < far


def test_a_blurred_picture_is_farther_than_a_sharp_one() -> None:
    style = stripes()
    blurred = torch.stack([style.roll(by, 0) for by in (-1, 0, 1)]).mean(0)
    near, far = (loss_of(style, each) for each in (style.roll(3, 0), blurred))
    assert 5 * near < far


def test_a_picture_of_half_of_the_style_is_farther_than_one_of_all_its_pieces() -> None:
    """Each place of either is a place of the style."""
    rows = torch.arange(64)
    light = torch.where(rows < 32, rows // 2 % 2, rows // 8 % 2).float()
    style = light[:, None, None].expand(64, 64, 3) * torch.tensor([0.9, 0.5, 0.1])
    half = torch.cat([style[32:], style[32:]])
    near, far = (loss_of(style, each) for each in (style.flip(1), half))
    assert 3 * near < far


@pytest.mark.usefixtures("one_way")
def test_sharp_patches_of_a_large_style_are_nearer_than_blurred_ones() -> None:
    style = dabs(223)
    blurred = style.unfold(0, 3, 1).unfold(1, 3, 1).mean((3, 4))
    near, far = (loss_of(style, each) for each in (style[1:-1, 1:-1], blurred))
    assert near < 0.5 * far


def dabs(side: int) -> Tensor:
    """Many random strokes, each of one colour."""
    drawn = torch.Generator().manual_seed(0)
    down, across = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    pixels = torch.zeros(side, side, 3)
    for _ in range(4000):
        y, x, angle = torch.rand(3, generator=drawn) * torch.tensor([side, side, 0.8])
        along = (down - y) * angle.cos() + (across - x) * angle.sin()
        aside = (across - x) * angle.cos() - (down - y) * angle.sin()
        inside = (along.abs() < 6) & (aside.abs() < 1.7)
        pixels[inside] = torch.rand(3, generator=drawn)
    return pixels

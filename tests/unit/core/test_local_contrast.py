"""What areas of a picture lack beside those of a style: contrast and brightness."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from usdsmoke.config.settings import Config
from usdsmoke.core.steps.targets import make_targets
from usdsmoke.core.style import local_contrast
from usdsmoke.core.style.local_contrast import DARK, WEIGHTS, AreaLevels, area_distance, area_levels
from usdsmoke.core.style.style_image import scale_style
from usdsmoke.core.views.scene import Scene

SIDE = 96
RADIUS = 6.0
ALL = torch.ones(SIDE, SIDE, dtype=torch.float64)
SCENE = Scene(0.6, 0.3, 1.0, "Y", 1.0, SIDE)


def even(value: float, side: int = SIDE) -> Tensor:
    return torch.full((side, side, 3), value, dtype=torch.float64)


def stripes(amplitude: float, period: int, mean: float = 0.5) -> Tensor:
    """Vertical, ``amplitude`` above and below a grey."""
    sign = torch.arange(SIDE) // (period // 2) % 2 * 2.0 - 1
    return even(mean) + amplitude * sign.double()[None, :, None]


def random_picture(seed: int = 0, low: float = 0.0) -> Tensor:
    """Squares of four pixels."""
    drawn = np.random.default_rng(seed).uniform(low, 1, (SIDE // 4, SIDE // 4, 3))
    return torch.as_tensor(drawn.repeat(4, 0).repeat(4, 1))


@pytest.mark.parametrize("value", [0.0, 0.1, 0.3, 0.4, 0.9])
def test_an_even_picture_costs_what_it_is_darker_than_the_level(value: float) -> None:
    expected = DARK * max(0.0, 1 - value / 0.4) ** 2
    found = area_distance(even(value), ALL, AreaLevels(RADIUS, 0.4, (0.0, 0.0)))
    assert float(found) == pytest.approx(expected, rel=1e-6)


def test_the_brightest_channel_tells_what_is_dark() -> None:
    red = even(0.0)
    red[..., 0] = 0.4
    assert float(area_distance(red, ALL, AreaLevels(RADIUS, 0.4, (0.0, 0.0)))) == pytest.approx(
        0, abs=1e-9
    )


@pytest.mark.parametrize("kind", [0, 1])
@pytest.mark.parametrize("share", [0.25, 0.5, 1.0, 2.0])
def test_fine_stripes_cost_what_they_lack_in_contrast(share: float, kind: int) -> None:
    """Both contrasts of stripes of two pixels are those of all their pixels."""
    wanted = [0.0, 0.0]
    wanted[kind] = 0.2 * 3**0.5  # of three channels
    levels = AreaLevels(RADIUS, 0.0, (wanted[0], wanted[1]))
    found = float(area_distance(stripes(0.2 * share, 2), ALL, levels))
    assert found == pytest.approx(WEIGHTS[kind] * max(0.0, 1 - share) ** 2, abs=1e-3)


def test_only_the_contrast_of_all_marks_sees_wide_ones() -> None:
    """A Gaussian of 2 pixels keeps .58 of the first wave of stripes of 12 pixels, which has .81 of
    their power, and hardly anything of the others: .58 of the contrast is finer."""
    everything, fine = area_levels(stripes(0.2, 12), RADIUS).contrasts
    narrow = area_levels(stripes(0.2, 2), RADIUS).contrasts
    assert narrow == pytest.approx([0.2 * 3**0.5] * 2, rel=0.01)
    assert fine == pytest.approx(0.58 * narrow[0], rel=0.06)
    assert everything > 0.95 * narrow[0]


def test_black_that_is_gathered_costs_and_black_that_is_spread_does_not() -> None:
    """The two have the same pixels."""
    spread = torch.where(stripes(0.4, 2) > 0.5, 0.9, 0.0)
    gathered = spread.sort(dim=1).values
    levels = AreaLevels(RADIUS, 0.4, (0.0, 0.0))
    assert float(area_distance(spread, ALL, levels)) == pytest.approx(0, abs=1e-9)
    assert float(area_distance(gathered, ALL, levels)) > 0.2 * DARK


def test_marks_that_are_gathered_cost_and_marks_everywhere_do_not() -> None:
    style = random_picture()
    levels = area_levels(style, RADIUS)
    half = style.clone()
    half[:, : SIDE // 2] = style.mean((0, 1))
    other = float(area_distance(random_picture(1), ALL, levels))
    assert other < 0.03
    assert float(area_distance(half, ALL, levels)) > max(0.5, 20 * other)


def test_what_is_blurred_costs() -> None:
    style = random_picture()
    levels = area_levels(style, RADIUS)
    kernel = torch.ones(3, 1, 5, 5, dtype=torch.float64) / 25
    blurred = torch.nn.functional.conv2d(style.permute(2, 0, 1)[None], kernel, groups=3, padding=2)
    assert float(area_distance(blurred[0].permute(1, 2, 0), ALL, levels)) > 0.1


def test_only_the_smoke_counts() -> None:
    picture, guide = random_picture(), ALL.clone()
    guide[:, : SIDE // 2] = 0
    beside = picture.clone()
    beside[:, : SIDE // 2] = 0
    levels = AreaLevels(RADIUS, 0.9, (1.0, 1.0))
    found = float(area_distance(picture, guide, levels))
    assert float(area_distance(beside, guide, levels)) == pytest.approx(found, rel=1e-12)
    assert float(area_distance(beside, ALL, levels)) > 1.2 * found
    assert float(area_distance(picture, torch.zeros_like(guide), levels)) == 0


@pytest.mark.parametrize("thin", [1.0, 0.05, 1e-6])
def test_smoke_of_a_part_of_the_picture_costs_as_much_as_of_the_whole(thin: float) -> None:
    guide = thin * ALL
    guide[:, : SIDE // 2] = 0
    for value, cost in ((0.5, 0.0), (0.1, DARK * 0.75**2)):
        found = float(area_distance(even(value), guide, AreaLevels(RADIUS, 0.4, (0.0, 0.0))))
        assert found == pytest.approx(cost, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("side", [192, 193, 199])
def test_a_ramp_has_no_contrast_wherever_the_picture_ends(side: int) -> None:
    """Means at pixels lie where the pixels are; a side may be no multiple of a cell's."""
    ramp = even(1.0, side) * torch.linspace(0, 1, side, dtype=torch.float64)[:, None]
    assert area_levels(ramp, 8.0).contrasts[0] < 0.006


def test_a_style_s_areas_that_do_not_count_set_no_level() -> None:
    style, alpha = random_picture(), ALL.clone()
    alpha[:, : SIDE // 2] = 0
    flat = style.clone()
    flat[:, : SIDE // 2] = 0.5

    def contrasts(pixels: Tensor, areas: Tensor) -> tuple[float, ...]:
        return area_levels(torch.cat([pixels, areas[..., None]], dim=2), RADIUS).contrasts

    assert contrasts(flat, alpha) == pytest.approx(contrasts(style, alpha), rel=1e-12)
    assert contrasts(flat, ALL)[0] < 0.1 * contrasts(style, ALL)[0]
    without = area_levels(style, RADIUS).contrasts
    assert contrasts(style, 0 * ALL) == without  # areas that are too small to be seen


def test_nine_of_ten_areas_of_a_style_are_bright_enough() -> None:
    """Of a ramp from black to white, the darkest tenth sets the level."""
    ramp = even(1.0) * torch.linspace(0, 1, SIDE, dtype=torch.float64)[:, None, None]
    assert area_levels(ramp, 2.0).value == pytest.approx(0.1, abs=0.03)


def test_an_even_style_asks_for_no_contrast() -> None:
    assert float(area_distance(even(0.5), ALL, area_levels(even(0.5), RADIUS))) == 0
    assert float(area_distance(even(0.0), ALL, area_levels(even(0.0), RADIUS))) == 0


def test_what_is_hardly_seen_in_a_style_costs_little() -> None:
    grain = even(0.5) + (torch.rand(SIDE, SIDE, 3).double() - 0.5) * (4 / 255)
    assert float(area_distance(even(0.5), ALL, area_levels(grain, RADIUS))) < 0.3
    assert float(area_distance(even(0.005), ALL, area_levels(even(0.01), RADIUS))) < 0.2


def test_fine_marks_of_less_than_a_pixel_are_not_looked_for() -> None:
    assert len(area_levels(random_picture(), 2.9).contrasts) == 1
    assert len(area_levels(random_picture(), 3.0).contrasts) == 2


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 3)])
def test_pictures_smaller_than_an_area_are_finite(shape: tuple[int, int]) -> None:
    picture = torch.rand(*shape, 3, generator=torch.Generator().manual_seed(0))
    found = area_distance(0.5 * picture, torch.ones(shape), area_levels(picture, RADIUS))
    assert 0 <= float(found) < 10


def test_gradients_are_those_of_finite_differences() -> None:
    picture, guide = random_picture(2, 0.2)[:20, :16].clone(), ALL[:20, :16].clone()
    guide[:, :5] = 0.3
    levels = AreaLevels(3.0, 0.9, (0.9, 0.6))
    picture.requires_grad_(True)
    assert torch.autograd.gradcheck(lambda x: area_distance(x, guide, levels), [picture])


# In a run


def loss_of(picture: Tensor, styles: Sequence[Tensor], factor: int = 1, **settings: Any) -> float:
    """Of a picture full of smoke; patches, which grey has none of, are left out."""
    grey = settings.pop("grey", False)
    config = Config()
    weights = settings.pop("weights", ())
    config = config.replace(
        losses=config.losses.replace(**{"nearest": 0.0, **settings}),
        style=config.style.replace(weights=weights),
    )
    pixels = [style.float().numpy() for style in styles]
    made = make_targets(pixels, SCENE, config, torch.device("cpu"))
    return float(made.at(factor, grey)(picture.float(), torch.ones(picture.shape[:2])))


def lack_of(picture: Tensor, styles: Sequence[Tensor], factor: int = 1, **settings: Any) -> float:
    """What the term adds with its weight of 10."""
    plain = loss_of(picture, styles, factor, local_contrast=0.0, **settings)
    return loss_of(picture, styles, factor, **settings) - plain


@pytest.mark.parametrize("factor", [1, 2])
def test_the_colour_step_compares_areas_of_a_24th_of_the_picture(factor: int) -> None:
    style, side = random_picture(), SIDE // factor
    picture = random_picture(3)[:side, :side].clone()
    picture[:, : side // 2] = 0
    small = scale_style(style.float().numpy(), side, Config().style, torch.zeros(()))
    levels, guide = area_levels(small, side / 24), torch.ones(side, side)
    wanted = 10 * float(area_distance(picture.float(), guide, levels))
    assert wanted > 1
    assert lack_of(picture, [style], factor) == pytest.approx(wanted, rel=1e-3)
    assert lack_of(picture, [style], factor, style=3.0) == pytest.approx(3 * wanted, rel=1e-3)
    assert lack_of(picture, [style], factor, grey=True) == 0


def test_nothing_is_measured_without_weight(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("areas were measured")

    monkeypatch.setattr(local_contrast, "_measured", refuse)
    assert loss_of(random_picture(1), [random_picture()], local_contrast=0.0) > 0


def test_styles_of_a_mix_set_levels_by_their_shares() -> None:
    dark, bright = even(0.2), even(0.8)
    for weights, level in (([1.0, 1.0], 0.5), ([1.0, 3.0], 0.65), ([1.0, 0.0], 0.2)):
        wanted = 10 * DARK * max(0.0, 1 - 0.4 / level) ** 2
        found = lack_of(even(0.4), [dark, bright], weights=weights)
        assert found == pytest.approx(wanted, rel=0.01, abs=1e-3)

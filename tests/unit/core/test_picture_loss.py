"""The loss of a picture: which terms count, and what each of them asks for."""

import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

from tests.fixtures.smoke_fixtures import random_style
from usdsmoke.config.look_sections import LossesConfig
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.core.features.network import EmbeddedFeatures
from usdsmoke.core.smoke.srgb import decode_srgb
from usdsmoke.core.steps.optimize import Descent, minimize
from usdsmoke.core.steps.targets import StyleTargets, make_targets
from usdsmoke.core.style import losses
from usdsmoke.core.style.losses import PictureLoss, StyleTarget
from usdsmoke.core.views.scene import Scene

DOUBLE = torch.float64
DISTRIBUTIONS = [{}, {"histogram": 1.0, "statistic": "gram"}]


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=DOUBLE)


class Pixels:
    """A network whose maps are the picture itself, by any name; notes what it is asked for."""

    def __init__(self) -> None:
        self.asked: set[str] = set()

    def __call__(self, picture: Tensor, wanted: frozenset[str]) -> dict[str, Tensor]:
        self.asked |= wanted
        return {name: picture.permute(2, 0, 1)[None] for name in wanted}


def pixel_target(style: Tensor, network: Pixels | None = None, **weights: Any) -> StyleTarget:
    return StyleTarget(
        style, network or Pixels(), {"style": 1.0}, LossesConfig(**weights), ["content"], seed=0
    )


def embedded_target(style: Tensor, **weights: Any) -> StyleTarget:
    layers = dict.fromkeys(("oriented1", "oriented2", "learned1"), 1.0)
    network = EmbeddedFeatures(style)
    return StyleTarget(style, network, layers, LossesConfig(**weights), ["oriented2"], seed=0)


# Which terms count


TERMS = {
    "content": (losses, "content_distance"),
    "laplacian": (losses, "laplacian_distance"),
    "photorealism": (losses, "photorealism_distance"),
    "total_variation": (losses, "total_variation"),
    "histogram": (losses, "quantile_distance"),
}


@pytest.mark.parametrize("weighted", TERMS)
def test_what_has_weight_zero_is_not_evaluated_and_what_has_weight_is(weighted, monkeypatch):
    called = []
    for name, (module, function) in TERMS.items():
        real = getattr(module, function)

        def noted(*args: Any, name: str = name, real: Any = real) -> Tensor:
            called.append(name)
            return real(*args)

        monkeypatch.setattr(module, function, noted)
    weights, network = {weighted: 0.5}, Pixels()
    target = pixel_target(random(8, 8, 3), network, **weights)
    judge = PictureLoss([target], [1.0], LossesConfig(**weights))
    picture, guide = random(6, 7, 3, seed=1), random(6, 7, seed=2)
    judge(picture, guide, judge.content(picture**2))
    assert called == [weighted]
    assert network.asked == {"style", "content"} if weighted == "content" else {"style"}
    assert judge.uses_content == (weighted in ("content", "laplacian", "photorealism"))


def test_gram_matrices_are_not_made_for_sliced_wasserstein_nor_quantiles_for_gram(monkeypatch):
    def refuse(*_: object) -> None:
        raise AssertionError("a statistic was made that nobody wants")

    for function, weights in (
        ("gram_matrix", {}),
        ("quantile_table", {"statistic": "gram"}),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(losses, function, refuse)
            target = pixel_target(random(8, 8, 3), **weights)
            assert target.loss(random(8, 8, 3, seed=1), None) > 0


def test_the_terms_add_up_by_their_weights():
    picture, content, guide = (random(9, 8, 3, seed=s) for s in (1, 2, 3))
    style = random(10, 10, 3)

    def loss(**weights: float) -> float:
        judge = PictureLoss([pixel_target(style, **weights)], [1.0], LossesConfig(**weights))
        return judge(picture, guide[..., 0], judge.content(content)).item()

    alone = loss()
    parts = {name: loss(**{name: 1.0}) - alone for name in TERMS}
    assert min(parts.values()) > 1e-4
    weights = {name: 0.1 + n for n, name in enumerate(TERMS)}
    wanted = alone + sum(weights[name] * part for name, part in parts.items())
    assert loss(**weights) == pytest.approx(wanted, rel=1e-9)


def test_without_a_content_picture_the_losses_that_need_it_are_left_out():
    weights = {"content": 1.0, "laplacian": 1.0, "photorealism": 1.0}
    judge = PictureLoss([pixel_target(random(8, 8, 3))], [1.0], LossesConfig(**weights))
    plain = PictureLoss([pixel_target(random(8, 8, 3))], [1.0], LossesConfig())
    picture, guide = random(6, 7, 3, seed=1), random(6, 7, seed=2)
    assert judge(picture, guide).item() == plain(picture, guide).item()


@pytest.mark.parametrize("weights", [{"statistic": "gram"}, {"content": 2.0}, *DISTRIBUTIONS])
def test_several_styles_count_by_their_shares_and_what_is_kept_counts_once(weights):
    styles = [random(8, 8, 3, seed=s) for s in (0, 5)]
    picture, guide, content = random(6, 7, 3, seed=1), random(6, 7, seed=2), random(6, 7, 3, seed=3)

    def loss(shares: dict[int, float]) -> float:
        targets = [pixel_target(styles[n], **weights) for n in shares]
        judge = PictureLoss(targets, list(shares.values()), LossesConfig(**weights))
        return judge(picture, guide, judge.content(content)).item()

    wanted = 0.75 * loss({0: 1.0}) + 0.25 * loss({1: 1.0})
    assert loss({0: 0.75, 1: 0.25}) == pytest.approx(wanted, rel=1e-12)
    assert loss({0: 1.0}) != pytest.approx(loss({1: 1.0}), rel=1e-3)


def test_content_is_compared_in_grey_so_that_the_colours_are_free():
    """Colours of equal luminance cost nothing beside their content."""
    light = random(8, 9)
    none = torch.tensor([1.0, 0.0, -0.2126 / 0.0722], dtype=DOUBLE)  # luminance
    tint = 0.2 * random(8, 9, 1, seed=4) * none
    content = light[..., None].expand(-1, -1, 3)
    guide = torch.ones_like(light)
    for weights in ({"content": 1.0}, {"laplacian": 1.0}):
        target = StyleTarget(content, Pixels(), {}, content_layers=["content"])
        judge = PictureLoss([target], [1.0], LossesConfig(**weights))
        kept = judge.content(content)
        assert judge(content + tint, guide, kept).item() < 1e-12
        assert judge(content.flip(0), guide, kept).item() > 1e-3


# Distributions instead of Gram matrices


@pytest.mark.parametrize("weights", DISTRIBUTIONS)
def test_the_style_s_own_features_cost_next_to_nothing(weights):
    """What a table of 256 quantiles leaves of 1280 pixels: hundredths of a feature's rms."""
    style = torch.from_numpy(random_style(32, 40)).double()
    target = embedded_target(style, **weights)
    own = target.loss(style, None).item()
    assert own < 0.02 * 3
    for other in (style.flip(2), style.mean(dim=(0, 1)).expand_as(style), style + 0.05):
        assert target.loss(other, None).item() > 4 * own


def test_a_large_style_is_told_by_a_draw_of_its_features():
    style = torch.from_numpy(random_style(280, 300)).double()  # more than 16 times as many
    target = StyleTarget(style, Pixels(), {"style": 1.0}, seed=0)
    shuffled = style.flatten(0, 1)[torch.randperm(280 * 300)].view(300, 280, 3)
    own = target.loss(shuffled, None).item()
    assert own < 0.04
    for other in (style.square(), style.mean(dim=(0, 1)).expand_as(style), style + 0.05):
        assert target.loss(other, None).item() > 2 * own


@pytest.mark.parametrize("weights", DISTRIBUTIONS)
def test_it_falls_when_a_picture_is_optimised(weights):
    style = torch.from_numpy(random_style(24, 24))
    target = embedded_target(style, **weights)
    picture = random(20, 22, 3).float().requires_grad_()
    ends = list(minimize(lambda n: target.loss(picture, None, n), [picture], Descent(0.03, 60)))
    assert ends[-1].rollbacks == 0
    assert target.loss(picture, None).item() < 0.25 * ends[0].loss


@pytest.mark.parametrize("weights", DISTRIBUTIONS)
def test_gradients_agree_with_finite_differences(weights):
    """Through both halves of the network, a guide that is 0 in places, and the match."""
    target = embedded_target(random(16, 16, 3), **weights)
    guide = (random(7, 6, seed=2) - 0.2).clamp_min(0)
    picture = random(7, 6, 3, seed=1).requires_grad_()
    assert gradcheck(lambda p: target.loss(p, guide, 5), picture, eps=1e-7, atol=1e-4, rtol=1e-3)


def test_the_distance_of_two_distributions_with_equal_moments_is_seen_by_histograms_alone():
    """Two levels and an even spread of equal mean and variance: the Gram matrices agree, and the
    squared transport distance is 2 - sqrt(3) of the variance."""
    n = 4096
    two = torch.where(torch.arange(n) < n // 2, -1.0, 1.0).double()
    even = math.sqrt(3) * (2 * (torch.arange(n).double() + 0.5) / n - 1)
    style, picture = (x.view(64, 64, 1).expand(-1, -1, 3).contiguous() for x in (two, even))
    assert pixel_target(style, statistic="gram").loss(picture, None).item() < 2e-4
    found = pixel_target(style, statistic="gram", histogram=1.0).loss(picture, None).item()
    scale = 1 / (1 + 1e-3)
    assert found == pytest.approx(scale * math.sqrt(2 - math.sqrt(3)), rel=0.01)


def test_histograms_pin_the_brightness():
    """The style's own texture on another level: the distance is the shift over the style's rms."""
    style = torch.from_numpy(random_style(32, 40)).double()
    rms = style.square().mean(dim=(0, 1)).sqrt() + 1e-3
    own, shifted = (
        pixel_target(style, histogram=1.0).loss(style + shift, None).item()
        - pixel_target(style).loss(style + shift, None).item()
        for shift in (0.0, 0.1)
    )
    assert own < 0.01
    assert shifted == pytest.approx((0.1 / rms).square().mean().sqrt().item(), rel=0.01)


def test_directions_change_with_the_draw_and_the_seed_and_repeat():
    style, picture = random(12, 12, 3), random(12, 12, 3, seed=1)
    target = embedded_target(style, statistic="sliced_wasserstein")
    found = [target.loss(picture, None, draw).item() for draw in (0, 1, losses.N_DRAWS)]
    assert found[0] != found[1] and found[0] == found[2]
    layers = {"learned1": 1.0}
    weights = LossesConfig(statistic="sliced_wasserstein")
    other = [
        StyleTarget(style, EmbeddedFeatures(style), layers, weights, seed=s).loss(picture, None)
        for s in (0, 0, 1)
    ]
    assert other[0] == other[1] != other[2]


@pytest.mark.parametrize("weights", DISTRIBUTIONS)
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_features_in_half_precision_are_compared_in_single(weights, dtype):
    style, picture = (random(8, 8, 3, seed=s).to(dtype) for s in (0, 1))
    found = pixel_target(style, **weights).loss(picture, torch.ones(8, 8))
    wanted = pixel_target(style.double(), **weights).loss(picture.double(), None)
    assert found.item() == pytest.approx(wanted.item(), rel=0.03)


@pytest.mark.parametrize("weights", DISTRIBUTIONS)
def test_pixels_outside_the_guide_have_no_say(weights):
    target = pixel_target(random(12, 12, 3), **weights)
    picture, spoiled = random(8, 8, 3, seed=1), random(8, 8, 3, seed=1)
    spoiled[:, 5:] = 1e6
    guide = torch.ones(8, 8, dtype=DOUBLE)
    guide[:, 5:] = 0
    found = target.loss(spoiled, guide, 2).item()
    assert found == pytest.approx(target.loss(picture, guide, 2).item(), rel=1e-12)


# The targets of a run


def run_targets(config: Config, styles: list[np.ndarray]) -> StyleTargets:
    scene = Scene(0.6, 0.3, 1.0, "Y", 1.0, 24)
    return make_targets(styles, scene, config, torch.device("cpu"))


@pytest.mark.parametrize("shares", [[1.0], [3.0, 1.0]])
def test_background_and_brightness_are_the_styles_means_by_their_shares(shares):
    styles = [random_style(16, 20, seed) ** (1 + seed) for seed in range(len(shares))]
    targets = run_targets(resolve_config({"style": {"weights": shares}}), styles)
    parts = [share / sum(shares) for share in shares]
    linear = [decode_srgb(torch.from_numpy(style)).mean(dim=(0, 1)) for style in styles]
    wanted = sum(part * mean for part, mean in zip(parts, linear, strict=True))
    assert targets.background.tolist() == pytest.approx(wanted.tolist(), rel=1e-5)
    lights = [style @ np.array([0.2126, 0.7152, 0.0722]) for style in styles]
    mean = sum(part * light.mean() for part, light in zip(parts, lights, strict=True))
    spread = sum(part * light.std() for part, light in zip(parts, lights, strict=True))
    assert targets.brightness == pytest.approx((mean, spread), rel=1e-5)

"""The way from features to the nearest ones of a style."""

import pytest
import torch

from usdsmoke.base.sections import FeaturesConfig, LossesConfig
from usdsmoke.core.style.features import EmbeddedFeatures
from usdsmoke.core.style.layers import nearest_layers
from usdsmoke.core.style.losses import StyleTarget
from usdsmoke.core.style.nearest import MOST_LOOKED_UP, MOST_STYLE, nearest_distance, thin_out


def test_it_is_the_mean_square_way_to_the_nearest_feature():
    style = torch.tensor([[0.0, 1.0], [0.0, 1.0]])
    values = torch.tensor([[0.1, 0.5, 1.0], [0.1, 0.4, 2.0]])
    ways = [0.01, (0.25 + 0.16) / 2, 0.5]
    assert nearest_distance(values, None, style).item() == pytest.approx(sum(ways) / 3)
    weighted = nearest_distance(values, torch.tensor([1.0, 0.0, 3.0]), style)
    assert weighted.item() == pytest.approx((ways[0] + 3 * ways[2]) / 4)
    assert nearest_distance(values, torch.zeros(3), style).item() == 0


def test_draws_that_follow_each_other_look_up_all_of_many_features():
    generator = torch.Generator().manual_seed(0)
    values = torch.rand(3, 3 * MOST_LOOKED_UP, generator=generator)
    style = torch.rand(3, 50, generator=generator)
    squares = (values[:, :, None] - style[:, None, :]).square().mean(0).amin(1)
    found = [nearest_distance(values, None, style, draw).item() for draw in range(4)]
    assert sum(found[:3]) / 3 == pytest.approx(squares.mean().item())
    assert found[3] == found[0] != found[1]


def test_the_gradient_leads_to_the_nearest_feature():
    style = torch.tensor([[0.0, 1.0]], dtype=torch.float64)
    values = torch.tensor([[0.2, 0.9, 0.4]], dtype=torch.float64, requires_grad=True)
    weights = torch.tensor([1.0, 0.5, 0.7], dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda v: nearest_distance(v, weights, style), values)


def test_a_large_style_is_thinned_out_evenly():
    style = torch.arange(4 * MOST_STYLE + 1.0)[None]
    thin = thin_out(style)
    assert thin.shape[1] <= MOST_STYLE
    assert torch.equal(thin.diff(), torch.full_like(thin.diff(), 5.0))
    assert torch.equal(thin_out(style[:, :9]), style[:, :9])


def test_a_picture_of_mixtures_is_farther_than_one_of_pieces_of_the_style():
    stripes = (torch.arange(64) // 4 % 2).float()
    style = stripes[:, None, None].expand(64, 64, 3) * torch.tensor([0.9, 0.5, 0.1])
    crossed = 0.5 * (style + style.transpose(0, 1))
    network = EmbeddedFeatures(style)
    layers = ("learned2", "learned3")
    only = LossesConfig(nearest=1.0, statistic="gram")
    plain = LossesConfig(nearest=0.0, statistic="gram")
    ways = []
    for picture in (style.roll(8, 0), crossed):
        drawn, undrawn = (
            StyleTarget(style, network, dict.fromkeys(layers, 1.0), losses, nearest_layers=layers)
            for losses in (only, plain)
        )
        ways.append((drawn.loss(picture, None) - undrawn.loss(picture, None)).item())
    assert 5 * ways[0] < ways[1]


@pytest.mark.parametrize(
    "given, found",
    [
        ({}, ("learned2", "learned3")),
        ({"layers": ["learned4", "oriented4", "learned1"]}, ("learned1", "learned4")),
        ({"layers": ["oriented1"]}, ()),
        ({"network": "vgg19"}, ("relu2_1", "relu3_1")),
    ],
)
def test_the_two_deepest_learned_style_layers_are_taken(given, found):
    assert nearest_layers(FeaturesConfig(**given)) == found

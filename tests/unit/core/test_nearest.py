"""The ways from features to the nearest ones of a style, and back."""

import pytest
import torch

from usdsmoke.config.look_sections import FeaturesConfig, LossesConfig
from usdsmoke.core.features.layers import nearest_layers
from usdsmoke.core.features.network import EmbeddedFeatures
from usdsmoke.core.style.losses import StyleTarget
from usdsmoke.core.style.nearest import MOST_LOOKED_UP, MOST_STYLE, nearest_distances, thin_out


def test_it_is_the_mean_square_way_to_the_nearest_feature():
    style = torch.tensor([[0.0, 1.0], [0.0, 1.0]])
    values = torch.tensor([[0.1, 0.5, 1.0], [0.1, 0.4, 2.0]])
    ways = [0.01, (0.25 + 0.16) / 2, 0.5]
    assert nearest_distances(values, None, style)[0].item() == pytest.approx(sum(ways) / 3)
    weighted, _ = nearest_distances(values, torch.tensor([1.0, 0.0, 3.0]), style)
    assert weighted.item() == pytest.approx((ways[0] + 3 * ways[2]) / 4)
    assert [way.item() for way in nearest_distances(values, torch.zeros(3), style)] == [0, 0]


def test_a_style_s_features_look_back_in_turn_to_features_of_enough_weight():
    style = torch.tensor([[0.0, 1.0, 5.0, 7.0]])
    values = torch.tensor([[0.1, 0.6, 5.5]])
    backs = [nearest_distances(values, None, style, draw)[1].item() for draw in range(3)]
    assert backs == pytest.approx([(0.01 + 0.25) / 2, (0.16 + 2.25) / 2, (0.01 + 0.25) / 2])
    _, without_the_first = nearest_distances(values, torch.tensor([0.2, 0.5, 0.45]), style)
    assert without_the_first.item() == pytest.approx((0.36 + 0.25) / 2)
    assert nearest_distances(values, None, style[:, :1], 1)[1].item() == pytest.approx(0.01)


def test_draws_that_follow_each_other_look_up_all_of_many_features():
    generator = torch.Generator().manual_seed(0)
    values = torch.rand(3, 3 * MOST_LOOKED_UP, generator=generator)
    style = torch.rand(3, 50, generator=generator)
    squares = (values[:, :, None] - style[:, None, :]).square().mean(0).amin(1)
    found = [nearest_distances(values, None, style, draw)[0].item() for draw in range(4)]
    assert sum(found[:3]) / 3 == pytest.approx(squares.mean().item())
    assert found[3] == found[0] != found[1]


def test_each_feature_of_an_odd_number_looks_back():
    style = torch.tensor([[0.0, 0.0, 9.0]])  # the last one is the only one that is far
    ways = [nearest_distances(torch.zeros(1, 4), None, style, draw)[1].item() for draw in (0, 1)]
    assert ways == pytest.approx([81 / 2, 81 / 2])


def test_the_gradients_lead_to_the_nearest_features():
    style = torch.tensor([[0.0, 1.0, 0.3, 0.7]], dtype=torch.float64)
    values = torch.tensor([[0.25, 0.9, 0.4]], dtype=torch.float64, requires_grad=True)
    weights = torch.tensor([1.0, 0.5, 0.7], dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda v: nearest_distances(v, weights, style), values)


def test_a_large_style_is_thinned_out_evenly():
    style = torch.arange(4 * MOST_STYLE + 1.0)[None]
    thin = thin_out(style)
    assert thin.shape[1] <= MOST_STYLE
    assert torch.equal(thin.diff(), torch.full_like(thin.diff(), 5.0))
    assert torch.equal(thin_out(style[:, :9]), style[:, :9])


def drawn_share(style: torch.Tensor, picture: torch.Tensor) -> float:
    """What the ways to nearest features add to a picture's loss."""
    network, layers = EmbeddedFeatures(style), ("learned2", "learned3")
    with_ways, without = (
        StyleTarget(
            style, network, dict.fromkeys(layers, 1.0),
            LossesConfig(nearest=weight, statistic="gram"), nearest_layers=layers,
        ).loss(picture, None).item()
        for weight in (1.0, 0.0)
    )  # fmt: skip
    return with_ways - without


def test_a_picture_of_mixtures_is_farther_than_one_of_pieces_of_the_style():
    stripes = (torch.arange(64) // 4 % 2).float()
    style = stripes[:, None, None].expand(64, 64, 3) * torch.tensor([0.9, 0.5, 0.1])
    crossed = 0.5 * (style + style.transpose(0, 1))
    assert 5 * drawn_share(style, style.roll(8, 0)) < drawn_share(style, crossed)


def test_a_picture_of_half_of_the_style_is_farther_than_one_of_all_its_pieces():
    """Each place of either is a place of the style."""
    rows = torch.arange(64)
    stripes = torch.where(rows < 32, rows // 2 % 2, rows // 8 % 2).float()
    style = stripes[:, None, None].expand(64, 64, 3) * torch.tensor([0.9, 0.5, 0.1])
    half = torch.cat([style[32:], style[32:]])
    assert 3 * drawn_share(style, style.flip(1)) < drawn_share(style, half)


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

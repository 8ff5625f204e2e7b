"""The embedded features, and which layers are evaluated at all."""

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.fixtures.smoke_fixtures import random_style
from usdsmoke.base.errors import ConfigError
from usdsmoke.config.look_sections import FeaturesConfig, LossesConfig, StyleConfig
from usdsmoke.core.features.definition import default_layers
from usdsmoke.core.features.layers import layer_names, style_layers
from usdsmoke.core.features.learned import LearnedFeatures
from usdsmoke.core.features.network import EmbeddedFeatures, build_network
from usdsmoke.core.features.oriented import OrientedFeatures
from usdsmoke.core.features.whitening import colour_whitening
from usdsmoke.core.style.losses import StyleTarget
from usdsmoke.core.style.style_image import match_grey, scale_style

STYLE = torch.from_numpy(random_style(40, 48))


@pytest.fixture
def convolutions(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The number of filters of each dense convolution that is made; blurs do not count."""
    made: list[int] = []
    real = torch.nn.functional.conv2d

    def counted(image: Tensor, weight: Tensor, *args: object, **options: object) -> Tensor:
        if options.get("groups", 1) == 1:
            made.append(len(weight))
        return real(image, weight, *args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(torch.nn.functional, "conv2d", counted)
    return made


def test_maps_have_the_documented_channels_and_sizes():
    maps = EmbeddedFeatures(STYLE)(STYLE, frozenset(EmbeddedFeatures.names))
    shapes = {name: tuple(found.shape[1:]) for name, found in maps.items()}
    assert shapes == {
        "oriented1": (51, 40, 48),
        "oriented2": (51, 20, 24),
        "oriented3": (51, 10, 12),
        "oriented4": (51, 5, 6),
        "learned0": (3, 40, 48),
        "learned1": (64, 40, 48),
        "learned2": (96, 20, 24),
        "learned3": (128, 10, 12),
        "learned4": (160, 5, 6),
    }


@pytest.mark.parametrize(
    ("wanted", "filters"),
    [
        ({"oriented1"}, [48]),
        ({"oriented3"}, [48]),  # the levels above it are blurred, not filtered
        ({"learned0"}, []),
        ({"learned2"}, [64, 96]),
        ({"learned4"}, [64, 96, 128, 160]),
        ({"oriented2", "learned1"}, [48, 64]),
        (set(), []),
    ],
)
def test_layers_deeper_than_the_deepest_wanted_are_not_evaluated(wanted, filters, convolutions):
    network = EmbeddedFeatures(STYLE)
    network(STYLE, frozenset(wanted))  # learns
    convolutions.clear()
    assert set(network(STYLE, frozenset(wanted))) == wanted
    assert convolutions == filters


def test_a_layer_is_the_same_whatever_else_is_wanted():
    network = EmbeddedFeatures(STYLE)
    together = network(STYLE, frozenset(network.names))
    for name in network.names:
        assert torch.equal(network(STYLE, frozenset({name}))[name], together[name])


def test_filters_are_not_learned_when_no_learned_layer_is_wanted(monkeypatch):
    def refuse(*_: object) -> None:
        raise AssertionError("learned without need")

    monkeypatch.setattr("usdsmoke.core.features.learned.LearnedFeatures.__init__", refuse)
    assert set(EmbeddedFeatures(STYLE)(STYLE, frozenset({"oriented2"}))) == {"oriented2"}


@pytest.mark.parametrize(
    ("wanted", "learned"),
    [("learned0", 0), ("learned2", 2), ("learned3", 3), ("learned4", 4)],
)
def test_filters_are_learned_no_deeper_than_wanted_and_once(wanted, learned, monkeypatch):
    numbers: list[int] = []
    real = LearnedFeatures._learn

    def counted(*arguments: Any) -> Tensor:
        numbers.append(arguments[3])
        return real(*arguments)

    monkeypatch.setattr(LearnedFeatures, "_learn", staticmethod(counted))
    network = EmbeddedFeatures(STYLE)
    for _ in range(2):
        network(STYLE, frozenset({wanted}))
    assert numbers == list(range(learned))


@pytest.mark.parametrize("first", ["learned1", "learned3", "learned4"])
def test_the_order_in_which_layers_are_asked_for_changes_no_filter(first):
    """All draws are made from shallow to deep, whenever that is."""
    wanted = frozenset(default_layers())
    plain = EmbeddedFeatures(STYLE, seed=5)(STYLE, wanted)
    network = EmbeddedFeatures(STYLE, seed=5)
    network(STYLE, frozenset({first, "oriented4"}))
    later = network(STYLE, wanted)
    assert all(torch.equal(later[name], plain[name]) for name in wanted)


@pytest.mark.parametrize(
    ("name", "across"),
    [
        ("learned1", (5, 5)),
        ("learned2", (10, 10)),
        ("learned3", (20, 20)),
        ("learned4", (36, 40)),  # pools pass on one of their four: some border pixels reach nothing
        ("oriented1", (11, 11)),
        ("oriented2", (25, 25)),
        ("oriented3", (53, 53)),
        ("oriented4", (109, 109)),
    ],
)
def test_receptive_fields_are_the_documented_ones(name, across):
    """By the gradient of one value in the middle, in float64."""
    style = torch.from_numpy(random_style(64, 64)).double()
    picture = torch.rand(
        144, 144, 3, generator=torch.Generator().manual_seed(4), dtype=torch.float64
    ).requires_grad_()
    maps = EmbeddedFeatures(style)(picture, frozenset({name}))[name]
    middle = maps.shape[-1] // 2
    (gradient,) = torch.autograd.grad(maps[0, :, middle, middle].square().sum(), picture)
    found = torch.nonzero(gradient.abs().sum(dim=2))
    sides = (found.max(dim=0).values - found.min(dim=0).values + 1).tolist()
    assert all(across[0] <= side <= across[1] for side in sides)


def test_features_follow_the_seed():
    first, again, other = (
        EmbeddedFeatures(STYLE, seed)(STYLE, frozenset({"learned2", "oriented1"}))
        for seed in (1, 1, 2)
    )
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not any(torch.equal(first[name], other[name]) for name in first)


def test_oriented_energy_answers_to_its_own_orientation():
    """Stripes along x excite the pair across them most: filters 0 and 4 of the frequency 0.2."""
    network = OrientedFeatures(STYLE)
    _, x = np.mgrid[:32, :32]
    across = torch.from_numpy(0.5 + 0.5 * np.sin(2 * np.pi * 0.2 * x)).float()
    picture = across[..., None].expand(-1, -1, 3)
    for turned, (strong, weak) in ((picture, (8, 12)), (picture.transpose(0, 1), (12, 8))):
        even = network(turned.contiguous(), frozenset({"oriented1"}))["oriented1"][
            0, 27:, 8:24, 8:24
        ]
        power = even.square().mean(dim=(1, 2))
        assert power[strong].item() > 20 * power[weak].item()


def test_oriented_filters_do_not_see_the_mean_colour():
    maps = OrientedFeatures(STYLE)(torch.full((20, 20, 3), 0.3), frozenset({"oriented1"}))
    energy, colour, even = maps["oriented1"][0].split([24, 3, 24])
    assert energy.abs().max().item() < 1e-5 and even.abs().max().item() < 1e-4
    assert colour.abs().max().item() > 0.1


@pytest.mark.parametrize("shape", [(40, 60), (160, 200)])
def test_filters_learned_from_stripes_answer_to_stripes_that_way(shape):
    """Of the larger image, with more pixels than patches, some are drawn."""
    light = 0.5 + 0.3 * torch.sin(torch.arange(shape[1]) * 0.9).expand(shape)
    learned = LearnedFeatures(light[..., None].repeat(1, 1, 3))
    along = 0.5 + 0.3 * torch.sin(torch.arange(64) * 0.9)[:, None].expand(64, 64)
    wanted = frozenset({"learned1"})
    same, turned = (
        learned(picture[..., None].repeat(1, 1, 3), wanted)["learned1"].std(dim=(2, 3)).max()
        for picture in (along.T, along)
    )
    assert same > 20 * turned


def test_learned_maps_of_the_style_itself_are_standardised():
    network = LearnedFeatures(STYLE)
    for number in (1, 2, 3, 4):
        maps = network(STYLE, frozenset({f"learned{number}"}))[f"learned{number}"]
        assert 0.2 < maps.square().mean().sqrt().item() < 2


def test_whitening_makes_colours_uncorrelated_but_blows_nothing_up():
    mean, matrix = colour_whitening(STYLE, 1e-9)
    white = (STYLE.reshape(-1, 3) - mean) @ matrix
    assert torch.cov(white.T, correction=0).numpy() == pytest.approx(np.eye(3), abs=1e-3)
    _, matrix = colour_whitening(torch.full((4, 4, 3), 0.5), 1e-4, relative=0.1)
    assert matrix.numpy() == pytest.approx(100 * np.eye(3), rel=1e-4)


def speck() -> np.ndarray:
    style = np.full((20, 20, 3), 102 / 255, np.float32)
    style[3, 4] = 103 / 255
    return style


def halves() -> np.ndarray:
    style = np.zeros((20, 20, 3), np.float32)
    style[:, 10:] = 1
    return style


STRANGE = {
    "one colour": np.full((20, 20, 3), 0.4, np.float32),
    "one pixel": np.full((1, 1, 3), 0.7, np.float32),
    "black": np.zeros((5, 7, 3), np.float32),
    "grey": np.repeat(random_style(20, 20)[..., :1], 3, axis=-1),
    "one speck": speck(),
    "two halves": halves(),
    "a line": random_style(1, 40),
}


@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("name", STRANGE)
def test_strange_styles_give_finite_losses_gradients_and_no_loss_for_themselves(name, grey):
    style = scale_style(STRANGE[name], 32, StyleConfig(), torch.zeros(()))
    if grey:
        style = match_grey(style, 0.5, 0.2)
    network, names = EmbeddedFeatures(style), dict.fromkeys(EmbeddedFeatures.names, 1.0)
    target = StyleTarget(style, network, names)
    noise = torch.rand(32, 32, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    loss = target.loss(noise, None)
    (gradient,) = torch.autograd.grad(loss, noise)
    assert 0.1 < loss.item() < 1e10  # the square of a gradient still fits float32
    assert torch.isfinite(gradient).all() and gradient.any()
    by_matrices = StyleTarget(style, network, names, LossesConfig(statistic="gram"))
    assert by_matrices.loss(style, None).item() < 1e-3
    assert target.loss(style, None).item() < 0.5  # a table of 256 quantiles


def test_flat_patches_teach_no_filters():
    """Their directions are round-off's: filters that no style excites, but any picture does."""
    style = match_grey(scale_style(halves(), 32, StyleConfig(), torch.zeros(())), 0.5, 0.2)
    target = StyleTarget(style, EmbeddedFeatures(style), {"learned1": 1.0})
    noise = torch.rand(32, 32, 3, generator=torch.Generator().manual_seed(0))
    assert target.loss(noise, None).item() < 10


def test_style_layers_default_to_three_depths_of_the_embedded_network_and_two_of_vgg19():
    oriented = [f"oriented{depth}" for depth in (1, 2, 3)]
    learned = [f"learned{depth}" for depth in (0, 1, 2, 3)]
    assert style_layers(FeaturesConfig()) == dict.fromkeys(oriented + learned, 1.0)
    assert style_layers(FeaturesConfig(network="vgg19")) == {"relu2_1": 1.0, "relu3_1": 1.0}


def test_deeper_layers_than_the_default_can_be_named():
    named = ["oriented4", "learned4"]
    assert style_layers(FeaturesConfig(layers=named)) == dict.fromkeys(named, 1.0)


@pytest.mark.parametrize("size", [(1, 1), (3, 40), (7, 9), (17, 16)])
def test_small_pictures_pass_every_layer(size):
    picture = torch.rand(*size, 3, generator=torch.Generator().manual_seed(2)).requires_grad_()
    maps = EmbeddedFeatures(STYLE)(picture, frozenset(EmbeddedFeatures.names))
    assert all(found.isfinite().all() and found.numel() for found in maps.values())
    (gradient,) = torch.autograd.grad(sum(found.sum() for found in maps.values()), picture)
    assert torch.isfinite(gradient).all()


def test_style_layers_leave_out_those_of_weight_zero():
    config = FeaturesConfig(layers=["oriented1", "learned1"], weights=[0.0, 2.0])
    assert style_layers(config) == {"learned1": 2.0}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"layers": ["relu1_1"]}, "relu1_1.* embedded .*oriented1"),
        ({"layers": ["learned1"], "weights": [1.0, 2.0]}, "2 numbers for 1 style layer"),
        ({"layers": ["learned1"], "weights": [0.0]}, "all 0 .* losses.style=0"),
    ],
)
def test_wrong_layers_are_refused_with_those_there_are(settings, message):
    with pytest.raises(ConfigError, match=message):
        style_layers(FeaturesConfig(**settings))


def test_build_network_learns_from_each_style_anew():
    build = build_network(FeaturesConfig(), seed=0)
    first, second = build(STYLE), build(STYLE.flip(2))
    wanted = frozenset({"learned1"})
    assert not torch.equal(first(STYLE, wanted)["learned1"], second(STYLE, wanted)["learned1"])
    assert layer_names(FeaturesConfig()) == EmbeddedFeatures.names
    assert len(layer_names(FeaturesConfig(network="vgg19"))) == 16


@pytest.mark.parametrize("side", [16, 18, 22, 30])
def test_the_deepest_layer_is_learned_of_the_few_patches_of_a_small_style(side):
    """Thousands of dimensions, a dozen points: 32 bits do not tell their axes apart."""
    for seed in range(4):
        style = torch.rand(side, side, 3, generator=torch.Generator().manual_seed(seed))
        maps = LearnedFeatures(style, seed)(style, frozenset({"learned4"}))["learned4"]
        assert bool(maps.isfinite().all())

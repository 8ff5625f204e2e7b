"""Distributions by counting, against sorting every sample."""

import pytest
import torch
from torch import Tensor

from tests.fixtures.smoke_fixtures import random_style
from usdsmoke.base.errors import ShapeError
from usdsmoke.core.features.network import EmbeddedFeatures
from usdsmoke.core.steps.optimize import Descent, minimize
from usdsmoke.core.style.quantiles import quantile_distance, quantile_table, random_directions
from usdsmoke.core.style.sliced import sliced_distance

DOUBLE = torch.float64
LAYERS = ("oriented1", "oriented2", "learned1", "learned2")


def normal(*shape: int, seed: int = 0, dtype: torch.dtype = DOUBLE) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=DOUBLE).to(dtype)


def skewed(n_channels: int, n: int, seed: int) -> Tensor:
    """Samples with the long tails that features have."""
    return normal(n_channels, n, seed=seed).exp()


def setting(n: int = 6000, n_axes: int = 8) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Samples, their weights, directions, and another distribution's quantiles along them."""
    axes = random_directions(5, n_axes, 3, torch.zeros((), dtype=DOUBLE))
    table = quantile_table(axes @ (1.2 * skewed(5, 5000, 1) - 0.3))
    weights = (normal(n, seed=2) + 0.5).clamp_min(0)
    return skewed(5, n, 0), weights, axes, table


def gradient_of(distance: Tensor, values: Tensor) -> Tensor:
    return torch.autograd.grad(distance, values)[0]


@pytest.mark.parametrize("layer", LAYERS)
def test_the_distance_of_features_is_that_of_sorting_within_half_a_percent(layer: str) -> None:
    style, picture = (torch.from_numpy(random_style(128, 112, seed)) for seed in (0, 4))
    network = EmbeddedFeatures(style)
    maps = network(picture**1.5, frozenset([layer]))[layer][0].flatten(1)
    own = network(style, frozenset([layer]))[layer][0].flatten(1)
    assert maps.shape[1] > 2048  # fewer are sorted
    axes = random_directions(len(maps), 32, 1, maps)
    table = quantile_table(axes @ own)
    weights = torch.rand(maps.shape[1], generator=torch.Generator().manual_seed(5))
    for w in (None, weights * (weights > 0.3)):
        wanted = quantile_distance(axes @ maps, w, table).item()
        assert sliced_distance(maps, w, axes, table).item() == pytest.approx(wanted, rel=5e-3)


def test_more_bins_come_nearer_to_sorting() -> None:
    values, weights, axes, table = setting(20000)
    wanted = quantile_distance(axes @ values, weights, table).item()
    errors = [
        abs(sliced_distance(values, weights, axes, table, n).item() / wanted - 1)
        for n in (8, 64, 512)
    ]
    assert errors[0] > 4 * errors[1] and errors[1] > errors[2] and errors[2] < 1e-3


@pytest.mark.parametrize("way", ["scaled", "shifted"])
def test_the_gradient_is_the_slope_of_the_distance(way: str) -> None:
    """Bins follow a change that all samples share, so that the distance is a parabola."""
    values, weights, axes, table = setting()
    step = values if way == "scaled" else normal(5, 1, seed=9).expand_as(values)
    ahead, behind = (
        sliced_distance(values + h * step, weights, axes, table).item() for h in (0.01, -0.01)
    )
    values = values.clone().requires_grad_()
    gradient = gradient_of(sliced_distance(values, weights, axes, table), values)
    assert (gradient * step).sum().item() == pytest.approx((ahead - behind) / 0.02, rel=1e-6)


def test_the_gradient_is_the_slope_of_the_distance_by_sorting_for_any_smooth_change() -> None:
    values, weights, axes, table = setting(20000)
    ahead = values.clone().requires_grad_()
    gradient = gradient_of(sliced_distance(ahead, weights, axes, table), ahead)
    slopes = []
    for seed in range(6):
        way = torch.tanh(normal(5, 5, seed=seed + 9) @ values)
        distances = [
            quantile_distance(axes @ (values + h * way), weights, table).item()
            for h in (1e-3, -1e-3)
        ]
        wanted = (distances[0] - distances[1]) / 2e-3
        slopes.append(((gradient * way).sum().item(), wanted))
    found, wanted = torch.tensor(slopes).T
    assert ((found - wanted).norm() / wanted.norm()).item() < 0.02
    exact = gradient_of(quantile_distance(axes @ ahead, weights, table), ahead)
    assert ((gradient - exact).norm() / exact.norm()).item() < 0.03


def test_few_samples_are_sorted() -> None:
    values, weights, axes, table = setting(300)
    wanted = quantile_distance(axes @ values, weights, table).item()
    assert sliced_distance(values, weights, axes, table).item() == pytest.approx(wanted, rel=1e-12)


def test_samples_without_weight_have_no_say_and_no_gradient() -> None:
    values, weights, axes, table = setting()
    spoiled = torch.where(weights > 0, values, 1e6).requires_grad_()
    found = sliced_distance(spoiled, weights, axes, table)
    assert found.item() == sliced_distance(values, weights, axes, table).item()
    gradient = gradient_of(found, spoiled)
    assert not gradient[:, weights == 0].any() and gradient[:, weights > 0].any()
    nothing = sliced_distance(spoiled, torch.zeros_like(weights), axes, table)
    assert nothing.item() == 0 and not gradient_of(nothing, spoiled).any()


def test_no_size_of_values_or_weights_matters() -> None:
    values, weights, axes, table = setting()
    wanted = sliced_distance(values, weights, axes, table).item()
    for factor in (1e-30, 1e30):
        found = sliced_distance(values, factor * weights, axes, table).item()
        assert found == pytest.approx(wanted, rel=1e-12)
        scaled = sliced_distance(values * factor, weights, axes, table * factor).item()
        assert scaled == pytest.approx(wanted * factor**2, rel=1e-9)


def test_one_value_everywhere_is_matched_with_all_of_the_style() -> None:
    _, _, axes, table = setting()
    values = torch.full((5, 4000), 0.25, dtype=DOUBLE)
    wanted = ((axes @ values)[:, :1] - table.mean(dim=1, keepdim=True)).square().mean().item()
    found = sliced_distance(values, None, axes, table).item()
    assert torch.isfinite(torch.tensor(found)) and found >= wanted * (1 - 1e-9)


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
def test_what_is_not_finite_gives_a_distance_that_is_not_finite(bad: float) -> None:
    values, weights, axes, table = setting()
    values[2, 7], weights[7] = bad, 1.0
    assert not torch.isfinite(sliced_distance(values, weights, axes, table))


@pytest.mark.parametrize("n_threads", [1, 2])
def test_the_same_bits_come_again(n_threads: int) -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(n_threads)
    try:
        values = skewed(64, 30000, 0).float().requires_grad_()
        axes = random_directions(64, 32, 0, values)
        table = quantile_table(axes @ skewed(64, 9000, 1).float())
        found = []
        for _ in range(3):
            distance = sliced_distance(values, None, axes, table)
            found.append((distance.item(), gradient_of(distance, values)))
        assert found[0][0] == found[1][0] == found[2][0]
        assert all(torch.equal(found[0][1], other) for _, other in found[1:])
    finally:
        torch.set_num_threads(before)


def test_descent_ends_where_sorting_along_all_directions_ends() -> None:
    """Judged by sorting along 64 directions that neither had, after 16 draws of 8 taken in turn."""
    target, start = torch.exp(0.5 * normal(16, 6000, seed=1)), normal(16, 4000, seed=3) * 0.2 + 1

    def all_sorted(values: Tensor, seed: int) -> Tensor:
        axes = random_directions(16, 64, seed, target)
        return quantile_distance(axes @ values, None, quantile_table(axes @ target)).sqrt()

    def counted(values: Tensor, iteration: int) -> Tensor:
        axes = random_directions(16, 8, iteration % 16, target)
        return sliced_distance(values, None, axes, quantile_table(axes @ target)).sqrt()

    ends = []
    for loss in (lambda x, n: all_sorted(x, 0), counted):
        values = start.clone().requires_grad_()
        list(minimize(lambda n, x=values, f=loss: f(x, n), [values], Descent(0.02, 160)))
        ends.append(all_sorted(values.detach(), 777).item())
    assert max(ends) < 0.2 * all_sorted(start, 777).item()
    assert ends[1] < 1.03 * ends[0]


@pytest.mark.parametrize(
    ("values", "weights", "table"),
    [((3, 5), None, (2, 4)), ((2, 5), (4,), (2, 4)), ((5,), None, (2, 4)), ((2, 5), None, (1, 4))],
)
def test_shapes_that_do_not_fit_are_refused_with_what_was_found(values, weights, table) -> None:
    w = None if weights is None else torch.ones(weights)
    with pytest.raises(ShapeError, match=r"sliced_distance: .*\["):
        sliced_distance(torch.ones(values), w, torch.eye(2), torch.ones(table))

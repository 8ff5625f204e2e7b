"""Quantile tables, the transport distance to them, and directions to project on."""

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.autograd import gradcheck

from usdsmoke.base.errors import ShapeError
from usdsmoke.core.style.quantiles import (
    STEPS,
    quantile_distance,
    quantile_table,
    random_directions,
)

DOUBLE = torch.float64


def normal(*shape: int, seed: int = 0, dtype: torch.dtype = DOUBLE) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def weights_of(n: int, seed: int = 9) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(n, generator=generator, dtype=DOUBLE) + 0.1


def distance_sample_by_sample(values: np.ndarray, weights: np.ndarray, table: np.ndarray) -> float:
    """The definition, one channel and one sample after the other."""
    n = table.shape[1]
    total = 0.0
    for row, quantiles in zip(values, table, strict=True):
        below, cost = 0.0, 0.0
        for p in sorted(range(len(row)), key=lambda p: row[p]):
            share = (below + weights[p] / 2) / weights.sum()
            wanted = np.interp(share, (np.arange(n) + 0.5) / n, quantiles)
            cost += weights[p] * (row[p] - wanted) ** 2
            below += weights[p]
        total += cost / weights.sum()
    return total / len(values)


def wasserstein_squared(a: np.ndarray, a_weights: np.ndarray, b: np.ndarray) -> float:
    """Between two sets of points on the line, exactly: mass moved piece by piece, in order."""
    order = np.argsort(a)
    a, ends = a[order], np.cumsum(a_weights[order]) / a_weights.sum()
    b, b_ends = np.sort(b), np.arange(1, len(b) + 1) / len(b)
    cuts = np.union1d(ends, b_ends)
    middles = (cuts + np.concatenate([[0.0], cuts[:-1]])) / 2
    at_a = a[np.searchsorted(ends, middles).clip(max=len(a) - 1)]
    at_b = b[np.searchsorted(b_ends, middles).clip(max=len(b) - 1)]
    return float((np.diff(cuts, prepend=0.0) * (at_a - at_b) ** 2).sum())


def test_table_of_as_many_entries_as_samples_is_the_sorted_samples():
    values = normal(3, 37)
    assert torch.allclose(quantile_table(values, 37), values.sort(dim=1).values, atol=1e-13)


@pytest.mark.parametrize("n_samples", [1, 2, 5, 300])
@pytest.mark.parametrize("n", [1, 7, 256])
def test_table_is_numpys_quantiles_of_mid_point_positions(n_samples, n):
    values = normal(2, n_samples)
    shares = (np.arange(n) + 0.5) / n
    wanted = np.quantile(values.numpy(), shares, axis=1, method="hazen").T
    assert np.allclose(quantile_table(values, n).numpy(), wanted, atol=1e-13)


def test_a_table_of_many_samples_is_off_by_no_more_than_half_a_step():
    values = normal(3, 5000, dtype=torch.float32) * torch.tensor([[1e-3], [1.0], [1e6]])
    values[2] = 7.0  # of one value
    found, wanted = quantile_table(values, 5000), values.sort(dim=1).values
    off, reach = (found - wanted).abs().amax(1), wanted[:, -1] - wanted[:, 0]
    assert (off <= 0.51 * reach / STEPS + 1e-6 * wanted.abs().amax(1)).all()
    assert off[:2].min() > 0  # they are rounded


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_sample_that_is_not_finite_leaves_the_others_where_they_are(bad):
    values = normal(2, 5000, dtype=torch.float32)
    values[1, 7] = bad
    found = quantile_table(values, 5000)
    assert torch.equal(found[1, :-2], values[1].sort().values[:-2])
    assert not found[1, -1].isfinite()


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32])
def test_halves_are_counted_in_single_precision(dtype):
    values = (normal(2, 4000) * 100).to(dtype)
    table = quantile_table(values, 64)
    distance = quantile_distance(values + 200, torch.ones(4000, dtype=dtype), table)
    assert table.dtype == distance.dtype == torch.float32
    # 4000 x 200^2 = 1.6e8 is far beyond 65504.
    assert distance.item() == pytest.approx(200.0**2, rel=2e-2 if dtype == torch.bfloat16 else 2e-3)


def test_distance_of_the_style_itself_is_zero_in_any_order_of_pixels():
    style = normal(4, 64)
    shuffled = style[:, torch.randperm(64, generator=torch.Generator().manual_seed(1))]
    for weights in (None, torch.full((64,), 0.3, dtype=DOUBLE)):
        assert quantile_distance(shuffled, weights, quantile_table(style, 64)).item() < 1e-26


def test_distance_of_a_large_style_itself_falls_with_the_size_of_the_table():
    """What is left is the tails beyond the outermost quantiles."""
    style = normal(2, 20000)
    found = [
        quantile_distance(style, None, quantile_table(style, n)).item() for n in (64, 256, 1024)
    ]
    assert found[1] < 1e-3 and found[1] < found[0] / 3 and found[2] < found[1] / 3


@pytest.mark.parametrize("weighted", [False, True])
def test_distance_of_shifted_samples_is_the_square_of_the_shift(weighted):
    style = normal(3, 50)
    shift = torch.tensor([0.5, -2.0, 3.0], dtype=DOUBLE)
    weights = torch.full((50,), 0.7, dtype=DOUBLE) if weighted else None
    found = quantile_distance(style + shift[:, None], weights, quantile_table(style, 50))
    assert found.item() == pytest.approx((0.25 + 4 + 9) / 3, rel=1e-12)


@pytest.mark.parametrize("factor", [0.0, 0.25, 3.0])
def test_distance_of_scaled_samples_is_their_mean_square_times_the_square_of_the_change(factor):
    style = normal(1, 80)
    found = quantile_distance(factor * style, None, quantile_table(style, 80))
    assert found.item() == pytest.approx(
        (factor - 1) ** 2 * style.square().mean().item(), rel=1e-12
    )


def test_distance_between_normal_distributions_has_its_closed_form():
    """(mean difference)^2 + (deviation difference)^2."""
    shares = (torch.arange(4096, dtype=DOUBLE) + 0.5) / 4096
    quantiles = torch.special.ndtri(shares)[None]
    found = quantile_distance(1 + 2 * quantiles, None, quantile_table(quantiles, 4096))
    assert found.item() == pytest.approx(1 + 1, rel=2e-3)


def test_distance_agrees_with_the_definition_sample_by_sample():
    values, weights, table = (
        normal(3, 41),
        weights_of(41),
        quantile_table(normal(3, 90, seed=2), 17),
    )
    for w in (None, weights):
        given_weights = np.ones(41) if w is None else w.numpy()
        wanted = distance_sample_by_sample(values.numpy(), given_weights, table.numpy())
        assert quantile_distance(values, w, table).item() == pytest.approx(wanted, rel=1e-12)


def test_distance_without_weights_is_the_squared_wasserstein_distance():
    values, style = normal(1, 60), normal(1, 60, seed=1) * 2 + 1
    wanted = wasserstein_squared(values[0].numpy(), np.ones(60), style[0].numpy())
    found = quantile_distance(values, None, quantile_table(style, 60)).item()
    assert found == pytest.approx(wanted, rel=1e-12)


def test_weighted_distance_tends_to_the_squared_wasserstein_distance():
    style = normal(1, 2000, seed=1) * 2 + 1
    errors = []
    for n in (100, 10000):
        values, weights = normal(1, n), weights_of(n)
        wanted = wasserstein_squared(values[0].numpy(), weights.numpy(), style[0].numpy())
        found = quantile_distance(values, weights, quantile_table(style, 2000)).item()
        errors.append(abs(found - wanted) / wanted)
    assert errors[0] < 2e-2 and errors[1] < 2e-4


def test_an_integer_weight_pulls_as_hard_as_that_many_copies_of_the_pixel():
    """Exact where the table is linear; the copies' values alone spread within their share."""
    table = torch.linspace(-50, 50, 4096, dtype=DOUBLE)[None]
    values, counts = normal(1, 20).sort(dim=1).values, torch.arange(20) % 3 + 1
    few = values.clone().requires_grad_()
    many = values.repeat_interleave(counts, dim=1).requires_grad_()
    (pull,) = torch.autograd.grad(quantile_distance(few, counts.double(), table), few)
    (pulls,) = torch.autograd.grad(quantile_distance(many, None, table), many)
    owner = torch.arange(20).repeat_interleave(counts)
    summed = torch.zeros(20, dtype=DOUBLE).index_add_(0, owner, pulls[0])
    # A copy within half a table entry of the ends is held at them.
    assert torch.allclose(pull[0, 1:-1], summed[1:-1], rtol=1e-10)


def test_weights_count_relative_to_one_another_however_small_or_large():
    values, table, weights = normal(2, 30), quantile_table(normal(2, 50, seed=1)), weights_of(30)
    wanted = quantile_distance(values, weights, table).item()
    for factor in (1e-300, 1e-5, 1e308):  # the sum of the last overflows
        found = quantile_distance(values, weights * factor, table).item()
        assert found == pytest.approx(wanted, rel=1e-12)


def test_pixels_of_weight_zero_have_no_influence_and_no_gradient():
    values, weights, table = normal(2, 30), weights_of(30), quantile_table(normal(2, 50, seed=1))
    weights[::3] = 0
    kept = weights > 0
    wanted = quantile_distance(values[:, kept], weights[kept], table)
    values[:, ~kept] = 1e6
    values.requires_grad_()
    found = quantile_distance(values, weights, table)
    (gradient,) = torch.autograd.grad(found, values)
    assert found.item() == wanted.item()
    assert not gradient[:, ~kept].any() and gradient[:, kept].all()


def test_no_weight_at_all_gives_exactly_zero_and_no_gradient():
    values = normal(2, 5).requires_grad_()
    found = quantile_distance(values, torch.zeros(5, dtype=DOUBLE), quantile_table(normal(2, 9)))
    (gradient,) = torch.autograd.grad(found, values)
    assert found.item() == 0 and not gradient.any()


def test_one_pixel_is_matched_with_the_median():
    table = quantile_table(torch.tensor([[1.0, 2.0, 9.0]]), 3)
    for weights in (None, torch.tensor([0.01])):
        assert quantile_distance(torch.tensor([[5.0]]), weights, table).item() == pytest.approx(9.0)


@pytest.mark.parametrize("weighted", [False, True])
def test_gradients_agree_with_finite_differences_away_from_ties(weighted):
    values, table = normal(3, 12).requires_grad_(), quantile_table(normal(3, 40, seed=1), 8)
    weights = weights_of(12) if weighted else None
    if weights is not None:
        weights[4] = 0
    assert gradcheck(lambda x: quantile_distance(x, weights, table), values)


def test_descent_carries_the_picture_to_the_distribution_of_the_style():
    values, style = normal(2, 40).requires_grad_(), normal(2, 40, seed=1).exp()
    table = quantile_table(style, 40)
    (gradient,) = torch.autograd.grad(quantile_distance(values, None, table), values)
    arrived = values - gradient * 2 * 40 / 2  # one Newton step: the distance is a parabola
    assert torch.allclose(arrived.sort(dim=1).values, style.sort(dim=1).values, atol=1e-12)


finite = st.floats(-(2.0**50), 2.0**50, width=32)  # squares stay in float32


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(finite, st.floats(0, 1, width=32)), min_size=1, max_size=12),
    st.lists(finite, min_size=1, max_size=12),
    st.integers(1, 9),
)
@example([(4.9050096287419677e-23, 1.0)], [0.0], 1)
def test_any_finite_input_gives_a_finite_distance_and_gradient(samples, style, n):
    values = torch.tensor([[value for value, _ in samples]], requires_grad=True)
    weights = torch.tensor([weight for _, weight in samples])
    table = quantile_table(torch.tensor([style]), n)
    found = quantile_distance(values, weights, table)
    (gradient,) = torch.autograd.grad(found, values)
    assert torch.isfinite(table).all() and (table.diff(dim=1) >= 0).all()
    assert torch.isfinite(found) and found >= 0 and torch.isfinite(gradient).all()
    reach = max(abs(value) for value, _ in samples) + max(map(abs, style))
    # squares below the least normal number are rounded to whole steps of 1.4e-45
    assert found.item() <= reach**2 * (1 + 1e-4) + len(samples) * 2.0**-149


@pytest.mark.parametrize(("n_channels", "n"), [(1, 3), (5, 5), (7, 3), (4, 11), (128, 32)])
def test_directions_are_orthonormal_within_each_block(n_channels, n):
    directions = random_directions(n_channels, n, 3, torch.zeros((), dtype=DOUBLE))
    assert directions.shape == (n, n_channels)
    for block in directions.split(n_channels):
        unit = torch.eye(len(block), dtype=DOUBLE)
        assert torch.allclose(block @ block.T, unit, atol=1e-13)


def test_directions_follow_the_seed_and_the_dtype():
    single = random_directions(6, 6, 1, torch.zeros(1))
    assert torch.equal(single, random_directions(6, 6, 1, torch.zeros(1, requires_grad=True)))
    assert single.dtype == random_directions(6, 6, 1, torch.zeros(1).half()).dtype == torch.float32
    assert not torch.allclose(single, random_directions(6, 6, 2, torch.zeros(1)))
    blocks = random_directions(6, 12, 1, torch.zeros(1)).split(6)
    assert not torch.allclose(blocks[0], blocks[1])


def test_directions_favour_no_side():
    """Of 2000 directions in the plane, all octants hold an eighth."""
    x, y = random_directions(2, 2000, 0, torch.zeros((), dtype=DOUBLE)).T
    octants = ((torch.atan2(y, x) / (torch.pi / 4)).floor() + 4).long().bincount(minlength=8)
    assert octants.min() > 200 and octants.max() < 300


def test_sliced_distance_of_a_shift_is_its_mean_square_whichever_way_it_points():
    style, basis = normal(6, 50), random_directions(6, 6, 4, torch.zeros((), dtype=DOUBLE))
    for seed in (5, 6):
        shift = normal(6, 1, seed=seed)
        found = quantile_distance(basis @ (style + shift), None, quantile_table(basis @ style, 50))
        assert found.item() == pytest.approx(shift.square().mean().item(), rel=1e-12)


def test_sliced_distance_sees_correlations_that_single_channels_do_not():
    style = normal(2, 4000)
    style[1] = style[0] + 0.1 * style[1]
    picture = torch.stack([style[0], style[1].flip(0)])
    channelwise = quantile_distance(picture, None, quantile_table(style, 4000))
    directions = random_directions(2, 8, 0, style)
    sliced = quantile_distance(directions @ picture, None, quantile_table(directions @ style, 4000))
    assert channelwise.item() < 1e-20 and sliced.item() > 0.05


@pytest.mark.parametrize(
    ("values", "weights", "table"),
    [((2, 5), None, (3, 4)), ((2, 5), (4,), (2, 4)), ((5,), None, (1, 4)), ((2, 5), None, (2, 0))],
)
def test_shapes_that_do_not_fit_are_refused_with_both_named(values, weights, table):
    w = None if weights is None else torch.ones(weights)
    with pytest.raises(ShapeError, match=r"quantile_distance: .*\["):
        quantile_distance(torch.ones(values), w, torch.ones(table))


@pytest.mark.parametrize(("shape", "n"), [((2, 0), 8), ((5,), 8), ((2, 5), 0)])
def test_tables_of_nothing_are_refused(shape, n):
    with pytest.raises(ShapeError, match=r"quantile_table: "):
        quantile_table(torch.ones(shape), n)

"""Estimated errors against true ones, on problems where these are known."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.special import erf
from torch import Tensor

from benchmarks.raymarch import march_rays
from tests.fixtures.smoke_fixtures import gaussian_column, gaussian_smoke, smoke_of
from usdsmoke.config.settings import Config
from usdsmoke.core.fields.richardson import step_error
from usdsmoke.core.fields.transport import Scheme, warp
from usdsmoke.core.fields.warp_error import warp_error
from usdsmoke.core.sequence import picture_errors
from usdsmoke.core.sequence.error_estimates import USUALLY_LEFT, tail_figures
from usdsmoke.core.sequence.picture_errors import (
    Painted,
    fit_blocks,
    pixel_filter_error,
    quadrature_error,
    resolution_error,
)
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.steps.loss_tail import likely_difference, remaining_decrease, spread_of_mean
from usdsmoke.core.steps.optimize import MENDING, Descent, Minimum, minimize
from usdsmoke.core.views.cameras import View, orbit_view
from usdsmoke.core.views.scene import fit_view

WITHIN = 3.0  # times too large or too small
WIDTH = 0.09  # of the Gaussian, whose box ends at 1/2: 2e-7 of it lies outside


def agree(estimated: float, true: float) -> bool:
    return true / WITHIN < estimated < true * WITHIN


def view_of(smoke: ActiveSmoke, azimuth: float, elevation: float, pixel: float) -> View:
    tiny = orbit_view(azimuth, elevation, "Y", np.zeros(3), 1, 1, pixel)
    return fit_blocks(fit_view(tiny, smoke))


def blob(n: int, gamma: float, azimuth: float, elevation: float) -> tuple[Painted, View]:
    """A Gaussian whose colour is its own transmittance: the ray's sum is (1 - T^2) / 2."""
    smoke = gaussian_smoke(n, WIDTH)
    view = view_of(smoke, azimuth, elevation, 1 / n)
    axes = np.stack([view.right, view.up, view.forward], axis=1)
    x, y, z = (smoke.positions.numpy() @ axes).T
    before = gaussian_column(x, y, WIDTH) / 2 * (1 + erf(z / (WIDTH * math.sqrt(2))))
    colour = torch.as_tensor(np.exp(-gamma * before), dtype=torch.float32)
    return Painted(smoke, colour[:, None].repeat(1, 3)), view


def exact_picture(view: View, gamma: float) -> np.ndarray:
    x = (np.arange(view.width) - (view.width - 1) / 2) * view.pixel_size + view.centre @ view.right
    y = ((view.height - 1) / 2 - np.arange(view.height)) * view.pixel_size + view.centre @ view.up
    column = gamma * gaussian_column(x[None], y[:, None], WIDTH)
    light = -np.expm1(-2 * column) / 2
    return np.stack([light, light, light, -np.expm1(-column)], axis=-1)


def marched(painted: Painted, view: View, gamma: float) -> np.ndarray:
    """The picture by a renderer that shares no code with the project's."""
    n = round(len(painted.smoke.ijk) ** (1 / 3))
    assert painted.colours is not None
    density = painted.smoke.density.view(n, n, n).numpy()
    light = (painted.colours * gamma * painted.smoke.density[:, None]).view(n, n, n, 3).numpy()
    matrix = painted.smoke.index_to_stage
    colour, alpha = march_rays(density, light, matrix, gamma, view, steps_per_voxel=8)
    return np.concatenate([colour, alpha[..., None]], axis=-1)


@pytest.mark.parametrize("gamma", [1.0, 10.0, 100.0])
@pytest.mark.parametrize("angles", [(17.0, 9.0), (45.0, 10.0), (0.0, 0.0)])
def test_quadrature_is_the_difference_from_another_renderer(
    gamma: float, angles: tuple[float, float]
) -> None:
    painted, view = blob(32, gamma, *angles)
    view = replace(view, centre=view.centre + view.pixel_size * (0.3 * view.right - 0.2 * view.up))
    exact = marched(painted, view, gamma)
    true = float(np.abs(painted.picture(view, gamma).numpy() - exact).sum() / exact.sum())
    assert quadrature_error(painted, view, gamma) == pytest.approx(true, rel=0.1, abs=1e-4)


def test_quadrature_of_large_smoke_is_that_of_its_middle_and_of_some_pixels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    painted, view = blob(32, 10.0, 17.0, 9.0)
    whole = quadrature_error(painted, view, 10.0)
    monkeypatch.setattr(picture_errors, "MOST_RAYS", 400)
    assert quadrature_error(painted, view, 10.0) == pytest.approx(whole, rel=0.3)
    monkeypatch.setattr(picture_errors, "MOST_VOXELS", 9000)
    assert whole / 2 < quadrature_error(painted, view, 10.0) < 2 * whole


@pytest.mark.parametrize("gamma", [1.0, 10.0, 50.0])
@pytest.mark.parametrize("n", [24, 48])
@pytest.mark.parametrize("angles", [(-31.0, 4.0), (17.0, 9.0)])
def test_resolution_of_a_blob_with_analytic_columns(
    gamma: float, n: int, angles: tuple[float, float]
) -> None:
    painted, view = blob(n, gamma, *angles)
    found, exact = painted.picture(view, gamma).double().numpy(), exact_picture(view, gamma)
    true = float(np.abs(found - exact).sum() / exact.sum())
    assert agree(resolution_error(painted, view, gamma).value, true)


def test_resolution_is_not_underestimated_where_voxels_fall_on_pixels() -> None:
    """Such a view of point samples is exact, which coarser voxels, being means, cannot tell."""
    painted, view = blob(32, 10.0, 0.0, 0.0)
    found, exact = painted.picture(view, 10.0).double().numpy(), exact_picture(view, 10.0)
    assert resolution_error(painted, view, 10.0).value > np.abs(found - exact).sum() / exact.sum()


@pytest.mark.parametrize(("width", "wanted"), [(1, 0.3), (4, 0.075)])
def test_the_pixel_filter_blurs_stripes_of_a_pixel(width: int, wanted: float) -> None:
    """Black and white stripes, linear between voxels."""
    n = 96
    smoke = smoke_of(np.ones((n, n, 2)))
    stripes = (smoke.ijk[:, :1] // width % 2).float().expand(-1, 3)
    view = view_of(smoke, 0.0, 0.0, smoke.voxel_size)
    found = pixel_filter_error(Painted(smoke, stripes.contiguous()), view, 1e3)
    assert found == pytest.approx(wanted, rel=0.25)


def test_smooth_smoke_has_hardly_any_error_of_the_pixel_filter() -> None:
    painted, view = blob(48, 1.0, 0.0, 0.0)
    assert pixel_filter_error(painted, view, 1.0) < 0.01


def moved_blob(width: float, turned: bool) -> tuple[Tensor, Tensor, Tensor]:
    """A Gaussian in 48^3 voxels, a displacement, and what it becomes."""

    def at(i: Tensor, j: Tensor, k: Tensor) -> Tensor:
        squares = (i - 24) ** 2 + (j - 23) ** 2 + (k - 25) ** 2
        return torch.exp(-squares / (2 * width**2))

    axis = torch.arange(48, dtype=torch.float64)
    place = torch.meshgrid(axis, axis, axis, indexing="ij")
    if turned:
        x, y, turn = place[0] - 20, place[1] - 20, 0.3
        u = torch.stack(
            [
                x - math.cos(turn) * x - math.sin(turn) * y,
                y + math.sin(turn) * x - math.cos(turn) * y,
                torch.zeros_like(x),
            ],
            dim=-1,
        )
    else:
        u = torch.tensor([2.3, -1.4, 0.5], dtype=torch.float64).expand(48, 48, 48, 3)
    departures = [p - part for p, part in zip(place, u.unbind(-1), strict=True)]
    return at(*place), u, at(*departures)


@pytest.mark.parametrize("scheme", ["linear", "cubic"])
@pytest.mark.parametrize("width", [3.0, 4.0])
@pytest.mark.parametrize("turned", [False, True])
def test_transport_of_a_blob_shifted_and_turned(scheme: Scheme, width: float, turned: bool) -> None:
    values, u, exact = moved_blob(width, turned)
    moved = warp(values, u, scheme=scheme)
    true = float((moved - exact).abs().sum() / exact.sum())
    assert agree(warp_error(values, u, moved.clamp_min(0), scheme), true)


def test_a_shift_by_four_voxels_has_no_transport_error() -> None:
    values = moved_blob(3.0, False)[0]
    u = torch.zeros(48, 48, 48, 3, dtype=torch.float64)
    u[..., 0] = 4
    assert warp_error(values, u, warp(values, u, scheme="linear"), "linear") < 1e-12


def distance(place: np.ndarray) -> np.ndarray:
    return np.sqrt(((place - 11.5) ** 2).sum(-1))


def lumps(place: np.ndarray, width: float) -> np.ndarray:
    """Sixty Gaussians anywhere in 16 of the 24 voxels."""
    centres = np.random.default_rng(1).uniform(7, 16, (60, 3))
    squares = ((place[..., None, :] - centres) ** 2).sum(-1)
    return np.exp(-squares / (2 * width**2)).sum(-1)


DENSITIES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    **{f"lumps of {s} voxels": lambda x, s=s: lumps(x, s) for s in (1.6, 1.2, 1.0, 0.6, 0.4)},
    "cube": lambda x: (np.abs(x - 11.5).max(-1) < 4.9).astype(float),
    "ball": lambda x: (distance(x) < 5.3).astype(float),
    "cone": lambda x: np.clip(1 - distance(x) / 6, 0, None),
}


@pytest.mark.parametrize("name", DENSITIES)
@pytest.mark.parametrize("scheme", ["linear", "cubic"])
def test_transport_is_told_within_a_factor_of_2_however_fine_the_smoke(
    name: str, scheme: Scheme
) -> None:
    n = 24
    place = np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), -1).astype(float)
    vortices = np.sin(2 * np.pi * place[..., [1, 2, 0]] / 12) * 0.9
    values, u = torch.as_tensor(DENSITIES[name](place)), torch.as_tensor(vortices)
    moved = warp(values, u, scheme=scheme).clamp_min(0)
    exact = torch.as_tensor(DENSITIES[name](place - vortices))
    true = float((moved - exact).abs().sum() / exact.sum())
    assert true / 2 < warp_error(values, u, moved, scheme) < 2 * true


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 9, 9), (9, 1, 1)])
def test_transport_of_little_smoke_has_a_finite_estimate(shape: tuple[int, int, int]) -> None:
    values = torch.zeros(shape)
    u = torch.full((*shape, 3), 0.4)
    assert warp_error(values, u, values, "cubic") == 0
    values[tuple(n // 2 for n in shape)] = 1e30
    assert 0 <= warp_error(values, u, warp(values, u, scheme="cubic").clamp_min(0), "cubic") < 5


USUAL = USUALLY_LEFT["colour"]
STEP_LOSSES = Path(__file__).with_name("step_losses.json")


def bowl(conditioning: float, noise: float) -> tuple[Tensor, Callable[[int], Tensor]]:
    """200 unknowns from chance, and 10 + half their weighted squares, with noise on the 10."""
    generator = torch.Generator().manual_seed(1)
    weights = torch.logspace(0, -math.log10(conditioning), 200, dtype=torch.float64)
    unknowns = torch.randn(200, generator=generator, dtype=torch.float64).requires_grad_()
    shaken = torch.randn(1000, generator=generator, dtype=torch.float64)

    def loss(iteration: int) -> Tensor:
        return 0.5 * (weights * unknowns**2).sum() + 10 * (1 + noise * shaken[iteration])

    return unknowns, loss


@pytest.mark.parametrize("conditioning", [3.0, 1000.0])
@pytest.mark.parametrize(("rate", "n"), [(0.01, 60), (0.01, 120), (0.03, 60)])
@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_what_a_bowl_s_loss_still_has_to_fall(
    conditioning: float, rate: float, n: int, noise: float
) -> None:
    unknowns, loss = bowl(conditioning, noise)
    end = list(minimize(loss, [unknowns], Descent(rate, n)))[-1]
    weights = torch.logspace(0, -math.log10(conditioning), 200, dtype=torch.float64)
    left = float(0.5 * (weights * unknowns.detach() ** 2).sum())
    assert agree(remaining_decrease(end.losses, end.rates, USUAL), left)


@pytest.mark.parametrize("run", json.loads(STEP_LOSSES.read_text()), ids=lambda run: run["smoke"])
def test_what_steps_still_have_to_fall_is_told_within_a_factor_of_2(run: dict[str, Any]) -> None:
    """Recorded runs, and their ends and those of runs four times as long, each over a passage."""
    rates = run["rate"] * np.array(run["shares"])
    told = remaining_decrease(run["losses"], list(rates), USUALLY_LEFT[run["step"]])
    assert 0.5 < told / (run["end"] - run["far_end"]) < 2


def test_a_bowl_whose_bottom_is_reached_has_nothing_left() -> None:
    unknowns, loss = bowl(3.0, 0.0)
    end = list(minimize(loss, [unknowns], Descent(0.05, 300)))[-1]
    assert remaining_decrease(end.losses, end.rates, USUAL) < 1e-3 * (
        end.losses[0] - end.losses[-1]
    )


def test_few_losses_or_some_that_are_not_finite_tell_nothing() -> None:
    assert math.isnan(remaining_decrease([1.0] * 29, [1.0] * 29, USUAL))
    assert math.isnan(remaining_decrease([1.0] * 29 + [math.inf], [1.0] * 30, USUAL))
    assert remaining_decrease([1.0] * 30, [1.0] * 30, USUAL) < 1e-9


def test_the_defaults_have_enough_iterations_for_it() -> None:
    """``daily`` tells what is left of both steps; iterations after a change are not counted."""
    config = Config()
    n_shape, n_colour = config.shape.iterations[-1], config.colour.iterations[-1]
    for n in (n_shape, n_colour - int(MENDING * n_colour)):
        left = remaining_decrease((1.0 + 1.0 / np.arange(1, n + 1)).tolist(), [1.0] * n, USUAL)
        assert left > 0


@pytest.mark.parametrize(("pool", "count"), [(16, 1), (12, 1), (16, 4)])
def test_spread_over_views_is_that_of_the_means_of_many_pools(pool: int, count: int) -> None:
    """Losses like those of Gram matrices, sums of 50 squares, the same view with the same loss."""
    generator = np.random.default_rng(0)

    def pool_losses() -> np.ndarray:
        return generator.normal(size=(pool, 50)) ** 2 @ np.ones(50)

    true = np.std([losses.mean() / 50 for losses in (pool_losses() for _ in range(2000))])
    for _ in range(20):
        drawn = generator.permutation(pool_losses()).reshape(-1, count).mean(axis=1)
        falling = np.linspace(0.1, 0.0, len(drawn)) * 50
        assert agree(spread_of_mean(list(drawn + falling), pool, count), float(true))


def test_one_view_has_no_spread() -> None:
    assert math.isnan(spread_of_mean([3.0, 2.0, 1.0], 1))


def test_few_views_tell_how_far_apart_two_sets_of_them_are() -> None:
    """The root mean square of what is told is that of the sets' true differences."""
    generator, told, true = np.random.default_rng(3), [], []
    for _ in range(4000):
        ours, others = generator.normal(2.0, 0.05, 8), generator.normal(2.0, 0.05, 2)
        apart = generator.normal(0.0, 0.05 * math.sqrt(1 / 8 + 1 / 2))
        told.append(likely_difference(ours, others + apart))
        true.append(apart / 2.0)
    assert np.sqrt(np.mean(np.square(told))) == pytest.approx(np.std(true), rel=0.1)
    assert np.mean(np.array(told) < 0.2 * np.std(true)) == 0  # no accident tells that there is none
    assert likely_difference([2.0, 2.0], [2.5]) == pytest.approx(0.125)  # half of it, no scatter
    assert likely_difference([2.0], [2.5]) == pytest.approx(0.25)
    assert likely_difference([0.0, 0.0], [1.0]) == 0.0


def test_the_order_is_fitted_and_held_in_its_limits() -> None:
    exact = torch.linspace(1, 2, 100)
    for order, fitted in ((1.5, 1.5), (0.5, 1.0), (3.0, 2.0)):
        found = step_error([exact + 1e-3 * h**order for h in (1.0, 2.0, 4.0)])
        assert found.order == pytest.approx(fitted, abs=1e-2)


def test_what_all_octaves_leave_does_not_depend_on_how_each_weighs_its_loss() -> None:
    def ended(first: float, last: float, weight: float) -> Minimum:
        losses = tuple(weight * value for value in np.linspace(first, last, 20))
        return Minimum(
            19, losses[-1], losses[-1], 0, 0.01, "iterations", losses=losses, rates=(0.01,) * 20
        )

    for weight in (1.0, 3.0):
        ends = [ended(8.0, 4.0, weight), ended(5.0, 4.0, weight), ended(4.0, 3.0, 1.0)]
        fallen = tail_figures("colour", ends, 16, 1)["fallen"]
        assert 3.0 / (3.0 + fallen) == pytest.approx(0.5 * 0.8 * 0.75)
    gone = tail_figures("colour", [ended(8.0, 0.0, 1.0), ended(4.0, 3.0, 1.0)], 16, 1)
    assert gone["fallen"] > 1e6

"""Transmittance, emission, scattered light and gradients against Mitsuba 3; skipped without it."""

import importlib.util
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.lights import (
    field_of,
    lumpy_ball,
    our_emission,
    our_picture,
    refined,
    stripes,
)
from usdsmoke.base.volume import DenseField, LightSource, Scattering
from usdsmoke.core.smoke.active import ActiveSmoke, activate
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.lighting import light_smoke
from usdsmoke.core.views.optics import opacity
from usdsmoke.core.views.project import colour_map, column_map
from usdsmoke.work_precision.path_tracer import MOST_BOUNCES, TracedSmoke

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None, reason="Mitsuba 3 is not installed"
)
N, FINER, SEEDS, SAMPLES = 24, 4, 8, 24
VIEW = View(np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2], np.zeros(3), N, N, 1 / N)
SIDE, BACK = (0.8, 0.36, 0.48), (0.0, 0.6, -0.8)


DENSITY = lumpy_ball(N)


def within_three_errors(
    theirs: Callable[[int], np.ndarray], ours: Callable[[DenseField, View], torch.Tensor]
) -> None:
    """The model on finer voxels of the same trilinear field, against a few seeds."""
    means = [theirs(seed).mean((0, 1)) for seed in range(SEEDS)]
    finer = replace(VIEW, height=FINER * N, width=FINER * N, pixel_size=1 / N / FINER)
    found = ours(field_of(refined(DENSITY, FINER)), finer).mean((0, 1)).numpy()
    error = np.std(means, axis=0, ddof=1) / SEEDS**0.5
    assert (error < 0.05 * np.mean(means, axis=0)).all()
    assert (np.abs(found - np.mean(means, axis=0)) < 3 * error).all()


def extinction(depth: float) -> float:
    """With which the deepest column has an optical depth."""
    return depth / float((DENSITY.sum(2) / N).max())


def compare(scattering: Scattering, depth: float) -> None:
    gamma_w = extinction(depth)
    within_three_errors(
        lambda seed: TracedSmoke(field_of(DENSITY), gamma_w, scattering).lit(VIEW, SAMPLES, seed),
        lambda smoke, view: our_picture(smoke, gamma_w, scattering, view),
    )


@pytest.mark.parametrize("depth", [0.1, 1.0, 10.0, 50.0])
def test_transmittance_is_within_three_standard_errors(depth: float) -> None:
    compare(Scattering((), 0.0), depth)


@pytest.mark.parametrize("depth", [0.1, 4.0, 50.0])
def test_emission_is_within_three_standard_errors(depth: float) -> None:
    gamma_w, colours = extinction(depth), stripes(N)
    finer = field_of(refined(colours, FINER))
    within_three_errors(
        lambda seed: TracedSmoke(field_of(DENSITY), gamma_w, Scattering((), 0.0)).glow(
            field_of(colours), VIEW, 3 * SAMPLES, seed
        ),
        lambda smoke, view: our_emission(smoke, finer, gamma_w, view),
    )


@pytest.mark.parametrize("towards", [SIDE, BACK])
@pytest.mark.parametrize(("depth", "anisotropy"), [(0.1, 0.0), (4.0, -0.4), (50.0, 0.6)])
def test_single_scattering_is_within_three_standard_errors(towards, depth, anisotropy) -> None:
    sun = LightSource("/sun", (1.0, 0.5, 0.25), towards)
    compare(Scattering((sun,), 0.9, anisotropy), depth)


@pytest.mark.parametrize("depth", [0.1, 4.0, 50.0])
def test_a_dome_is_within_three_standard_errors(depth: float) -> None:
    compare(Scattering((LightSource("/sky", (1.0, 0.5, 0.25)),), 0.9), depth)


def finest() -> tuple[ActiveSmoke, View]:
    """The ball on finer voxels of the same trilinear field, and its view."""
    smoke = activate(field_of(refined(DENSITY, FINER)), np.eye(4), torch.device("cpu"))
    return smoke, replace(VIEW, height=FINER * N, width=FINER * N, pixel_size=1 / N / FINER)


def at(smoke: ActiveSmoke, values: np.ndarray) -> torch.Tensor:
    """Finer values at the voxels of the smoke."""
    return torch.from_numpy(refined(values, FINER)[tuple(smoke.ijk.numpy().T)])


def slope(change: torch.Tensor, start: torch.Tensor, mean: Callable[..., torch.Tensor]) -> float:
    """The derivative of a mean pixel along a change of the voxels, by autograd."""
    values = start.clone().requires_grad_()
    (found,) = torch.autograd.grad(mean(values), values)
    return float((found * change).sum())


def close_to(found: float, means: list[float]) -> None:
    error = np.std(means, ddof=1) / SEEDS**0.5
    assert error < 0.05 * abs(np.mean(means))
    assert abs(found - np.mean(means)) < 3 * error


RAMP = np.broadcast_to((np.arange(N, dtype=np.float32)[:, None, None] + 0.5) / N, DENSITY.shape)
RAMPS = np.repeat(RAMP[..., None], 3, axis=-1)  # of colours


@pytest.mark.parametrize("depth", [0.1, 4.0, 50.0])
def test_the_gradient_by_emission_is_within_three_standard_errors(depth: float) -> None:
    (smoke, view), gamma_w = finest(), extinction(depth)
    image, _ = colour_map(
        smoke.positions, smoke.density, smoke.edges, gamma_w, view, smoke.voxel_size
    )
    change = at(smoke, RAMPS)
    found = slope(change, torch.zeros_like(change), lambda colours: image.apply(colours).mean())
    traced = TracedSmoke(field_of(DENSITY), gamma_w, Scattering((), 0.0))
    glows = [traced.glow(field_of(RAMPS), VIEW, 3 * SAMPLES, seed) for seed in range(SEEDS)]
    close_to(found, [float(glow.mean()) for glow in glows])


@pytest.mark.parametrize("depth", [0.1, 4.0, 50.0])
def test_the_gradient_by_albedo_is_within_three_standard_errors(depth: float) -> None:
    (smoke, view), gamma_w = finest(), extinction(depth)
    scattering = Scattering((LightSource("/sun", (1.0, 1.0, 1.0), SIDE),), 1.0)
    image, _ = colour_map(
        smoke.positions, smoke.density, smoke.edges, gamma_w, view, smoke.voxel_size
    )
    lighting = light_smoke(smoke, gamma_w, scattering)
    assert lighting is not None
    light = lighting.on(smoke.positions).scattered(view.forward)
    change = at(smoke, RAMPS)
    found = slope(change, torch.zeros_like(change), lambda a: image.apply(light * a).mean())
    traced = TracedSmoke(field_of(DENSITY), gamma_w, scattering, field_of(RAMPS))
    close_to(found, [float(traced.lit(VIEW, SAMPLES, seed).mean()) for seed in range(SEEDS)])


@pytest.mark.parametrize("depth", [0.1, 4.0, 50.0])
def test_the_gradient_by_density_is_within_three_standard_errors(depth: float) -> None:
    """Integrated over a change of the density, by Simpson's rule, it is the change of the mean
    transmittance."""
    (smoke, view), gamma_w = finest(), extinction(depth)
    image = column_map(smoke.positions, smoke.edges, view)
    change = at(smoke, DENSITY * RAMP)

    def seen(density: torch.Tensor) -> torch.Tensor:
        return 1 - opacity(gamma_w * image.apply(density[:, None])).mean()

    less, middle, more = (slope(change, smoke.density + h * change, seen) for h in (-0.5, 0.0, 0.5))
    ends = [
        TracedSmoke(field_of(DENSITY * (1 + h * RAMP)), gamma_w, Scattering((), 0.0))
        for h in (-0.5, 0.5)
    ]
    means = [[end.lit(VIEW, 2 * SAMPLES, seed).mean() for seed in range(SEEDS)] for end in ends]
    close_to((less + 4 * middle + more) / 6, [float(b - a) for a, b in zip(*means, strict=True)])


def test_glow_that_is_scattered_many_times_is_that_of_a_half_space() -> None:
    """Opaque smoke that glows with 1 - a: sqrt(1 - a) H(1) along the normal, with Chandrasekhar's
    H(mu) = 1 + a / 2 mu H(mu) times the integral of H(nu) / (mu + nu) over nu from 0 to 1."""
    albedo, n = 0.6, 8
    smoke = field_of(np.ones((n, n, n), np.float32))
    colours = field_of(np.full((n, n, n, 3), 1 - albedo, np.float32))
    view = View(np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2], np.zeros(3), 4, 4, 1 / n)
    traced = TracedSmoke(smoke, 400.0, Scattering((), albedo))
    nodes, weights = (values / 2 for values in np.polynomial.legendre.leggauss(64))
    nodes, h = nodes + 0.5, np.ones(64)
    for _ in range(200):
        h = 1 / (1 - albedo / 2 * nodes * ((weights * h) / (nodes[:, None] + nodes)).sum(1))
    along = 1 / (1 - albedo / 2 * ((weights * h) / (1 + nodes)).sum())
    found = [traced.glow(colours, view, 64, seed, MOST_BOUNCES).mean() for seed in range(SEEDS)]
    error = np.std(found, ddof=1) / SEEDS**0.5
    assert error < 0.02
    assert abs(np.mean(found) - (1 - albedo) ** 0.5 * along) < 3 * error
    assert traced.glow(colours, view, 64, 0).mean() == pytest.approx(1 - albedo, rel=1e-3)


@pytest.mark.parametrize("towards", [SIDE, BACK])
@pytest.mark.parametrize(("depth", "albedo"), [(1.0, 0.9), (10.0, 0.5), (10.0, 0.9)])
def test_many_bounces_are_a_sum_of_six_terms_to_eight_percent(towards, depth, albedo) -> None:
    sun = (LightSource("/sun", (1.0, 1.0, 1.0), towards),)
    gamma_w, scattering = extinction(depth), Scattering(sun, albedo, bounces=True)
    traced = TracedSmoke(field_of(DENSITY), gamma_w, scattering)
    means = [traced.lit(VIEW, SAMPLES, seed, MOST_BOUNCES).mean() for seed in range(2)]
    found = our_picture(field_of(DENSITY), gamma_w, scattering, VIEW).mean()
    assert found == pytest.approx(np.mean(means), rel=0.08)
    once = our_picture(field_of(DENSITY), gamma_w, replace(scattering, bounces=False), VIEW).mean()
    assert once < 0.9 * np.mean(means)

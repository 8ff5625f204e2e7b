"""Transmittance, emission and scattered light against Mitsuba 3; skipped where it is missing."""

import importlib.util
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.lights import (
    field_of,
    lumpy_ball,
    mitsuba_emission,
    mitsuba_picture,
    our_emission,
    our_picture,
    refined,
    stripes,
)
from usdsmoke.base.volume import DenseField, LightSource, Scattering
from usdsmoke.core.views.cameras import View

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
        lambda seed: mitsuba_picture(field_of(DENSITY), gamma_w, scattering, VIEW, SAMPLES, seed),
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
        lambda seed: mitsuba_emission(
            field_of(DENSITY), field_of(colours), gamma_w, VIEW, 3 * SAMPLES, seed
        ),
        lambda smoke, view: our_emission(smoke, finer, gamma_w, view),
    )


@pytest.mark.parametrize("towards", [SIDE, BACK])
@pytest.mark.parametrize(("depth", "anisotropy"), [(0.1, 0.0), (4.0, -0.4), (50.0, 0.6)])
def test_single_scattering_is_within_three_standard_errors(towards, depth, anisotropy) -> None:
    sun = LightSource("/sun", (1.0, 0.5, 0.25), towards)
    compare(Scattering((sun,), 0.9, anisotropy), depth)

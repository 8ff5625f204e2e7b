"""Transmittance and scattered light against Mitsuba 3; skipped where that is not installed."""

import importlib.util
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.lights import field_of, lumpy_ball, mitsuba_picture, our_picture, refined
from usdsmoke.base.volume import LightSource, Scattering
from usdsmoke.core.views.cameras import View

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None, reason="Mitsuba 3 is not installed"
)
N, FINER, SEEDS, SAMPLES = 24, 4, 8, 24
VIEW = View(np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2], np.zeros(3), N, N, 1 / N)
SIDE, BACK = (0.8, 0.36, 0.48), (0.0, 0.6, -0.8)


def within_three_errors(scattering: Scattering, depth: float) -> None:
    """The model on finer voxels of the same trilinear field, against seeds in a fixed order."""
    density = lumpy_ball(N)
    gamma_w = depth / float((density.sum(2) / N).max())
    theirs = [
        mitsuba_picture(field_of(density), gamma_w, scattering, VIEW, SAMPLES, seed).mean((0, 1))
        for seed in range(SEEDS)
    ]
    finer = replace(VIEW, height=FINER * N, width=FINER * N, pixel_size=1 / N / FINER)
    fine = field_of(refined(density, FINER))
    ours = our_picture(fine, gamma_w, scattering, finer).mean((0, 1)).numpy()
    error = np.std(theirs, axis=0, ddof=1) / SEEDS**0.5
    assert (error < 0.05 * np.mean(theirs, axis=0)).all()
    assert (np.abs(ours - np.mean(theirs, axis=0)) < 3 * error).all()


@pytest.mark.parametrize("depth", [0.1, 1.0, 10.0, 50.0])
def test_transmittance_is_within_three_standard_errors(depth: float) -> None:
    within_three_errors(Scattering((), 0.0), depth)


@pytest.mark.parametrize("towards", [SIDE, BACK])
@pytest.mark.parametrize(("depth", "anisotropy"), [(0.1, 0.0), (4.0, -0.4), (50.0, 0.6)])
def test_single_scattering_is_within_three_standard_errors(towards, depth, anisotropy) -> None:
    sun = LightSource("/sun", (1.0, 0.5, 0.25), towards)
    within_three_errors(Scattering((sun,), 0.9, anisotropy), depth)

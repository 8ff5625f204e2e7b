"""Light that is scattered more than once: conservation, limits, a path tracer's stored pictures."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.lights import field_of, lumpy_ball, our_picture
from usdsmoke.base.volume import LightSource, Scattering
from usdsmoke.core.smoke.active import activate
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.lighting import (
    Lighting,
    LitPoints,
    light_smoke,
    sky_directions,
)
from usdsmoke.core.views.project import colour_map
from usdsmoke.core.views.scene import fit_view
from usdsmoke.core.views.shadows import light_view

N = 16
SMOKE = activate(field_of(lumpy_ball(N)), np.eye(4), torch.device("cpu"))
THICKEST = float((lumpy_ball(N).sum(2) / N).max())  # of the columns
TILTED = (0.48, 0.6, 0.64)
DOME = Scattering((LightSource("/sky", (1.0, 1.0, 1.0)),), 1.0, bounces=True)
SUN = replace(DOME, lights=(LightSource("/sun", (1.0, 1.0, 1.0), TILTED),))


def lit(scattering: Scattering, depth: float) -> Lighting:
    found = light_smoke(SMOKE, depth / THICKEST, scattering)
    assert found is not None
    return found


def seen(light: Lighting, points: LitPoints, way: np.ndarray) -> tuple[float, float]:
    """Light to the eye along a way, and what the smoke takes of white behind it; by area."""
    view = fit_view(light_view(-way, SMOKE.voxel_size), SMOKE)
    image, alpha = colour_map(
        SMOKE.positions, SMOKE.density, SMOKE.edges, light.gamma_w, view, SMOKE.voxel_size
    )
    picture = image.apply(points.scattered(way))[..., 0]
    return float(picture.sum()) * view.pixel_size**2, float(alpha.sum()) * view.pixel_size**2


@pytest.mark.parametrize(
    ("depth", "least"), [(0.1, 0.99), (0.5, 0.98), (2.0, 0.97), (8.0, 0.97), (30.0, 0.95)]
)
def test_smoke_that_absorbs_nothing_is_hardly_seen_in_a_white_furnace(depth, least) -> None:
    """What it takes of the light behind it, it gives of the light from all around."""
    way, light = np.array([0.6, 0.0, -0.8]), lit(DOME, depth)
    points = light.on(SMOKE.positions)
    given, taken = seen(light, points, way)
    assert least < given / taken < 1.01
    assert 0 <= float(points.even.min()) and float(points.even.max()) < 1.03
    light = lit(replace(DOME, bounces=False), depth)
    once, _ = seen(light, light.on(SMOKE.positions), way)
    assert once < given


@pytest.mark.parametrize("anisotropy", [0.0, 0.6])
@pytest.mark.parametrize(("depth", "least"), [(0.5, 0.87), (8.0, 0.7), (1e3, 0.3)])
def test_smoke_gives_no_more_light_of_a_sun_than_it_takes(depth, least, anisotropy) -> None:
    light = lit(replace(SUN, anisotropy=anisotropy), depth)
    points = light.on(SMOKE.positions)
    _, taken = seen(light, points, -np.array(TILTED))
    ways = np.concatenate([sky_directions(), -sky_directions()])
    given = 4 * math.pi * float(np.mean([seen(light, points, way)[0] for way in ways]))
    assert least < given / taken < 1


@pytest.mark.parametrize("scattering", [SUN, DOME, replace(SUN, anisotropy=0.6)])
def test_light_grows_with_the_albedo_from_light_that_is_scattered_once(scattering) -> None:
    way, before = -np.array(TILTED), None
    for albedo in (1e-4, 0.2, 0.5, 0.9, 1.0):
        found = replace(scattering, albedo=albedo)
        light = lit(found, 6.0).on(SMOKE.positions).scattered(way) / albedo
        once = lit(replace(found, bounces=False), 6.0).on(SMOKE.positions).scattered(way) / albedo
        if before is None:
            assert torch.allclose(light, once, rtol=1e-3, atol=1e-5)
        else:
            assert bool((light >= before).all()) and float(light.mean()) > float(before.mean())
        assert bool((light >= once).all())
        before = light


@pytest.mark.parametrize(
    ("depth", "albedo", "traced"),  # with standard errors of 0.7 to 1 %
    [(2.0, 0.9, 0.01183), (10.0, 0.5, 0.00907), (10.0, 0.9, 0.02438)],
)
def test_pictures_are_as_bright_as_a_path_tracer_s(depth, albedo, traced) -> None:
    """Mean light of a picture by Mitsuba with 64 bounces, 32 samples a pixel, four seeds."""
    view = View(np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2], np.zeros(3), N, N, 1 / N)
    sun = replace(SUN, albedo=albedo)
    field = field_of(lumpy_ball(N))
    found, once = (
        float(our_picture(field, depth / THICKEST, how, view).mean())
        for how in (sun, replace(sun, bounces=False))
    )
    assert found == pytest.approx(traced, rel=0.08)
    assert once < 0.75 * traced

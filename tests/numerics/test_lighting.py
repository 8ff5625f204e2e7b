"""Light that smoke scatters: closed forms, fitted orders, stiff smoke, the gradient beside it."""

import math

import numpy as np
import pytest
import torch

from benchmarks.lights import field_of, lumpy_ball, our_picture, refined
from tests.fixtures.smoke_fixtures import affine, puff, smoke_of
from usdsmoke.base.volume import LightSource, Scattering
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.srgb import decode_srgb
from usdsmoke.core.steps.pictures import ColourView
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.lighting import light_smoke, phase, sky_directions
from usdsmoke.core.views.project import colour_map
from usdsmoke.core.views.scene import fit_view
from usdsmoke.core.views.shadows import trace_shadows

WIDTH = 0.3  # of the smoke, stage units
TILTED = np.array([0.48, 0.6, 0.64])
TO_EYE, AWAY = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)


def on_lattice(density: torch.Tensor, size: float = 2.0) -> ActiveSmoke:
    """A cube of smoke around the origin, [n n n] float64."""
    n = len(density)
    matrix = np.diag([size / n, size / n, size / n, 1.0])
    matrix[3, :3] = (size / n - size) / 2
    return ActiveSmoke(torch.argwhere(density > 0), density[density > 0], matrix)


def gaussian(n: int) -> ActiveSmoke:
    x = 2 * (torch.arange(n, dtype=torch.float64) + 0.5) / n - 1
    square = x[:, None, None] ** 2 + x[:, None] ** 2 + x**2
    return on_lattice(torch.exp(-square / WIDTH**2))


def depth_towards(smoke: ActiveSmoke, towards: np.ndarray, gamma_w: float) -> torch.Tensor:
    """Optical depth from each voxel to a light, in closed form."""
    along = smoke.positions @ torch.as_tensor(towards)
    across = (smoke.positions**2).sum(1) - along**2
    half = WIDTH * math.sqrt(math.pi) / 2
    return gamma_w * half * torch.exp(-across / WIDTH**2) * torch.erfc(along / WIDTH)


def arriving(smoke: ActiveSmoke, gamma_w: float, towards: np.ndarray) -> torch.Tensor:
    return trace_shadows(smoke, gamma_w, towards).at(smoke.positions)


@pytest.mark.parametrize("gamma_w", [1.0, 10.0])
@pytest.mark.parametrize("towards", [np.array(TO_EYE), TILTED])
def test_light_through_a_ball_is_of_second_order(gamma_w: float, towards: np.ndarray) -> None:
    errors = []
    for n in (16, 32, 64):
        smoke = gaussian(n)
        off = arriving(smoke, gamma_w, towards) - torch.exp(-depth_towards(smoke, towards, gamma_w))
        weight = smoke.density / smoke.density.sum()
        errors.append(float((weight * off**2).sum().sqrt()))
    assert errors[-1] < 2.5e-3
    assert min(-np.diff(np.log2(errors))) > 1.85


@pytest.mark.parametrize("towards", [TO_EYE, None], ids=["sun", "dome"])
@pytest.mark.parametrize("gamma_w", [2.0, 20.0])
def test_a_picture_of_scattered_light_is_of_second_order(
    gamma_w: float, towards: tuple[float, float, float] | None
) -> None:
    """By what each halving of the voxels changes in the mean of the picture."""
    scattering, means = Scattering((LightSource("/light", (1.0, 1.0, 1.0), towards),), 0.9), []
    for n in (12, 24, 48, 96):
        smoke = gaussian(n)
        view = View(np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2], np.zeros(3), n, n, 2 / n)
        image, _ = colour_map(
            smoke.positions, smoke.density, smoke.edges, gamma_w, view, smoke.voxel_size
        )
        lighting = light_smoke(smoke, gamma_w, scattering)
        assert lighting is not None
        light = lighting.on(smoke.positions).scattered(view.forward)
        means.append(float(image.apply(light).mean()))
    changes = np.abs(np.diff(means))
    assert changes[-1] < 5e-3 * means[-1]
    assert min(np.log2(changes[:-1] / changes[1:])) > 1.5


@pytest.mark.parametrize("depth", [1e-3, 1.0, 1e3])
def test_stiff_smoke_gives_shares_that_fall_along_the_way(depth: float) -> None:
    smoke = on_lattice(torch.ones(12, 12, 12, dtype=torch.float64), 1.0)
    light = arriving(smoke, depth, np.array(TO_EYE)).view(12, 12, 12)
    assert bool(((light >= 0) & (light <= 1)).all())
    assert bool((light.diff(dim=2) >= 0).all())  # the light comes from +z
    inside = -math.expm1(-depth / 12) / (depth / 12)  # mean over a voxel
    before = torch.arange(12, dtype=torch.float64).flip(0) / 12
    wanted = inside * torch.exp(-depth * before)
    assert torch.allclose(light[6, 6], wanted, rtol=1e-9, atol=1e-30)


def front_view(n: int) -> View:
    right, up, forward = np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2]
    return View(right, up, forward, np.zeros(3), n, n, 1 / n)


@pytest.mark.parametrize(("depth", "error"), [(1e-3, 1e-5), (0.1, 1e-3), (1.0, 0.01), (8.0, 0.07)])
@pytest.mark.parametrize("towards", [TO_EYE, AWAY])
def test_single_scattering_of_a_wall_is_the_closed_form(depth, error, towards) -> None:
    """Lit from the eye's side: (1 - exp(-2 tau)) / 2; from behind: tau exp(-tau)."""
    n = 32
    smoke = on_lattice(torch.ones(n, n, n, dtype=torch.float64), 1.0)
    scattering = Scattering((LightSource("/sun", (2.0, 1.0, 0.5), towards),), 0.8, 0.3)
    lighting = light_smoke(smoke, depth, scattering)
    view = front_view(n)
    image, _ = colour_map(smoke.positions, smoke.density, smoke.edges, depth, view, 1 / n)
    picture = image.apply(lighting.on(smoke.positions).scattered(view.forward))
    cosine = 1.0 if towards == AWAY else -1.0
    share = depth * math.exp(-depth) if towards == AWAY else -math.expm1(-2 * depth) / 2
    wanted = 0.8 * float(phase(0.3, torch.tensor(cosine))) * share
    assert picture[n // 2, n // 2].tolist() == pytest.approx(
        [2 * wanted, wanted, wanted / 2], rel=error
    )


@pytest.mark.parametrize("anisotropy", [-0.6, 0.0, 0.4, 0.8])
def test_the_phase_function_adds_up_to_1_and_has_its_mean_cosine(anisotropy: float) -> None:
    cosine, weight = np.polynomial.legendre.leggauss(200)
    density = phase(anisotropy, torch.as_tensor(cosine)).numpy() * weight * 2 * math.pi
    assert density.sum() == pytest.approx(1, rel=1e-9)
    assert (density * cosine).sum() == pytest.approx(anisotropy, abs=1e-9)


def test_a_dome_lights_thin_smoke_from_all_around_and_a_deep_voxel_hardly() -> None:
    dome = (LightSource("/sky", (0.2, 0.4, 0.8)),)
    smoke = gaussian(24)
    thin = light_smoke(smoke, 1e-4, Scattering(dome, 0.5, 0.7))
    found = thin.on(smoke.positions).scattered(np.array(AWAY))
    assert torch.allclose(found, torch.tensor([[0.1, 0.2, 0.4]], dtype=torch.float64), rtol=1e-3)
    thick = light_smoke(smoke, 100.0, Scattering(dome, 0.5)).on(smoke.positions).scattered(TILTED)
    at = int((smoke.positions**2).sum(1).argmin())
    assert 0 <= float(thick[at].max()) < 1e-3
    wanted = torch.exp(-depth_towards(smoke, TILTED, 2.0))[at]  # the same from every side
    even = light_smoke(smoke, 2.0, Scattering(dome, 1.0)).on(smoke.positions).scattered(TILTED)
    assert float(even[at, 2]) == pytest.approx(0.8 * float(wanted), rel=0.05)


def test_directions_to_a_dome_have_no_preferred_side() -> None:
    directions = sky_directions()
    assert np.allclose(np.linalg.norm(directions, axis=1), 1)
    assert (directions @ directions.T > -0.5).all()  # none is another one's opposite
    assert np.allclose(directions.T @ directions / len(directions), np.eye(3) / 3)


def test_lights_add_up_and_light_the_same_smoke_anywhere() -> None:
    sun, sky = LightSource("/a", (1.0, 0.8, 0.6), tuple(TILTED)), LightSource("/b", (0.1, 0.2, 0.3))
    matrix = affine(3)
    smoke = smoke_of(puff(14), index_to_stage=matrix)

    def light(*lights: LightSource) -> torch.Tensor:
        lighting = light_smoke(smoke, 0.7, Scattering(lights, 0.9, 0.5))
        return lighting.on(smoke.positions).scattered(np.array(AWAY))

    assert torch.allclose(light(sun, sky), light(sun) + light(sky))
    assert float(light(sun).min()) >= 0
    assert light_smoke(smoke, 0.7, Scattering((), 0.9)) is None
    assert light_smoke(smoke, 0.7, Scattering((sun,), 0.0)) is None


@pytest.mark.parametrize("depth", [1e-3, 0.6, 1e3])
@pytest.mark.parametrize(("painted", "bounces"), [(False, False), (True, False), (False, True)])
def test_the_gradient_of_a_lit_picture_is_that_of_its_differences(depth, painted, bounces) -> None:
    smoke = smoke_of(puff(8)).take(torch.arange(40))
    smoke = ActiveSmoke(smoke.ijk, smoke.density.double(), smoke.index_to_stage)
    view = fit_view(front_view(1), smoke)
    image, alpha = colour_map(smoke.positions, smoke.density, smoke.edges, depth, view, 1.0)
    lights = (LightSource("/sun", (1.0, 0.9, 0.7), tuple(TILTED)),)
    sun = Scattering(lights, 0.9, bounces=bounces)
    light = light_smoke(smoke, depth, sun).on(smoke.positions).scattered(view.forward)
    how = {"light": light} if painted else {"scattered": image.apply(light)}
    lit = ColourView(image, alpha, **how)
    background = torch.tensor([0.5, 0.4, 0.3], dtype=torch.float64)

    def loss(colours: torch.Tensor) -> torch.Tensor:
        return (lit.unpremultiplied(decode_srgb(colours), background) ** 2).mean()

    colours = torch.rand(len(smoke.ijk), 3, dtype=torch.float64, generator=torch.manual_seed(0))
    assert torch.autograd.gradcheck(loss, colours.requires_grad_(True), eps=1e-6, atol=1e-8)


@pytest.mark.parametrize(("depth", "most"), [(1.0, 0.004), (30.0, 0.035), (50.0, 0.056)])
@pytest.mark.parametrize("towards", [(0.8, 0.36, 0.48), None], ids=["sun", "dome"])
def test_light_on_the_smoke_s_own_voxels_is_little_darker_than_on_finer_ones(depth, most, towards):
    """A column of 32 voxels; the bound for thick smoke is what the documents say."""
    n, density = 32, lumpy_ball(32)
    scattering = Scattering((LightSource("/light", (1.0, 1.0, 1.0), towards),), 0.9)
    gamma_w, means = depth / float((density.sum(2) / n).max()), []
    for factor in (1, 2):
        field, side = field_of(refined(density, factor)), factor * n
        means.append(float(our_picture(field, gamma_w, scattering, front_view(side)).mean()))
    assert abs(means[0] / means[1] - 1) < most

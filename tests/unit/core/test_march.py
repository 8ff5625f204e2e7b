"""Rays through lattices: closed forms, independent quadrature, other renderers, geometry."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.ndimage import map_coordinates

from benchmarks.raymarch import march_rays
from benchmarks.splats import render_fields
from tests.fixtures.smoke_fixtures import affine, puff
from usdsmoke.base.errors import ShapeError
from usdsmoke.base.volume import DenseField
from usdsmoke.core.rays.march import march
from usdsmoke.core.rays.media import Medium, make_media
from usdsmoke.core.rays.segments import segment_weights
from usdsmoke.core.smoke.tasks import computing_threads
from usdsmoke.core.views.cameras import View, orbit_view, view_rays
from usdsmoke.core.views.project import Projector
from usdsmoke.pictures import encode_srgb

EIGHT_BITS = 1 / 255
BOX = (12, 10, 8)
COLOUR = np.array([0.8, 0.3, 0.1], np.float32)


def placed(shape: tuple[int, ...], voxel: float = 0.1) -> np.ndarray:
    """Index to stage with the box's middle in the origin."""
    matrix = np.diag([voxel, voxel, voxel, 1.0])
    matrix[3, :3] = -voxel * (np.array(shape[:3]) - 1) / 2
    return matrix


def field(values: np.ndarray, matrix: np.ndarray, ijk_min: tuple[int, int, int] = (0, 0, 0)):
    name = "emission" if values.ndim == 4 else "density"
    return DenseField(name, np.asarray(values, np.float32), ijk_min, matrix)


def media_of(
    density: np.ndarray, light: np.ndarray | None, matrix: np.ndarray, gamma_w: float = 1.0
) -> list[Medium]:
    smoke = field(density, matrix)
    if light is None:
        return make_media(smoke, None, np.eye(4), None, gamma_w, 0.5)
    return make_media(smoke, field(light, matrix), np.eye(4), np.eye(4), gamma_w, 0.5)


def front(height: int = 6, width: int = 8, pixel_size: float = 0.05) -> View:
    return orbit_view(0.0, 0.0, "Y", np.zeros(3), height, width, pixel_size)


def pinhole(eye: tuple[float, float, float], size: int = 40, focal: float = 60.0) -> View:
    """Looks along -Z from the eye."""
    axes = np.eye(3)
    return View(axes[0], axes[1], -axes[2], np.array(eye), size, size, 0.0, focal)


def lumps(shape: tuple[int, ...] = (9, 8, 7), seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Density, and an emission whose colour jumps from voxel to voxel."""
    generator = np.random.default_rng(seed)
    density = generator.uniform(0, 1, shape) * (generator.uniform(0, 1, shape) > 0.3)
    return density, density[..., None] * generator.uniform(0, 1, (*shape, 3))


def quadrature(
    density: np.ndarray, light: np.ndarray, matrix: np.ndarray, view: View, n: int = 20001
) -> tuple[np.ndarray, np.ndarray]:
    """Optical depth and radiance of every pixel by the midpoint rule with very many points."""
    y, x = (grid.ravel() for grid in np.mgrid[: view.height, : view.width])
    start, direction = view_rays(view, x, y)
    to_index = np.linalg.inv(matrix)
    middle = (np.array(density.shape) - 1) / 2 @ matrix[:3, :3] + matrix[3, :3]
    reach = np.linalg.norm(matrix[:3, :3], 2) * np.linalg.norm(np.array(density.shape) + 1) / 2
    depths, lights = [], []
    for o, d in zip(start, direction, strict=True):
        nearest = float((middle - o) @ d)
        t, step = np.linspace(nearest - reach, nearest + reach, n, retstep=True)
        if view.focal is not None:
            t = t[t > 0]
        place = ((o + t[:, None] * d) @ to_index[:3, :3] + to_index[3, :3]).T
        sigma = map_coordinates(density, place, order=1, mode="grid-constant")
        glow = [
            map_coordinates(light[..., c], place, order=1, mode="grid-constant") for c in (0, 1, 2)
        ]
        before = np.cumsum(sigma * step) - sigma * step / 2
        depths.append(sigma.sum() * step)
        lights.append([(g * np.exp(-before)).sum() * step for g in glow])
    size = (view.height, view.width)
    return np.array(depths).reshape(size), np.array(lights).reshape(*size, 3)


@pytest.mark.parametrize("gamma_w", [1e-9, 0.7, 30.0, 1e9])
def test_a_slab_of_constant_extinction_and_emission_has_its_closed_form(gamma_w: float) -> None:
    density = np.full(BOX, 2.0)
    light = np.broadcast_to(COLOUR * np.float32(gamma_w * 2.0), (*BOX, 3))
    picture = march(media_of(density, light, placed(BOX), gamma_w), front())
    sigma, length = 2.0 * gamma_w, 0.1 * BOX[2]
    wanted = -np.expm1(-sigma * length)  # E / sigma = COLOUR
    assert np.allclose(picture.alpha, wanted, rtol=1e-6, atol=0)
    assert np.allclose(picture.emission, wanted * COLOUR, rtol=1e-6, atol=0)
    assert np.allclose(picture.depth, sigma * length, rtol=1e-6)
    assert (picture.grey == 0).all()


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("thickness", [1.0, 8.0])
@pytest.mark.parametrize("perspective", [False, True])
def test_optical_depth_is_exact_and_light_far_below_eight_bits(
    seed: int, perspective: bool, thickness: float
) -> None:
    density, light = (thickness * values for values in lumps(seed=seed))
    matrix = affine(seed, mirrored=seed == 1)
    middle = (np.array(density.shape) - 1) / 2 @ matrix[:3, :3] + matrix[3, :3]
    view = orbit_view(20.0, 30.0, "Y", middle, 5, 6, 1.3)
    if perspective:
        view = replace(view, centre=middle - 14 * view.forward, focal=10.0, shift=(0.4, -0.7))
    picture = march(media_of(density, light, matrix), view, rays=1)
    depth, radiance = quadrature(density, light, matrix, view)
    assert depth.max() > 2
    assert np.abs(picture.depth - depth).max() < 2e-5 * depth.max()
    shown = encode_srgb(picture.emission) - encode_srgb(radiance)
    assert np.abs(shown).max() < EIGHT_BITS / 20


def test_pictures_agree_with_a_marcher_that_shares_no_code() -> None:
    density, light = puff(14), puff(14)[..., None] * COLOUR
    matrix = placed(density.shape, 0.2)
    for view in (front(20, 20, 0.15), pinhole((0.3, 0.2, 4.0))):
        picture = march(media_of(density, light, matrix, 3.0), view, rays=1)
        other, alpha = march_rays(density, light, matrix, 3.0, view, 32.0)
        assert np.abs(picture.alpha - alpha).max() < 5e-4
        assert np.abs(picture.emission - other).max() < 5e-4


def test_pictures_agree_with_the_optimisers_splat_where_pixels_are_voxels() -> None:
    density = puff(14)
    light = density[..., None] * np.float32(2.0) * COLOUR
    matrix = placed(density.shape, 0.2)
    view = front(16, 16, 0.2)
    picture = march(media_of(density, light, matrix, 2.0), view)
    splat = render_fields(field(density, matrix), field(light, matrix), np.eye(4), 2.0, view)
    assert np.abs(picture.alpha - splat[..., 3]).max() < 1e-5  # the same column sums
    assert np.abs(picture.emission - splat[..., :3]).max() < 1e-5  # one colour


def test_smoke_without_emission_glows_in_even_grey() -> None:
    density = puff(10)
    picture = march(media_of(density, None, placed(density.shape)), front())
    assert np.allclose(picture.grey, 0.5 * picture.alpha, atol=1e-7)
    assert (picture.emission == 0).all() and picture.alpha.max() > 0.05
    assert np.allclose(picture.rgba[..., 0], picture.grey)


def test_of_two_volumes_the_nearer_hides_the_other_from_either_side() -> None:
    sheet = np.full((8, 8, 2), 400.0)
    red, blue = (sheet[..., None] * np.eye(3)[n] for n in (0, 2))
    near, far = placed(sheet.shape), placed(sheet.shape)
    near[3, 2] += 1.0
    far[3, 2] -= 1.0
    both = media_of(sheet, red, near) + media_of(sheet, blue, far)
    for media in (both, both[::-1]):
        assert np.allclose(march(media, front()).rgba, [1, 0, 0, 1], atol=1e-6)
        behind = orbit_view(180.0, 0.0, "Y", np.zeros(3), 6, 8, 0.05)
        assert np.allclose(march(media, behind).rgba, [0, 0, 1, 1], atol=1e-6)


def test_volumes_that_overlap_add_up() -> None:
    density, light = lumps()
    matrix = placed(density.shape)
    whole = march(media_of(density, light, matrix, 5.0), front(), rays=1)
    halves = media_of(density / 2, light / 2, matrix, 5.0) * 2
    for name in ("depth", "emission", "alpha"):
        found = getattr(march(halves, front(), rays=1), name)
        assert np.allclose(found, getattr(whole, name), rtol=1e-5, atol=1e-7)


def test_voxels_of_different_sizes_share_the_rays() -> None:
    fine, coarse = np.ones((40, 40, 40)), np.ones((5, 5, 5))
    inside = media_of(fine, None, placed(fine.shape, 0.05)) + media_of(
        coarse, None, placed(coarse.shape, 1.0)
    )
    picture = march(inside, front())
    assert np.allclose(picture.depth, 40 * 0.05 + 5 * 1.0, rtol=1e-6)


def test_emission_with_a_box_and_a_lattice_of_its_own_stands_where_it_is() -> None:
    density = np.full(BOX, 1e-6)
    light = np.zeros((2, 2, 2, 3))
    light[..., 1] = 1.0
    matrix = placed(BOX)
    cropped = make_media(
        field(density, matrix), field(light, matrix, (8, 6, 3)), np.eye(4), np.eye(4), 1.0, 0.5
    )
    assert len(cropped) == 1
    own = np.diag([0.2, 0.2, 0.2, 1.0])
    own[3, :3] = np.array([8.5, 6.5, 3.5]) @ matrix[:3, :3] + matrix[3, :3]
    other = make_media(
        field(density, matrix), field(light[:1, :1, :1], own), np.eye(4), np.eye(4), 1.0, 0.5
    )
    assert len(other) == 2
    for media in (cropped, other):
        glow = march(media, front(60, 60, 0.02)).emission[..., 1]
        y, x = (np.average(grid, weights=glow) for grid in np.mgrid[:60, :60])
        assert x == pytest.approx(29.5 + own[3, 0] / 0.02, abs=0.05)
        assert y == pytest.approx(29.5 - own[3, 1] / 0.02, abs=0.05)
        assert glow.sum() * 0.02**2 == pytest.approx(0.2**3, rel=0.01)  # all of its light


def test_a_known_point_falls_on_the_known_pixel_of_a_shifted_camera() -> None:
    density = np.zeros(BOX)
    density[9, 7, 5] = 50.0
    matrix = placed(BOX)
    place = np.array([9, 7, 5]) @ matrix[:3, :3] + matrix[3, :3]
    eye = (0.1, -0.2, 3.0)
    view = replace(pinhole(eye, 80, 150.0), shift=(5.0, -3.0))
    alpha = march(media_of(density, None, matrix), view).alpha
    y, x = (np.average(grid, weights=alpha) for grid in np.mgrid[:80, :80])
    scale = 150.0 / (eye[2] - place[2])
    assert x == pytest.approx(39.5 + 5.0 + scale * (place[0] - eye[0]), abs=0.05)
    assert y == pytest.approx(39.5 - 3.0 - scale * (place[1] - eye[1]), abs=0.05)


@pytest.mark.parametrize("focal", [None, 30.0])
def test_rays_go_through_the_pixels_that_points_project_to(focal: float | None) -> None:
    view = replace(orbit_view(30.0, -20.0, "Z", np.array([1.0, 2, 3]), 9, 7, 0.3), focal=focal)
    view = replace(view, shift=(1.5, -2.25))
    x, y = np.array([0.0, 3.25, 6.0]), np.array([8.0, 1.5, 4.0])
    start, direction = view_rays(view, x, y)
    points = torch.from_numpy(start + 4.0 * direction)
    projector = Projector(points, view)
    (foot,) = projector.footprints(points)
    pixel, weight = foot.first.numpy() + np.array(projector.shifts)[:, None], foot.weights.numpy()
    found_x = ((pixel % view.width) * weight).sum(0)
    found_y = ((pixel // view.width) * weight).sum(0)
    assert np.allclose(found_x, x) and np.allclose(found_y, y)


def test_an_eye_inside_the_smoke_sees_what_is_in_front_and_clipping_cuts() -> None:
    density = np.ones((41, 41, 41))
    media = media_of(density, None, placed(density.shape))
    inside = pinhole((0.0, 0.0, 0.0), 3, 50.0)
    assert march(media, inside).depth[1, 1] == pytest.approx(4.1 / 2, rel=1e-6)
    outside = pinhole((0.0, 0.0, 5.0), 3, 50.0)
    assert march(media, outside).depth[1, 1] == pytest.approx(4.1, rel=1e-6)
    # planes, not distances from the eye: the corner's ray has the same share of a longer way
    cut = march(media, outside, (4.5, 6.0)).depth
    slant = np.sqrt(1 + 2 * (1 / 50.0) ** 2)
    assert cut[1, 1] == pytest.approx(1.5, rel=1e-6)
    assert cut[0, 0] == pytest.approx(1.5 * slant, rel=1e-6)


def test_a_slab_of_one_voxel_has_its_voxels_depth() -> None:
    density = np.full((10, 8, 1), 3.0)
    picture = march(media_of(density, None, placed(density.shape)), front(4, 4, 0.05))
    assert np.allclose(picture.depth, 3.0 * 0.1, rtol=1e-6)


def test_a_place_far_from_the_origin_changes_nothing() -> None:
    density, light = lumps()
    matrix, there = placed(density.shape), np.array([3e6, -2e6, 1e6])
    view = front()
    moved_matrix = matrix.copy()
    moved_matrix[3, :3] += there
    here = march(media_of(density, light, matrix), view)
    far = march(media_of(density, light, moved_matrix), replace(view, centre=there))
    assert np.abs(here.rgba - far.rgba).max() < 1e-5


def test_pixels_larger_than_voxels_show_their_mean() -> None:
    density = np.zeros((8, 8, 4))
    density[::2] = 10.0  # rays through voxel centres alone would see all or nothing
    media = media_of(density, None, placed(density.shape))
    picture = march(media, front(2, 2, 0.4))
    assert picture.depth.mean() == pytest.approx(10.0 * 0.4 / 2, rel=0.02)
    one = march(media, front(2, 2, 0.4), rays=1)
    assert one.alpha.max() <= 1.0 and (picture.alpha <= -np.expm1(-picture.depth) + 1e-6).all()


@pytest.mark.parametrize("angles", [(0.0, 0.0), (90.0, 0.0), (180.0, 0.0), (0.0, 90.0)])
@pytest.mark.parametrize("mirrored", [False, True])
def test_rays_along_an_axis_show_what_rays_beside_it_show(
    angles: tuple[float, float], mirrored: bool
) -> None:
    density, light = (12.0 * values for values in lumps())
    matrix = placed(density.shape)
    if mirrored:
        matrix = np.diag([-1.0, -1.0, -1.0, 1.0]) @ matrix
        matrix[3, :3] *= -1
    for media in (media_of(density, light, matrix), media_of(density, None, matrix)):
        pictures = [
            march(media, orbit_view(a, angles[1], "Y", np.zeros(3), 20, 20, 0.05))
            for a in (angles[0], angles[0] + 1e-5)
        ]
        assert pictures[0].alpha.max() > 0.9
        for name in ("depth", "emission", "grey", "alpha"):
            along, beside = (getattr(picture, name) for picture in pictures)
            assert np.abs(along - beside).max() <= 1e-5 * max(beside.max(), 1e-9)


def test_clipping_cuts_rays_along_an_axis() -> None:
    density, light = lumps()
    media = media_of(density, light, placed(density.shape), 3.0)
    whole = march(media, front())
    assert np.allclose(march(media, front(), (-1e3, 1e3)).rgba, whole.rgba, rtol=0, atol=1e-6)
    halves = [march(media, front(), clip).depth for clip in ((-9.0, 0.07), (0.07, 9.0))]
    assert min(half.max() for half in halves) > 0.05 and np.allclose(sum(halves), whole.depth)


def test_light_behind_much_smoke_is_hidden_and_its_depth_counts() -> None:
    density = np.full(BOX, 1.0)
    light = np.ones((*BOX, 3))
    light[..., 0] = np.linspace(0, 1, BOX[2])  # nearer voxels have more of it
    media = media_of(density, light, placed(BOX), 1e3)
    for view in (front(), orbit_view(1e-5, 0.0, "Y", np.zeros(3), 6, 8, 0.05)):
        picture = march(media, view)
        assert np.allclose(picture.depth, 1e3 * 0.1 * BOX[2], rtol=1e-6)
        assert np.allclose(picture.emission[..., 1], 1e-3, rtol=1e-6)
        assert np.allclose(picture.emission[..., 0], 1e-3, rtol=1e-2)


def test_a_glow_that_is_bright_enough_shines_through_much_smoke() -> None:
    density = np.full(BOX, 30.0)  # an optical depth of 24
    light = np.zeros((*BOX, 3))
    light[:, :, 0] = 1e10  # at the far end
    matrix, view = placed(BOX), front(1, 1)
    picture = march(media_of(density, light, matrix), view, rays=1)
    wanted = quadrature(density, light, matrix, view)[1]
    assert wanted.min() > 1e-3 and np.allclose(picture.emission, wanted, rtol=0.01)


def test_nothing_gives_an_empty_picture_and_negative_density_counts_as_none() -> None:
    assert (march([], front()).rgba == 0).all()
    empty = field(np.zeros((0, 0, 0)), np.eye(4))
    assert make_media(empty, None, np.eye(4), None, 1.0, 0.5) == []
    negative = media_of(np.full(BOX, -1.0), None, placed(BOX))
    assert (march(negative, front()).rgba == 0).all()


def test_the_densest_smoke_that_floats_hold_is_opaque_and_finite() -> None:
    picture = march(media_of(np.full(BOX, 3e38), None, placed(BOX), 1e6), front())
    assert np.allclose(picture.rgba, [0.5, 0.5, 0.5, 1.0]) and np.isfinite(picture.depth).all()


def test_a_flattened_field_is_refused_by_name() -> None:
    density = field(np.ones(BOX), placed(BOX))
    with pytest.raises(ShapeError, match=r'"density".*flattens'):
        make_media(density, None, np.diag([1.0, 0.0, 1.0, 1.0]), None, 1.0, 0.5)


def test_the_rule_of_a_segment_is_exact_to_4e_5_up_to_an_optical_depth_of_1() -> None:
    generator = np.random.default_rng(0)
    n, places = 500, (np.arange(2000) + 0.5) / 2000
    for depth in (1e-9, 0.3, 1.0):
        ends = generator.uniform(0, 1, (2, n)) * generator.choice([0.0, 1.0], (2, n), p=[0.2, 0.8])
        ends[0] += 1e-3  # not empty
        sigma = ends * (2 * depth / ends.sum(axis=0))
        light = sigma * generator.uniform(0, 1, (2, n))  # no colour is brighter than 1
        before = np.outer(sigma[0], places) + np.outer((sigma[1] - sigma[0]) / 2, places**2)
        glow = np.outer(light[0], 1 - places) + np.outer(light[1], places)
        wanted = (glow * np.exp(-before)).mean(axis=1)
        slope = (sigma[1] - sigma[0]) / sigma.sum(axis=0)
        mean, rest = segment_weights(np.full(n, depth), slope)
        found = light.mean(axis=0) * mean - (light[1] - light[0]) / 2 * rest
        assert np.abs(found - wanted).max() < 4e-5 * min(depth, 1)


@pytest.mark.parametrize("angle", [0.0, 20.0])
def test_pictures_have_the_same_bits_for_any_number_of_threads(angle: float) -> None:
    density, light = lumps((20, 18, 16))
    media = media_of(density, light, placed(density.shape), 3.0)
    view = orbit_view(angle, 0.0, "Y", np.zeros(3), 150, 150, 0.02)
    pictures = []
    for count in (1, 3):
        with computing_threads(count):
            pictures.append(march(media, view, rays=1).rgba)
    assert pictures[0].max() > 0.1 and np.array_equal(*pictures)

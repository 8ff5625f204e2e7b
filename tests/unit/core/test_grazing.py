"""Marks in grooves are smoothed; marks that are seen face on stay, and get a little clearer."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import frame_of, smoke_of
from tests.fixtures.stylize_fixtures import finished, same_bits
from usdsmoke.core.smoke.active import ActiveSmoke, activate
from usdsmoke.core.smoke.tasks import computing_threads
from usdsmoke.core.views.grazing import CLEARER, smooth_grazing
from usdsmoke.core.views.joined import join_smoke
from usdsmoke.core.views.scene import Scene

N = 24  # voxels along a side of the block
SCENE = Scene(2.0, 1.0, 1.0, "Y", 1.0, 48)  # pictures see half a voxel deep; nothing is joined
NOISE = np.random.default_rng(3).random((N, N, N, 3)).astype(np.float32)
WALL = np.s_[9, N - 10 : N - 4, 6:18]  # of the groove, deep in it
TOP = np.s_[3:8, N - 1, 6:18]  # beside the groove


def grooved() -> np.ndarray:
    """A block with a groove along z in its upper side, two wide and twelve deep."""
    density = np.ones((N, N, N), np.float32)
    density[10:12, N - 12 :, :] = 0
    return density


def smoothed(
    colours: np.ndarray,
    density: np.ndarray,
    amount: float = 1.0,
    scene: Scene = SCENE,
    painted: ActiveSmoke | None = None,
) -> np.ndarray:
    """Of a block of colours [I J K 3]."""
    smoke = smoke_of(density)
    painted = painted or smoke
    at = tuple(painted.ijk.T.numpy())
    found = colours.copy()
    joined = join_smoke(smoke, scene)
    given = torch.from_numpy(colours[at])
    found[at] = smooth_grazing(given, painted, joined, scene.gamma_w, amount).numpy()
    return found


def test_marks_in_a_groove_are_smoothed_and_marks_on_top_are_not() -> None:
    found = smoothed(NOISE, grooved())
    assert found[WALL].std() < 0.3 * NOISE[WALL].std()
    assert 1 + CLEARER / 4 < found[TOP].std() / NOISE[TOP].std() < 1 + CLEARER
    assert np.corrcoef(found[TOP].ravel(), NOISE[TOP].ravel())[0, 1] > 0.98


def test_half_of_the_amount_smooths_half() -> None:
    none, half, all_of_it = (smoothed(NOISE, grooved(), amount) for amount in (0.0, 0.5, 1.0))
    assert np.array_equal(none, NOISE)
    deep = WALL[0], slice(N - 12, N - 8), WALL[2]  # which no picture shows face on
    assert half[deep] == pytest.approx((none[deep] + all_of_it[deep]) / 2, abs=1e-2)


def test_a_wall_that_is_seen_face_on_keeps_its_marks() -> None:
    wide = grooved()
    wide[10:, N - 12 :, :] = 0  # a step instead of a groove
    found = smoothed(NOISE, wide)[WALL]
    assert found.std() > 0.85 * NOISE[WALL].std()
    assert np.corrcoef(found.ravel(), NOISE[WALL].ravel())[0, 1] > 0.98


@pytest.mark.parametrize("depth", [1.0, 5.0, 20.0, 100.0, 1e6])
def test_dense_voxels_do_not_hide_themselves(depth: float) -> None:
    found = smoothed(NOISE, np.ones((N, N, N), np.float32), scene=replace(SCENE, gamma_w=depth))
    top = np.s_[4:20, N - 1, 4:20]
    assert np.corrcoef(found[top].ravel(), NOISE[top].ravel())[0, 1] > 0.97
    assert found[top].std() > NOISE[top].std()


def test_a_floor_that_gets_light_at_grazing_angles_only_is_not_face_on() -> None:
    slot = np.ones((N, N, N), np.float32)
    slot[:, 10:14, :] = 0  # open at the sides, under a ceiling
    joined = join_smoke(smoke_of(slot), replace(SCENE, gamma_w=0.5))
    row = joined.smoke.ijk.tolist().index([20, 9, 12])
    assert float(joined.clear[row]) > 0.5 > 0.45 > float(joined.facing[row])


@pytest.mark.parametrize("up_axis", ["Y", "Z"])
def test_normals_point_out_of_a_sphere_in_any_grid(up_axis: str) -> None:
    """Rotated, and with voxels of two lengths; a face that looks at a side is shown by it."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag([1.0, 0.5, 1.0]) @ _rotation(0.5)
    centre = np.array([11.5, 23.5, 11.5])
    place = np.stack(np.meshgrid(*map(np.arange, (N, 2 * N, N)), indexing="ij"), -1) - centre
    distance = np.linalg.norm(place @ matrix[:3, :3], axis=-1)
    density = np.clip((9.0 - distance) / 4, 0, 1).astype(np.float32)
    field = frame_of(density).density
    smoke = activate(field, matrix, torch.device("cpu"))
    joined = join_smoke(smoke, replace(SCENE, up_axis=up_axis, gamma_w=3.0))
    middle = centre @ matrix[:3, :3]
    out = joined.smoke.positions.numpy() - middle
    radius = np.linalg.norm(out, axis=1)
    shell = (radius > 7.5) & (radius < 8.5)
    # twelve sides, so the nearest is 37 degrees away at most
    assert np.quantile(joined.facing.numpy()[shell], 0.05) > 0.55


def _rotation(angle: float) -> np.ndarray:
    """About the axis [1 1 1]."""
    axis = np.full(3, 3**-0.5)
    cross = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def test_hidden_voxels_lend_hardly_any_colour() -> None:
    colours = np.zeros((N, N, N, 3), np.float32)
    colours[9] = 0.5  # the wall of the groove; all behind it is black
    wall = smoothed(colours, grooved())[9, N - 8 : N - 4, 12, 0]
    assert wall.min() > 0.09  # 0.076 if all layers counted alike


@pytest.mark.parametrize("value", [0.0, 0.4, 1.4])
def test_an_even_colour_stays(value: float) -> None:
    colours = np.full((N, N, N, 3), value, np.float32)
    assert smoothed(colours, grooved()) == pytest.approx(colours, abs=1e-6)


def test_fog_has_no_flanks() -> None:
    """All sides show thin smoke alike, and a thin veil of one layer has no normal."""
    veil = np.zeros((N, N, N), np.float32)
    veil[:, 12, :] = 0.2
    for density, scene in ((grooved(), replace(SCENE, gamma_w=1e-4)), (veil, SCENE)):
        found, inside = smoothed(NOISE, density, scene=scene), density > 0
        assert np.corrcoef(found[inside].ravel(), NOISE[inside].ravel())[0, 1] > 0.98


def test_smoke_that_is_not_painted_hides_what_is() -> None:
    """The painted side of the groove is as smooth as where all of it is painted."""
    smoke = smoke_of(grooved())
    half = smoke.take(smoke.ijk[:, 0] < 10)
    alone = smoothed(NOISE, grooved(), painted=half)
    assert alone[WALL].std() < 0.4 * NOISE[WALL].std()


def test_colours_stay_in_their_range() -> None:
    colours = NOISE.copy()
    colours[::2] = np.rint(colours[::2])
    found = smoothed(colours, grooved())
    assert 0 <= found.min() and found.max() <= 1


@pytest.mark.parametrize("n_voxels", [1, 2])
@pytest.mark.parametrize("value", [1e-30, 1e30])
def test_few_voxels_keep_finite_colours(n_voxels: int, value: float) -> None:
    density, colours = np.zeros((3, 3, 3), np.float32), NOISE[:3, :3, :3].copy()
    density[0, 0, :n_voxels] = value
    found = smoothed(colours, density)
    assert np.isfinite(found).all() and 0 <= found.min() and found.max() <= 1


def test_threads_do_not_change_the_bits() -> None:
    found = []
    for n in (1, 3):
        with computing_threads(n):
            found.append(smoothed(NOISE, grooved()))
    assert np.array_equal(*found)


def test_a_run_smooths_by_the_amount_and_leaves_albedos_and_flat_smoke() -> None:
    plain, half, found = (finished(grazing=amount) for amount in (0.0, 0.5, 1.0))
    assert not same_bits(plain, half) and not same_bits(half, found)
    change, all_of_it = (
        np.abs(one.emission.values - plain.emission.values).sum() for one in (half, found)
    )
    assert 0.3 < change / all_of_it < 0.7
    flat = np.ones((16, 16, 1), np.float32)
    assert same_bits(*(finished(flat, grazing=amount) for amount in (0.0, 1.0)))
    assert same_bits(*(finished(grazing=amount, target="albedo") for amount in (0.0, 1.0)))

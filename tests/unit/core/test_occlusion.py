"""Ambient occlusion: what is in a groove is darker, what stands out is not, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.fixtures.camera_fixtures import DENSITY, MIDDLE, looking, seen_by
from tests.fixtures.smoke_fixtures import frame_of, puff, random_style, smoke_of
from tests.fixtures.stylize_fixtures import by_voxel, finished, quick_config, same_bits, scene_of
from usdsmoke.core.sequence.frame_state import make_context, open_frame
from usdsmoke.core.smoke.tasks import computing_threads
from usdsmoke.core.views.joined import join_smoke
from usdsmoke.core.views.occlusion import find_relief, shaded
from usdsmoke.core.views.scene import Scene

N = 24  # voxels along a side of the block
SCENE = Scene(2.0, 1.0, 1.0, "Y", 1.0, 48)  # pictures see half a voxel deep


def grooved() -> np.ndarray:
    """A block with a groove along z in its upper side, three wide and ten deep."""
    density = np.ones((N, N, N), np.float32)
    density[10:13, N - 10 :, :] = 0
    return density


def relief_of(density: np.ndarray, scene: Scene = SCENE) -> np.ndarray:
    """Of each voxel, in the shape of the block; 1 where there is no smoke."""
    smoke = smoke_of(density)
    found = np.ones(density.shape)
    found[tuple(smoke.ijk.T.numpy())] = find_relief(
        join_smoke(smoke, scene), smoke.positions
    ).numpy()
    return found


def test_the_bottom_of_a_groove_is_darker_than_the_ridges_beside_it() -> None:
    relief = relief_of(grooved())
    assert bottom_of(relief).max() < 1 < 1.05 < ridges_of(relief).min()


@pytest.mark.parametrize("gamma_w", [0.02, 0.2, 2.0, 20.0])
def test_an_even_side_is_as_bright_as_before(gamma_w: float) -> None:
    relief = relief_of(np.ones((48, 12, 48), np.float32), replace(SCENE, gamma_w=gamma_w))
    light = np.exp(-gamma_w * np.arange(12))[::-1]  # of a layer in a picture from above
    seen = (relief[20:28, :, 20:28].mean((0, 2)) * light).sum() / light.sum()
    assert seen == pytest.approx(1.0, abs=0.1)


def test_smoke_that_hides_nothing_keeps_its_colours() -> None:
    relief = relief_of(grooved(), replace(SCENE, gamma_w=1e-5))
    assert relief == pytest.approx(np.ones_like(relief), abs=1e-3)


def test_the_sky_is_above_along_the_stages_up_axis() -> None:
    upright = relief_of(grooved())
    lying = relief_of(grooved().swapaxes(1, 2).copy(), replace(SCENE, up_axis="Z"))
    assert lying.swapaxes(1, 2) == pytest.approx(upright, abs=1e-4)
    below = relief_of(grooved()[:, ::-1].copy())[:, ::-1]  # turned over, and its relief back
    assert ridges_of(upright).min() > 1.5 * ridges_of(below).max()


def bottom_of(relief: np.ndarray) -> np.ndarray:
    """The layer under the middle of the groove."""
    return relief[11, N - 11, 8:16]


def ridges_of(relief: np.ndarray) -> np.ndarray:
    """The upper layer on both sides of the groove."""
    return relief[[5, 18], N - 1, 8:16]


def test_large_smoke_is_joined_to_the_same_relief() -> None:
    fine = np.kron(grooved(), np.ones((4, 4, 4), np.float32))  # 96 voxels: joined once
    coarse = np.kron(grooved(), np.ones((2, 2, 2), np.float32))  # 48: not joined
    joined = relief_of(fine, Scene(0.5, 1.0, 1.0, "Y", 1.0, 96))
    whole = relief_of(coarse, Scene(1.0, 1.0, 1.0, "Y", 1.0, 48))
    means = joined.reshape(48, 2, 48, 2, 48, 2).mean((1, 3, 5))
    assert np.abs(means - whole).mean() < 0.05 * whole.std()


@pytest.mark.parametrize("n_voxels", [1, 2])
def test_few_voxels_and_dense_ones_have_a_finite_relief(n_voxels: int) -> None:
    density = np.zeros((3, 3, 3), np.float32)
    density[0, 0, :n_voxels] = 1e30
    smoke = smoke_of(density)
    found = find_relief(join_smoke(smoke, SCENE), smoke.positions)
    assert bool((found >= 0).all()) and bool(torch.isfinite(found).all())


def test_smoke_that_the_camera_misses_hides_the_sky_too() -> None:
    beside = np.add(MIDDLE, [8, 0, 0])
    frame = seen_by(looking(np.add(beside, [0, 0, 40]), beside, film=8.0))
    config = quick_config()
    context = make_context([random_style()], scene_of([frame], config), config, None, 24.0, None, 1)
    opened = open_frame(frame, context)
    assert 0 < len(opened.smoke.ijk) < len(opened.whole_smoke().ijk) == (DENSITY > 0).sum()


def test_relief_is_bounded_in_grainy_smoke() -> None:
    grains = np.random.default_rng(0).random((N, N, N)) ** 8 * 50
    assert relief_of(grains.astype(np.float32)).max() == 2.0


def test_threads_do_not_change_the_bits() -> None:
    found = []
    for n in (1, 3):
        with computing_threads(n):
            found.append(relief_of(grooved()))
    assert np.array_equal(*found)


def test_colours_are_no_brighter_than_white_for_their_relief() -> None:
    colours = torch.tensor([[0.5, 0.9, 1.2]] * 3)
    found = shaded(colours, torch.tensor([0.5, 1.0, 2.0]), 1.0)
    expected = [[0.25, 0.45, 0.6], [0.5, 0.9, 1.2], [1.0, 1.0, 1.2]]
    assert found.tolist() == [pytest.approx(row) for row in expected]
    assert shaded(colours, torch.zeros(3), 0.4).tolist() == [pytest.approx([0.3, 0.54, 0.72])] * 3


@pytest.mark.parametrize("target", ["emission", "both"])
def test_a_run_darkens_what_it_would_write_without_occlusion(target: str) -> None:
    plain, found = (finished(occlusion=amount, target=target) for amount in (0.0, 1.0))
    before, after = plain.emission, found.emission
    assert np.array_equal(plain.density.values, found.density.values)
    assert by_voxel(after).keys() == by_voxel(before).keys()
    smoke = smoke_of(plain.density.values)
    joined = join_smoke(smoke, scene_of([frame_of(puff(16))], quick_config()))
    relief = find_relief(joined, smoke.positions)
    at = tuple(smoke.ijk.T.numpy())
    bright = before.values[at][:, 1] > 1e-3
    ratio = (after.values[at][:, 1] / before.values[at][:, 1].clip(1e-9))[bright]
    expected = relief.numpy()[bright]
    assert np.corrcoef(ratio, expected)[0, 1] > 0.9
    assert ratio[expected < 0.6].max() < 0.6


def test_albedos_and_flat_smoke_are_left_alone() -> None:
    flat = np.ones((16, 16, 1), np.float32)
    assert same_bits(*(finished(flat, occlusion=amount) for amount in (0.0, 1.0)))
    assert same_bits(*(finished(occlusion=amount, target="albedo") for amount in (0.0, 1.0)))

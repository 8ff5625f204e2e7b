"""A few voxels a hundred or 10^30 times denser than the smoke change nothing around them."""

from functools import cache

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import frame_of, puff, smoke_of
from tests.fixtures.stylize_fixtures import by_voxel, quick_config, run_core, scene_of
from usdsmoke.base.errors import ConfigError
from usdsmoke.core.fields.displacement import smooth_mask
from usdsmoke.core.sequence.stylize import StylizedFrame
from usdsmoke.core.smoke.levels import bounded, dense_level, ranked

DENSE = (12, 12, 12)
LEVELS = [1e2, 1e4, 1e6, 1e30]
CONFIG = quick_config(
    shape={"iterations": [6, 6]}, colour={"iterations": [4, 4]}, views={"image_size": 32}
)


def spoiled(level: float) -> np.ndarray:
    density = puff(20)
    density[DENSE] = level
    return density


@cache
def stylized(level: float) -> StylizedFrame:
    return run_core([frame_of(spoiled(level))], CONFIG)[0]


def around(found: dict[tuple[int, ...], tuple[float, ...]]) -> dict[tuple[int, ...], np.ndarray]:
    """Without the voxels that the dense one reaches when it is moved."""
    far = {v: np.array(x) for v, x in found.items() if max(abs(a - 12) for a in v) > 2}
    assert len(far) > 1000
    return far


@pytest.mark.parametrize("level", LEVELS)
def test_one_dense_voxel_leaves_the_extinction_as_it_is(level):
    plain, dense = (scene_of([frame_of(spoiled(x))], CONFIG) for x in (1.0, level))
    assert dense.gamma_w == pytest.approx(plain.gamma_w, rel=0.02)
    assert dense.gamma_w_shape == pytest.approx(plain.gamma_w_shape, rel=0.02)


@pytest.mark.parametrize("level", LEVELS)
def test_smoke_around_one_dense_voxel_moves_and_is_painted_as_ever(level):
    """The same motion as around one ten times denser than the rest; colours see it in front."""
    usual, dense = stylized(10.0), stylized(level)
    transport = dense.report.transport
    assert transport.largest_displacement > 0.9 * transport.cap
    for name in ("density", "emission"):
        wanted, found = (around(by_voxel(getattr(r, name))) for r in (usual, dense))
        assert found.keys() == wanted.keys()
        size = sum(np.abs(x).sum() for x in wanted.values())
        missed = sum(np.abs(found[v] - wanted[v]).sum() for v in wanted)
        assert missed < (1e-5 if name == "density" else 0.15) * size


@pytest.mark.parametrize("level", LEVELS)
def test_one_dense_voxel_deletes_no_smoke_and_the_mass_of_both_is_kept(level):
    found, source = stylized(level).density.values, spoiled(level)
    assert (found > 0).sum() >= (source > 0).sum()
    assert found.sum(dtype=float) == pytest.approx(source.sum(dtype=float), rel=1e-4)
    usual = stylized(10.0).density.values
    rest, wanted = (np.sort(x, axis=None)[:-64].sum(dtype=float) for x in (found, usual))
    assert rest == pytest.approx(wanted, rel=0.02)
    assert rest > 0.85 * puff(20).sum(dtype=float)


@pytest.mark.parametrize("level", LEVELS)
def test_where_smoke_is_does_not_depend_on_its_densest_voxel(level):
    plain, dense = (smooth_mask(torch.from_numpy(spoiled(x)), 1.5) for x in (1.0, level))
    torch.testing.assert_close(plain, dense)


def test_one_voxel_far_away_moves_no_smoke_out_of_its_place():
    """Its distance is no size of the smoke: the puff would be moved by more than its radius."""
    far = np.zeros((16, 216, 16), np.float32)
    far[:, :16] = puff(16)
    far[8, 215, 8] = 0.5
    config = quick_config(
        shape={"iterations": [0, 20]},
        optimize={"steps": ["shape"]},
        views={"pool": 4, "image_size": 216},
    )
    transport = run_core([frame_of(far)], config)[0].report.transport
    assert 0.5 * transport.cap < transport.largest_displacement < 0.2 * 16
    assert transport.folded < 0.005 and transport.unread < 0.01


REMAINS = {"crumbs": (120, 0.02), "a wisp": (64, 0.05), "few voxels": (2, 0.5), "much": (20, 0.3)}


@cache
def with_remains(name: str, axis: int) -> np.ndarray:
    """A puff of 14 voxels a side, and what is left of other smoke, up to three boxes away."""
    number, amount = REMAINS[name]
    density, generator = np.zeros((60, 14, 14), np.float32), np.random.default_rng(5)
    density[:14] = puff(14)
    places = generator.integers([20, 0, 0], density.shape, (number, 3))
    density[tuple(places.T)] = density[59, 7, 7] = amount
    return np.moveaxis(density, 0, axis)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("name", REMAINS)
def test_remains_far_away_change_neither_extinction_nor_reach(name, axis):
    density = with_remains(name, axis)
    alone = np.where(np.indices(density.shape)[axis] < 14, density, 0)
    plain, remains = (scene_of([frame_of(x)], CONFIG) for x in (alone, density))
    assert remains.gamma_w == pytest.approx(plain.gamma_w, rel=1e-6)
    assert remains.gamma_w_shape == pytest.approx(plain.gamma_w_shape, rel=1e-6)
    assert plain.widened == 1 and remains.widened > 1.5
    assert smoke_of(density).extent == pytest.approx(smoke_of(alone).extent, rel=0.25)


@pytest.mark.parametrize("smoke", ["puff", "core", "two", "sheet", "filament"])
def test_smoke_without_remains_is_all_main_part(smoke):
    """Also two puffs of one size, and a core in thin smoke."""
    density = puff(20, cut=1e-3)
    if smoke == "core":
        density[8:11, 8:11, 8:11] *= 300
    elif smoke == "two":
        density = np.concatenate([density, np.zeros((60, 20, 20), np.float32), density])
    elif smoke == "sheet":
        density = np.ones((40, 1, 40), np.float32)
    elif smoke == "filament":
        density = np.ones((100, 1, 1), np.float32)
    voxels = smoke_of(density).voxels
    assert voxels.main_part() is voxels


def test_the_reach_does_not_jump_when_a_wisp_leaves():
    lengths = []
    for distance in range(0, 80):
        density = np.zeros((110, 16, 16), np.float32)
        density[:16] = puff(16)
        density[16 + distance : 20 + distance, 6:9, 6:9] = 0.1
        lengths.append(smoke_of(density).extent)
    steps = np.diff(np.log(lengths))
    assert np.abs(steps).max() < 0.1
    assert lengths[-1] == pytest.approx(lengths[0], rel=0.3)


def test_lumps_far_apart_have_the_extinction_of_one_and_are_named():
    density = np.zeros((90, 14, 14), np.float32)
    density[:14] = density[-14:] = puff(14)
    one, two = (scene_of([frame_of(x)], CONFIG) for x in (density[:14], density))
    assert two.gamma_w == pytest.approx(one.gamma_w, rel=0.02)
    assert two.widened > 3 and one.widened == 1


@pytest.mark.parametrize("side", [1, 3])
def test_wisps_before_and_after_the_smoke_do_not_choose_its_extinction(side):
    """Frames count by their voxels: most frames hold a lump, all of the smoke is in one."""
    wisp = np.zeros((20, 20, 20), np.float32)
    wisp[9 : 9 + side, 9 : 9 + side, 9 : 9 + side] = 0.5
    frames = [frame_of(x, float(n)) for n, x in enumerate([wisp, wisp, puff(20), wisp, wisp])]
    alone, shot = (scene_of(some, CONFIG) for some in (frames[2:3], frames))
    assert shot.gamma_w == pytest.approx(alone.gamma_w, rel=0.2)


@pytest.mark.parametrize("times", [0.1, 10.0])
def test_one_frame_of_three_with_another_unit_does_not_choose_the_extinction(times):
    frames = [
        frame_of(puff(20), float(n), index_to_world=np.diag([scale, scale, scale, 1.0]))
        for n, scale in enumerate([1.0, times, 1.0])
    ]
    fine = quick_config(views={"image_size": 256})  # pixels of the largest frame fit all voxels
    alone, shot = (scene_of(some, fine) for some in (frames[:1], frames))
    assert shot.gamma_w == pytest.approx(alone.gamma_w, rel=0.01)


@pytest.mark.parametrize("floor", [1e-6, 1e-4, 1e-2])
def test_a_floor_in_all_of_the_box_changes_neither_extinction_nor_reach(floor):
    """What a simulation leaves everywhere: it is not what is made opaque."""
    alone = np.zeros((32, 32, 32), np.float32)
    alone[9:23, 9:23, 9:23] = puff(14, cut=0.1)
    density = np.maximum(alone, np.float32(floor))
    plain, found = (scene_of([frame_of(x)], CONFIG) for x in (alone, density))
    assert found.gamma_w == pytest.approx(plain.gamma_w, rel=0.1)
    assert smoke_of(density).extent == pytest.approx(smoke_of(alone).extent, rel=0.1)
    smoke = smoke_of(density)
    assert bounded(smoke) is smoke


def test_smoke_that_fills_its_box_has_no_floor():
    noise = np.random.default_rng(0).uniform(0.5, 1.5, (12, 12, 12)).astype(np.float32)
    spotted = np.ones((12, 12, 12), np.float32)
    spotted[4:7, 4:7, 4:7] = 1e6
    for density in (noise, spotted, np.ones((9, 9, 9), np.float32)):
        assert smoke_of(density).voxels.floor == 0


def test_thin_smoke_that_covers_the_picture_and_is_chosen_is_measured():
    """A ball of thin smoke around a puff: no box tells that it is a floor."""
    places = np.indices((40, 40, 40)) - 19.5
    density = np.where((places**2).sum(0) < 19**2, np.float32(1e-3), 0).astype(np.float32)
    assert scene_of([frame_of(density)], CONFIG).hidden == 0
    density[16:24, 16:24, 16:24] += puff(8)
    assert scene_of([frame_of(density)], CONFIG).hidden > 0.1


@pytest.mark.parametrize("level", [1e-3, 1e-4])
def test_dense_smoke_apart_from_more_thin_smoke_is_no_remains(level):
    """A layer of ground fog has most voxels, and the puff above it most of the mass."""
    density = np.zeros((32, 32, 32), np.float32)
    density[10:20, 20:30, 10:20] = puff(10)
    alone = scene_of([frame_of(density)], CONFIG).gamma_w
    density[:, :8] = level
    assert scene_of([frame_of(density)], CONFIG).gamma_w < 4 * alone


@pytest.mark.parametrize("shape", [(1, 1, 9), (9, 1, 9), (2, 2, 40), (30, 30, 30)])
def test_smoke_in_one_piece_is_one_lump(shape):
    voxels = smoke_of(np.ones(shape, np.float32)).voxels
    assert voxels.largest_lump() is voxels


def test_a_rank_is_never_the_largest_of_two_or_more():
    assert ranked(torch.tensor([]), 0.99) == 0
    assert ranked(torch.tensor([3.0]), 0.99) == 3
    for n in (2, 5, 1000):
        values = torch.arange(n, dtype=torch.float32)
        assert ranked(values, 0.99) == int(0.99 * (n - 1)) < n - 1


def test_ordinary_smoke_has_no_outliers():
    smoke = smoke_of(puff(20))
    assert bounded(smoke) is smoke
    dense = smoke_of(spoiled(1e6))
    assert bounded(dense).density.max() == pytest.approx(dense_level(dense.density))
    assert dense_level(torch.zeros(3)) == 0


@pytest.mark.parametrize("amount", [1e-34, 1e-36])
def test_the_faintest_smoke_that_float32_holds_keeps_its_mass(amount):
    density = puff(10) * np.float32(amount)
    result = run_core([frame_of(density)])[0]
    assert not result.report.left_out
    assert result.density.values.sum(dtype=float) == pytest.approx(
        density.sum(dtype=float), rel=1e-3
    )
    assert np.isfinite(result.emission.values).all() and result.emission.values.any()


@pytest.mark.parametrize(("level", "name"), [(1e6, "density"), (3e4, "emission")])
def test_what_16_bit_floats_cannot_hold_is_refused_before_anything_is_optimised(level, name):
    """The emission of a voxel is at most 2.54 times its extinction."""
    frame, seen = frame_of(spoiled(level)), []
    config = quick_config(grids={"half": True}, optics={"gamma": 4.0})
    with pytest.raises(ConfigError, match=rf"{name} at timeCode 1 .*grids\.half"):
        run_core([frame], config, watch=seen)
    assert not seen
    assert run_core([frame_of(spoiled(1.0))], config)[0].emission is not None

"""Active voxels, their octaves, and colours between them."""

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import affine, puff, smoke_of
from usdsmoke.base.volume import DenseField
from usdsmoke.core.smoke.active import (
    ActiveSmoke,
    activate,
    coarsen,
    densify,
    make_octaves,
    sample_colours,
)
from usdsmoke.core.smoke.voxels import LEAST_DENSITY

CPU = torch.device("cpu")


def activated(values: np.ndarray, ijk_min: tuple[int, int, int] = (0, 0, 0)) -> ActiveSmoke:
    return activate(DenseField("density", values, ijk_min, affine(0)), affine(1), CPU)


def mass(smoke: ActiveSmoke) -> float:
    return float(smoke.density.double().sum()) * smoke.voxel_volume


def by_voxel(smoke: ActiveSmoke) -> dict[tuple[int, ...], float]:
    return dict(zip(map(tuple, smoke.ijk.tolist()), smoke.density.tolist(), strict=True))


def test_only_voxels_with_smoke_are_active_at_their_absolute_indices():
    values = np.zeros((3, 2, 2), np.float32)
    values[1, 0, 1], values[2, 1, 0], values[0, 0, 0] = 0.5, 2.0, -1.0
    smoke = activated(values, (-5, 7, 100))
    assert by_voxel(smoke) == {(-4, 7, 101): 0.5, (-3, 8, 100): 2.0}
    assert smoke.positions[0].numpy() == pytest.approx(
        np.array([-4, 7, 101, 1]) @ affine(0) @ affine(1) @ np.eye(4, 3)
    )


def test_denormal_density_counts_as_none_and_faint_density_as_smoke():
    values = np.array([1e-45, 1e-40, 2 * LEAST_DENSITY, 1e-30], np.float32).reshape(4, 1, 1)
    assert activated(values).ijk[:, 0].tolist() == [2, 3]


@pytest.mark.parametrize("shape", [(8, 8, 8), (7, 5, 9), (1, 6, 8), (5, 1, 1), (1, 1, 1)])
def test_coarsening_keeps_the_mass(shape):
    values = np.random.default_rng(0).random(shape).astype(np.float32)
    smoke = activated(values, (-3, 2, 5))
    for octave in make_octaves(smoke, 4):
        assert mass(octave) == pytest.approx(mass(smoke), rel=1e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_coarsening_keeps_the_column_sums_of_whole_blocks(axis):
    values = np.random.default_rng(1).random((8, 6, 4)).astype(np.float32)
    smoke = smoke_of(values)
    coarse = coarsen(smoke)
    low = torch.zeros(3, dtype=torch.int64)
    box = densify(coarse.ijk, coarse.density[:, None], low, (4, 3, 2))[..., 0].numpy()
    fine_columns = values.sum(axis)
    n, m = fine_columns.shape
    blocks = fine_columns.reshape(n // 2, 2, m // 2, 2).mean(axis=(1, 3))
    assert 2 * box.sum(axis) == pytest.approx(blocks, rel=1e-6)


def test_a_coarse_voxel_lies_in_the_middle_of_its_eight():
    smoke = activated(np.ones((4, 4, 4), np.float32), (-6, 2, 0))
    coarse = coarsen(smoke)
    wanted = smoke.positions.view(2, 2, 2, 2, 2, 2, 3).mean(dim=(1, 3, 5)).reshape(-1, 3)
    assert torch.allclose(coarse.positions, wanted, atol=1e-12)


def test_octaves_do_not_depend_on_how_the_box_was_cropped():
    values = puff(9)
    smoke = activated(values, (-4, -3, -7))
    padded = activated(np.pad(values, ((3, 1), (0, 2), (5, 5))), (-7, -3, -12))
    for octave, other in zip(make_octaves(smoke, 4), make_octaves(padded, 4), strict=True):
        assert torch.equal(octave.ijk, other.ijk)
        assert torch.equal(octave.density, other.density)
        assert np.array_equal(octave.index_to_stage, other.index_to_stage)


def test_smoke_far_away_changes_no_block():
    """However large the box: blocks of near and far smoke are those of each alone."""
    parts = [activated(puff(6), low) for low in ((-3, 1, 2), (40_001, -90_000, 70_003))]
    both = ActiveSmoke(
        torch.cat([part.ijk for part in parts]),
        torch.cat([part.density for part in parts]),
        parts[0].index_to_stage,
    )
    alone = [coarsen(part) for part in parts]
    found = coarsen(both)
    assert torch.equal(found.ijk, torch.cat([part.ijk for part in alone]))
    assert torch.equal(found.density, torch.cat([part.density for part in alone]))


def test_blocks_below_zero_are_aligned_like_those_above():
    """-1 and -2 are one block, 0 and 1 the next: nothing is mirrored at 0."""
    smoke = activated(np.ones((4, 1, 1), np.float32), (-2, 0, 0))
    assert coarsen(smoke).ijk[:, 0].tolist() == [-1, 0]
    assert coarsen(smoke).density.tolist() == [1.0, 1.0]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_slab_stays_a_slab_of_the_same_thickness(axis):
    values = np.ones((6, 6, 6), np.float32).take([0], axis=axis)
    smoke = activated(values)
    assert smoke.thin_axis == axis
    for octave in make_octaves(smoke, 3):
        assert octave.thin_axis == axis
        sides = [np.linalg.norm(s.index_to_stage[axis, :3]) for s in (smoke, octave)]
        assert sides[0] == pytest.approx(sides[1])
    faces = np.delete(smoke.index_to_stage[:3, :3], axis, axis=0)
    assert smoke.voxel_size**2 == pytest.approx(np.linalg.norm(np.cross(*faces)))


def test_one_voxel_and_a_row_of_voxels_are_not_2d():
    assert activated(np.ones((1, 1, 1), np.float32)).thin_axis is None
    assert activated(np.ones((1, 4, 1), np.float32)).thin_axis is None


def test_an_empty_frame_has_empty_octaves():
    for values in (np.zeros((0, 0, 0), np.float32), np.zeros((3, 3, 3), np.float32)):
        smoke = activated(values)
        assert [len(octave.ijk) for octave in make_octaves(smoke, 3)] == [0, 0, 0]
        assert smoke.thin_axis is None and smoke.voxel_size > 0
        assert smoke.positions.shape == (0, 3)


def test_colours_between_voxels_are_trilinear_inside_the_smoke():
    smoke = smoke_of(np.ones((5, 6, 7)), affine(2))
    slope = torch.tensor([[0.1, 0.0, 0.3], [0.0, 0.2, -0.1], [0.05, 0.1, 0.0]]).double()
    colours = smoke.positions @ slope + 0.4
    ijk = torch.rand(50, 3, generator=torch.Generator().manual_seed(0)).double()
    ijk = ijk * torch.tensor([4.0, 5.0, 6.0])
    matrix = torch.from_numpy(smoke.index_to_stage)
    places = ijk @ matrix[:3, :3] + matrix[3, :3]
    found, near = sample_colours(smoke, colours, places)
    assert torch.allclose(found, places @ slope + 0.4, atol=1e-12)
    assert torch.allclose(near, torch.ones(50, 1).double())


def test_colours_at_voxels_are_their_own_whatever_lies_around():
    smoke = smoke_of(puff(9), affine(3, mirrored=True))
    colours = torch.rand(len(smoke.ijk), 3, generator=torch.Generator().manual_seed(1))
    found, near = sample_colours(smoke, colours, smoke.positions)
    assert torch.allclose(found, colours, atol=1e-5)
    assert torch.allclose(near, torch.ones_like(near), atol=1e-5)


def test_nothing_bleeds_in_from_outside_the_smoke():
    """Beside the last voxel its colour goes on undarkened until no voxel is near."""
    smoke = smoke_of(np.ones((2, 2, 2)))
    colours = torch.full((8, 3), 0.8, dtype=torch.float64)
    places = torch.tensor([[1.6, 0.5, 0.5], [1.99, 1.9, 0.0], [2.5, 0.0, 0.0], [-9.0, 0, 0]])
    found, near = sample_colours(smoke, colours, places.double())
    assert found[:2].flatten().tolist() == pytest.approx([0.8] * 6)
    assert near.flatten().tolist() == pytest.approx([0.4, 0.001, 0.0, 0.0])
    assert not found[2:].any()


def test_colours_at_places_absurdly_far_away_are_none_and_finite():
    smoke = smoke_of(puff(6))
    places = torch.tensor([[1e30, 0.0, 0.0], [-1e15, 3.0, 3.0], [0.0, 1e9, -1e9]]).double()
    found, near = sample_colours(smoke, torch.ones(len(smoke.ijk), 3), places)
    assert not found.any() and not near.any()


def test_the_outline_holds_the_voxels_farthest_in_every_direction() -> None:
    rng = np.random.default_rng(4)
    values = np.where(rng.random((14, 11, 17)) < 0.4, 1.0, 0.0).astype(np.float32)
    smoke = smoke_of(np.pad(values, ((0, 0), (0, 0), (3, 9))), affine(4))
    everywhere = smoke.positions.numpy()
    assert len(smoke.outline) < 0.7 * len(everywhere)
    for axis in rng.standard_normal((50, 3)):
        assert (smoke.outline @ axis).max() == (everywhere @ axis).max()

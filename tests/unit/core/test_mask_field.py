"""The effect mask's values anywhere in stage space."""

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import affine, frame_of, masked, puff
from usdsmoke.core.views.visibility import EffectMask, effect_mask


def test_a_linear_ramp_in_space_is_found_again_from_a_turned_grid_of_uneven_voxels():
    """On a grid with a place of its own, under a prim with a place of its own."""
    grid, prim = affine(3, mirrored=True), affine(5)
    low, shape = (-4, 7, 2), (9, 8, 7)
    voxels = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), -1) + low
    to_stage = grid @ prim
    places = voxels @ to_stage[:3, :3] + to_stage[3, :3]
    slope = np.array([0.03, -0.02, 0.025])
    offset = 0.5 - slope @ places.reshape(-1, 3).mean(0)
    mask = EffectMask(masked(places @ slope + offset, None, grid, low, 0.25, prim))
    inside = np.random.default_rng(0).uniform(0, np.array(shape) - 1, (200, 3)) + low
    points = inside @ to_stage[:3, :3] + to_stage[3, :3]
    found = mask.at(torch.from_numpy(points))
    assert found.dtype == torch.float32 and mask.n_clamped == 0
    assert found.numpy() == pytest.approx(points @ slope + offset, abs=1e-6)


def test_beyond_the_box_the_background_holds_and_blends_in_within_a_voxel():
    mask = EffectMask(masked(np.full((3, 3, 3), 0.75), background=0.25))
    x = torch.tensor([-1e300, -1, -0.5, 0, 1, 2, 2.25, 3, 1e6, 1e300], dtype=torch.float64)
    points = torch.stack([x, torch.ones_like(x), torch.ones_like(x)], 1)
    wanted = [0.25, 0.25, 0.5, 0.75, 0.75, 0.75, 0.625, 0.25, 0.25, 0.25]
    assert mask.at(points).tolist() == pytest.approx(wanted)


@pytest.mark.parametrize("shape", [(3, 3, 1), (1, 3, 1), (1, 1, 1)])
def test_a_flat_mask_holds_for_half_a_voxel_and_ends_after_a_whole_one(shape):
    mask = EffectMask(masked(np.full(shape, 0.75), background=0.25))
    x = torch.tensor([-1e300, -2, -1, -0.75, -0.5, 0, 0.3, 0.5, 1, 2, 1e300], dtype=torch.float64)
    wanted = [0.25, 0.25, 0.25, 0.5, 0.75, 0.75, 0.75, 0.75, 0.25, 0.25, 0.25]
    for axis in (axis for axis, length in enumerate(shape) if length == 1):
        points = torch.zeros(len(x), 3, dtype=torch.float64)
        points[:, axis] = x
        assert mask.at(points).tolist() == pytest.approx(wanted)


def test_values_and_background_are_clamped_and_the_clamped_values_counted():
    values = np.array([-0.5, 0.0, 0.5, 1.0, 1.5, 3e38]).reshape(6, 1, 1)
    mask = EffectMask(masked(values, background=-7.0))
    assert mask.n_clamped == 3
    points = torch.tensor([[float(i), 0.0, 0.0] for i in range(-3, 6)]).double()
    assert mask.at(points).tolist() == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0])
    assert EffectMask(masked(values, background=7.0)).at(points)[0] == 1.0


@pytest.mark.parametrize("background", [0.0, 0.4, 1.0])
def test_an_empty_grid_is_its_background_everywhere(background):
    mask = EffectMask(masked(np.zeros((0, 0, 0)), background=background))
    points = torch.tensor([[0.0, 0.0, 0.0], [1e6, -1e6, 5.0]]).double()
    assert mask.at(points).tolist() == pytest.approx([background] * 2) and mask.n_clamped == 0


def test_far_from_the_origin_a_mask_is_as_sharp_as_near_it():
    """A million voxels away float32 has eighths of a voxel left; the places are float64."""
    values = np.random.default_rng(0).random((5, 6, 4))
    far = np.diag([0.1, 0.1, 0.1, 1.0])
    far[3, :3] = [1e6, -2e6, 3e6]
    inside = np.random.default_rng(1).uniform(-1, 6, (100, 3))
    near = EffectMask(masked(values)).at(torch.from_numpy(inside))
    points = torch.from_numpy(inside @ far[:3, :3] + far[3, :3])
    found = EffectMask(masked(values, index_to_world=far)).at(points)
    assert torch.allclose(found, near, atol=1e-6) and near.std() > 0.1


def test_a_frame_without_a_mask_has_none():
    assert effect_mask(frame_of(puff(4))) is None
    with pytest.raises(ValueError, match="no mask"):
        EffectMask(frame_of(puff(4)))

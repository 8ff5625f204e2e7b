"""The dense box around the smoke of an octave."""

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import affine, puff, smoke_of
from usdsmoke.base.errors import PlanError
from usdsmoke.base.volume import DenseField
from usdsmoke.core.fields import lattice as lattice_module
from usdsmoke.core.fields.lattice import field_from_box, grow, surround
from usdsmoke.core.smoke.active import ActiveSmoke, make_octaves


def test_the_box_holds_the_smoke_with_room_around():
    smoke = smoke_of(puff(9), affine(0))
    lattice = surround(smoke, 2)
    box = lattice.fill(smoke)
    low, high = smoke.box
    assert lattice.low.tolist() == (low - 2).tolist()
    assert list(lattice.shape) == (high - low + 5).tolist()
    assert float(box.double().sum()) == pytest.approx(float(smoke.density.double().sum()))
    index = (smoke.ijk - torch.from_numpy(lattice.low)).numpy().T
    assert torch.equal(box[tuple(index)], smoke.density)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_slab_gets_no_room_across(axis):
    smoke = smoke_of(np.ones((5, 5, 5)).take([0], axis=axis))
    assert surround(smoke, 3).shape[axis] == 1


def test_smoke_in_places_far_apart_is_refused_with_a_way_out():
    ijk = torch.tensor([[0, 0, 0], [1_000_000, 0, 0]])
    smoke = ActiveSmoke(ijk, torch.ones(2), np.eye(4))
    with pytest.raises(PlanError, match=r"1000003 x 1 x 1 voxels.*optimize\.steps=\[colour\]"):
        surround(smoke, 1)


def test_the_room_around_flat_voxels_is_not_called_smoke_far_apart():
    smoke = smoke_of(puff(9), np.diag([1.0, 1.0, 1e-12, 1.0]))
    with pytest.raises(PlanError, match=r"1 x 1 x 1e-12 stage units.*transform") as refused:
        surround(smoke, (2, 2, 10**7))
    assert "far apart" not in str(refused.value)


def test_positions_are_those_of_the_smoke_s_voxels():
    smoke = smoke_of(puff(9), affine(2, mirrored=True))
    lattice = surround(smoke, 1)
    ijk = smoke.ijk - torch.from_numpy(lattice.low)
    assert torch.allclose(lattice.positions(ijk), smoke.positions)
    everywhere = lattice.positions().view(*lattice.shape, 3)
    assert torch.allclose(everywhere[tuple(ijk.T)], smoke.positions)
    sides = np.linalg.norm(smoke.index_to_stage[:3, :3], axis=1)
    assert lattice.spacing == pytest.approx(tuple(sides))


def test_values_go_from_one_octave_s_box_to_another_s_through_space():
    """A field linear in space is the same at the same places of both boxes."""
    coarse, fine = (surround(s, 2) for s in make_octaves(smoke_of(puff(12), affine(1)), 2))
    slope = torch.tensor([0.3, -0.2, 0.5]).double()
    values = (coarse.positions() @ slope).view(*coarse.shape, 1)
    inside = fine.positions().view(*fine.shape, 3)[2:-2, 2:-2, 2:-2].reshape(-1, 3)
    assert torch.allclose(coarse.sample(values, inside)[:, 0], inside @ slope, atol=1e-9)


def test_growing_adds_one_voxel_on_every_side_but_not_across_a_slab():
    mask = torch.zeros(5, 1, 6, dtype=torch.bool)
    mask[2, 0, 3] = mask[0, 0, 0] = True
    grown = grow(mask)
    assert grown.shape == mask.shape
    assert int(grown.sum()) == 9 + 4
    assert grown[1:4, 0, 2:5].all() and grown[:2, 0, :2].all()
    assert torch.equal(grow(mask, (3, 3, 3)), grow(grow(grown)))


def field(background: float = 0.0) -> DenseField:
    return DenseField("density", np.ones((2, 2, 2), np.float32), (1, 2, 3), affine(0), background)


def test_a_field_from_a_box_is_trimmed_and_keeps_its_place():
    values = np.zeros((6, 5, 4), np.float32)
    values[2, 1, 3], values[4, 2, 1] = 1.0, 2.0
    made = field_from_box(field(), values, np.array([-10, 20, 0]))
    assert made.ijk_min == (-8, 21, 1) and made.values.shape == (3, 2, 3)
    assert made.values[0, 0, 2] == 1.0 and made.values[2, 1, 0] == 2.0
    assert np.array_equal(made.index_to_world, affine(0)) and made.name == "density"


def test_a_box_of_nothing_gives_an_empty_field():
    assert field_from_box(field(), np.zeros((3, 3, 3), np.float32), np.zeros(3)).is_empty


@pytest.mark.parametrize("at_once", [7, 10**6])
def test_a_function_of_places_is_taken_at_every_voxel_a_few_at_a_time(monkeypatch, at_once):
    monkeypatch.setattr(lattice_module, "LATTICE_CHUNK", at_once)
    lattice = surround(smoke_of(puff(5), affine(4)), 2)
    sizes = []

    def seen(places: torch.Tensor) -> torch.Tensor:
        sizes.append(len(places))
        return torch.cat([places, places.sum(1, keepdim=True)], 1)

    found = lattice.on_voxels(seen, torch.zeros(1))
    wanted = lattice.positions()
    assert found.shape == (*lattice.shape, 4) and found.dtype == torch.float64
    assert torch.equal(found[..., :3].reshape(-1, 3), wanted)
    assert max(sizes) <= at_once and sum(sizes) == len(wanted) + 1  # one tells the shape

    where = torch.rand(lattice.shape) < 0.3
    some = lattice.on_voxels(seen, torch.zeros(1), where)
    assert torch.equal(some[where], found[where]) and not some[~where].any()
    nowhere = lattice.on_voxels(seen, torch.zeros(1), where & ~where)
    assert nowhere.shape == found.shape and not nowhere.any()

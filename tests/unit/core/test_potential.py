"""From potentials to displacements: faded at the border, capped, carried along."""

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import affine, divergence, held_in_voxels, puff, smoke_of
from usdsmoke.core.fields.lattice import Lattice, surround
from usdsmoke.core.fields.potential import (
    Displacement,
    Potential,
    border_mask,
)

CHANNELS = {"stream": 3, "potential": 1, "mixed": 4}


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.fixture(scope="module")
def lattice() -> Lattice:
    return surround(smoke_of(puff(14), np.diag([0.5, 1.0, 2.0, 1.0])), 2)


@pytest.fixture(scope="module")
def box(lattice: Lattice) -> torch.Tensor:
    return lattice.fill(smoke_of(puff(14), np.diag([0.5, 1.0, 2.0, 1.0]))).double()


def test_the_mask_is_one_deep_inside_and_zero_outside_the_smoke():
    box = torch.zeros(20, 20, 20, dtype=torch.float64)
    box[4:16, 4:16, 4:16] = 0.7
    mask = border_mask(box, 2.0)
    assert mask[9:11, 9:11, 9:11].min() > 0.9
    assert mask[box == 0].max() < 0.02  # half a voxel beyond the border the blur is below one half
    line = mask[:11, 10, 10]
    assert (line[1:] - line[:-1]).min() >= -1e-9  # rises inwards, up to round-off of the blur
    assert torch.equal(mask, border_mask(1e12 * box, 2.0))


def test_an_empty_box_has_an_empty_mask():
    assert not border_mask(torch.zeros(3, 4, 5), 2.0).any()


@pytest.mark.parametrize("kind", CHANNELS)
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e12])
def test_displacements_stay_below_the_cap_in_stage_units(kind, size, lattice, box):
    potential = size * random(*lattice.shape, CHANNELS[kind])
    moved = held_in_voxels(potential, border_mask(box, 2.0), kind, 0.8, lattice)
    lengths = (moved * torch.tensor(lattice.spacing)).norm(dim=-1)
    assert torch.isfinite(moved).all()
    assert 0 < lengths.max().item() <= 0.8 * (1 + 1e-9)


@pytest.mark.parametrize("kind", CHANNELS)
def test_nothing_moves_far_outside_the_smoke(kind, lattice, box):
    moved = held_in_voxels(
        random(*lattice.shape, CHANNELS[kind]), border_mask(box, 2.0), kind, 0.8, lattice
    )
    outer = torch.ones(lattice.shape, dtype=torch.bool)
    outer[1:-1, 1:-1, 1:-1] = False
    assert moved[outer].abs().max().item() < 1e-3


def test_a_faded_stream_function_stays_free_of_divergence(lattice, box):
    """In stage units and far below the cap, which alone disturbs it."""
    moved = held_in_voxels(
        1e-3 * random(*lattice.shape, 3), border_mask(box, 2.0), "stream", 1e3, lattice
    )
    moved = moved * torch.tensor(lattice.spacing)
    found = divergence(moved, lattice.spacing).abs().max().item()
    assert found < 1e-9 * moved.abs().max().item()


def test_mixed_is_half_of_each(lattice, box):
    mask, both = border_mask(box, 2.0), random(*lattice.shape, 4)
    stream = held_in_voxels(both[..., :3], mask, "stream", 1e9, lattice)
    potential = held_in_voxels(both[..., 3:], mask, "potential", 1e9, lattice)
    mixed = held_in_voxels(both, mask, "mixed", 1e9, lattice)
    assert torch.allclose(mixed, 0.5 * (stream + potential), atol=1e-12)


def test_a_potential_is_the_same_in_space_on_another_box():
    smoke = smoke_of(puff(12), affine(1))
    small, large = surround(smoke, 1), surround(smoke, 3)
    values = random(*small.shape, 3)
    potential = Potential(values, small)
    assert torch.allclose(potential.on(small), values)
    assert torch.allclose(potential.on(large)[2:-2, 2:-2, 2:-2], values)


def test_a_displacement_is_found_between_voxels_and_ends_with_its_box():
    smoke = smoke_of(puff(12))
    lattice = surround(smoke, 1)
    values = random(*lattice.shape, 3)
    displacement = Displacement(values, lattice)
    assert torch.allclose(displacement.at(lattice.positions()).view(values.shape), values)
    halfway = torch.tensor([[0.5, 0.0, 0.0]]).double() + lattice.positions()[:1]
    assert torch.allclose(displacement.at(halfway)[0], (values[0, 0, 0] + values[1, 0, 0]) / 2)
    assert not displacement.at(halfway + 1e6).any()

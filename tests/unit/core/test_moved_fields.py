"""Other fields that move with the density."""

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import frame_of, puff
from tests.fixtures.stylize_fixtures import quick_config, run_core
from usdsmoke.base.volume import DenseField
from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.steps.move import move_field
from usdsmoke.vdb.blend import relative_difference

PLACE = np.diag([0.5, 0.5, 0.5, 1.0])  # stage units per voxel of the density


def rotation(speed: float, n: int = 24) -> Displacement:
    """Around the k axis through the middle of the box, fading towards its border."""
    lattice = Lattice(np.zeros(3, np.int64), (n, n, n), PLACE)
    axes = torch.meshgrid(*[torch.arange(n, dtype=torch.float32)] * 3, indexing="ij")
    x, y, z = (0.5 * (axis - (n - 1) / 2) for axis in axes)
    fade = torch.exp(-(x**2 + y**2 + z**2) / 4)
    return Displacement(torch.stack([-y, x, 0 * z], dim=-1) * (speed * fade)[..., None], lattice)


def blob(n: int, voxel: float, background: float = 0.0) -> DenseField:
    """A ball beside the middle, in stage units at the same place whatever the voxels are."""
    positions = voxel * np.indices((n, n, n)).transpose(1, 2, 3, 0)
    distance = np.linalg.norm(positions - [6.5, 5.75, 5.75], axis=-1)
    values = np.maximum(0, 1.5 - distance).astype(np.float32) + np.float32(background)
    return DenseField("heat", values, (0, 0, 0), np.diag([voxel] * 3 + [1.0]), background)


def centre(field: DenseField) -> np.ndarray:
    weights = np.asarray(field.values - np.float32(field.background), np.float64)
    places = np.indices(weights.shape).reshape(3, -1).T + field.ijk_min
    middle = np.average(places, axis=0, weights=weights.ravel())
    moved: np.ndarray = middle @ field.index_to_world[:3, :3] + field.index_to_world[3, :3]
    return moved


def test_fields_of_other_voxels_move_to_the_same_place_as_the_density() -> None:
    motion = rotation(0.3)
    shifts = [
        centre(move_field(blob(n, voxel), np.eye(4), motion)) - centre(blob(n, voxel))
        for n, voxel in ((24, 0.5), (48, 0.25))
    ]
    assert np.linalg.norm(shifts[1]) > 0.1
    assert np.linalg.norm(shifts[0] - shifts[1]) < 0.1 * np.linalg.norm(shifts[1])


def test_values_keep_their_range_and_what_does_not_move_keeps_its_bits() -> None:
    field = blob(24, 0.5, background=-2.0)
    moved = move_field(field, np.eye(4), rotation(0.3))
    assert -2.0 <= moved.values.min() and moved.values.max() <= field.values.max()
    assert moved.background == -2.0
    still = Displacement(0 * rotation(1.0).values, rotation(1.0).lattice)
    assert move_field(field, np.eye(4), still) is field
    assert move_field(field, np.eye(4), None) is field
    far = np.eye(4)
    far[3, 0] = 100.0  # beyond the box of the motion
    away = move_field(field, far, rotation(0.3))
    active = [f.values[f.values != -2.0] for f in (field, away)]
    np.testing.assert_array_equal(*active)


def test_colours_move_component_by_component() -> None:
    grey = blob(24, 0.5)
    colour = DenseField(
        "Cd", np.stack([grey.values, 2 * grey.values, 0 * grey.values], axis=-1), (0, 0, 0),
        grey.index_to_world, (0.0, 0.0, 0.0),
    )  # fmt: skip
    moved, expected = (move_field(f, np.eye(4), rotation(0.3)) for f in (colour, grey))
    assert moved.ijk_min == expected.ijk_min
    np.testing.assert_allclose(moved.values[..., 1], 2 * expected.values, atol=1e-6)
    assert not moved.values[..., 2].any()


@pytest.mark.parametrize("strength", [1.0, 0.5])
def test_what_moves_the_density_moves_a_copy_of_it_to_the_same_place(strength: float) -> None:
    frame = frame_of(puff(12))
    config = quick_config(
        shape={"iterations": [10], "interpolation": "linear", "mass_correction": False},
        optimize={"steps": ["shape"], "strength": strength, "threads": 1},
    )
    (result,) = run_core([frame], config)
    moved = move_field(frame.density, frame.density_to_stage, result.moved_by)
    assert relative_difference(moved, result.density) < 1e-5
    assert relative_difference(frame.density, result.density) > 0.01


def test_colours_alone_move_nothing() -> None:
    config = quick_config(optimize={"steps": ["colour"], "threads": 1})
    assert run_core([frame_of(puff(12))], config)[0].moved_by is None

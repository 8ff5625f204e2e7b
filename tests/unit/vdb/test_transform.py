"""Index space and grid world, against hand-made numbers."""

import numpy as np
import pytest

from tests.fixtures.grids_fixtures import make_field, make_vectors, rotated, uniform
from usdsmoke.base.volume import DenseField
from usdsmoke.vdb.boxes import (
    active_box,
    active_mask,
    box_extent,
    crop_to_active,
    field_extent,
    index_to_world,
)


def test_point_is_a_row_and_the_translation_stands_in_the_last_row() -> None:
    matrix = np.eye(4)
    matrix[0, 1] = 2.0  # i leans towards y
    matrix[3, :3] = (10.0, 20.0, 30.0)
    assert index_to_world((1, 0, 0), matrix).tolist() == [11.0, 22.0, 30.0]
    assert index_to_world([[(0, 0, 0)], [(0, 1, 0)]], matrix).shape == (2, 1, 3)


def test_box_reaches_half_a_voxel_beyond_its_outer_indices() -> None:
    low, high = box_extent((-1, 0, 2), (3, 1, 2), uniform(0.5, (10.0, 0.0, 0.0)))
    assert low.tolist() == [10.0 - 0.75, -0.25, 0.75]
    assert high.tolist() == [10.0 + 0.75, 0.25, 1.75]


def test_box_of_a_mirrored_and_turned_grid_holds_all_its_corners() -> None:
    matrix = rotated(0.5, scale=(-1.0, 1.0, 1.0), translation=(0, 0, 0))
    low, high = box_extent((0, 0, 0), (1, 1, 1), matrix)
    reach = 0.5 * (np.cos(0.5) + np.sin(0.5))
    assert np.allclose(high, [reach, reach, 0.5])
    assert np.allclose(low, [-reach, -reach, -0.5])


def test_extent_counts_active_voxels_only() -> None:
    values = np.zeros((5, 4, 3), np.float32)
    values[1, 2, 0] = values[3, 2, 1] = 1.0
    field = DenseField("density", values, (10, 0, 0), uniform(1.0))
    assert field_extent(field) == ((10.5, 1.5, -0.5), (13.5, 2.5, 1.5))
    assert active_box(field) == ((11, 2, 0), (3, 1, 2))


def test_field_of_nothing_but_background_has_no_extent() -> None:
    values = np.full((2, 2, 2), 7.0, np.float32)
    assert field_extent(DenseField("a", values, (0, 0, 0), np.eye(4), background=7.0)) is None
    assert field_extent(DenseField("a", values[:0, :0, :0], (0, 0, 0), np.eye(4))) is None


def test_vector_is_active_when_any_component_differs() -> None:
    values = np.zeros((2, 1, 1, 3), np.float32)
    values[1, 0, 0] = (0.0, 0.0, 1.0)
    field = DenseField("a", values, (0, 0, 0), np.eye(4), background=(0.0, 0.0, 0.0))
    assert active_mask(field).ravel().tolist() == [False, True]


@pytest.mark.parametrize("make", [make_field, make_vectors])
def test_cropping_loses_no_active_voxel_and_moves_none(make) -> None:
    field = make(ijk_min=(-3, 4, 0))
    border = [(2, 1), (0, 3), (1, 0)] + [(0, 0)] * (field.values.ndim - 3)
    padded = DenseField(
        "a", np.pad(field.values, border), (-5, 4, -1), np.eye(4), background=field.background
    )
    cropped = crop_to_active(padded)
    assert active_box(cropped) == active_box(padded) == active_box(field)
    assert cropped.values.shape[:3] == active_box(field)[1]
    assert cropped.values.flags.c_contiguous
    assert np.array_equal(cropped.values, crop_to_active(field).values)

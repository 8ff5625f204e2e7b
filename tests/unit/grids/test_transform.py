"""Index space and grid world, against hand-made numbers and as inverses of each other."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.grids_fixtures import make_field, make_vectors, rotated, uniform
from usdsmoke.grids.active_box import active_box, active_mask, crop_to_active
from usdsmoke.grids.transform import (
    box_extent,
    compose,
    field_extent,
    index_to_world,
    invert,
    is_axis_aligned,
    voxel_size,
    voxel_volume,
    world_to_index,
)
from usdsmoke.volume import DenseField

lengths = st.floats(1e-3, 1e3)
offsets = st.floats(-1e4, 1e4)


@st.composite
def transforms(draw: st.DrawFn) -> np.ndarray:
    angle = draw(st.floats(-3.2, 3.2))
    scale = [draw(lengths) * draw(st.sampled_from([-1, 1])) for _ in range(3)]
    return rotated(angle, scale, [draw(offsets) for _ in range(3)])


@given(transforms(), st.tuples(*[st.floats(-1e3, 1e3)] * 3))
def test_world_and_back_is_the_same_index(
    matrix: np.ndarray, point: tuple[float, float, float]
) -> None:
    world = index_to_world(point, matrix)
    scale = np.abs(world).max() + np.abs(matrix[3, :3]).max()
    assert np.allclose(
        world_to_index(world, matrix), point, rtol=1e-9, atol=1e-12 * scale / voxel_size(matrix)
    )
    there_and_back = compose(matrix, invert(matrix))
    assert np.allclose(
        there_and_back, np.eye(4), atol=1e-9 * (1 + scale / voxel_size(matrix).min())
    )


@given(transforms(), transforms())
def test_composed_transform_acts_one_after_the_other(first: np.ndarray, then: np.ndarray) -> None:
    point = np.array([1.5, -2.0, 0.25])
    wanted = index_to_world(index_to_world(point, first), then)
    scale = np.abs(then).max() * (1 + np.abs(first).max())
    assert np.allclose(index_to_world(point, compose(first, then)), wanted, atol=1e-12 * scale)


def test_point_is_a_row_and_the_translation_stands_in_the_last_row() -> None:
    matrix = np.eye(4)
    matrix[0, 1] = 2.0  # i leans towards y
    matrix[3, :3] = (10.0, 20.0, 30.0)
    assert index_to_world((1, 0, 0), matrix).tolist() == [11.0, 22.0, 30.0]
    assert index_to_world([[(0, 0, 0)], [(0, 1, 0)]], matrix).shape == (2, 1, 3)


def test_voxel_has_the_edges_and_the_volume_of_its_scale() -> None:
    matrix = rotated(0.7, scale=(-0.1, 0.2, 0.05))
    assert np.allclose(voxel_size(matrix), [0.1, 0.2, 0.05])
    assert voxel_volume(matrix) == pytest.approx(0.001)


def test_sheared_voxel_keeps_its_volume() -> None:
    matrix = np.eye(4)
    matrix[1, 0] = 1.0
    assert voxel_volume(matrix) == pytest.approx(1.0)
    assert np.allclose(voxel_size(matrix), [1.0, np.sqrt(2.0), 1.0])


def test_only_scales_mirrors_and_quarter_turns_are_axis_aligned() -> None:
    quarter = np.eye(4)
    quarter[:3, :3] = [[0, 2, 0], [-1, 0, 0], [0, 0, 1]]
    assert is_axis_aligned(uniform(0.3, (1, 2, 3)))
    assert is_axis_aligned(np.diag([-1.0, 2.0, 3.0, 1.0]))
    assert is_axis_aligned(quarter)
    assert not is_axis_aligned(rotated(0.01))
    flat = np.eye(4)
    flat[1, :3] = (1, 0, 0)  # two axes along x
    assert not is_axis_aligned(flat)


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

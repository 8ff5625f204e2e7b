"""Blending two versions of a frame: weights, unions of boxes, mass, emission, bits that stay."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from usdsmoke.base.errors import ShapeError
from usdsmoke.base.volume import DenseField
from usdsmoke.vdb.blend import blend_frames, relative_difference, tail_weights


def field(
    values: np.ndarray, ijk_min: tuple[int, int, int] = (0, 0, 0), background: float = 0.0
) -> DenseField:
    """A grid "density" or, with three numbers a voxel, "emission"."""
    is_colour = values.ndim == 4
    return DenseField(
        "emission" if is_colour else "density",
        values.astype(np.float32),
        ijk_min,
        np.diag([0.5, 0.5, 0.5, 1.0]),
        (0.0, 0.0, 0.0) if is_colour else background,
    )


def random_field(seed: int) -> DenseField:
    random = np.random.default_rng(seed)
    shape = tuple(random.integers(1, 4, 3))
    first, second, third = random.integers(-2, 3, 3).tolist()
    return field(random.random(shape), (first, second, third))


def at(values: DenseField, ijk: tuple[int, int, int]) -> np.ndarray:
    """One voxel, of the background where the box does not reach."""
    place = np.subtract(ijk, values.ijk_min)
    if not values.is_empty and (place >= 0).all() and (place < values.values.shape[:3]).all():
        return np.asarray(values.values[tuple(place)], float)
    return np.asarray(values.background, float)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 8])
def test_weights_fall_most_in_the_middle_and_neither_window_ever_has_all(n: int) -> None:
    weights = np.array([1.0, *tail_weights(n), 0.0])
    steps = -np.diff(weights)
    assert (steps > 0).all() and (weights[1:-1] < 1).all()
    if n > 1:  # one frame has an end on either side
        middle = int(steps.argmax())
        assert 0 < middle < n
        assert (np.diff(steps[: middle + 1]) > 0).all() and (np.diff(steps[middle:]) < 0).all()
    place = (n + 1) ** -1.2
    np.testing.assert_allclose(steps[0], 3 * place**2 - 2 * place**3)


def test_without_an_overlap_there_are_no_weights() -> None:
    assert tail_weights(0) == []


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 10**6), st.floats(0, 1))
def test_every_voxel_is_the_weighted_mean_of_both_versions(
    one: int, other: int, weight: float
) -> None:
    tail, head = random_field(one), random_field(other)
    (blended,) = blend_frames([tail], [head], weight)
    for ijk in np.ndindex(8, 8, 8):
        place = (ijk[0] - 3, ijk[1] - 3, ijk[2] - 3)
        wanted = weight * at(tail, place) + (1 - weight) * at(head, place)
        assert at(blended, place) == pytest.approx(float(wanted), rel=1e-6, abs=1e-15)


def test_the_box_is_the_union_also_of_boxes_that_do_not_touch() -> None:
    tail, head = field(np.ones((2, 3, 1)), (-7, 0, 2)), field(np.ones((1, 1, 4)), (5, 1, 9))
    (blended,) = blend_frames([tail], [head], 0.25)
    assert blended.ijk_min == (-7, 0, 2) and blended.values.shape == (13, 3, 11)
    assert blended.values[:2, :, 0].tolist() == np.full((2, 3), 0.25).tolist()
    assert blended.values[12, 1, 7:].tolist() == [0.75] * 4


@given(st.integers(0, 10**6), st.floats(0, 1))
def test_mass_is_the_blend_of_both_masses(seed: int, weight: float) -> None:
    tail, head = random_field(seed), random_field(seed + 1)
    (blended,) = blend_frames([tail], [head], weight)
    masses = [np.sum(item.values, dtype=float) for item in (tail, head, blended)]
    assert masses[2] == pytest.approx(weight * masses[0] + (1 - weight) * masses[1], rel=1e-6)


@given(st.integers(0, 10**6), st.floats(0, 1))
def test_equal_versions_keep_their_bits(seed: int, weight: float) -> None:
    only = random_field(seed)
    (blended,) = blend_frames([only], [only], weight)
    assert blended.values.tobytes() == only.values.tobytes()
    assert blended.ijk_min == only.ijk_min
    assert relative_difference(only, only) == 0.0


def test_a_background_that_is_not_zero_fills_the_boxes() -> None:
    tail = field(np.full((1, 1, 1), 3.0), (0, 0, 0), background=1.0)
    head = field(np.full((1, 1, 1), 5.0), (2, 0, 0), background=1.0)
    (blended,) = blend_frames([tail], [head], 0.5)
    assert blended.values[:, 0, 0].tolist() == [2.0, 1.0, 3.0]


def test_emission_is_blended_like_density_and_only_where_smoke_is() -> None:
    tail = [field(np.ones((1, 1, 2))), field(np.full((1, 1, 2, 3), 4.0))]
    head = [field(np.zeros((1, 1, 3))), field(np.full((1, 1, 3, 3), 8.0))]
    density, emission = blend_frames(tail, head, 0.25)
    assert density.values[0, 0].tolist() == [0.25, 0.25, 0.0]
    assert emission.values[0, 0, :, 0].tolist() == [7.0, 7.0, 0.0]


def test_emission_beyond_the_densitys_box_goes_away() -> None:
    density, wide = field(np.ones((1, 1, 1)), (3, 0, 0)), field(np.ones((5, 1, 1, 3)), (1, 0, 0))
    _, emission = blend_frames([density, wide], [density, wide], 0.5)
    assert emission.values[:, 0, 0, 0].tolist() == [0, 0, 1, 0, 0]


def test_an_empty_version_takes_its_share_and_two_empty_ones_stay_empty() -> None:
    full, none = field(np.ones((2, 2, 2))), field(np.zeros((0, 0, 0)))
    (blended,) = blend_frames([none], [full], 0.75)
    assert (blended.values == 0.25).all() and blended.values.shape == (2, 2, 2)
    assert relative_difference(none, full) == 2.0
    (empty,) = blend_frames([none], [none], 0.5)
    assert empty.is_empty
    assert relative_difference(none, none) == 0.0


def test_the_difference_is_relative_to_the_mean_of_both_norms() -> None:
    tail, head = field(np.full((2, 2, 2), 3.0)), field(np.full((2, 2, 2), 1.0))
    assert relative_difference(tail, head) == pytest.approx(1.0)
    assert relative_difference(head, tail) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "change",
    [{"name": "v"}, {"index_to_world": np.eye(4)}, {"background": 1.0},
     {"values": np.ones((2, 2, 2, 3), np.float32)}],
    ids=["name", "transform", "background", "components"],
)  # fmt: skip
def test_versions_of_different_grids_are_refused(change: dict[str, object]) -> None:
    head = field(np.ones((2, 2, 2)))
    with pytest.raises(ShapeError, match="transform"):
        blend_frames([dataclasses.replace(head, **change)], [head], 0.5)  # type: ignore[arg-type]
    with pytest.raises(ShapeError, match="have 1 and 0 grids"):
        blend_frames([head], [], 0.5)

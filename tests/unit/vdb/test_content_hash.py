"""The content hash sees everything that a grid holds, and nothing of how it is stored."""

import dataclasses
import struct
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.fixtures.grids_fixtures import TIGHT, check_content, make_field, make_vectors, rotated
from usdsmoke.vdb.content_hash import CONTENT_KEY, hash_fields, hash_vdb_file
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.write import write_frame

FIELD = make_field()
BASE = hash_fields([FIELD])


def changed(**changes: Any) -> str:
    return hash_fields([dataclasses.replace(FIELD, **changes)])


def test_hash_is_that_of_another_process_and_another_day() -> None:
    """A change here makes every file written before look damaged."""
    values = np.arange(120, dtype=np.float32).reshape(6, 5, 4)
    assert changed(values=values).startswith("d491771a77bba909")


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), min_size=3, max_size=3))
def test_padding_with_background_does_not_count(border: list[tuple[int, int]]) -> None:
    low = tuple(a - b[0] for a, b in zip(FIELD.ijk_min, border, strict=True))
    assert changed(values=np.pad(FIELD.values, border), ijk_min=low) == BASE


def test_order_of_grids_memory_and_the_sign_of_zero_do_not_count() -> None:
    other = make_vectors()
    assert hash_fields([FIELD, other]) == hash_fields([other, FIELD])
    assert changed(values=np.asfortranarray(FIELD.values)) == BASE
    assert changed(values=np.where(FIELD.values == 0, np.float32(-0.0), FIELD.values)) == BASE
    assert changed(metadata={"a": 1}) == BASE


def test_every_part_of_a_grid_counts() -> None:
    one_value = FIELD.values.copy()
    one_value[tuple(np.argwhere(one_value)[0])] *= 1 + 2**-23
    matrix = FIELD.index_to_world.copy()
    matrix[3, 0] += 1e-9
    hashes = {
        BASE,
        changed(name="Density"),
        changed(grid_class="unknown"),
        changed(half=True),
        changed(background=0.5),
        changed(values=one_value),
        changed(ijk_min=(-2, 0, 4)),
        changed(index_to_world=matrix),
        changed(index_to_world=rotated()),
        changed(values=np.repeat(FIELD.values[..., None], 3, -1), background=(0.0, 0.0, 0.0)),
        hash_fields([FIELD, FIELD]),
        hash_fields([]),
    }
    assert len(hashes) == 12


def test_names_cannot_pose_as_their_neighbours() -> None:
    first = changed(name="a", grid_class="bc")
    assert first != changed(name="ab", grid_class="c")


def test_transform_may_differ_by_rounding_only() -> None:
    matrix = np.diag([0.1, 0.2, 0.3, 1.0])
    before = changed(index_to_world=matrix)
    matrix[0, 0] = np.nextafter(matrix[0, 0], 1)
    matrix[1, 2] = -1e-250
    assert changed(index_to_world=matrix) == before
    matrix[1, 2] = 1e-8
    assert changed(index_to_world=matrix) != before


def test_empty_grids_of_one_place_are_equal_whatever_their_box() -> None:
    empty = np.zeros((0, 0, 0), np.float32)
    background = np.zeros((3, 1, 2), np.float32)
    assert changed(values=empty) == changed(values=background) != BASE


def test_file_hashes_like_its_fields_and_a_changed_one_is_found(tmp_path: Path) -> None:
    file_path = tmp_path / "a.vdb"
    fields = [make_field(), make_vectors()]
    content = write_frame(file_path, fields, {}, half=False)
    assert content == hash_fields(fields) == hash_vdb_file(file_path, TIGHT)
    assert read_header(file_path).metadata[CONTENT_KEY] == content
    check_content(file_path)
    packed = file_path.read_bytes()
    map_name = b"UniformScaleTranslateMap"
    place = packed.index(map_name) + len(map_name)  # the translation of density
    file_path.write_bytes(packed[:place] + struct.pack("<d", 1.0) + packed[place + 8 :])
    assert hash_vdb_file(file_path, TIGHT) != content

"""Finding a grid by name and index, refusing what smoke cannot be read from, dense values."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from tests.fixtures.grids_fixtures import (
    TIGHT,
    make_field,
    openvdb,
    raw_grid,
    rotated,
    shared_file,
    write_raw,
)
from usdsmoke.base.errors import (
    AssetNotResolved,
    GridNotFound,
    GridTooLarge,
    NonFiniteError,
    UnsupportedGrid,
)
from usdsmoke.vdb.header import FileHeader, GridHeader, read_header
from usdsmoke.vdb.read import (
    GridRequest,
    check_readable,
    find_grid,
    read_binding_version,
    read_grids,
)
from usdsmoke.vdb.write import write_frame

WHERE = "field </shot/plume/density>, timeCode 42"


def header_of(*names: str) -> FileHeader:
    grids = tuple(
        GridHeader(name, names[:place].count(name), name, "float")
        for place, name in enumerate(names)
    )
    return FileHeader("/show/smoke.0042.vdb", 224, (11, 0), "", {}, grids)


@pytest.mark.parametrize(
    ("names", "name", "index", "position"),
    [
        (("temperature", "density"), "density", None, 1),
        (("temperature", "density"), "density", 0, 1),
        (("density",), "density", 3, 0),  # an index tells grids of one name apart, nothing else
        (("density", "a", "density"), "density", None, 0),
        (("density", "a", "density"), "density", 1, 2),
        (("", "a", ""), "", 1, 2),
        (("a", "b"), "", 1, 1),
        (("a",), "", None, 0),
    ],
)
def test_grid_is_found_by_name_then_index(
    names: tuple[str, ...], name: str, index: int | None, position: int
) -> None:
    header = header_of(*names)
    assert find_grid(header, GridRequest(name, index)) is header.grids[position]


@pytest.mark.parametrize(
    ("names", "name", "index", "asked"),
    [
        (("a", "vel"), "densty", None, 'grid "densty"'),
        (("a", "vel"), "Density", 0, 'grid "Density" with fieldIndex 0'),
        (("a", "a"), "a", 2, 'grid "a" with fieldIndex 2'),
        (("a", "a"), "a", -1, 'grid "a" with fieldIndex -1'),
        (("a", "vel"), "", None, "grid without a name"),
        ((), "density", None, 'grid "density"'),
    ],
)
def test_grid_not_found_lists_what_the_file_has(
    names: tuple[str, ...], name: str, index: int | None, asked: str
) -> None:
    with pytest.raises(GridNotFound) as caught:
        find_grid(header_of(*names), GridRequest(name, index, WHERE))
    said = str(caught.value)
    assert said.startswith(f"smoke.0042.vdb ({WHERE})") and asked in said
    listed = {("a", "a"): "a[0], a[1]", (): "no grids at all"}.get(names, "a, vel")
    assert f" {listed}." in said


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"value_type": "points"}, "points"),
        ({"value_type": "double"}, "double values.*float"),
        ({"value_type": "int32"}, "int32 values"),
        ({"tree_levels": "4_3"}, "float in a 4_3 tree"),
        ({"grid_class": "level set"}, "level set"),
        ({"index_to_world": None, "transform_type": "NonlinearFrustumMap"}, "not linear"),
        ({"index_to_world": np.diag([1.0, 0.0, 1.0, 1.0])}, "flattens space"),
        ({"value_type": "vec3s"}, "3 components per voxel.* 1"),
    ],
)
def test_grid_that_is_no_smoke_is_refused_from_its_header(changes: dict, words: str) -> None:
    header = header_of("density")
    grid = dataclasses.replace(header.grids[0], **{"index_to_world": np.eye(4), **changes})
    with pytest.raises(UnsupportedGrid, match=words) as caught:
        check_readable(header, grid, GridRequest("density", where=WHERE, components=1))
    assert WHERE in str(caught.value)
    assert "smoke.0042.vdb" in str(caught.value)


def test_houdini_grids_of_one_name_are_told_apart_by_index() -> None:
    """The extents are those that the stage beside the file authors for fieldIndex 0, 1 and 2."""
    file_path = shared_file("arnold-usd/grids.vdb")
    wanted = [GridRequest("density", index) for index in (2, 0, 1)]
    fields = read_grids(file_path, wanted, TIGHT)
    assert [field.index_to_world[3, 0] for field in fields] == [0.0, 4.0, 2.0]
    assert [int((field.values != 0).sum()) for field in fields] == [803, 491, 2222]


def test_half_float_plume_is_read_with_its_place() -> None:
    (field,) = read_grids(shared_file("cortex/smoke.vdb"), [GridRequest("density")], TIGHT)
    assert field.values.shape == (111, 222, 112)
    assert field.values.dtype == np.float32
    assert field.values.flags.c_contiguous
    assert field.ijk_min == (1, 2, 1)
    assert field.half
    assert int((field.values != 0).sum()) == 1_049_275
    assert field.values.max() == pytest.approx(5.71484, abs=1e-5)  # as vdb_print says
    assert field.metadata == {
        "is_local_space": False,
        "roiMin": (0, 0, 0),
        "roiMax": (112, 224, 113),
        "vector_type": "invariant",
    }


def test_level_set_file_is_refused_before_openvdb_opens_it() -> None:
    with pytest.raises(UnsupportedGrid, match=r'"ls_sphere".*level set'):
        read_grids(shared_file("cortex/sphere.vdb"), [GridRequest("ls_sphere")], TIGHT)


def test_values_background_and_box_are_those_openvdb_holds(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(size=(3, 4, 5)).astype(np.float32)  # negative ones too
    file_path = write_raw(tmp_path / "a.vdb", raw_grid(values, ijk=(-7, 0, 12), matrix=rotated()))
    (field,) = read_grids(file_path, [GridRequest("density")], TIGHT)
    assert np.array_equal(field.values, values)
    assert field.ijk_min == (-7, 0, 12)
    assert np.allclose(field.index_to_world, rotated(), rtol=0, atol=1e-15)


@pytest.mark.parametrize("place", [(5, 1, 1), (-3, -2, 1), (1, 1, 12), (0, -8, 0)])
def test_inactive_voxels_beside_the_box_are_told(tmp_path: Path, place: tuple[int, int, int]):
    grid = raw_grid(np.ones((5, 5, 5), np.float32))
    (inside,) = read_grids(write_raw(tmp_path / "a.vdb", grid), [GridRequest("density")], TIGHT)
    grid.getAccessor().setValueOff(place, -0.75)
    (field,) = read_grids(write_raw(tmp_path / "b.vdb", grid), [GridRequest("density")], TIGHT)
    assert (inside.beside, field.beside) == (0.0, 0.75)
    assert np.array_equal(field.values, inside.values)


def test_active_tile_is_filled_and_background_shows_between(tmp_path: Path) -> None:
    grid = openvdb().FloatGrid(0.5)
    grid.fill((0, 0, 0), (7, 7, 7), 2.0)
    grid.fill((16, 0, 0), (16, 0, 0), 3.0)
    grid.name = "density"
    (field,) = read_grids(write_raw(tmp_path / "a.vdb", grid), [GridRequest("density")], TIGHT)
    assert field.values.shape == (17, 8, 8)
    assert (field.values[:8] == 2.0).all()
    assert field.values[16, 0, 0] == 3.0
    assert (field.values[8:16] == 0.5).all()
    assert field.background == 0.5
    assert field.grid_class == "unknown"


def test_grids_of_other_types_in_the_file_are_left_alone(tmp_path: Path) -> None:
    """With an int32 grid beside it, the bindings refuse to read the whole file, but not by name."""
    file_path = tmp_path / "a.vdb"
    write_frame(file_path, [make_field("density"), make_field("flags", seed=1)], {}, half=False)
    packed = file_path.read_bytes()
    place = packed.rindex(b"Tree_float_5_4_3")
    assert packed.rindex(b"flags", 0, place) > 0
    changed = packed[:place] + b"Tree_int32_5_4_3" + packed[place + 16 :]
    file_path.write_bytes(changed)
    assert [grid.value_type for grid in read_header(file_path).grids] == ["float", "int32"]
    (field,) = read_grids(file_path, [GridRequest("density")], TIGHT)
    assert np.array_equal(field.values, make_field("density").values)
    with pytest.raises(UnsupportedGrid, match="int32"):
        read_grids(file_path, [GridRequest("flags")], TIGHT)


def test_nan_and_infinite_voxels_are_counted_and_placed(tmp_path: Path) -> None:
    values = np.ones((3, 3, 3), np.float32)
    values[1, 2, 0], values[2, 0, 0] = np.nan, np.inf
    file_path = write_raw(tmp_path / "a.vdb", raw_grid(values, ijk=(10, 0, 0)))
    with pytest.raises(NonFiniteError, match=r"2 NaN") as caught:
        read_grids(file_path, [GridRequest("density", where=WHERE)], TIGHT)
    for part in ("[11, 2, 0]", WHERE, "a.vdb", "--repair nan=0"):
        assert part in str(caught.value)
    repaired = TIGHT.replace(repair_nan=0.25)
    (field,) = read_grids(file_path, [GridRequest("density")], repaired)
    assert field.values[1, 2, 0] == field.values[2, 0, 0] == 0.25
    assert int((field.values == 1.0).sum()) == 25
    assert field.repaired == 2


@pytest.mark.parametrize("first", [2_000_000_000, -(2**31) + 8])
def test_indices_at_the_end_of_32_bits_are_refused_before_openvdb_crashes(
    tmp_path: Path, first: int
) -> None:
    file_path = write_raw(tmp_path / "a.vdb", raw_grid(np.ones((2, 2, 2)), ijk=(first, 0, 0)))
    with pytest.raises(UnsupportedGrid, match=str(abs(first))):
        read_grids(file_path, [GridRequest("density")], TIGHT)


def test_background_that_is_not_finite_is_refused(tmp_path: Path) -> None:
    grid = openvdb().FloatGrid(float("inf"))
    grid.fill((0, 0, 0), (1, 0, 0), 2.0)
    grid.name = "density"
    file_path = write_raw(tmp_path / "a.vdb", grid)
    with pytest.raises(NonFiniteError, match="background"):
        read_grids(file_path, [GridRequest("density")], TIGHT)


def test_empty_grids_have_no_box_but_their_place(tmp_path: Path) -> None:
    binding = openvdb()
    number, vector = binding.FloatGrid(), binding.Vec3SGrid()
    number.name, vector.name = "density", "vel"
    file_path = write_raw(tmp_path / "a.vdb", number, vector)
    fields = read_grids(file_path, [GridRequest("density"), GridRequest("vel")], TIGHT)
    assert [field.values.shape for field in fields] == [(0, 0, 0), (0, 0, 0, 3)]
    assert all(field.is_empty and field.ijk_min == (0, 0, 0) for field in fields)


def test_box_that_does_not_fit_is_refused_with_the_number(tmp_path: Path) -> None:
    """Two voxels, ten thousand apart along every axis: 4 TB as a dense array."""
    grid = openvdb().FloatGrid()
    accessor = grid.getAccessor()
    accessor.setValueOn((0, 0, 0), 1.0)
    accessor.setValueOn((9999, 9999, 9999), 1.0)
    grid.name = "density"
    file_path = write_raw(tmp_path / "a.vdb", grid)
    with pytest.raises(GridTooLarge, match=r"10000 x 10000 x 10000 voxels, 3725\.3 GiB") as caught:
        read_grids(file_path, [GridRequest("density")], TIGHT)
    assert "grids.memory_limit_gib" in str(caught.value)
    # A box that the header does not tell is found out by the reading process.
    file_path.write_bytes(file_path.read_bytes().replace(b"file_bbox_max", b"file_bbox_MAX"))
    assert read_header(file_path).grids[0].box_shape is None
    with pytest.raises(GridTooLarge, match="10000 x 10000 x 10000"):
        read_grids(file_path, [GridRequest("density")], TIGHT)


def test_nothing_wanted_opens_nothing(tmp_path: Path) -> None:
    assert read_grids(tmp_path / "none.vdb", [], TIGHT) == []


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(AssetNotResolved, match=r"none\.vdb"):
        read_grids(tmp_path / "none.vdb", [GridRequest("density")], TIGHT)


def test_bindings_tell_their_version() -> None:
    binding = openvdb()
    numbers = ".".join(map(str, binding.LIBRARY_VERSION))
    assert read_binding_version(TIGHT) == f"{binding.__name__} {numbers}"

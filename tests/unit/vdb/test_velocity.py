"""Velocities under their usual names, put together and brought to voxel centres."""

from pathlib import Path

import numpy as np
import pytest

from tests.fixtures.grids_fixtures import TIGHT, make_field, make_vectors, uniform
from usdsmoke.base.errors import UnsupportedGrid
from usdsmoke.base.volume import DenseField
from usdsmoke.vdb.header import FileHeader, GridHeader, read_header
from usdsmoke.vdb.velocity import (
    centre_staggered,
    find_velocity,
    join_components,
    read_velocity,
)
from usdsmoke.vdb.write import write_frame


def header_of(**grids: str) -> FileHeader:
    found = tuple(
        GridHeader(name.replace("__", "."), 0, name, kind) for name, kind in grids.items()
    )
    return FileHeader("smoke.vdb", 224, (11, 0), "", {}, found)


@pytest.mark.parametrize(
    ("header", "name", "found"),
    [
        (header_of(density="float", vel="vec3s"), "", ["vel"]),
        (header_of(v="vec3s", velocity="vec3s"), "", ["v"]),
        (
            header_of(vel__z="float", vel__x="float", vel__y="float"),
            "",
            ["vel.x", "vel.y", "vel.z"],
        ),
        (
            header_of(velocity_x="float", velocity_y="float", velocity_z="float"),
            "",
            ["velocity_x", "velocity_y", "velocity_z"],
        ),
        (header_of(v="float", vel="vec3d"), "", []),  # a colour's value; a type nobody reads
        (header_of(vel_x="float", vel_y="float"), "", []),
        (header_of(wind="vec3s", vel="vec3s"), "wind", ["wind"]),
        (header_of(wind__x="float", wind__y="float", wind__z="float"), "wind", None),
        (header_of(vel="vec3s"), "wind", []),
    ],
)
def test_velocity_is_found_by_name(header: FileHeader, name: str, found: list[str] | None) -> None:
    names = [grid.name for grid in find_velocity(header, name)]
    assert names == (["wind.x", "wind.y", "wind.z"] if found is None else found)


def test_staggered_components_are_averaged_to_the_centres() -> None:
    """u is linear along each axis, u(face i) = i: at the centre of voxel i it is i + 1/2."""
    shape = (4, 3, 2)
    faces = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    field = DenseField(
        "vel", faces.astype(np.float32), (0, 0, 0), uniform(), (0.0, 0.0, 0.0), "staggered"
    )
    centred = centre_staggered(field)
    assert np.array_equal(centred.values[:-1, :-1, :-1], faces[:-1, :-1, :-1] + 0.5)
    # Beyond the box is the background: the last voxel gets half of its lower face.
    assert centred.values[3, 0, 0, 0] == 1.5
    assert centred.values[0, 2, 0, 1] == 1.0
    assert centred.grid_class != "staggered"


def test_centred_velocity_is_left_as_it_is() -> None:
    field = make_vectors("vel")
    assert centre_staggered(field) is field


def test_three_grids_are_joined_on_the_box_that_holds_them() -> None:
    parts = [
        make_field(f"vel.{axis}", (2, 2, 2), ijk, seed, background=float(seed))
        for seed, (axis, ijk) in enumerate(
            {"x": (0, 0, 0), "y": (1, 0, 0), "z": (0, 0, -3)}.items()
        )
    ]
    joined = join_components(parts, "a test")
    assert joined.name == "vel"
    assert joined.ijk_min == (0, 0, -3)
    assert joined.values.shape == (3, 2, 5, 3)
    assert joined.background == (0.0, 1.0, 2.0)
    assert np.array_equal(joined.values[:2, :, 3:, 0], parts[0].values)
    assert np.array_equal(joined.values[1:, :, 3:, 1], parts[1].values)
    assert np.array_equal(joined.values[:2, :, :2, 2], parts[2].values)
    assert (joined.values[2, ..., 0] == 0.0).all()
    assert (joined.values[0, ..., 1] == 1.0).all()


def test_empty_components_count_as_background() -> None:
    empty = DenseField("vel_y", np.zeros((0, 0, 0), np.float32), (0, 0, 0), uniform())
    full = make_field("vel_x", (2, 2, 2), (5, 5, 5))
    joined = join_components([full, empty, empty], "a test")
    assert joined.ijk_min == (5, 5, 5)
    assert np.array_equal(joined.values[..., 0], full.values)
    assert not joined.values[..., 1:].any()
    assert join_components([empty] * 3, "a test").is_empty


def test_components_on_different_voxels_are_refused() -> None:
    parts = [make_field(f"vel.{axis}") for axis in "xy"]
    moved = make_field("vel.z", index_to_world=uniform(0.1, (0.05, 0.0, 0.0)))
    with pytest.raises(UnsupportedGrid, match=r'"vel.x" and "vel.z" .*different transforms'):
        join_components([*parts, moved], "smoke.vdb")


def test_velocity_is_read_from_vectors_and_from_three_grids(tmp_path: Path) -> None:
    vectors = make_vectors("vel", grid_class="staggered")
    parts = [make_field(f"wind_{axis}", seed=n) for n, axis in enumerate("xyz")]
    file_path = tmp_path / "a.vdb"
    write_frame(file_path, [make_field(), vectors, *parts], {}, half=False)
    header = read_header(file_path)
    found = read_velocity(file_path, find_velocity(header), TIGHT)
    assert np.array_equal(found.values, centre_staggered(vectors).values)
    wind = read_velocity(file_path, find_velocity(header, "wind"), TIGHT)
    assert wind.name == "wind"
    assert np.array_equal(wind.values, np.stack([part.values for part in parts], axis=-1))
    with pytest.raises(UnsupportedGrid, match=r"1 component per voxel.* 3"):
        read_velocity(file_path, find_velocity(header, "density"), TIGHT)


def test_file_without_velocity_has_none(tmp_path: Path) -> None:
    write_frame(tmp_path / "a.vdb", [make_field()], {}, half=False)
    assert find_velocity(read_header(tmp_path / "a.vdb")) == ()

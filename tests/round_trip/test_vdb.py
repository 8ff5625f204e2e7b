"""VDB -> arrays -> VDB: what goes in comes out, and programs that are not ours read it too."""

import dataclasses
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from tests.fixtures.grids_fixtures import (
    TIGHT,
    make_field,
    make_vectors,
    openvdb,
    rotated,
    shared_file,
    uniform,
)
from usdsmoke.base.volume import DenseField
from usdsmoke.vdb.boxes import crop_to_active
from usdsmoke.vdb.content_hash import CONTENT_KEY, hash_fields
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.read import GridRequest, read_grids
from usdsmoke.vdb.write import write_frame


def again(folder: Path, *fields: DenseField, half: bool = False) -> list[DenseField]:
    """The fields after a way through one file, whose writing and reading takes three processes."""
    file_path = folder / "again.vdb"
    write_frame(file_path, fields, {}, half, TIGHT)
    return read_grids(file_path, [GridRequest(field.name) for field in fields], TIGHT)


def as_half(numbers: Any) -> np.ndarray:
    return np.asarray(numbers, np.float32).astype(np.float16).astype(np.float32)


def check_same(found: DenseField, wanted: DenseField) -> None:
    """Bit for bit, apart from a border of background."""
    wanted = crop_to_active(wanted)
    assert found.name == wanted.name
    assert found.ijk_min == wanted.ijk_min
    assert np.array_equal(found.values, wanted.values)
    assert found.background == wanted.background
    assert found.grid_class == wanted.grid_class
    assert found.half == wanted.half
    assert np.array_equal(found.index_to_world, wanted.index_to_world)


mirrored = np.diag([-0.1, 0.1, 0.1, 1.0])
flattened = np.diag([0.1, 0.2, 0.05, 1.0])
sheared = uniform(0.25, (1.0, 2.0, 3.0))
sheared[1, 0] = 0.125
far = uniform(1 / 2.1, (-3.4e7, 1.3e7 / 3, 0.1))

MATRICES = {
    "identity": np.eye(4),
    "uniform": uniform(0.1, (1.1, -2.2, 1e-3)),
    "mirrored": mirrored,
    "anisotropic": flattened,
    "anisotropic and moved": rotated(0.0),
    "rotated": rotated(0.3),
    "sheared": sheared,
    "far from the origin": far,
}


def test_transform_survives_bit_for_bit(tmp_path: Path) -> None:
    fields = [make_field(name, index_to_world=matrix) for name, matrix in MATRICES.items()]
    for found, field in zip(again(tmp_path, *fields), fields, strict=True):
        check_same(found, field)


def test_values_background_class_and_box_survive(tmp_path: Path) -> None:
    fields = [
        make_field("background", grid_class="unknown", background=0.75),
        make_field("far box", ijk_min=(-1_000_000, 0, 2_000_000)),
        make_field("one voxel thick", shape=(1, 9, 30)),
        make_field("Dichte é [2]"),
        make_vectors("vectors", background=(0.5, -1.0, 2.0)),
        make_vectors("vel", grid_class="staggered"),
    ]
    for found, field in zip(again(tmp_path, *fields), fields, strict=True):
        check_same(found, field)


def test_crumbs_of_rounding_in_the_transform_are_swept_away(tmp_path: Path) -> None:
    field = make_field(index_to_world=rotated(np.pi / 2, (0.1, 0.1, 0.1)))
    assert field.index_to_world[0, 0] == pytest.approx(6e-18, abs=1e-18)
    (found,) = again(tmp_path, field)
    assert np.count_nonzero(found.index_to_world[:3, :3]) == 3
    assert np.allclose(found.index_to_world, field.index_to_world, rtol=0, atol=1e-16)
    assert read_header(tmp_path / "again.vdb").metadata[CONTENT_KEY] == hash_fields([found])


def test_half_floats_lose_rounding_only(tmp_path: Path) -> None:
    fields = []
    for field in (make_field(), make_vectors()):
        powers = np.random.default_rng(2).integers(-6, 4, field.values.shape)
        values = (field.values * 10.0**powers).astype(np.float32)
        fields.append(dataclasses.replace(field, values=values))
    for found, field in zip(again(tmp_path, *fields, half=True), fields, strict=True):
        rounded = dataclasses.replace(field, values=as_half(field.values), half=True)
        check_same(found, rounded)
        error = np.abs(as_half(field.values) - field.values)
        assert (error <= np.maximum(2.0**-11 * field.values, 2.0**-25)).all()


def test_metadata_of_file_and_grid_survives(tmp_path: Path) -> None:
    grid_metadata = {"index": 2, "note": "é", "is_local_space": False, "roiMax": (1, 2, 3)}
    field = make_field(metadata={**grid_metadata, "file_bbox_min": (9, 9, 9), "class": "level set"})
    file_metadata = {"creator": "a test", "usdsmoke:run": "1", "scale": 0.1, "on": True}
    file_path = tmp_path / "a.vdb"
    content = write_frame(file_path, [field], file_metadata, half=False)
    assert read_header(file_path).metadata == {**file_metadata, CONTENT_KEY: content}
    (found,) = read_grids(file_path, [GridRequest("density")], TIGHT)
    assert found.metadata == {**grid_metadata, "vector_type": "invariant"}
    assert found.grid_class == "fog volume"
    assert again(tmp_path, found)[0].metadata == found.metadata


@st.composite
def fields(draw: st.DrawFn) -> DenseField:
    return make_field(
        shape=draw(st.tuples(*[st.integers(1, 12)] * 3)),
        ijk_min=draw(st.tuples(*[st.integers(-(2**20), 2**20)] * 3)),
        seed=draw(st.integers(0, 2**20)),
        background=draw(st.sampled_from([0.0, 1.0, -0.5])),
        index_to_world=rotated(draw(st.floats(0.001, 3.0))),
    )


# Every example starts three processes, so there are few, and a failing one is not made smaller.
@settings(max_examples=4, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(st.lists(fields(), min_size=5, max_size=10))
def test_any_field_survives(
    tmp_path_factory: pytest.TempPathFactory, drawn: list[DenseField]
) -> None:
    named = [dataclasses.replace(field, name=f"grid {n}") for n, field in enumerate(drawn)]
    filled = [field for field in named if not crop_to_active(field).is_empty]
    read = again(tmp_path_factory.mktemp("any"), *filled)
    for found, field in zip(read, filled, strict=True):
        check_same(found, field)


@pytest.mark.parametrize(
    ("name", "grid"),
    [("cortex/smoke.vdb", "density"), ("openimageio/sphereCd.vdb", "Cd")],
)
def test_files_of_houdini_survive(tmp_path: Path, name: str, grid: str) -> None:
    (source,) = read_grids(shared_file(name), [GridRequest(grid)], TIGHT)
    (found,) = again(tmp_path, source, half=source.half)
    check_same(found, source)
    assert found.metadata == source.metadata
    assert hash_fields([found]) == hash_fields([source])


def test_equal_fields_give_equal_hashes_in_different_files(tmp_path: Path) -> None:
    fields = [make_field(), make_vectors()]
    first = write_frame(tmp_path / "a.vdb", fields, {}, half=True)
    second = write_frame(tmp_path / "b.vdb", fields[::-1], {}, half=True)
    assert first == second
    assert (tmp_path / "a.vdb").read_bytes() != (tmp_path / "b.vdb").read_bytes()


def test_voxels_equal_to_the_background_are_inactive(tmp_path: Path) -> None:
    field = make_field(background=0.5)
    again(tmp_path, field)
    (header,) = read_header(tmp_path / "again.vdb").grids
    assert header.active_voxels == int((field.values != 0.5).sum()) < field.values.size
    grid = openvdb().read(str(tmp_path / "again.vdb"), "density")
    assert grid.activeVoxelCount() == header.active_voxels
    assert grid.getConstAccessor().getValue((999, 0, 0)) == 0.5


def test_vdb_print_reads_what_we_wrote(tmp_path: Path) -> None:
    """An independent reader; it comes with Debian's and Ubuntu's libopenvdb-tools."""
    if shutil.which("vdb_print") is None:
        pytest.skip("needs vdb_print of libopenvdb-tools")
    density = make_field(index_to_world=uniform(0.25, (1.0, -2.0, 0.5)))
    emission = make_vectors(index_to_world=density.index_to_world)
    file_path = tmp_path / "smoke.0001.vdb"
    write_frame(file_path, [density, emission], {"creator": "usdsmoke"}, half=True)
    said = subprocess.run(
        ["vdb_print", "-l", str(file_path)], capture_output=True, text=True, check=True
    ).stdout
    assert "ERROR" not in said
    assert "creator: usdsmoke" in said
    first, second = re.split(r"^Name: ", said, flags=re.MULTILINE)[1:]
    assert first.startswith("density\n")
    assert "Tree_float_5_4_3" in first
    assert second.startswith("emission\n")
    assert "Tree_vec3s_5_4_3" in second
    n_active = int((as_half(density.values) != 0).sum())
    assert re.search(rf"Number of active voxels: +{n_active}\n", first)
    assert "Bounding box of active voxels: [-2, 0, 3] -> [3, 4, 6]" in first
    assert f"Max value: {as_half(density.values).max():.6g}" in first
    assert "class: fog volume" in first
    assert "is_saved_as_half_float: true" in first
    assert "voxel size: 0.25" in first
    assert "[1, -2, 0.5, 1]" in first

"""Frames: which velocity belongs to a density, and in which units it arrives."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.fixtures.grids_fixtures import make_field, raw_grid, uniform, write_raw
from tests.fixtures.usd_fixtures import (
    density_prim,
    sampled,
    volume_prim,
    world,
    write_text,
    write_vdb,
)
from usdsmoke.base.errors import GridNotFound, UnsupportedGrid
from usdsmoke.base.volume import FrameSource, VolumeSource
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.planning.frame_reader import read_frame, read_velocity_grids
from usdsmoke.planning.frames import (
    VelocitySource,
    find_density,
    find_frame_velocity,
    is_split,
)
from usdsmoke.usd.stage import find_volumes, open_stage
from usdsmoke.vdb.header import FileHeader, read_header


def only_frame(stage: Path, config: Config) -> tuple[VolumeSource, FrameSource]:
    (volume,) = find_volumes(open_stage(stage), config.stage).volumes
    return volume, volume.frames[0]


def headers_of(frame: FrameSource) -> dict[str, FileHeader]:
    return {field.file_path: read_header(field.file_path) for field in frame.fields.values()}


def velocity_of(stage: Path, config: Config) -> VelocitySource | None:
    volume, frame = only_frame(stage, config)
    return find_frame_velocity(volume, frame, headers_of(frame), config)


def make_stage(folder: Path, *names: str, velocity_file: str = "") -> Path:
    """A Volume whose density file has these grids, and whose velocity may have a field prim."""
    write_vdb(folder / "smoke.vdb", ("density", *names), value=2.0)
    body, relations = density_prim("asset filePath = @./smoke.vdb@"), None
    if velocity_file:
        write_vdb(folder / velocity_file, ("vel",), value=3.0)
        prim = density_prim(
            f"asset filePath = @./{velocity_file}@", "vel", grid='token fieldName = "vel"'
        )
        body += prim.replace("{", "{\n double3 xformOp:translate = (5, 0, 0)\n "
            'uniform token[] xformOpOrder = ["xformOp:translate"]', 1)  # fmt: skip
        relations = "\n".join(
            f"rel field:{name} = </World/smoke/{name}>" for name in ("density", "vel")
        )
    return write_text(folder / "s.usda", world(volume_prim(body, relations=relations)))


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (("vel",), ["vel"]),
        (("v.x", "v.y", "v.z"), ["v.x", "v.y", "v.z"]),
        (("heat",), None),
    ],
)
def test_velocity_is_found_among_the_grids_of_the_densitys_file(
    tmp_path: Path, names: tuple[str, ...], found: list[str] | None
) -> None:
    velocity = velocity_of(make_stage(tmp_path, *names), Config())
    assert (None if velocity is None else [grid.name for grid in velocity.grids]) == found


def test_a_velocity_field_of_the_volume_comes_before_one_in_the_file(tmp_path: Path) -> None:
    stage = make_stage(tmp_path, "vel", velocity_file="vel.vdb")
    velocity = velocity_of(stage, Config())
    assert velocity is not None and Path(velocity.field.file_path).name == "vel.vdb"
    volume, frame = only_frame(stage, Config())
    read = read_frame(volume, frame, Config(), velocity)
    assert read.velocity is not None and read.velocity_to_stage is not None
    np.testing.assert_array_equal(read.velocity.values, 3.0)
    np.testing.assert_array_equal(read.velocity_to_stage[3], [5, 0, 0, 1])
    np.testing.assert_array_equal(read.density_to_stage, np.eye(4))


@pytest.mark.parametrize(("unit", "expected"), [("second", 2.0), ("frame", 50.0)])
def test_velocity_arrives_per_second_whatever_the_file_holds(
    tmp_path: Path, quick_grids: None, unit: str, expected: float
) -> None:
    config = resolve_config([f"stage.velocity_unit={unit}"])
    stage = make_stage(tmp_path, "vel")
    volume, frame = only_frame(stage, config)
    read = read_frame(volume, frame, config, velocity_of(stage, config), 25.0)
    assert read.velocity is not None
    np.testing.assert_array_equal(read.velocity.values, np.full((4, 3, 2, 3), expected))


def test_three_grids_arrive_as_one_of_vectors(tmp_path: Path, quick_grids: None) -> None:
    grids = [
        raw_grid(np.full((2, 2, 2), number), name=f"vel.{axis}")
        for number, axis in enumerate("xyz", 1)
    ]
    write_raw(tmp_path / "smoke.vdb", raw_grid(np.ones((2, 2, 2))), *grids)
    body = volume_prim(density_prim("asset filePath = @./smoke.vdb@"))
    stage = write_text(tmp_path / "s.usda", world(body))
    volume, frame = only_frame(stage, Config())
    read = read_frame(volume, frame, Config(), velocity_of(stage, Config()))
    assert read.velocity is not None
    np.testing.assert_array_equal(read.velocity.values[0, 1, 0], [1, 2, 3])


def split_velocity(folder: Path, relationships: Sequence[str], grids: Sequence[str]) -> Path:
    """A stage whose velocity is three field prims, all of one file."""
    values = [
        raw_grid(np.full((2, 2, 2), number), name=name) for number, name in enumerate(grids, 1)
    ]
    write_raw(folder / "smoke.vdb", raw_grid(np.ones((2, 2, 2))), *values)
    file_path = "asset filePath = @./smoke.vdb@"
    bodies = [density_prim(file_path)]
    for number, name in enumerate(grids):
        bodies.append(density_prim(file_path, f"part{number}", grid=f'token fieldName = "{name}"'))
    relations = ["rel field:density = </World/smoke/density>"]
    for number, name in enumerate(relationships):
        relations.append(f"rel field:{name} = </World/smoke/part{number}>")
    body = volume_prim("\n".join(bodies), relations="\n".join(relations))
    return write_text(folder / "s.usda", world(body))


@pytest.mark.parametrize(
    ("relationships", "grids"),
    [
        (("velx", "vely", "velz"), ("velx", "vely", "velz")),
        (("vel_x", "vel_y", "vel_z"), ("u", "v", "w")),
        (("vel:x", "vel:y", "vel:z"), ("vel.x", "vel.y", "vel.z")),
    ],
)
def test_three_relationships_show_a_grid_each(
    tmp_path: Path, quick_grids: None, relationships: Sequence[str], grids: Sequence[str]
) -> None:
    stage = split_velocity(tmp_path, relationships, grids)
    velocity, (volume, frame) = velocity_of(stage, Config()), only_frame(stage, Config())
    read = read_frame(volume, frame, Config(), velocity)
    assert read.velocity is not None
    np.testing.assert_array_equal(read.velocity.values[0, 1, 0], [1, 2, 3])


def test_the_whole_of_three_relationships_has_a_name(tmp_path: Path) -> None:
    """By which ``layer.copy_fields`` names it."""
    for number, grids in enumerate((("vel_x", "vel_y", "vel_z"), ("u", "v", "w"))):
        folder = tmp_path / str(number)
        folder.mkdir()
        velocity = velocity_of(split_velocity(folder, ("vel_x", "vel_y", "vel_z"), grids), Config())
        assert velocity is not None and {"vel", *grids} <= velocity.names


@pytest.mark.parametrize("fault", ["missing grid", "gap"])
def test_where_a_component_is_missing_the_usual_grids_of_the_file_are_taken(
    tmp_path: Path, quick_grids: None, fault: str
) -> None:
    names = ("vel_x", "vel_y", "vel_z")
    stage = split_velocity(tmp_path, names, names)
    text = stage.read_text()
    head, part, tail = text.partition('"part2"')
    if fault == "gap":
        tail = tail.replace("asset filePath = @./smoke.vdb@", "asset filePath = None", 1)
    else:
        tail = tail.replace('fieldName = "vel_z"', 'fieldName = "vel_q"', 1)
    stage.write_text(head + part + tail)
    volume, frame = only_frame(stage, Config())
    read = read_frame(volume, frame, Config(), velocity_of(stage, Config()))
    assert read.velocity is not None
    np.testing.assert_array_equal(read.velocity.values[0, 1, 0], [1, 2, 3])


def test_components_in_several_files_are_no_velocity_and_it_is_told(
    tmp_path: Path, quick_grids: None
) -> None:
    names = ("vel_x", "vel_y", "vel_z")
    stage = split_velocity(tmp_path, names, names)
    write_raw(tmp_path / "other.vdb", raw_grid(np.ones((2, 2, 2)), name="vel_z"))
    head, part, tail = stage.read_text().partition('"part2"')
    stage.write_text(head + part + tail.replace("smoke.vdb", "other.vdb", 1))
    write_raw(tmp_path / "smoke.vdb", raw_grid(np.ones((2, 2, 2))))
    assert velocity_of(stage, Config()) is None
    assert is_split(*only_frame(stage, Config()))
    with pytest.raises(GridNotFound, match='"vel"'):
        velocity_of(stage, resolve_config(["stage.velocity=vel"]))


def test_without_a_velocity_source_no_velocity_is_read(tmp_path: Path, quick_grids: None) -> None:
    volume, frame = only_frame(make_stage(tmp_path, "vel"), Config())
    read = read_frame(volume, frame, Config())
    assert read.velocity is None and read.velocity_to_stage is None


def test_the_messages_say_which_field_at_which_timecode(tmp_path: Path) -> None:
    stage = make_stage(tmp_path)
    write_vdb(tmp_path / "smoke.vdb", ("smoke",))
    volume, frame = only_frame(stage, Config())
    with pytest.raises(GridNotFound, match=r"field </World/smoke/density>, timeCode 1\)"):
        find_density(volume, frame, read_header(tmp_path / "smoke.vdb"))


def test_a_velocity_that_was_named_has_to_be_there(tmp_path: Path) -> None:
    config = resolve_config(["stage.velocity=speed"])
    with pytest.raises(GridNotFound, match=r'no velocity "speed".*found: density.*stage\.velocity'):
        velocity_of(make_stage(tmp_path, "vel"), config)


def test_velocity_in_another_place_is_not_copied_beside_the_density(
    tmp_path: Path, quick_grids: None
) -> None:
    stage = make_stage(tmp_path, velocity_file="vel.vdb")
    velocity = velocity_of(stage, Config())
    assert velocity is not None
    _, frame = only_frame(stage, Config())
    with pytest.raises(UnsupportedGrid, match=r"differs.*copy_velocity"):
        read_velocity_grids(velocity, frame.fields["density"], Config())


def test_staggered_velocity_is_copied_as_it_is(tmp_path: Path, quick_grids: None) -> None:
    values = make_field(shape=(3, 3, 3, 3)).values
    vectors = raw_grid(values, name="vel", grid_class="staggered", matrix=uniform(0.5))
    write_raw(tmp_path / "smoke.vdb", raw_grid(np.ones((3, 3, 3))), vectors)
    body = volume_prim(density_prim("asset filePath = @./smoke.vdb@"))
    stage = write_text(tmp_path / "s.usda", world(body))
    velocity = velocity_of(stage, Config())
    assert velocity is not None
    (copied,) = read_velocity_grids(velocity, velocity.field, Config())
    assert copied.grid_class == "staggered"
    np.testing.assert_array_equal(copied.values, values)


@pytest.mark.parametrize("scale", [2.0, 0.5])
@pytest.mark.parametrize(("unit", "rate", "speed"), [
    ("second", 24, 2.0), ("frame", 24, 48.0), ("second", 48, 2.0), ("frame", 48, 48.0),
])  # fmt: skip
def test_a_retimed_reference_slows_the_velocity_down(
    tmp_path: Path, quick_grids: None, scale: float, unit: str, rate: int, speed: float
) -> None:
    """Read and copied, whatever the stage's own number of timeCodes per second is."""
    write_vdb(tmp_path / "smoke.vdb", ("density", "vel"), value=2.0)
    samples = sampled("asset filePath", {1: "@./smoke.vdb@", 2: "@./smoke.vdb@"})
    body = volume_prim(density_prim(samples))
    header = '#usda 1.0\n(\n    defaultPrim = "World"\n    timeCodesPerSecond = {}\n)\n'
    text = world(body)
    write_text(tmp_path / "asset.usda", header.format(24) + text[text.index("def ") :])
    reference = f"(prepend references = @./asset.usda@ (offset = 10; scale = {scale}))"
    stage = write_text(
        tmp_path / "s.usda", header.format(rate) + f'def "World" {reference}\n{{\n}}\n'
    )
    config = resolve_config([f"stage.velocity_unit={unit}"])
    volume, frame = only_frame(stage, config)
    assert [item.time_code for item in volume.frames] == [
        10 + n * scale * rate / 24 for n in (1, 2)
    ]
    velocity = velocity_of(stage, config)
    assert velocity is not None
    read = read_frame(volume, frame, config, velocity, float(rate))
    assert read.velocity is not None
    np.testing.assert_allclose(read.velocity.values, speed / scale)
    (copied,) = read_velocity_grids(velocity, velocity.field, config)
    per_code = 24 / rate if unit == "frame" else 1.0
    np.testing.assert_allclose(copied.values, 2.0 * per_code / scale)

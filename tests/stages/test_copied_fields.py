"""Other fields in the result's files, extents of other frames, and paths as authored."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from pxr import Usd, UsdVol

from tests.fixtures.grids_fixtures import openvdb, raw_grid
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, make_shot, run, values_of
from tests.fixtures.usd_fixtures import (
    density_prim,
    sequence,
    volume_prim,
    world,
    write_text,
    write_vdb,
)
from usdsmoke import verify
from usdsmoke.base.errors import ConfigError
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.pipeline import plan as make_plan
from usdsmoke.usd.rules import Severity, validate
from usdsmoke.vdb.read import GridRequest, read_grids

pytestmark = pytest.mark.usefixtures("core")


def field_prim(name: str, files: str, grid: str, extra: str = "") -> str:
    return density_prim(files, name, extra, f'token fieldName = "{grid}"')


@pytest.fixture
def fire(tmp_path: Path) -> Shot:
    """Density and vel in one file, heat (grid temperature) in another; 4 frames."""
    shot = make_shot(tmp_path / "shot", n_frames=4, names=("density", "vel", "fuel"))
    for code in range(1, 5):
        write_vdb(shot.stage.parent / f"cache/heat.{code:04d}.vdb", ("temperature",), value=code)
    prims = density_prim(sequence(range(1, 5))) + field_prim(
        "heat", sequence(range(1, 5)).replace("smoke.", "heat."), "temperature"
    )
    text = volume_prim(prims).replace(
        "rel field:density", "rel field:heat = </World/smoke/heat>\n        rel field:density", 1
    )
    write_text(shot.stage, world(text))
    return shot


def grids_in(file_path: str | Path) -> set[str]:
    return {grid.name for grid in openvdb().readAllGridMetadata(str(file_path))}


def shown(stage: Usd.Stage, name: str, code: float) -> tuple[str, str]:
    volume = UsdVol.Volume(stage.GetPrimAtPath("/World/smoke"))
    prim = stage.GetPrimAtPath(volume.GetFieldPath(name))
    path, grid = (prim.GetAttribute(item).Get(code) for item in ("filePath", "fieldName"))
    return path.resolvedPath, grid


def test_every_field_and_grid_is_in_one_file_under_the_name_of_its_relationship(
    fire: Shot,
) -> None:
    result = run(fire, "layer.copy_fields=[all]", "stage.frames=2-3")
    assert grids_in(result.frames[0]) == {"density", "emission", "heat", "vel", "fuel"}
    assert np.all(values_of(result.frames[1], "heat") == 3)
    stage = Usd.Stage.Open(str(result.root_stage))
    for code in (2.0, 3.0):
        for name in ("density", "heat", "emission"):
            assert shown(stage, name, code) == (str(result.frames[int(code) - 2]), name)
    heat = fire.stage.parent / "cache/heat.0001.vdb"
    assert shown(stage, "heat", 1.0) == (str(heat), "temperature")  # as in the source
    rules = {finding.rule for finding in validate(Usd.Stage.Open(str(result.root_stage)))}
    assert "GridMissing" not in rules


def test_named_fields_alone_are_copied_and_also_where_windows_are_blended(fire: Shot) -> None:
    windows = ("windows.size=2", "windows.overlap=1")
    result = run(fire, "layer.copy_fields=[heat,fuel]", *windows)
    for code, file_path in enumerate(result.frames, 1):
        assert grids_in(file_path) == {"density", "emission", "heat", "fuel"}
        assert np.all(values_of(file_path, "heat") == code)
    rules = {finding.rule for finding in validate(Usd.Stage.Open(str(result.root_stage)))}
    assert not {"MixedFilesPerVolume", "GridMissing", "FieldNameMismatch"} & rules


def test_an_edited_field_that_was_copied_is_a_changed_source(fire: Shot) -> None:
    result = run(fire, "layer.copy_fields=[all]")
    assert verify(result.look_layer) == []
    later = (2_000_000_000, 2_000_000_000)
    cache = write_vdb(fire.stage.parent / "cache/heat.0002.vdb", ("temperature",), value=9)
    os.utime(cache, later)
    (change,) = verify(result.look_layer)
    assert (change.kind, change.file) == ("input-edited", str(cache))
    assert change.expected.startswith("temperature ")
    (found,) = [item for item in validate(result.root_stage) if item.rule == "LookStale"]
    assert (found.severity, "heat.0002.vdb" in found.message) == (Severity.ERROR, True)
    os.utime(write_vdb(cache, ("temperature",), value=2), later)  # the same grid in other bytes
    assert [item.severity for item in verify(result.look_layer)] == ["note"]


def shifted(fire: Shot, core: FakeCore) -> None:
    """What the core moves goes one voxel along i."""
    voxel = read_grids(
        fire.stage.parent / "cache/heat.0001.vdb", [GridRequest("temperature")], GridsConfig()
    )[0]
    matrix = voxel.index_to_world
    lattice = Lattice(np.array([-4, -4, -4]), (16, 16, 16), matrix)
    step = torch.tensor(matrix[0, :3], dtype=torch.float32).expand(16, 16, 16, 3).contiguous()
    core.moved_by = Displacement(step, lattice)


@pytest.mark.parametrize("windows", [(), ("windows.size=2", "windows.overlap=1")])
def test_copied_fields_move_with_the_density_also_where_windows_are_blended(
    fire: Shot, core: FakeCore, windows: tuple[str, ...]
) -> None:
    shifted(fire, core)
    result = run(fire, "layer.copy_fields=[heat]", *windows)
    for code, file_path in enumerate(result.frames, 1):
        source = read_grids(
            fire.stage.parent / f"cache/heat.{code:04d}.vdb",
            [GridRequest("temperature")],
            GridsConfig(),
        )[0]
        (heat,) = read_grids(file_path, [GridRequest("heat")], GridsConfig())
        assert heat.ijk_min == (source.ijk_min[0] + 1, *source.ijk_min[1:])
        np.testing.assert_allclose(heat.values, source.values, rtol=1e-6)
    assert any("moved with the density: heat" in text for text in result.plan.needed)


def test_copied_fields_stay_where_that_is_asked_for_or_the_density_does(
    fire: Shot, core: FakeCore
) -> None:
    shifted(fire, core)
    still = run(fire, "layer.copy_fields=[heat]", "layer.move_fields=false", "stage.frames=1")
    colour = run(
        replace(fire, output=fire.folder / "colour"), "layer.copy_fields=[heat]",
        "optimize.steps=[colour]", "stage.frames=1",
    )  # fmt: skip
    for result in (still, colour):
        (heat,) = read_grids(result.frames[0], [GridRequest("heat")], GridsConfig())
        assert heat.ijk_min == (0, 0, 0)
        assert any("as they are: heat" in text for text in result.plan.needed)


def test_by_default_nothing_is_copied_and_the_plan_names_the_setting(fire: Shot) -> None:
    (left,) = [
        item for item in make_plan(fire.stage, fire.style, fire.output).omitted
        if item.what == "field heat of </World/smoke>"
    ]  # fmt: skip
    assert "layer.copy_fields" in left.reason
    assert grids_in(run(fire).frames[0]) == {"density", "emission"}


def test_a_field_of_the_name_of_the_look_s_own_is_replaced_and_the_plan_says_so(
    fire: Shot,
) -> None:
    text = fire.stage.read_text().replace("field:heat", "field:emission")
    fire.stage.write_text(text)

    def reason(*settings: str) -> str:
        planned = make_plan(fire.stage, fire.style, fire.output, list(settings))
        (found,) = (item for item in planned.omitted if "emission of" in item.what)
        return found.reason

    assert "layer.copy_fields" not in reason()  # would not help
    assert reason() == reason("layer.copy_fields=[all]")
    with pytest.raises(ConfigError, match="emission"):
        make_plan(fire.stage, fire.style, fire.output, ["layer.copy_fields=[emission]"])


def test_numbers_too_small_for_16_bits_are_refused_like_those_too_large(fire: Shot) -> None:
    half = ("grids.half=true", "layer.copy_fields=[heat]")
    for value, found in ((1e-9, "100%"), (1e9, "65504")):
        write_vdb(fire.stage.parent / "cache/heat.0003.vdb", ("temperature",), value=value)
        with pytest.raises(ConfigError, match=rf"{found}.*layer\.copy_fields"):
            run(fire, *half)
        assert not list(fire.output.rglob("*.vdb"))
    write_vdb(fire.stage.parent / "cache/heat.0003.vdb", ("temperature",), value=1e-4)
    assert len(run(fire, *half).frames) == 4


def test_a_field_that_is_not_there_or_stands_elsewhere_is_refused_by_name(fire: Shot) -> None:
    with pytest.raises(ConfigError, match=r'"heta" of </World/smoke>.*layer.copy_fields'):
        run(fire, "layer.copy_fields=[heta]")
    elsewhere = (
        '"heat"\n        {\n double3 xformOp:translate = (9, 0, 0)\n'
        'uniform token[] xformOpOrder = ["xformOp:translate"]\n'
    )
    text = fire.stage.read_text().replace('"heat"\n        {', elsewhere)
    assert "9, 0, 0" in text
    fire.stage.write_text(text)
    with pytest.raises(ConfigError, match="another place"):
        run(fire, "layer.copy_fields=[heat]")
    result = run(fire, "layer.copy_fields=[all]")
    assert "heat" not in grids_in(result.frames[0])
    assert any("another place" in item.reason for item in result.plan.omitted)


def test_a_field_that_16_bit_floats_cannot_hold_is_refused_before_the_run(
    fire: Shot, core: FakeCore
) -> None:
    write_vdb(fire.stage.parent / "cache/heat.0004.vdb", ("temperature",), value=1e6)
    with pytest.raises(ConfigError, match=r"heat.* reaches 1e\+06.*grids\.half"):
        run(fire, "layer.copy_fields=[heat]", "grids.half=true")
    assert not core.stylized
    assert run(fire, "grids.half=true").frames


@pytest.mark.parametrize("setting", ["layer.compact_velocity=true", "grids.half=true"])
@pytest.mark.parametrize("speed", [7e4, 2e-8])
def test_a_velocity_that_16_bit_floats_cannot_hold_is_refused_before_the_run(
    tmp_path: Path, core: FakeCore, setting: str, speed: float
) -> None:
    shot = make_shot(tmp_path / "shot", n_frames=1)
    wind = raw_grid(np.full((4, 4, 4, 3), speed), "vel", grid_class="unknown")
    file_path = shot.stage.parent / "cache/smoke.0001.vdb"
    openvdb().write(str(file_path), grids=[raw_grid(np.ones((4, 4, 4))), wind])
    with pytest.raises(ConfigError, match="vel"):
        run(shot, "layer.copy_velocity=true", setting)
    assert not core.stylized
    assert run(shot, "layer.copy_velocity=false", setting).frames


@pytest.mark.usefixtures("core")
def test_a_velocity_is_judged_as_a_whole_and_where_it_is_written(tmp_path: Path) -> None:
    """What hardly counts beside another component, or lies far from the smoke, is no reason."""
    shot = make_shot(tmp_path / "shot", n_frames=1)
    file_path = shot.stage.parent / "cache/smoke.0001.vdb"
    speeds = {"vel.x": 1.5, "vel.y": 0.5, "vel.z": 2e-8}
    wind = [
        raw_grid(np.full((4, 4, 4), speed), name, grid_class="unknown")
        for name, speed in speeds.items()
    ]
    openvdb().write(str(file_path), grids=[raw_grid(np.ones((4, 4, 4))), *wind])
    assert run(shot, "layer.copy_velocity=true", "grids.half=true").frames
    far = np.full((24, 4, 4, 3), 0.5)
    far[20:] = 1e5
    grids = [raw_grid(np.ones((4, 4, 4))), raw_grid(far, "vel", grid_class="unknown")]
    openvdb().write(str(file_path), grids=grids)
    compact = ("layer.copy_velocity=true", "layer.compact_velocity=true")
    assert run(replace(shot, output=shot.folder / "compact"), *compact).frames


def test_frames_outside_the_range_have_the_boxes_of_their_files(tmp_path: Path) -> None:
    shot = make_shot(tmp_path / "shot", n_frames=4)
    for code in (3, 4):
        name = shot.stage.parent / f"cache/smoke.{code:04d}.vdb"
        write_vdb(name, ("density",), voxel_size=0.5 * code)
    stage = Usd.Stage.Open(str(run(shot, "stage.frames=1-2").root_stage))
    extent = stage.GetPrimAtPath("/World/smoke").GetAttribute("extent")
    sides = [extent.Get(code)[1][0] for code in (1, 2, 3, 4)]
    # 4 voxels from index 0, each half a voxel around its centre
    assert sides == pytest.approx([1.75, 1.75, 3.5 * 1.5, 3.5 * 2])


def test_a_search_path_outside_the_range_stays_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pxr import Ar

    shot = make_shot(tmp_path / "shot", n_frames=3)
    shot.stage.write_text(shot.stage.read_text().replace("@./cache/", "@cache/"))
    assert "@cache/smoke.0003.vdb@" in shot.stage.read_text()
    context = Ar.DefaultResolverContext([str(shot.stage.parent)])
    with Ar.ResolverContextBinder(context):
        result = run(shot, "stage.frames=1-2")
    text = result.look_layer.read_text()
    assert "@cache/smoke.0003.vdb@" in text and "@./vdb/" in text


def test_a_compact_velocity_is_where_the_smoke_is_and_half_as_large(tmp_path: Path) -> None:
    shot = make_shot(tmp_path / "shot", n_frames=1)
    density = np.zeros((40, 8, 8), np.float32)
    density[30:34, 2:5, 2:5] = 1
    wind = np.full((20, 4, 4, 3), 0.3, np.float32)  # voxels of twice the size
    file_path = shot.stage.parent / "cache/smoke.0001.vdb"
    grids = [openvdb().FloatGrid(), openvdb().Vec3SGrid()]
    for grid, values, name, size in zip(
        grids, (density, wind), ("density", "vel"), (0.5, 1.0), strict=True
    ):
        grid.copyFromArray(values)
        grid.transform = openvdb().createLinearTransform(voxelSize=size)
        grid.name = name
        grid.gridClass = "fog volume" if name == "density" else "unknown"
    openvdb().write(str(file_path), grids=grids)
    settings = ("layer.copy_velocity=true", "optimize.steps=[colour]")
    whole = run(replace(shot, output=shot.folder / "whole"), *settings)
    compact = run(shot, *settings, "layer.compact_velocity=true")
    (vel,) = read_grids(compact.frames[0], [GridRequest("vel")], GridsConfig())
    (as_it_is,) = read_grids(whole.frames[0], [GridRequest("vel")], GridsConfig())
    assert vel.half and not as_it_is.half
    assert as_it_is.values.shape[:3] == (20, 4, 4)
    assert vel.ijk_min[0] == 15 - 2 and vel.ijk_min[0] + vel.values.shape[0] == 17 + 2
    np.testing.assert_allclose(vel.values, 0.3, rtol=1e-3)
    (smoke,) = read_grids(compact.frames[0], [GridRequest("density")], GridsConfig())
    assert not smoke.half


@pytest.mark.parametrize(
    "fields", [("[vel,heat]",), ("[vel]", "layer.copy_velocity=true"), ("[all]",)]
)
def test_a_velocity_that_is_named_among_other_fields_is_a_velocity(
    fire: Shot, fields: tuple[str, ...]
) -> None:
    """It has no relationship, so that only its grid's name can be given."""
    named, *more = fields
    settings = (f"layer.copy_fields={named}", *more, "layer.compact_velocity=true")
    result = run(fire, *settings, "stage.frames=1", "layer.contact_sheet=0")
    (vel,) = read_grids(result.frames[0], [GridRequest("vel")], GridsConfig())
    assert vel.half
    assert not any("copy of vel" in item.what for item in result.plan.omitted)
    assert ("heat" in grids_in(result.frames[0])) == (named != "[vel]")

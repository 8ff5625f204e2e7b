"""A stage made from bare VDB files: fields, time samples, extents, and what is refused."""

import shlex
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdVol

from tests.fixtures.grids_fixtures import make_field, raw_grid, uniform, write_raw
from tests.fixtures.usd_fixtures import (
    density_prim,
    needs_usd,
    volume_prim,
    world,
    write_sequence,
    write_text,
    write_vdb,
)
from usdsmoke import inspect
from usdsmoke.base.errors import AssetNotResolved, ConfigError, LayerError, StageError
from usdsmoke.config.run_sections import StageConfig
from usdsmoke.ui.cli.main import main
from usdsmoke.ui.cli.text import source_stage_text
from usdsmoke.usd.rules import validate
from usdsmoke.usd.source_stage import write_source_stage
from usdsmoke.usd.stage import find_volumes, open_stage
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.write import write_frame


def make(folder, codes=(8, 9, 10), pattern="plume.####.vdb", **options):
    for code in codes:
        write_vdb(folder / f"cache/plume.{code:04d}.vdb", ("density", "vel"))
    return write_source_stage(str(folder / "cache" / pattern), folder / "a.usda", 0.01, **options)


@pytest.mark.parametrize("pattern", ["plume.####.vdb", "plume.$F4.vdb", "plume.%04d.vdb"])
def test_a_sequence_can_be_stylized_as_it_is(tmp_path, pattern):
    made = make(tmp_path, pattern=pattern, up_axis="Z", frames_per_second=25)
    assert (made.time_codes, made.fields) == ((8, 9, 10), ("density", "vel"))
    stage = open_stage(made.file)
    source = find_volumes(stage, StageConfig())
    (volume,) = source.volumes
    assert [frame.time_code for frame in volume.frames] == [8, 9, 10]
    assert volume.density == "density" and volume.velocity == ("vel",)
    assert (source.up_axis, source.meters_per_unit) == ("Z", 0.01)
    assert (source.time_codes_per_second, source.start_time_code) == (25, 8)
    layer_text = made.file.read_text()
    assert "@./cache/plume.0009.vdb@" in layer_text


def test_the_extent_encloses_whole_voxels(tmp_path):
    made = make(tmp_path)
    stage = Usd.Stage.Open(str(made.file))
    extent = UsdVol.Volume(stage.GetPrimAtPath(made.prim_path)).GetExtentAttr().Get(9)
    # 4 x 3 x 2 voxels of edge 0.5, centres at whole multiples
    assert np.allclose(extent, [(-0.25, -0.25, -0.25), (1.75, 1.25, 0.75)])
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01


def test_the_extent_holds_what_is_shown_between_two_files(tmp_path):
    """USD interpolates extents, and holds files."""
    for code in (8, 9, 10):
        field = make_field(ijk_min=(100 * code, 0, 0), index_to_world=uniform(1.0))
        (tmp_path / "cache").mkdir(exist_ok=True)
        write_frame(tmp_path / f"cache/plume.{code:04d}.vdb", [field], {}, half=False)
    made = write_source_stage(str(tmp_path / "cache/plume.####.vdb"), tmp_path / "a.usda", 0.01)
    stage = Usd.Stage.Open(str(made.file))
    volume = UsdVol.Volume(stage.GetPrimAtPath(made.prim_path))
    shown = [corner[0] for corner in read_header(tmp_path / "cache/plume.0008.vdb").grids[0].extent]
    for code in (8, 8.25, 8.5, 8.99):
        low, high = volume.GetExtentAttr().Get(code)
        assert low[0] <= shown[0] and shown[1] <= high[0]
    low, high = volume.GetExtentAttr().Get(10)
    assert low[0] > shown[1]


@needs_usd(26, 5)
def test_nothing_is_wrong_with_it(tmp_path):
    assert validate(make(tmp_path).file) == []


def test_a_surface_is_named(tmp_path):
    smoke = make(tmp_path)
    assert smoke.level_sets == () and "no field can be a density" not in source_stage_text(smoke)
    surface = raw_grid(np.ones((3, 3, 3)), "surface", grid_class="level set")
    write_raw(tmp_path / "ball.vdb", surface)
    made = write_source_stage(str(tmp_path / "ball.vdb"), tmp_path / "b.usda", 1)
    assert made.level_sets == ("surface",)
    assert "surface is a level set" in source_stage_text(made)
    assert "no field can be a density" in source_stage_text(made)


def test_a_pattern_that_the_shell_expands_is_answered(tmp_path, capsys):
    words = [str(tmp_path / f"a.{code}.vdb") for code in (1, 2, 3)]
    with pytest.raises(SystemExit):
        main(["stage", *words, "-o", str(tmp_path / "a.usda"), "--meters-per-unit", "1"])
    assert "in quotes: 'plume.####.vdb'" in capsys.readouterr().err


def test_a_missing_file_is_named(tmp_path):
    assert "no file between" not in source_stage_text(make(tmp_path))
    write_vdb(tmp_path / "cache/plume.0012.vdb", ("density", "vel"))
    made = write_source_stage(str(tmp_path / "cache/plume.####.vdb"), tmp_path / "b.usda", 1.0)
    assert "no file between 10 and 12" in source_stage_text(made)


def test_a_single_file_has_no_time(tmp_path):
    write_vdb(tmp_path / "puff.vdb", ("density",))
    made = write_source_stage(str(tmp_path / "puff.vdb"), tmp_path / "a.usdc", 1.0)
    assert made.time_codes == ()
    (volume,) = find_volumes(open_stage(made.file), StageConfig()).volumes
    assert not volume.animated


def test_what_cannot_be_made_is_refused_and_nothing_is_written(tmp_path):
    write_vdb(tmp_path / "a.1.vdb")
    (tmp_path / "a.01.vdb").write_bytes((tmp_path / "a.1.vdb").read_bytes())
    for pattern, error, text in (
        ("b.##.vdb", AssetNotResolved, "no file matches"),
        ("b.vdb", AssetNotResolved, "there is no file"),
        ("a.#.vdb", ConfigError, "both frame 1"),
        ("#.#.vdb", ConfigError, "2 frame numbers"),
    ):
        with pytest.raises(error, match=text):
            write_source_stage(str(tmp_path / pattern), tmp_path / "out.usda", 1.0)
    for options, text in (((0.0,), "above 0"), ((1.0, "X"), "Y or Z"), ((1.0, "Y", -1), "above 0")):
        with pytest.raises(ConfigError, match=text):
            write_source_stage(str(tmp_path / "a.1.vdb"), tmp_path / "out.usda", *options)
    assert not (tmp_path / "out.usda").exists()
    (tmp_path / "out.usda").write_text("mine")
    with pytest.raises(LayerError, match="exists already"):
        write_source_stage(str(tmp_path / "a.1.vdb"), tmp_path / "out.usda", 1.0)


def test_the_command_leads_from_a_file_to_a_plan(tmp_path, capsys):
    write_vdb(tmp_path / "puff.vdb")
    assert main(["inspect", str(tmp_path / "puff.vdb")]) == 1
    assert f"usdsmoke stage {tmp_path / 'puff.vdb'} -o" in capsys.readouterr().err
    write_vdb(tmp_path / "puff.0001.vdb")
    assert main(["inspect", str(tmp_path / "puff.0001.vdb")]) == 1
    assert f"usdsmoke stage '{tmp_path / 'puff.####.vdb'}' -o" in capsys.readouterr().err
    assert main(["inspect", str(tmp_path / "puff.%04d.vdb")]) == 1
    assert f"usdsmoke stage {tmp_path / 'puff.%04d.vdb'} -o" in capsys.readouterr().err
    stage_file = tmp_path / "puff.usda"
    command = ["stage", str(tmp_path / "puff.vdb"), "-o", str(stage_file)]
    assert main([*command, "--meters-per-unit", "1"]) == 0
    assert main(["inspect", str(stage_file)]) == 0


def test_the_command_of_a_refused_pattern_works_as_it_is_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_sequence(tmp_path / "in", (1, 2))
    files = density_prim("asset filePath = @./cache/smoke.$F4.vdb@")
    stage = write_text(tmp_path / "in/shot.usda", world(volume_prim(files)))
    with pytest.raises(StageError, match="usdsmoke stage") as refused:
        inspect(stage)
    command = str(refused.value).partition("usdsmoke stage ")[2].partition(". ")[0].rstrip(".")
    monkeypatch.chdir(tmp_path)
    assert main(["stage", *shlex.split(command)]) == 0
    made = Usd.Stage.Open(str(tmp_path / "NEW.usda"))
    assert UsdGeom.GetStageMetersPerUnit(made) == 0.5 and UsdGeom.GetStageUpAxis(made) == "Z"
    assert made.GetEndTimeCode() == 2

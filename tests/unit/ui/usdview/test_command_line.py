"""The command that the menu copies: parsed back by usdsmoke's own parser."""

import dataclasses
import shlex
from pathlib import Path
from typing import Any

import pytest
from pxr import Sdf, Usd, UsdVol

from tests.fixtures.pipeline_fixtures import Shot, run
from tests.fixtures.usd_fixtures import (
    density_prim,
    make_look,
    plume_stage,
    volume_prim,
    world,
    write_text,
    write_vdb,
)
from tests.fixtures.usdview_fixtures import FakeApi, do, open_in_usdview, refusal, two_plumes_stage
from usdsmoke.config.resolve import resolve_config
from usdsmoke.ui.cli.arguments import build_parser
from usdsmoke.ui.cli.options import given_settings
from usdsmoke.usd.layer_record import put_record, read_record
from usdsmoke.usd.look import LookFiles
from usdsmoke.usd.request_values import REQUEST_ATTRIBUTES, STYLE_IMAGES


@pytest.fixture
def two_plumes(tmp_path: Path) -> Path:
    """See ``two_plumes_stage``."""
    return two_plumes_stage(tmp_path)


def parsed(command: str) -> dict[str, object]:
    """The command as the parser of ``usdsmoke`` takes it."""
    program, *arguments = shlex.split(command)
    assert program == "usdsmoke"
    return vars(build_parser().parse_args(arguments))


def test_the_command_is_quoted_and_names_stage_volumes_and_frames(two_plumes: Path) -> None:
    api, _ = open_in_usdview(two_plumes, time_code=2.5)
    window = do("copy_all", api)
    command = parsed(window.copied[0])
    assert command["stage"] == str(two_plumes) and " " in two_plumes.name
    assert command["prim"] == ["/World/a", "/World/b"] and command["frames"] == "1-4"
    assert command["output"] == str(two_plumes.parent / "two plumes_look")
    assert command["style"] == ["STYLE.png"]
    ((_, text),) = window.texts
    assert "replace STYLE.png" in text


@pytest.mark.parametrize(
    ("time_code", "frames"), [(2.5, "1,2"), (3.0, "2,3"), (0.0, "1"), (None, "1")]
)
def test_this_frame_is_the_one_that_each_volume_holds(
    two_plumes: Path, time_code: float | None, frames: str
) -> None:
    api, _ = open_in_usdview(two_plumes, time_code=time_code)
    assert parsed(do("copy_frame", api).copied[0])["frames"] == frames


def test_smoke_that_is_not_animated_needs_no_frames(tmp_path: Path) -> None:
    write_vdb(tmp_path / "still.vdb")
    body = volume_prim(density_prim("asset filePath = @./still.vdb@"))
    (tmp_path / "still_look").mkdir()
    api, _ = open_in_usdview(write_text(tmp_path / "still.usda", world(body)))
    command = parsed(do("copy_frame", api).copied[0])
    assert command["frames"] is None
    assert command["output"] == str(tmp_path / "still_look_2")


def change_record(look_layer: Path, **values: Any) -> None:
    """Change values in the record of a look layer."""
    layer = Sdf.Layer.FindOrOpen(str(look_layer))
    put_record(layer, dataclasses.replace(read_record(layer), **values))
    layer.Save()


@pytest.fixture
def result(tmp_path: Path) -> LookFiles:
    """The look of a plume, made with settings of its own, as its layer alone tells."""
    files = make_look(plume_stage(tmp_path), tmp_path / "out")
    given = ["windows.size=3", "stage.frames=1-2", "style.weights=[3, 1]"]
    config = resolve_config(given).model_dump()
    change_record(files.look_layer, settings=config)
    return files


STYLES = ("../a b.png", "../c.png")


def test_the_command_of_a_look_stylizes_its_source_with_its_styles_and_settings(
    result: LookFiles, tmp_path: Path
) -> None:
    styles = [str(write_text(tmp_path / name, "")) for name in ("a b.png", "c.png")]
    change_record(result.look_layer, style_request=STYLES)
    api, _ = open_in_usdview(result.root_stage, "/World/smoke/density")
    window = do("copy_all", api)
    command = parsed(window.copied[0])
    assert command["stage"] == str(tmp_path / "shot.usda")
    assert command["style"] == styles
    assert command["set"] == ["windows.size=3", "style.weights=[3.0, 1.0]"]
    assert resolve_config(command["set"]).style.weights == [3, 1]
    assert command["frames"] == "1-4"
    assert window.texts == []


def test_what_is_no_longer_where_it_was_is_noted(result: LookFiles) -> None:
    change_record(result.look_layer, stage="../gone.usda")
    api, _ = open_in_usdview(result.root_stage)
    window = do("copy_all", api)
    assert parsed(window.copied[0])["stage"] == str(result.root_stage)
    assert "a look" in window.texts[0][1]
    assert "style image" in window.texts[0][1]


def test_edits_that_the_command_cannot_see_are_noted(two_plumes: Path) -> None:
    api, _ = open_in_usdview(two_plumes)
    UsdVol.Volume(api.stage.GetPrimAtPath("/World/a")).GetPrim().SetMetadata("comment", "edited")
    assert (
        "unsaved edits are not in the command's stage: two plumes.usda"
        in (do("copy_all", api).texts[0][1])
    )


def test_a_stage_without_a_file_cannot_be_named_in_a_command(two_plumes: Path) -> None:
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().subLayerPaths = [str(two_plumes)]
    api = FakeApi(stage, [], Usd.TimeCode(1))
    assert "file" in refusal("copy_all", api)


def test_volumes_that_name_their_images_themselves_get_no_others(tmp_path: Path) -> None:
    write_text(tmp_path / "own.png", "")
    stage_file = plume_stage(tmp_path)
    text = stage_file.read_text().replace(
        'def Volume "smoke"',
        'def Volume "smoke" (prepend apiSchemas = ["UsdSmokeStyleAPI"])',
    )
    images = f"asset[] {STYLE_IMAGES} = [@./own.png@]\n        rel field"
    write_text(stage_file, text.replace("rel field", images))
    api, _ = open_in_usdview(stage_file)
    window = do("copy_all", api)
    assert parsed(window.copied[0])["style"] is None and window.texts == []


@pytest.mark.usefixtures("core")
def test_the_command_of_a_finished_run_asks_for_the_same_run_again(shot: Shot) -> None:
    result = run(shot, "windows.size=2", "optimize.seed=5", "stage.frames=1-2")
    assert result.root_stage is not None
    api, _ = open_in_usdview(result.root_stage, "/World/smoke")
    window = do("copy_all", api)
    arguments = build_parser().parse_args(shlex.split(window.copied[0])[1:])
    assert window.texts == []
    assert (arguments.stage, arguments.style) == (str(shot.stage), [str(shot.style)])
    asked = resolve_config(*given_settings(arguments))
    made = result.plan.config
    named = made.stage.replace(prims=["/World/smoke"], frames="1-3")
    assert asked == made.replace(stage=named)


def test_what_a_volume_asks_for_itself_is_given_only_if_it_was_given_for_the_run(
    result: LookFiles, tmp_path: Path
) -> None:
    api, _ = open_in_usdview(result.root_stage)
    volume = api.stage.GetPrimAtPath("/World/smoke")
    volume.AddAppliedSchema("UsdSmokeStyleAPI")
    (row,) = (row for row in REQUEST_ATTRIBUTES if row.setting == "optimize.seed")
    volume.CreateAttribute(row.name, Sdf.ValueTypeNames.Int64).Set(8)
    config = resolve_config(["optimize.seed=5", "windows.size=3"]).model_dump()
    change_record(result.look_layer, settings=config, style_request=STYLES)
    assert parsed(do("copy_all", api).copied[0])["set"] == ["windows.size=3"]
    change_record(result.look_layer, explicit=("optimize.seed", "grids.half"))
    settings = parsed(do("copy_all", api).copied[0])["set"]
    assert settings == ["grids.half=false", "windows.size=3", "optimize.seed=5"]


def test_a_parameter_file_is_named_where_it_is(result: LookFiles) -> None:
    given = ["features.vgg19_file=../in/weights.pth"]
    config = resolve_config(given).model_dump()
    change_record(result.look_layer, settings=config, style_request=STYLES)
    api, _ = open_in_usdview(result.root_stage)
    place = result.look_layer.parent.parent / "in/weights.pth"
    assert parsed(do("copy_all", api).copied[0])["set"] == [f'features.vgg19_file="{place}"']

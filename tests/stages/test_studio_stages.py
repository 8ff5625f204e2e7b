"""What a studio's stages do besides holding smoke."""

import json
from pathlib import Path

import pytest
from pxr import Usd

from tests.fixtures.pipeline_fixtures import Shot, make_shot, make_style, run
from tests.fixtures.usd_fixtures import (
    density_prim,
    sampled,
    sequence,
    volume_prim,
    world,
    write_sequence,
    write_text,
    write_vdb,
)
from usdsmoke import inspect, preview
from usdsmoke.base.errors import GridError, StageError, VolumeNotFound
from usdsmoke.pipeline import plan as make_plan
from usdsmoke.ui.cli.main import main
from usdsmoke.usd.rules import validate

MOVED = (
    'double3 xformOp:translate = (0, 9, 0)\nuniform token[] xformOpOrder = ["xformOp:translate"]'
)


def shot_of(folder: Path, body: str) -> Shot:
    write_sequence(folder / "in", (1, 2))
    stage = write_text(folder / "in/shot.usda", world(body))
    return Shot(folder, stage, make_style(folder / "in/style.png"), folder / "out")


def smoke(name: str, extra: str = "") -> str:
    return volume_prim(extra + density_prim(sequence((1, 2))), name)


def test_a_field_prim_that_stands_elsewhere_is_named_in_plan_inspect_and_validate(
    tmp_path: Path,
) -> None:
    body = volume_prim("", relations="rel field:density = </World/caches/density>")
    caches = f'def Xform "caches" {{ {MOVED}\n{density_prim(sequence((1, 2)))} }}'
    shot = shot_of(tmp_path, body + caches)
    *_, note = make_plan(shot.stage, shot.style, shot.output).notes
    assert "</World/caches/density> stands elsewhere than its Volume </World/smoke>" in note
    assert any("stands elsewhere" in item for item in inspect(shot.stage)["notes"])
    drawn = preview(shot.stage, tmp_path / "a.png", width=16, frames="1")
    assert any("stands elsewhere" in item for item in drawn.notes)
    found = {finding.rule: finding for finding in validate(shot.stage)}
    assert found["FieldPlaceDiffers"].prim_path == "/World/smoke"
    assert "</World/caches/density>" in found["FieldPlaceDiffers"].message
    beside = shot_of(tmp_path / "beside", body + caches.replace("0, 9, 0", "0, 0, 0"))
    plan = make_plan(beside.stage, beside.style, beside.output)
    assert not any("stands elsewhere" in note for note in plan.notes)
    assert "FieldPlaceDiffers" not in {finding.rule for finding in validate(beside.stage)}


@pytest.mark.parametrize("is_below", [True, False])
def test_a_volume_below_a_point_instancer_is_named(tmp_path: Path, is_below: bool) -> None:
    instancer = """def PointInstancer "many" {
        rel prototypes = </World/%s/smoke>
        int[] protoIndices = [0, 0]
        point3f[] positions = [(0, 0, 0), (5, 0, 0)]
        %s }"""
    volume = smoke("smoke").replace(
        "/World/smoke", "/World/many/smoke" if is_below else "/World/x/smoke"
    )
    where = ("many", volume) if is_below else ("x", "")
    body = "\n" + instancer % where + ("" if is_below else f'\ndef Xform "x" {{ {volume} }}')
    shot = shot_of(tmp_path, body)
    *_, note = make_plan(shot.stage, shot.style, shot.output).notes
    assert "prototype" in note and "PointInstancer </World/many>" in note


@pytest.mark.usefixtures("core")
def test_a_group_names_the_shown_volumes_below_it(tmp_path: Path) -> None:
    body = smoke("one") + smoke("two") + smoke("off", 'token visibility = "invisible"\n')
    group = f'def Xform "fx" {{ {body.replace("/World/", "/World/fx/")} }}'
    shot = shot_of(tmp_path, group + smoke("three"))
    result = run(shot, "stage.prims=[/World/fx]")
    paths = [volume.source.prim_path for volume in result.plan.volumes]
    assert paths == ["/World/fx/one", "/World/fx/two"]
    assert any(item.what == "/World/fx/off" for item in result.plan.omitted) or any(
        "/World/fx/off" in f"{item.what} {item.reason}" for item in result.plan.omitted
    )
    assert len(inspect(shot.stage, ["/World/fx"])["volumes"]) == 2
    with pytest.raises(VolumeNotFound, match=r"it.*</World/three>"):
        make_plan(shot.stage, shot.style, shot.output, {"stage.prims": ["/World/three/density"]})


@pytest.mark.parametrize("fault", ["no field", "no file", "no grid"])
def test_one_bad_volume_among_good_ones_is_left_out_by_naming_the_others(
    tmp_path: Path, fault: str
) -> None:
    bad = {
        "no field": volume_prim("", "bad", ""),
        "no file": volume_prim(density_prim("asset filePath = @./gone.vdb@"), "bad"),
        "no grid": volume_prim(
            density_prim(sequence((1, 2)), grid='token fieldName = "soot"'), "bad"
        ),
    }[fault]
    shot = shot_of(tmp_path, smoke("good") + bad)
    for prims in ([], ["/World"]):  # a group too
        with pytest.raises((StageError, GridError), match=r"World/bad.*--prim /World/good\."):
            make_plan(shot.stage, shot.style, shot.output, {"stage.prims": prims})
    found = make_plan(shot.stage, shot.style, shot.output, {"stage.prims": ["/World/good"]})
    assert found.n_frames == 2
    seen = inspect(shot.stage)
    assert "/World/good" in [volume["prim_path"] for volume in seen["volumes"]]
    told = [item for item in seen["problems"] if "/World/bad" in item]
    assert told and all(item.endswith(".") for item in told) and seen["omitted"] == []


@pytest.mark.usefixtures("core")
def test_one_missing_frame_is_left_out_on_request(tmp_path: Path) -> None:
    shot = make_shot(tmp_path / "shot", n_frames=3)
    (shot.stage.parent / "cache/smoke.0002.vdb").unlink()
    with pytest.raises(StageError, match="--allow-missing"):
        run(shot)
    assert len(run(shot, "stage.allow_missing=true").frames) == 2


def test_points_or_vectors_as_density_are_an_error_of_validate(tmp_path: Path) -> None:
    shot = shot_of(tmp_path, smoke("smoke"))
    for code in (1, 2):
        file_path = shot.stage.parent / f"cache/smoke.{code:04d}.vdb"
        write_vdb(file_path, ("vel",))
    text = shot.stage.read_text().replace('fieldName = "density"', 'fieldName = "vel"')
    write_text(shot.stage, text)
    found = [finding for finding in validate(Usd.Stage.Open(str(shot.stage)))]
    assert "GridUnsupported" in {finding.rule for finding in found}
    problems = inspect(shot.stage)["problems"]
    assert len(problems) == 2 and all('"vel"' in problem for problem in problems)


def test_grids_without_a_relationship_are_named_with_the_setting_that_copies_them(
    tmp_path: Path,
) -> None:
    shot = shot_of(tmp_path, smoke("smoke"))
    assert inspect(shot.stage)["notes"] == []
    for code in (1, 2):
        names = ("density", "vel", "flame")
        write_vdb(shot.stage.parent / f"cache/smoke.{code:04d}.vdb", names)
    (note,) = inspect(shot.stage)["notes"]
    assert "flame" in note and "vel" not in note and "layer.copy_fields" in note


def test_a_range_that_starts_below_0_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    codes = (-2, -1, 0, 1)
    files = {code: "@./cache/smoke.0001.vdb@" for code in codes}
    shot = shot_of(tmp_path, volume_prim(density_prim(sampled("asset filePath", files))))
    assert main(["inspect", str(shot.stage), "--frames", "-2-0", "--json"]) == 0
    (volume,) = json.loads(capsys.readouterr().out)["volumes"]
    assert volume["time_codes"] == [-2, -1, 0]


def test_an_offset_that_openusd_refuses_is_told(tmp_path: Path) -> None:
    shot = shot_of(tmp_path, smoke("smoke"))
    root = write_text(
        tmp_path / "in/reversed.usda",
        f"#usda 1.0\n(\nsubLayers = [@./{shot.stage.name}@ (scale = -1)]\n)\n",
    )
    (problem,) = inspect(root)["problems"]
    assert "offset" in problem and shot.stage.name in problem


@pytest.mark.parametrize("arc", ["payload", "references", "subLayers"])
@pytest.mark.parametrize("text", [None, '#usda 1.0\ndef Xform "a" ('])
def test_a_layer_that_cannot_be_opened_is_named_beside_a_good_volume(
    tmp_path: Path, arc: str, text: str | None
) -> None:
    shot = shot_of(tmp_path, smoke("smoke"))
    fine = shot.stage.read_text()
    if text is not None:
        write_text(tmp_path / "in/other.usda", text)
    if arc == "subLayers":
        shot.stage.write_text(fine.replace("(", "(\nsubLayers = [@./other.usda@]\n", 1))
    else:
        shot.stage.write_text(f'{fine}\ndef Xform "fx" (\n{arc} = @./other.usda@\n)\n{{\n}}\n')
    told = inspect(shot.stage)
    assert [volume["prim_path"] for volume in told["volumes"]] == ["/World/smoke"]
    (problem,) = told["problems"]
    assert "the layer ./other.usda" in problem and "cannot be opened" in problem
    assert ("line 2" if text else "no such file") in problem
    (note,) = [
        note
        for note in make_plan(shot.stage, shot.style, shot.output).notes
        if "other.usda" in note
    ]
    assert problem == f"{note}."
    found = {finding.rule for finding in validate(shot.stage)}
    assert "usdValidation:CompositionErrorTest.CompositionError" in found
    assert "VolumeExtentMissing" in found
    shot.stage.write_text(fine)
    assert inspect(shot.stage)["problems"] == []

"""Stylizing what is stylized already: from the original, never one result over another."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdShade, UsdUtils, UsdVol

from tests.fixtures.pipeline_fixtures import Shot, make_shot, run, shown_files, values_of
from tests.fixtures.shot_fixtures import PLUME, make_big_shot
from tests.fixtures.stage_reader import read_stage
from tests.fixtures.usd_fixtures import HEADER, file_hashes, write_text
from usdsmoke.base.errors import LayerError, OutputExists, StageError
from usdsmoke.farm.openjd import submit
from usdsmoke.pipeline import Request, StylizeResult, stylize
from usdsmoke.ui.cli.main import main
from usdsmoke.usd.gate import validate_look
from usdsmoke.usd.stage import open_stage
from usdsmoke.usd.stage.originals import open_source

pytestmark = pytest.mark.usefixtures("core")

RESTYLIZE = "stage.restylize=true"


def again(shot: Shot, stage: Path, *settings: str, **options: Any) -> StylizeResult:
    """The result of a stage in a second folder."""
    return stylize(stage, shot.style, shot.folder / "second", settings=settings, **options)


def over(shot: Shot, *layers: Path, text: str = 'over "World"\n{\n}\n') -> Path:
    """A stage of the user's own with a prim in it, over other layers."""
    paths = ", ".join(f"@{layer}@" for layer in layers)
    header = HEADER.replace("(\n", f"(\n    subLayers = [{paths}]\n", 1)
    return write_text(shot.folder / "users.usda", header + text)


def referencing(shot: Shot, asset: Path) -> Path:
    """A stage of the user's own that references an asset."""
    text = f'def Xform "World" (\n    prepend references = @{asset}@\n)\n{{\n}}\n'
    return write_text(shot.folder / "users.usda", HEADER + text)


STYLIZED: dict[str, Callable[[Shot], Path]] = {
    "root": lambda shot: run(shot).root_stage,
    "asset": lambda shot: run(shot, "layer.mode=reference").root_stage,
    "root over root": lambda shot: again(shot, run(shot).root_stage, RESTYLIZE).root_stage,
    "users stage over the look": lambda shot: over(shot, run(shot).look_layer, shot.stage),
    "users stage over the root": lambda shot: over(shot, run(shot).root_stage),
    "users stage with the asset": lambda shot: referencing(
        shot, run(shot, "layer.mode=reference").root_stage
    ),
}  # type: ignore[dict-item]


@pytest.mark.parametrize("case", STYLIZED)
def test_a_stylized_stage_starts_from_the_original(tmp_path: Path, case: str) -> None:
    shot = make_shot(tmp_path)
    stage = STYLIZED[case](shot)
    before = file_hashes(tmp_path)
    result = stylize(stage, shot.style, shot.folder / "third")
    assert {name: file_hashes(tmp_path)[name] for name in before} == before
    for code, path in enumerate(result.frames, 1):
        np.testing.assert_allclose(values_of(path), (0.5 + code / 8) / 2)  # halved once
    assert any("starts from" in note and "--restylize" in note for note in result.warnings)
    assert list(shown_files(result.root_stage).values()) == [str(path) for path in result.frames]
    told = [item.reason for item in result.plan.omitted if item.what == "earlier look"]
    assert told and str(tmp_path) not in " ".join(told)


@pytest.mark.parametrize("case", ["root", "asset", "root over root"])
def test_the_new_root_stands_on_the_originals_root(tmp_path: Path, case: str) -> None:
    shot = make_shot(tmp_path)
    result = stylize(STYLIZED[case](shot), shot.style, shot.folder / "third")
    assert result.root_stage == shot.folder / "third/shot_look.usda"
    layers = read_stage(result.root_stage)["layers"]
    assert layers == [str(result.root_stage), str(result.look_layer), str(shot.stage)]


def test_the_result_is_the_one_of_the_original_and_replaces_the_earlier_in_its_folder(
    shot: Shot,
) -> None:
    first = run(shot)
    with pytest.raises(OutputExists):
        stylize(first.root_stage, shot.style, shot.output)
    second = stylize(
        first.root_stage, shot.style, shot.output, settings=["optimize.seed=1"], force=True
    )
    assert second.root_stage == first.root_stage
    assert not first.frames[0].exists()
    np.testing.assert_allclose(values_of(second.frames[0]), 0.625 / 2)


def test_restylize_takes_the_stylized_smoke_and_lays_the_new_look_over_the_old(shot: Shot) -> None:
    first = run(shot)
    second = again(shot, first.root_stage, RESTYLIZE)
    for code, path in enumerate(second.frames, 1):
        np.testing.assert_allclose(values_of(path), (0.5 + code / 8) / 4)  # halved twice
    layers = read_stage(second.root_stage)["layers"]
    assert [Path(name).parent.name + "/" + Path(name).name for name in layers] == [
        "second/shot_look_look.usda", "second/look.usda",
        "out/shot_look.usda", "out/look.usda", "in/shot.usda",
    ]  # fmt: skip
    muted = read_stage(second.root_stage, mute=(second.look_layer,))
    assert muted["prims"] == read_stage(first.root_stage)["prims"]
    assert not [item for item in second.plan.omitted if item.what == "earlier look"]
    assert validate_look(second.root_stage) == ([], [])
    third = stylize(second.root_stage, shot.style, shot.folder / "third", settings=[RESTYLIZE])
    assert validate_look(third.root_stage) == ([], [])


def test_a_look_over_a_look_has_a_material_of_its_own(shot: Shot) -> None:
    """That of the first one has other numbers."""
    first = run(shot)
    second = again(shot, first.root_stage, RESTYLIZE, "layer.emission_mode=perDensity")
    bound = []
    for stage in (first.root_stage, second.root_stage):
        opened = Usd.Stage.Open(str(stage))
        prim = opened.GetPrimAtPath("/World/smoke")
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("full")
        bound.append(material.GetPath())
        numbers = [
            shader.GetInput("emissionIsPerDensity").Get()
            for child in material.GetPrim().GetChildren()
            if (shader := UsdShade.Shader(child)).GetInput("emissionIsPerDensity")
        ]
        assert numbers == [float(len(bound) - 1)]
    assert bound[0] != bound[1]


def test_an_earlier_look_that_stays_in_the_users_stage_shows_nowhere(shot: Shot) -> None:
    """The new look has no emission; the earlier one's must not shine through it."""
    first = run(shot)
    for stage in (
        over(shot, first.look_layer, shot.stage),
        referencing(shot, run(shot, "layer.mode=reference", force=True).root_stage),
    ):
        result = again(shot, stage, "optimize.steps=[shape]", force=True)
        opened = Usd.Stage.Open(str(result.root_stage))
        volume = UsdVol.Volume(opened.GetPrimAtPath("/World/smoke"))
        assert not volume.GetPrim().GetRelationship("field:emission").GetTargets()
        assert shown_files(result.root_stage)[1.0] == str(result.frames[0])


def test_what_is_left_out_while_reading_is_left_out_in_memory_alone(shot: Shot) -> None:
    asset = run(shot, "layer.mode=reference").root_stage
    users = referencing(shot, asset)
    before = file_hashes(shot.folder)
    stage, earlier = open_source(users)
    assert earlier.variants == ("/World",)
    assert [Path(name).name for name in earlier.layers] == ["look.usda"]
    assert earlier.fields == {"/World/smoke": ("emission",)}
    shown = stage.GetPrimAtPath("/World/smoke/density").GetAttribute("filePath").Get(1)
    assert Path(shown.resolvedPath).parent.name == "cache"
    dirty = [layer for layer in Sdf.Layer.GetLoadedLayers() if layer.dirty and layer.realPath]
    assert dirty == []
    assert file_hashes(shot.folder) == before
    other = open_stage(users)
    shown = other.GetPrimAtPath("/World/smoke/density").GetAttribute("filePath").Get(1)
    assert Path(shown.resolvedPath).parent.parent.name == "vdb"


def test_a_look_in_one_asset_of_a_shot_is_left_out_there(tmp_path: Path) -> None:
    """The plume's own asset has a look; the shot references it with an offset of 110."""
    big = make_big_shot(tmp_path)
    plume = tmp_path / "in/assets/plume.usda"
    first = stylize(plume, big.style, tmp_path / "plume", settings=["layer.mode=reference"])
    fx = tmp_path / "in/shot/fx.usda"
    fx.write_text(fx.read_text().replace("@../assets/plume.usda@", f"@{first.root_stage}@"))
    stage = open_stage(big.stage)
    shown = stage.GetPrimAtPath("/World/fx/plume/fields/density")
    assert "plume/vdb" in shown.GetAttribute("filePath").Get(111).resolvedPath
    result = stylize(big.stage, big.style, big.output, settings=[f"stage.prims=[{PLUME}]"])
    np.testing.assert_allclose(values_of(result.frames[0]), 0.625 / 2)
    stage = Usd.Stage.Open(str(result.root_stage))
    density = stage.GetPrimAtPath("/World/fx/plume/fields/density")
    files = {
        code: density.GetAttribute("filePath").Get(code).resolvedPath for code in (111, 112, 113)
    }
    assert list(files.values()) == [str(path) for path in result.frames]


def test_a_look_of_the_given_stage_is_not_written_over(shot: Shot) -> None:
    users = over(shot, run(shot).look_layer, shot.stage)
    with pytest.raises(LayerError, match="an input"):
        stylize(users, shot.style, shot.output, force=True)
    side = stylize(users, shot.style, shot.output, settings=["layer.look=ember"])
    np.testing.assert_allclose(values_of(side.frames[0]), 0.625 / 2)


def test_a_flattened_result_is_refused_with_advice_unless_it_is_asked_for(shot: Shot) -> None:
    first = run(shot)
    flat = shot.folder / "flat.usda"
    Usd.Stage.Open(str(first.root_stage)).Flatten().Export(str(flat))
    with pytest.raises(StageError, match=r"</World/smoke>.*--restylize"):
        again(shot, flat)
    assert not (shot.folder / "second").exists()
    np.testing.assert_allclose(values_of(again(shot, flat, RESTYLIZE).frames[0]), 0.625 / 4)


def test_flattened_sublayers_keep_the_record_and_are_refused_the_same_way(shot: Shot) -> None:
    flat = shot.folder / "flat.usda"
    UsdUtils.FlattenLayerStack(Usd.Stage.Open(str(run(shot).root_stage))).Export(str(flat))
    assert "usdsmoke" in Sdf.Layer.FindOrOpen(str(flat)).customLayerData
    with pytest.raises(StageError, match=r"</World/smoke>.*--restylize"):
        again(shot, flat)
    np.testing.assert_allclose(values_of(again(shot, flat, RESTYLIZE).frames[0]), 0.625 / 4)


def test_a_root_whose_look_is_gone_shows_the_source_and_is_stylized_from_it(shot: Shot) -> None:
    result = run(shot)
    result.look_layer.unlink()
    np.testing.assert_allclose(values_of(again(shot, result.root_stage).frames[0]), 0.625 / 2)


def test_a_flattened_result_of_some_frames_is_refused_too(shot: Shot) -> None:
    flat = shot.folder / "flat.usda"
    Usd.Stage.Open(str(run(shot, "stage.frames=2").root_stage)).Flatten().Export(str(flat))
    with pytest.raises(StageError, match=r"smoke\.0002\.vdb"):
        again(shot, flat)
    again(shot, flat, "stage.frames=1,3")


@pytest.mark.parametrize("settings", [[], [RESTYLIZE]])
def test_a_look_layer_alone_is_no_stage_to_stylize(shot: Shot, settings: list[str]) -> None:
    look = run(shot, "layer.mode=layer").look_layer
    with pytest.raises(StageError, match="look layer"):
        again(shot, look, *settings)


def test_a_job_for_a_queue_is_given_the_original(shot: Shot) -> None:
    bundle = submit(Request(run(shot).root_stage, shot.style, shot.folder / "second"))
    assert bundle.parameters["Stage"] == str(shot.stage)
    linked = shot.folder / "link"
    linked.symlink_to(shot.stage.parent, target_is_directory=True)
    bundle = submit(Request(linked / "shot.usda", shot.style, shot.folder / "second"))
    assert bundle.parameters["Stage"] == str(linked / "shot.usda")


def test_the_command_line_says_so(shot: Shot, capsys: pytest.CaptureFixture[str]) -> None:
    result = run(shot)
    second = dataclasses.replace(shot, stage=result.root_stage, output=shot.folder / "second")
    assert main(second.arguments("--dry-run")) == 0
    told = capsys.readouterr().out
    assert (
        "earlier look: shot_look.usda is a result already: this one starts from shot.usda" in told
    )
    assert main(second.arguments("--restylize")) == 0
    assert "shot_look_look.usda" in capsys.readouterr().out

"""A shot of many layers through the whole pipeline: the right prims, files and stacks."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pxr import Usd, UsdVol

from tests.fixtures.pipeline_fixtures import values_of
from tests.fixtures.shot_fixtures import FOG, PLUME, BigShot, make_big_shot
from tests.fixtures.stage_reader import read_stage
from tests.fixtures.usd_fixtures import file_hashes
from usdsmoke.base.errors import OutputExists, StageError
from usdsmoke.farm.openjd import submit
from usdsmoke.pipeline import Request, StylizeResult, assemble, stylize
from usdsmoke.ui.cli.main import main
from usdsmoke.usd.stage import open_stage

pytestmark = pytest.mark.usefixtures("core")

ROOTS = ("/World", "/Caches")


@pytest.fixture
def big(tmp_path: Path) -> BigShot:
    return make_big_shot(tmp_path)


def run(shot: BigShot, *settings: str, **options: Any) -> StylizeResult:
    return stylize(shot.stage, shot.style, shot.output, settings=settings, **options)


def shown(root_stage: Path, volume: str, field: str = "density") -> dict[float | None, str]:
    """Names of files by timeCode; of the default alone where nothing is animated."""
    stage = Usd.Stage.Open(str(root_stage))
    path = UsdVol.Volume(stage.GetPrimAtPath(volume)).GetFieldPath(field)
    attribute = stage.GetPrimAtPath(path).GetAttribute("filePath")
    codes = attribute.GetTimeSamples()
    return {code: attribute.Get(code).resolvedPath for code in codes} or {
        None: attribute.Get().resolvedPath
    }


@pytest.mark.parametrize("mode", ["sublayer", "reference"])
def test_files_of_a_referenced_payload_with_offsets_are_shown_at_the_shots_timecodes(
    big: BigShot, mode: str
) -> None:
    before = file_hashes(big.folder / "in")
    result = run(big, f"layer.mode={mode}")
    assert [path.name for path in result.frames] == [
        "fog.0111.vdb", "smoke.0111.vdb", "smoke.0112.vdb", "smoke.0113.vdb",
    ]  # fmt: skip
    assert result.root_stage is not None
    for field in ("density", "emission"):
        files = shown(result.root_stage, PLUME, field)
        assert files == {
            float(path.name.split(".")[1]): str(path)
            for path in result.frames
            if "smoke" in str(path.name)
        }
        assert shown(result.root_stage, FOG, field) == {None: str(result.frames[0])}
    for number, path in enumerate(result.frames[1:], 1):  # the variant that the shot has chosen
        wide = values_of(big.folder / f"in/assets/cache/wide.{number:04d}.vdb")
        np.testing.assert_allclose(values_of(path), wide / 2)
    assert file_hashes(big.folder / "in") == before


def test_the_look_stands_over_everything_and_muting_it_gives_the_source(big: BigShot) -> None:
    result = run(big)
    source = read_stage(big.stage)
    muted = read_stage(result.root_stage, mute=(result.look_layer,))
    for key in source:
        if key != "layers":
            assert muted[key] == source[key]
    root = read_stage(result.root_stage)
    assert [Path(name).name for name in root["layers"]] == [
        "shot_look.usda", "look.usda", "shot.usda", "fx.usda", "layout.usda",
    ]  # fmt: skip
    stage = open_stage(result.root_stage)
    density = stage.GetPrimAtPath("/World/fx/plume/fields/density")
    stack = [Path(spec.layer.realPath).name for spec in density.GetPrimStack()]
    assert stack == ["look.usda", "plume.usda", "plume_payload.usda"]
    changed = {path for path in root["prims"] if root["prims"][path] != source["prims"].get(path)}
    material = {path for path in changed if path.startswith(f"{PLUME}/look_material")}
    assert material  # the fog has one of its own
    changed -= material
    assert changed == {
        PLUME, "/World/fx/plume/fields/density", "/World/fx/plume/fields/emission",
        FOG, "/Caches/fog", "/Caches/emission",
    }  # fmt: skip


def test_switching_to_original_gives_the_source(big: BigShot) -> None:
    result = run(big, "layer.mode=reference")
    source, asset = read_stage(big.stage), read_stage(result.root_stage, original=ROOTS)
    classes = {"/_class_plume", "/_class_light"}
    assert asset["prims"] == {p: v for p, v in source["prims"].items() if p not in classes}


def test_an_instanced_volume_is_left_out_and_refused_with_advice_when_it_is_named(
    big: BigShot,
) -> None:
    result = run(big)
    (left_out,) = [item for item in result.plan.omitted if "steam" in item.what]
    assert "inside the instance </World/set/steam>" in left_out.reason
    advice = r"tylize its source, </Steam/smoke> in .*steam\.usda, or set instanceable = false"
    with pytest.raises(StageError, match=advice):
        run(big, "stage.prims=[/World/set/steam/smoke]", "layer.look=steam")


def test_looks_made_one_after_another_are_variants_of_one_asset(big: BigShot) -> None:
    first = run(
        big, "layer.mode=reference", "layer.look=ember", "stage.prims=[/World/fx/plume/smoke]"
    )
    second = run(big, "layer.mode=reference", "layer.look=frost", "optimize.seed=1")
    assert first.root_stage == second.root_stage == big.output / "shot_asset.usda"
    assert shown(second.root_stage, PLUME)[111.0] == str(second.frames[1])
    stage = open_stage(second.root_stage)
    stage.SetEditTarget(stage.GetSessionLayer())
    for root in ROOTS:
        looks = stage.GetPrimAtPath(root).GetVariantSet("look")
        assert sorted(looks.GetVariantNames()) == ["ember", "frost", "original"]
        looks.SetVariantSelection("ember")
    ember = {
        code: stage.GetPrimAtPath("/World/fx/plume/fields/density")
        .GetAttribute("filePath")
        .Get(code)
        for code in (111, 112, 113)
    }
    assert [value.resolvedPath for value in ember.values()] == [str(path) for path in first.frames]
    fog = stage.GetPrimAtPath("/Caches/fog").GetAttribute("filePath").Get()
    assert fog.resolvedPath == str(big.folder / "in/assets/cache/fog.vdb")


def test_a_look_replaced_in_another_mode_leaves_the_asset_of_the_others(big: BigShot) -> None:
    run(big, "layer.mode=reference", "layer.look=ember")
    run(big, "layer.mode=reference", "layer.look=frost")
    with pytest.raises(OutputExists):
        run(big, "layer.mode=sublayer", "layer.look=frost", "optimize.seed=1")
    again = run(big, "layer.mode=sublayer", "layer.look=frost", "optimize.seed=1", force=True)
    assert again.root_stage == big.output / "shot_look_frost.usda"
    assert shown(big.output / "shot_asset.usda", PLUME)[111.0] == str(again.frames[1])
    assert assemble(big.output, look="ember", mode="sublayer").root_stage == (
        big.output / "shot_look_ember.usda"
    )


def test_what_an_asset_cannot_hold_is_refused_before_anything_is_written(big: BigShot) -> None:
    text = big.stage.read_text().replace('class "_class_light"', 'def "_class_light"')
    big.stage.write_text(text)
    with pytest.raises(Exception, match=r"asset.* </_class_light>"):
        run(big, "layer.mode=reference")
    assert not big.output.exists()
    run(big)


def test_the_command_line_tells_what_to_open_and_what_to_switch(
    big: BigShot, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [str(big.stage), "--style", str(big.style), "-o", str(big.output)]
    assert main(["stylize", *files, "--mode", "reference", "--look", "ember"]) == 0
    told = capsys.readouterr().out
    assert re.search(rf"open +{re.escape(str(big.output))}/shot_asset.usda", told)
    assert re.search("variant of 'look'.*ember.*original", told)


def test_a_job_for_a_queue_is_assembled_by_look_and_mode(big: BigShot) -> None:
    bundle = submit(
        Request(big.stage, big.style, big.output, ["layer.look=ember", "layer.mode=reference"])
    )
    template = yaml.safe_load(bundle.template.read_text())
    run_action = template["steps"][-1]["script"]["actions"]["onRun"]
    assert run_action["args"] == [
        "assemble", "{{Param.Output}}", "--look", "ember", "--mode", "reference",
    ]  # fmt: skip

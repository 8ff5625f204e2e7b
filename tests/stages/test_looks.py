"""Several looks in one output folder, and the ways in which a look is put on the stage."""

import dataclasses
import json
import random
from pathlib import Path

import pytest
from pxr import Sdf, Usd

from tests.fixtures.farm_fixtures import WINDOWS
from tests.fixtures.pipeline_fixtures import (
    FakeCore,
    Shot,
    contents,
    copied,
    make_shot,
    run,
    run_until,
    shown_files,
    values_of,
)
from tests.fixtures.usd_fixtures import file_hashes
from usdsmoke.base.errors import ConfigError, LayerError, OutputExists
from usdsmoke.base.naming import DEFAULT_LOOK
from usdsmoke.config.run_sections import LayerConfig
from usdsmoke.pipeline import Request, assemble, run_window
from usdsmoke.ui.cli.main import main
from usdsmoke.usd.look import look_files
from usdsmoke.usd.stage import find_volumes, open_stage

pytestmark = pytest.mark.usefixtures("core")


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.is_file())


def test_the_default_look_is_the_one_whose_files_are_named_after_none() -> None:
    assert LayerConfig().look == DEFAULT_LOOK


def test_looks_of_two_names_stand_side_by_side_each_with_its_own_files(shot: Shot) -> None:
    plain = run(shot)
    before = file_hashes(shot.output)
    ember = run(shot, "layer.look=ember", "optimize.seed=1")
    after = file_hashes(shot.output)
    assert {name: after[name] for name in before} == before
    assert names(shot.output) == [
        "contact_sheet.png", "look.glslfx", "look.usda", "look_ember.glslfx", "look_ember.usda",
        "look_ember_contact_sheet.png", "shot_look.usda", "shot_look_ember.usda",
    ]  # fmt: skip
    assert ember.contact_sheets == (shot.output / "look_ember_contact_sheet.png",)
    for result, share in ((plain, 1.0), (ember, 2.0)):
        files = shown_files(result.root_stage)
        assert list(files.values()) == [str(path) for path in result.frames]
        assert values_of(files[1.0], "emission")[..., 0].max() == pytest.approx(0.3125 * share)


def test_replacing_a_look_leaves_the_others_alone(shot: Shot) -> None:
    ember = run(shot, "layer.look=ember")
    run(shot)
    before = file_hashes(ember.frames[0].parent), ember.look_layer.read_bytes()
    with pytest.raises(OutputExists, match="already holds"):
        run(shot, "optimize.seed=1")
    run(shot, "optimize.seed=1", force=True)
    assert (file_hashes(ember.frames[0].parent), ember.look_layer.read_bytes()) == before
    assert len(list(shot.output.glob("vdb/*"))) == 2
    contents(ember.root_stage)


def test_windows_of_two_looks_are_assembled_by_name(farm: Shot) -> None:
    for settings in (WINDOWS, [*WINDOWS, "layer.look=ember"]):
        for window in (2, 0, 1):
            run_window(Request(farm.stage, farm.style, farm.output, settings), window)
    with pytest.raises(LayerError, match=r"stylized.*--look"):
        assemble(farm.output)
    ember = assemble(farm.output, look="ember")
    assert ember.root_stage == farm.output / "shot_look_ember.usda"
    assert assemble(farm.output).root_stage == farm.output / "shot_look.usda"  # the one unfinished
    with pytest.raises(LayerError, match="look frost"):
        assemble(farm.output, look="frost")
    assert contents(ember.root_stage) == contents(farm.output / "shot_look.usda")


def test_the_mode_layer_writes_the_look_and_no_stage(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(shot.arguments("--mode", "layer", "--json")) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["root_stage"] is None
    assert names(shot.output) == ["contact_sheet.png", "look.glslfx", "look.usda"]
    assert main(["assemble", str(shot.output)]) == 0
    assert f"subLayers = [@{shot.output}/look.usda@" in capsys.readouterr().out
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.subLayerPaths = [told["look_layer"], str(shot.stage)]
    stage = Usd.Stage.Open(layer)
    density = stage.GetPrimAtPath("/World/smoke/density")
    assert density.GetAttribute("filePath").Get(2).resolvedPath == told["frames"][1]


def test_another_mode_is_assembled_from_the_same_frames(shot: Shot, core: FakeCore) -> None:
    result = run(shot, "layer.mode=layer")
    core.stylized.clear()
    before = [path.stat().st_mtime_ns for path in result.frames]
    again = assemble(shot.output, mode="sublayer")
    assert again.root_stage == shot.output / "shot_look.usda"
    assert list(shown_files(again.root_stage).values()) == [str(path) for path in result.frames]
    assert core.stylized == []
    assert [path.stat().st_mtime_ns for path in again.frames] == before
    assert assemble(shot.output).root_stage == again.root_stage  # the folder remembers the mode
    with pytest.raises(OutputExists, match="'usdsmoke assemble'"):
        run(shot, "layer.mode=reference")
    with pytest.raises(ConfigError, match="sublayer, reference, layer"):
        assemble(shot.output, mode="usdz")


@pytest.mark.parametrize("name", ["original", "2nd", "a-b", "", "a b"])
def test_a_name_that_no_variant_can_have_is_refused(shot: Shot, name: str) -> None:
    with pytest.raises(ConfigError, match=r"layer\.look is .*letters, digits and _"):
        run(shot, f'layer.look="{name}"')


def test_files_are_known_by_mode_and_look_before_anything_is_written(shot: Shot) -> None:
    stage = open_stage(shot.stage)
    source = find_volumes(stage, run(shot).plan.config.stage)
    found = {
        (mode, look): look_files(
            source.file_path, Path("/o"), LayerConfig(mode=mode, look=look)
        ).root_stage
        for mode in ("sublayer", "layer")
        for look in ("stylized", "ember")
    }
    assert found == {
        ("sublayer", "stylized"): Path("/o/shot_look.usda"),
        ("sublayer", "ember"): Path("/o/shot_look_ember.usda"),
        ("layer", "stylized"): None,
        ("layer", "ember"): None,
    }


def test_a_name_that_differs_from_another_in_case_alone_is_refused(shot: Shot) -> None:
    run(shot, "layer.look=ember")
    with pytest.raises(LayerError, match=r"'ember',.*'Ember'"):
        run(shot, "layer.look=Ember")
    assert len(list(shot.output.glob("vdb/*"))) == 1


def test_killed_while_a_look_is_added_the_asset_is_the_old_one_or_the_new_one(shot: Shot) -> None:
    run(shot, "layer.mode=reference", "layer.look=ember")
    options = ("--mode", "reference", "--look", "frost", "--seed", "2")
    code, steps = run_until(0, *copied(shot, "alive").arguments(*options))
    assert code == 0
    for number, step in enumerate(random.Random(6).sample(range(2, len(steps) - 1), 3)):
        killed = copied(shot, f"killed{number}")
        assert run_until(step, *killed.arguments(*options))[0] == -9
        asset = killed.output / "shot_asset.usda"
        assert variants(asset) in (
            ("ember", ["ember", "original"]),
            ("frost", ["ember", "frost", "original"]),
        )
        assert len(contents(asset)) == 3  # every file is there and what it says it is
        run(killed, "layer.mode=reference", "layer.look=frost", "optimize.seed=2")
        assert variants(asset) == ("frost", ["ember", "frost", "original"])


def variants(asset: Path) -> tuple[str, list[str]]:
    """The selected look and all there are."""
    stage = Usd.Stage.Open(str(asset))
    looks = stage.GetPrimAtPath("/World").GetVariantSet("look")
    return looks.GetVariantSelection(), sorted(looks.GetVariantNames())


def test_a_name_that_is_too_long_for_a_file_is_refused_before_anything_is_computed(
    shot: Shot, core: FakeCore
) -> None:
    with pytest.raises(LayerError, match=r"\d+ bytes.*layer\.look"):
        run(shot, f"layer.look={'x' * 250}")
    assert core.stylized == [] and not shot.output.exists()


def test_an_asset_of_another_stage_of_the_same_name_is_not_replaced(shot: Shot) -> None:
    """Whatever references the asset would show another shot's smoke."""
    run(shot, "layer.look=A", "layer.mode=reference")
    before = file_hashes(shot.output)
    other = make_shot(shot.folder / "other")
    other = dataclasses.replace(other, output=shot.output)
    for settings in (["layer.look=B"], ["layer.look=A"]):
        with pytest.raises(LayerError, match=r"shot_asset\.usda .*in/shot"):
            run(other, *settings, "layer.mode=reference")
    assert file_hashes(shot.output) == before
    # a look of the other stage that is there already cannot become a variant either
    run(other, "layer.look=B")
    with pytest.raises(LayerError, match=r"shot_asset\.usda"):
        assemble(shot.output, look="B", mode="reference")
    assert file_hashes(shot.output)["shot_asset.usda"] == before["shot_asset.usda"]


def test_a_file_in_the_place_of_an_asset_is_not_replaced(shot: Shot) -> None:
    shot.output.mkdir()
    theirs = shot.output / "shot_asset.usda"
    theirs.write_text("#usda 1.0\n")
    with pytest.raises(LayerError, match=r"shot_asset\.usda"):
        run(shot, "layer.mode=reference")
    assert theirs.read_text() == "#usda 1.0\n"


def test_a_refusal_names_the_stage_if_it_is_another_one(shot: Shot) -> None:
    run(shot)
    other = dataclasses.replace(make_shot(shot.folder / "other", 2), output=shot.output)
    with pytest.raises(OutputExists, match=r" \.\./in/shot\.usda, .*\.\./other/in"):
        run(other)

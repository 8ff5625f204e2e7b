"""The plan and the end of a run say what a bound material does to the look."""

from pathlib import Path

import pytest
from pxr import Gf, Sdf

from tests.fixtures.pipeline_fixtures import FakeCore, Shot, make_shot, run
from tests.fixtures.usd_fixtures import density_prim, sequence, volume_prim, world
from usdsmoke.config.resolve import resolve_config
from usdsmoke.planning.make_plan import make_plan
from usdsmoke.planning.plan import Plan
from usdsmoke.ui.cli.main import main
from usdsmoke.ui.cli.plan_text import plan_text
from usdsmoke.usd.layer_record import read_record
from usdsmoke.usd.rules.volume_rules import check_look_seen
from usdsmoke.usd.stage import find_volumes, open_stage

MATERIAL = """
def Material "theirs"
{
    token outputs:volume.connect = </World/theirs/volume.outputs:out>
    def Shader "volume"
    {
        uniform token info:id = "SomeVolume"
        string inputs:channel = "density"
        token outputs:out
    }
}
"""


def bind(stage: Path, strength: str = "weakerThanDescendants") -> None:
    """Bind the world of a shot to a volume material that reads the density alone."""
    binding = f'rel material:binding = </World/theirs> (bindMaterialAs = "{strength}")\n'
    old = 'def Xform "World"\n{\n'
    text = stage.read_text()
    assert old in text
    world = f'def Xform "World" (\nprepend apiSchemas = ["MaterialBindingAPI"]\n)\n{{\n{binding}'
    stage.write_text(text.replace(old, world + MATERIAL, 1))


def plan_of(stage: Path, *settings: str) -> Plan:
    config, opened = resolve_config(list(settings)), open_stage(stage)
    return make_plan(find_volumes(opened, config.stage), config)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ([], "layer.material=replace"),
        (["layer.material=none"], "layer.material=replace"),
        (["layer.material=replace"], ""),
        (["optimize.steps=[shape]"], ""),
    ],
)
def test_a_material_that_hides_the_look_is_a_warning_with_the_remedy(
    shot: Shot, settings: list[str], words: str
) -> None:
    bind(shot.stage)
    found = plan_of(shot.stage, *settings).warnings
    assert bool(found) == bool(words)
    assert all(words in text and "</World/theirs>" in text for text in found)


def test_replacing_is_not_the_advice_where_it_cannot_work(shot: Shot) -> None:
    bind(shot.stage, "strongerThanDescendants")
    (text,) = plan_of(shot.stage, "layer.material=replace").warnings
    assert "replace" not in text and "stronger" in text


def test_a_hidden_look_is_said_in_full_in_ten_lines_of_plan(shot: Shot) -> None:
    bind(shot.stage)
    plan = plan_of(shot.stage, "layer.contact_sheet=0", "optics.gamma=1", "windows.size=1")
    (text,) = plan.warnings
    lines = plan_text(plan).splitlines()
    assert text in " ".join(line.strip() for line in lines)
    assert len(lines) <= 10 and max(map(len, lines[1:])) <= 100
    assert not any("look of" in line for line in lines if line.strip().startswith("left out"))
    assert text in plan_text(plan, everything=True) and text in str(plan)
    assert plan.to_dict()["warnings"] == [text]


def test_many_volumes_with_one_kind_of_material_are_one_warning(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, n_frames=1)
    body = "".join(volume_prim(density_prim(sequence((1,))), f"smoke_{n}") for n in range(5))
    shot.stage.write_text(world(body))
    bind(shot.stage)
    (text,) = plan_of(shot.stage).warnings
    assert "</World/smoke_0> and 4 more" in text and "</World/theirs> reads no" in text


def test_the_plan_names_the_material_that_it_will_write(shot: Shot) -> None:
    def needed(*settings: str) -> str:
        return "\n".join(plan_of(shot.stage, *settings).needed)

    assert "a material of </World/smoke> (glslfx, mtlx)" in needed()
    assert "(arnold)" in needed("layer.material_targets=[arnold]")
    assert "a material" not in needed("layer.material=none")
    assert plan_of(shot.stage).warnings == ()


def test_a_material_that_multiplies_emission_by_density_is_a_warning_with_the_remedy(
    shot: Shot,
) -> None:
    bind(shot.stage)
    reads = 'string inputs:emission_channel = "emission"\n string inputs:emission_mode = "density"'
    text = shot.stage.read_text().replace('string inputs:channel = "density"', reads)
    shot.stage.write_text(text.replace("outputs:volume.connect", "outputs:arnold:volume.connect"))
    plan = plan_of(shot.stage)
    (warning,) = plan.warnings
    assert "</World/theirs>" in warning and "--emission-mode perDensity" in warning
    assert warning in " ".join(line.strip() for line in plan_text(plan).splitlines())
    assert plan_of(shot.stage, "layer.emission_mode=perDensity").warnings == ()


@pytest.mark.usefixtures("core")
def test_a_run_begins_its_end_with_the_hidden_look_and_the_remedy(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(shot.arguments()) == 0
    assert "warning" not in capsys.readouterr().out
    bind(shot.stage)
    assert main(shot.arguments("--force")) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith("warning: ") and "</World/theirs>" in first
    assert "layer.material=replace" in first
    result = run(shot, force=True)
    assert f"warning: {result.plan.warnings[0]}" == first
    assert result.warnings[0] == result.plan.warnings[0]


@pytest.mark.usefixtures("core")
def test_the_end_and_the_gate_name_a_shader_that_is_too_thin(shot: Shot) -> None:
    bind(shot.stage)
    text = shot.stage.read_text().replace('"SomeVolume"', '"arnold:standard_volume"')
    reads = 'inputs:emission_channel = "emission"\n float inputs:density = 0.5'
    text = text.replace('inputs:channel = "density"', reads)
    shot.stage.write_text(text.replace("outputs:volume.connect", "outputs:arnold:volume.connect"))
    result = run(shot)
    gamma_w = f"{result.extinction['/World/smoke']:.4g}"
    words = f"multiplies the density by 0.5 in Arnold, and the look is made for {gamma_w}"
    assert result.root_stage and any(words in text for text in result.warnings)
    stage = open_stage(result.root_stage)
    volume = stage.GetPrimAtPath("/World/smoke")
    assert any(words in item.message for item in check_look_seen(volume, Gf.Interval()))


def test_the_record_of_a_run_has_the_material_s_settings(shot: Shot, core: FakeCore) -> None:
    assert core
    result = run(shot, "layer.material=replace", "layer.material_targets=[arnold]")
    layer = read_record(Sdf.Layer.FindOrOpen(str(result.look_layer))).settings["layer"]
    assert (layer["material"], layer["material_targets"]) == ("replace", ["arnold"])

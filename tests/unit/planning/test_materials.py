"""The plan and the end of a run say what a bound material does to the look."""

from pathlib import Path

import pytest
from pxr import Sdf

from tests.fixtures.pipeline_fixtures import FakeCore, Shot, run
from usdsmoke.base.resolve import resolve_config
from usdsmoke.planning.make_plan import make_plan
from usdsmoke.planning.plan import Plan
from usdsmoke.usd.layer_record import read_record
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


def hidden(plan: Plan) -> list[str]:
    return [item.reason for item in plan.omitted if item.what.startswith("the look of")]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ([], "layer.material=replace"),
        (["layer.material=none"], "layer.material=replace"),
        (["layer.material=replace"], ""),
        (["optimize.steps=[shape]"], ""),
    ],
)
def test_a_material_that_hides_the_look_is_unusual(
    shot: Shot, settings: list[str], words: str
) -> None:
    bind(shot.stage)
    plan = plan_of(shot.stage, *settings)
    found = hidden(plan)
    assert bool(found) == bool(words)
    assert all(words in reason and "</World/theirs>" in reason for reason in found)
    assert not any(item.expected for item in plan.omitted if item.what.startswith("the look of"))


def test_replacing_is_not_the_advice_where_it_cannot_work(shot: Shot) -> None:
    bind(shot.stage, "strongerThanDescendants")
    (reason,) = hidden(plan_of(shot.stage, "layer.material=replace"))
    assert "replace" not in reason and "stronger" in reason


def test_the_plan_names_the_material_that_it_will_write(shot: Shot) -> None:
    def needed(*settings: str) -> str:
        return "\n".join(plan_of(shot.stage, *settings).needed)

    assert "a material of </World/smoke> (glslfx, mtlx)" in needed()
    assert "(arnold)" in needed("layer.material_targets=[arnold]")
    assert "a material" not in needed("layer.material=none")
    assert hidden(plan_of(shot.stage)) == []


def test_a_run_ends_with_a_warning_where_the_look_is_not_seen(shot: Shot, core: FakeCore) -> None:
    assert core and not any("not seen" in text for text in run(shot).warnings)
    bind(shot.stage)
    (warning,) = [text for text in run(shot, force=True).warnings if "not seen" in text]
    assert "</World/theirs>" in warning and "layer.material=replace" in warning


def test_the_record_of_a_run_has_the_material_s_settings(shot: Shot, core: FakeCore) -> None:
    assert core
    result = run(shot, "layer.material=replace", "layer.material_targets=[arnold]")
    layer = read_record(Sdf.Layer.FindOrOpen(str(result.look_layer))).settings["layer"]
    assert (layer["material"], layer["material_targets"]) == ("replace", ["arnold"])

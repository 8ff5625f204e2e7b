"""What particular renderers want, on the stage: fields, relationships, one file for all."""

from itertools import pairwise
from pathlib import Path

import pytest
from pxr import Usd

from tests.fixtures.client_fixtures import ALL, CD, PARTS, SPLIT, VECTORS, fields_of
from tests.fixtures.grids_fixtures import openvdb
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, make_shot, run, shown_files
from tests.fixtures.usd_fixtures import (
    density_prim,
    needs_usd,
    sequence,
    volume_prim,
    world,
    write_text,
)
from usdsmoke.base.errors import ConfigError
from usdsmoke.usd.rules import Severity, validate


def test_all_grids_stand_in_one_file_in_one_place(plume: Shot) -> None:
    result = run(plume, *ALL)
    stage = Usd.Stage.Open(str(result.root_stage))
    fields = fields_of(stage)
    assert set(fields) == {"density", *VECTORS, *PARTS}
    for code in range(1, 8):
        shown = {prim.GetAttribute("filePath").Get(code).resolvedPath for prim in fields.values()}
        assert shown == {str(result.frames[code - 1])}
        grids, _ = openvdb().readAll(shown.pop())
        assert {grid.name for grid in grids} == set(fields)
        for one, other in pairwise(grids):
            assert one.transform == other.transform


def test_every_field_says_what_it_is_by_one_name(plume: Shot) -> None:
    stage = Usd.Stage.Open(str(run(plume, *ALL).root_stage))
    for name, prim in fields_of(stage).items():
        assert str(prim.GetPath()) == f"/World/smoke/{name}"
        assert prim.GetTypeName() == "OpenVDBAsset"
        tokens = [
            prim.GetAttribute(item).Get() for item in ("fieldName", "fieldDataType", "fieldClass")
        ]
        role = prim.GetAttribute("vectorDataRoleHint")
        if name == "density":
            assert tokens == [name, "float", "fogVolume"]
        elif name in VECTORS:
            assert tokens == [name, "float3", "unknown"]
            assert role.Get() == "Color"
        else:
            assert tokens == [name, "float", "unknown"]
            assert not role.HasAuthoredValue()
    volume = stage.GetPrimAtPath("/World/smoke")
    assert volume.GetAttribute("usdSmoke:emissionMode").Get() == "perDensity"


@needs_usd(26, 5)
def test_where_the_source_is_shown_every_colour_is_empty(plume: Shot) -> None:
    result = run(plume, *ALL, "stage.frames=3-5")
    stage = Usd.Stage.Open(str(result.root_stage))
    for name, prim in fields_of(stage).items():
        for code in (1, 2, 6, 7):
            shown = prim.GetAttribute("filePath").Get(code).resolvedPath
            if name == "density":
                assert shown == str(plume.folder / f"in/cache/smoke.{code:04d}.vdb")
                continue
            grid = openvdb().read(shown, name)
            assert grid.activeVoxelCount() == 0
            assert isinstance(grid.background, tuple) == (name in VECTORS)
    assert {item.severity for item in validate(result.root_stage)} <= {Severity.INFO}


@needs_usd(26, 5)
def test_our_validators_have_nothing_to_say_about_all_options(plume: Shot) -> None:
    assert validate(run(plume, *ALL, "grids.half=true").root_stage) == []


SOURCE_CD = """
        rel field:density = </World/smoke/density>
        rel field:Cd = </World/smoke/paint>
"""


def test_a_scattering_colour_of_the_source_is_overridden_where_ours_is_shown(
    tmp_path: Path, core: FakeCore
) -> None:
    shot = make_shot(tmp_path, n_frames=3, names=("density", "Cd"))
    paint = density_prim(sequence(range(1, 4)), "paint", grid='token fieldName = "Cd"')
    paint = paint.replace('"float"', '"float3"').replace('"fogVolume"', '"unknown"')
    body = density_prim(sequence(range(1, 4))) + paint
    write_text(shot.stage, world(volume_prim(body, relations=SOURCE_CD)))
    result = run(shot, CD, "stage.frames=2")
    stage = Usd.Stage.Open(str(result.root_stage))
    prim = fields_of(stage)["Cd"]
    assert str(prim.GetPath()) == "/World/smoke/paint"
    layers = [spec.layer.realPath for spec in prim.GetPrimStack()]
    assert layers == [str(result.look_layer), str(shot.stage)]
    files = shown_files(result.root_stage, "Cd")
    assert files[2.0] == str(result.frames[0])
    assert [Path(files[code]).parent.name for code in (1.0, 3.0)] == ["cache", "cache"]
    stage.MuteLayer(str(result.look_layer))
    assert prim.GetAttribute("filePath").Get(2).resolvedPath.endswith("in/cache/smoke.0002.vdb")


def test_new_fields_are_opinions_of_the_look_alone(plume: Shot) -> None:
    result = run(plume, *ALL)
    stage = Usd.Stage.Open(str(result.root_stage))
    for name in (*VECTORS, *PARTS):
        stack = fields_of(stage)[name].GetPrimStack()
        assert [spec.layer.realPath for spec in stack] == [str(result.look_layer)]
    stage.MuteLayer(str(result.look_layer))
    assert set(fields_of(stage)) == {"density"}


@pytest.mark.parametrize(("name", "setting"), [("Cd", CD), ("emission_g", SPLIT)])
def test_a_colour_never_takes_the_name_of_the_density(
    tmp_path: Path, core: FakeCore, name: str, setting: str
) -> None:
    shot = make_shot(tmp_path, n_frames=1)
    relations = f"rel field:{name} = </World/smoke/density>"
    write_text(shot.stage, world(volume_prim(density_prim(sequence([1])), relations=relations)))
    with pytest.raises(ConfigError, match=f"colour field {name} .* dens"):
        run(shot, setting, f"stage.density={name}")
    assert not shot.output.exists() and core.stylized == []
    run(shot, setting, f"stage.density={name}", "optimize.steps=shape")


def test_in_a_variant_every_colour_comes_and_goes_with_the_look(plume: Shot) -> None:
    stage = Usd.Stage.Open(str(run(plume, *ALL, "layer.mode=reference").root_stage))
    prims = fields_of(stage)
    assert set(prims) == {"density", *VECTORS, *PARTS}
    shown = {prim.GetAttribute("filePath").Get(2).resolvedPath for prim in prims.values()}
    assert len(shown) == 1
    (chosen,) = [prim for prim in stage.Traverse() if "look" in prim.GetVariantSets().GetNames()]
    stage.SetEditTarget(stage.GetSessionLayer())
    chosen.GetVariantSet("look").SetVariantSelection("original")
    assert set(fields_of(stage)) == {"density"}

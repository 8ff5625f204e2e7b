"""Which prims carry the result: none that another Volume shows, all in the density's place."""

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol

from tests.fixtures.usd_fixtures import (
    density_prim,
    make_look,
    needs_usd,
    sequence,
    shown_file,
    volume_prim,
    world,
    write_sequence,
    write_text,
)
from usdsmoke.base.errors import StageError
from usdsmoke.usd.stage import open_stage

CODES = [1, 2]
SHARED = "rel field:density = </World/fields/d>"
MOVING = """
            double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 2: (10, 0, 0) }
            float xformOp:rotateY:turn.timeSamples = { 1: 0, 2: 170 }
            double3 xformOp:translate:pivot = (1, 2, 3)
            uniform token[] xformOpOrder = ["!resetXformStack!", "xformOp:translate",
                "xformOp:translate:pivot", "xformOp:rotateY:turn",
                "!invert!xformOp:translate:pivot"]"""


def look(tmp_path, body, **settings):
    """The composed look of a stage with ``body`` below /World."""
    write_sequence(tmp_path, CODES)
    stage_file = write_text(tmp_path / "shot.usda", world(body))
    return open_stage(make_look(stage_file, tmp_path / "out", **settings).root_stage)


def fields_of(stage, path="/World/smoke"):
    paths = UsdVol.Volume(stage.GetPrimAtPath(path)).GetFieldPaths()
    return {str(name): str(target) for name, target in paths.items()}


def place(stage, path, code):
    return UsdGeom.XformCache(code).GetLocalToWorldTransform(stage.GetPrimAtPath(path))


def ours(tmp_path, name, code):
    return str(tmp_path / f"out/vdb/{name}.{code:04d}.vdb")


def test_a_field_prim_of_another_name_is_kept(tmp_path):
    body = density_prim(sequence(CODES), name="dens_field")
    relations = "rel field:density = </World/smoke/dens_field>"
    stage = look(tmp_path, volume_prim(body, relations=relations))
    assert fields_of(stage) == {
        "density": "/World/smoke/dens_field",
        "emission": "/World/smoke/emission",
    }
    assert shown_file(stage, "/World/smoke/dens_field", 2) == ours(tmp_path, "smoke", 2)


@pytest.mark.parametrize("code", [1, 1.37, 2, 3])
def test_the_emission_moves_exactly_with_the_density(tmp_path, code):
    body = volume_prim(density_prim(sequence(CODES), extra=MOVING))
    stage = look(tmp_path, body)
    density = place(stage, "/World/smoke/density", code)
    assert place(stage, "/World/smoke/emission", code) == density
    assert density != Gf.Matrix4d(1.0) or code == 1


SPLINE = """
            double xformOp:translateX.spline = {
                bezier,
                1: 0; post curve (0.3, 4),
                2: 8; pre (0.3, 0),
            }
            uniform token[] xformOpOrder = ["xformOp:translateX"]"""


@needs_usd(25, 8)
def test_an_xform_that_follows_a_spline_is_copied_as_one(tmp_path):
    write_sequence(tmp_path, CODES)
    stage_file = write_text(
        tmp_path / "shot.usda", world(volume_prim(density_prim(sequence(CODES), extra=SPLINE)))
    )
    stage = open_stage(make_look(stage_file, tmp_path / "out").root_stage)
    for code in (1, 1.25, 1.5, 2):
        moved = place(stage, "/World/smoke/emission", code)
        assert moved == place(stage, "/World/smoke/density", code)
    assert place(stage, "/World/smoke/emission", 1.5) != place(stage, "/World/smoke/emission", 1)


@needs_usd(25, 5)
def test_a_spline_that_usd_cannot_copy_is_refused_with_nothing_written(tmp_path, monkeypatch):
    monkeypatch.delattr(Sdf.AttributeSpec, "SetSpline", raising=False)  # it came with 25.08
    body = volume_prim(density_prim(sequence(CODES), extra=SPLINE))
    with pytest.raises(StageError, match=r"translateX> .*spline"):
        look(tmp_path, body)
    assert not list(tmp_path.glob("out/*.usd*"))


def test_a_density_outside_the_volume_gets_its_emission_beside_it(tmp_path):
    body = f'def Xform "fields"\n{{{density_prim(sequence(CODES), "d", MOVING)}}}\n'
    stage = look(tmp_path, body + volume_prim("", relations=SHARED))
    assert fields_of(stage) == {
        "density": "/World/fields/d",
        "emission": "/World/fields/emission",
    }
    assert place(stage, "/World/fields/emission", 2) == place(stage, "/World/fields/d", 2)


def test_a_new_field_has_no_name_that_differs_from_another_in_case_alone(tmp_path):
    body = f'def Xform "fields"\n{{{density_prim(sequence(CODES), "Density", MOVING)}\n'
    body += 'def Scope "Emission" {}\n}\n'
    shared = SHARED.replace("fields/d>", "fields/Density>")
    body += volume_prim("", "one", shared) + volume_prim("", "two", shared)
    stage = look(tmp_path, body)
    for name in ("one", "two"):
        assert fields_of(stage, f"/World/{name}") == {
            "density": f"/World/fields/density_{name}",
            "emission": f"/World/fields/emission_{name}",
        }


def test_volumes_that_share_a_density_each_show_their_own_result(tmp_path):
    body = f'def Xform "fields"\n{{{density_prim(sequence(CODES), "d", MOVING)}}}\n'
    body += volume_prim("", "one", SHARED) + volume_prim("", "two", SHARED)
    stage = look(tmp_path, body)
    for name in ("one", "two"):
        paths = fields_of(stage, f"/World/{name}")
        for path in paths.values():
            assert shown_file(stage, path, 2) == ours(tmp_path, name, 2)
            assert place(stage, path, 2) == place(stage, "/World/fields/d", 2)
    assert fields_of(stage, "/World/one") == {
        "density": "/World/fields/density",
        "emission": "/World/fields/emission",
    }
    assert fields_of(stage, "/World/two") == {
        "density": "/World/fields/density_two",
        "emission": "/World/fields/emission_two",
    }
    assert shown_file(stage, "/World/fields/d", 2) == str(tmp_path / "cache/smoke.0002.vdb")


def test_a_volume_that_is_not_stylized_keeps_the_shared_source(tmp_path):
    body = f'def Xform "fields"\n{{{density_prim(sequence(CODES), "d")}}}\n'
    body += volume_prim("", "one", SHARED) + volume_prim("", "two", SHARED)
    stage = look(tmp_path, body, prims=["/World/one"], frames="2")
    assert fields_of(stage, "/World/two") == {"density": "/World/fields/d"}
    assert shown_file(stage, "/World/fields/d", 2) == str(tmp_path / "cache/smoke.0002.vdb")
    own = fields_of(stage, "/World/one")["density"]
    assert own != "/World/fields/d"
    assert shown_file(stage, own, 2) == ours(tmp_path, "one", 2)
    assert shown_file(stage, own, 1) == str(tmp_path / "cache/smoke.0001.vdb")
    tokens = [
        stage.GetPrimAtPath(own).GetAttribute(name).Get() for name in ("fieldName", "fieldClass")
    ]
    assert tokens == ["density", "fogVolume"]


def test_one_volume_that_uses_its_density_twice_keeps_the_other_use(tmp_path):
    relations = (
        "rel field:density = </World/smoke/density>\nrel field:mask = </World/smoke/density>"
    )
    stage = look(tmp_path, volume_prim(density_prim(sequence(CODES)), relations=relations))
    fields = fields_of(stage)
    assert fields["mask"] == "/World/smoke/density"
    assert shown_file(stage, fields["mask"], 1) == str(tmp_path / "cache/smoke.0001.vdb")
    assert shown_file(stage, fields["density"], 1) == ours(tmp_path, "smoke", 1)


def test_a_prim_that_happens_to_be_called_emission_is_left_alone(tmp_path):
    body = density_prim(sequence(CODES)) + 'def Xform "emission" {}'
    stage = look(tmp_path, volume_prim(body))
    assert fields_of(stage)["emission"] == "/World/smoke/emission_smoke"
    taken = stage.GetPrimAtPath("/World/smoke/emission")
    assert taken.GetTypeName() == "Xform"
    assert not taken.HasProperty("filePath")


EMISSION = "rel field:density = </World/smoke/density>\nrel field:emission = </World/smoke/e>"


def test_an_emission_field_of_the_source_is_kept_up_outside_the_range(tmp_path):
    body = density_prim(sequence(CODES)) + density_prim(
        sequence(CODES), "e", grid='token fieldName = "glow"'
    )
    stage = look(tmp_path, volume_prim(body, relations=EMISSION), frames="2")
    assert fields_of(stage)["emission"] == "/World/smoke/e"
    prim = stage.GetPrimAtPath("/World/smoke/e")
    assert [prim.GetAttribute("fieldName").Get(code) for code in CODES] == ["glow", "emission"]
    assert [prim.GetAttribute("fieldDataType").Get(code) for code in CODES] == ["float", "float3"]
    assert shown_file(stage, "/World/smoke/e", 1) == str(tmp_path / "cache/smoke.0001.vdb")
    assert shown_file(stage, "/World/smoke/e", 2) == ours(tmp_path, "smoke", 2)


def test_an_emission_field_in_another_place_is_replaced(tmp_path):
    body = density_prim(sequence(CODES)) + density_prim(sequence(CODES), "e", MOVING)
    stage = look(tmp_path, volume_prim(body, relations=EMISSION))
    assert fields_of(stage)["emission"] == "/World/smoke/emission"
    assert place(stage, "/World/smoke/emission", 2) == place(stage, "/World/smoke/density", 2)
    assert shown_file(stage, "/World/smoke/e", 2) == str(tmp_path / "cache/smoke.0002.vdb")


def test_a_copied_velocity_comes_from_the_same_file_and_keeps_its_own_samples(tmp_path):
    relations = "rel field:density = </World/smoke/density>\nrel field:vel = </World/smoke/vel>"
    body = density_prim(sequence(CODES)) + density_prim(
        sequence([1]), "vel", grid='token fieldName = "vel"'
    )
    names = ("density", "emission", "vel")
    stage = look(tmp_path, volume_prim(body, relations=relations), names=names, frames="2")
    assert shown_file(stage, "/World/smoke/vel", 1) == str(tmp_path / "cache/smoke.0001.vdb")
    assert shown_file(stage, "/World/smoke/vel", 2) == ours(tmp_path, "smoke", 2)


def test_a_velocity_that_only_the_file_has_becomes_a_field(tmp_path):
    names = ("density", "emission", "vel")
    stage = look(tmp_path, volume_prim(density_prim(sequence(CODES))), names=names)
    assert fields_of(stage)["vel"] == "/World/smoke/vel"
    prim = stage.GetPrimAtPath("/World/smoke/vel")
    assert prim.GetAttribute("vectorDataRoleHint").Get() == "Vector"
    assert prim.GetAttribute("fieldDataType").Get() == "float3"


def test_density_alone_makes_no_emission_field(tmp_path):
    stage = look(tmp_path, volume_prim(density_prim(sequence(CODES))), names=("density",))
    assert fields_of(stage) == {"density": "/World/smoke/density"}


def test_an_empty_file_stands_where_there_is_no_emission(tmp_path):
    stage = look(tmp_path, volume_prim(density_prim(sequence(CODES))), frames="2", empty=True)
    empty = str(tmp_path / "out/vdb/smoke.none.vdb")
    assert [shown_file(stage, "/World/smoke/emission", code) for code in CODES] == [
        empty,
        ours(tmp_path, "smoke", 2),
    ]
    assert shown_file(stage, "/World/smoke/density", 1) == str(tmp_path / "cache/smoke.0001.vdb")


def test_nothing_but_new_field_prims_is_defined_by_the_look(tmp_path):
    body = f'def Xform "fields"\n{{{density_prim(sequence(CODES), "d")}}}\n'
    body += volume_prim("", "one", SHARED) + volume_prim("", "two", SHARED)
    look(tmp_path, body)
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "out/look.usda"))
    for name in ("one", "two"):
        del layer.GetPrimAtPath(f"/World/{name}").nameChildren["look_material"]
    defined = []
    layer.Traverse(
        Sdf.Path.absoluteRootPath,
        lambda path: (
            defined.append(str(path))
            if path.IsPrimPath() and layer.GetPrimAtPath(path).specifier == Sdf.SpecifierDef
            else None
        ),
    )
    assert len(defined) == 4
    assert all(layer.GetPrimAtPath(path).typeName == "OpenVDBAsset" for path in defined)
    assert all(path.startswith("/World/fields/") for path in defined)


def test_a_moving_density_moves_the_extent_too(tmp_path):
    extra = MOVING.replace('"!resetXformStack!", ', "").replace("1: 0, 2: 170", "1: 0, 2: 0")
    stage = look(tmp_path, volume_prim(density_prim(sequence([1]), extra=extra)))
    extent = stage.GetPrimAtPath("/World/smoke").GetAttribute("extent")
    np.testing.assert_array_equal(extent.Get(1), [[-0.25] * 3, [1.75, 1.25, 0.75]])
    np.testing.assert_array_equal(extent.Get(2), [[-0.25] * 3, [11.75, 1.25, 0.75]])
    assert Usd.TimeCode(2).GetValue() in extent.GetTimeSamples()

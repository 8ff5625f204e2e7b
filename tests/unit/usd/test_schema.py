"""The schema plug-in: known to USD when registered in time, applies to Volumes alone, is current.

USD reads schemas once in a process, so each case runs in a process of its own.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from pxr import Sdf, Tf

from tests.fixtures.usd_fixtures import needs_usd
from usdsmoke.usd import schema
from usdsmoke.usd.request_values import (
    CAMERA,
    MASK,
    REQUEST_ATTRIBUTES,
    REQUEST_PREFIX,
    STYLE_IMAGES,
)

PROJECT = Path(__file__).resolve().parents[3]
SOURCE = PROJECT / "schemas" / "usdSmoke" / "schema.usda"
GENERATOR = PROJECT / "tools" / "generate_schema.py"

ATTRIBUTES = {  # name: (type, fallback)
    schema.EXTINCTION_PER_DENSITY: ("float", 1.0),
    schema.STAGE_UNITS: ("float", 1.0),
    schema.EMISSION_MODE: ("token", schema.EMISSION_ABSOLUTE),
    schema.COLOR_SPACE: ("token", schema.LIN_REC709),
    schema.RUN: ("string", ""),
    schema.STYLE: ("string[]", []),
    schema.SEED: ("int64", 0),
    schema.ALBEDO: ("float", 0.0),
    schema.ANISOTROPY: ("float", 0.0),
    schema.BOUNCES: ("bool", False),
    schema.LIGHTS: ("float3[]", []),
    schema.EXPOSURE: ("float", 0.0),
    schema.SCATTER_FIELD: ("token", ""),
}

REQUESTED = (STYLE_IMAGES, CAMERA, MASK, *(row.name for row in REQUEST_ATTRIBUTES))

PREPARE = """
import json
from pxr import Usd, UsdGeom, UsdVol
from usdsmoke.usd.schema import LOOK_API, register_schema
known = register_schema()
stage = Usd.Stage.CreateInMemory()
volume = UsdVol.Volume.Define(stage, "/volume").GetPrim()
xform = UsdGeom.Xform.Define(stage, "/xform").GetPrim()
"""


def run_python(code: str, **environment: str) -> object:
    """What ``code`` prints as JSON, run by a fresh interpreter."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd=PROJECT,
        env={**os.environ, **environment},
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_schema_applies_to_a_volume_and_refuses_an_xform() -> None:
    assert run_python(
        PREPARE
        + """
volume.ApplyAPI(LOOK_API)
print(json.dumps([known, volume.HasAPI(LOOK_API), bool(xform.CanApplyAPI(LOOK_API))]))
"""
    ) == [True, True, False]


def test_applied_schema_gives_every_attribute_its_type_and_fallback() -> None:
    found = run_python(
        PREPARE
        + """
volume.ApplyAPI(LOOK_API)
ours = [a for a in volume.GetAttributes() if a.GetName().startswith("usdSmoke:")]
value = lambda a: list(a.Get()) if str(a.GetTypeName()).endswith("[]") else a.Get()
print(json.dumps({a.GetName(): [str(a.GetTypeName()), value(a)] for a in ours}))
"""
    )
    assert found == {name: list(expected) for name, expected in ATTRIBUTES.items()}


def test_a_request_has_no_fallbacks_so_that_applying_it_says_nothing() -> None:
    found = run_python(
        PREPARE
        + """
from usdsmoke.usd.schema import STYLE_API
volume.ApplyAPI(STYLE_API)
ours = [p for p in volume.GetProperties() if p.GetName().startswith("usdSmoke:request:")]
value = lambda p: p.Get() if hasattr(p, "Get") else list(p.GetTargets()) or None
print(json.dumps([bool(xform.CanApplyAPI(STYLE_API)), {p.GetName(): value(p) for p in ours}]))
"""
    )
    assert found == [False, dict.fromkeys(REQUESTED)]


@pytest.mark.parametrize(
    "before", ["", "from pxr import Usd, Plug", "import pxr"], ids=["first", "after USD", "pxr"]
)
def test_importing_the_package_before_a_stage_is_opened_is_enough(before: str) -> None:
    code = f"""
{before}
import json, usdsmoke
from pxr import Usd, UsdVol
stage = Usd.Stage.CreateInMemory()
volume = UsdVol.Volume.Define(stage, "/volume").GetPrim()
print(json.dumps(volume.ApplyAPI("UsdSmokeStyleAPI")))
"""
    assert run_python(code, PXR_PLUGINPATH_NAME="") is True


def test_importing_the_package_keeps_the_plugin_folders_that_are_there() -> None:
    code = "import json, os, usdsmoke; print(json.dumps(os.environ['PXR_PLUGINPATH_NAME']))"
    expected = os.pathsep.join(["/studio/plugins", str(schema.PLUGIN_FOLDER)])
    assert run_python(code, PXR_PLUGINPATH_NAME="/studio/plugins") == expected
    assert run_python(code, PXR_PLUGINPATH_NAME=expected) == expected


def test_registering_too_late_is_told_with_what_to_do() -> None:
    code = """
import json
from pxr import Usd
stage = Usd.Stage.CreateInMemory()
Usd.SchemaRegistry()
import usdsmoke
from usdsmoke.usd.schema import late_note
print(json.dumps(late_note()))
"""
    note = run_python(code, PXR_PLUGINPATH_NAME="")
    assert isinstance(note, str)
    assert "import usdsmoke first" in note and str(schema.PLUGIN_FOLDER) in note
    assert run_python(code, PXR_PLUGINPATH_NAME=str(schema.PLUGIN_FOLDER)) == ""


def test_registering_after_the_first_stage_answers_false() -> None:
    late = """
import json
from pxr import Usd
stage = Usd.Stage.CreateInMemory()
Usd.SchemaRegistry()
from usdsmoke.usd.schema import register_schema
print(json.dumps([register_schema(), register_schema()]))
"""
    assert run_python(late, PXR_PLUGINPATH_NAME="") == [False, False]


def test_plugin_is_found_through_the_environment_without_registering() -> None:
    code = """
import json
from pxr import Usd
print(json.dumps(bool(Usd.SchemaRegistry().FindAppliedAPIPrimDefinition("UsdSmokeLookAPI"))))
"""
    assert run_python(code, PXR_PLUGINPATH_NAME=str(schema.PLUGIN_FOLDER)) is True
    assert run_python(code, PXR_PLUGINPATH_NAME="") is False


def test_values_are_read_by_name_in_a_process_that_does_not_know_the_schema(
    tmp_path: Path,
) -> None:
    layer_file = tmp_path / "look.usda"
    authored = run_python(
        PREPARE
        + f"""
volume.ApplyAPI(LOOK_API)
volume.GetAttribute("usdSmoke:seed").Set(7)
print(json.dumps(stage.GetRootLayer().Export({str(layer_file)!r})))
"""
    )
    assert authored is True
    code = f"""
import json
from pxr import Usd
stage = Usd.Stage.Open({str(layer_file)!r})
volume = stage.GetPrimAtPath("/volume")
names = volume.GetPrimTypeInfo().GetAppliedAPISchemas()
print(json.dumps([volume.GetAttribute("usdSmoke:seed").Get(), list(names)]))
"""
    assert run_python(code, PXR_PLUGINPATH_NAME="") == [7, [schema.LOOK_API]]


@needs_usd(26, 8)  # earlier ones format the files otherwise
def test_generated_files_are_what_the_source_generates(tmp_path: Path) -> None:
    pytest.importorskip("jinja2", reason="usdGenSchema needs jinja2, an extra of development")
    subprocess.run(
        [sys.executable, str(GENERATOR), "--out", str(tmp_path)],
        check=True,
        capture_output=True,
    )
    fresh = {str(p.relative_to(tmp_path)): p.read_text() for p in tmp_path.rglob("*.*")}
    assert fresh.pop(SOURCE.name) == SOURCE.read_text(), "run 'make schema'"
    kept = {name: (schema.PLUGIN_FOLDER / name).read_text() for name in fresh}
    assert len(fresh) == 2
    assert kept == fresh, "usdsmoke/plugin is not current; run 'make schema'"


@pytest.mark.parametrize(
    "layer_file", [SOURCE, *schema.PLUGIN_FOLDER.rglob("*.usda")], ids=lambda p: p.name
)
def test_every_attribute_tells_its_units_and_range(layer_file: Path) -> None:
    layer = Sdf.Layer.OpenAsAnonymous(str(layer_file))
    attributes = layer.GetPrimAtPath(f"/{schema.LOOK_API}").attributes
    assert {item.name for item in attributes} == set(ATTRIBUTES)
    requests = layer.GetPrimAtPath(f"/{schema.STYLE_API}").properties
    assert {item.name for item in requests} == set(REQUESTED)
    for item in (*attributes, *requests):
        text = item.customData["userDocBrief"]
        assert "Units: " in text and "Range: " in text, f"{item.name}: {text}"


def test_every_token_is_among_those_that_are_allowed() -> None:
    layer = Sdf.Layer.OpenAsAnonymous(str(SOURCE))
    attributes = layer.GetPrimAtPath(f"/{schema.LOOK_API}").attributes
    for name in (schema.EMISSION_MODE, schema.COLOR_SPACE):
        assert attributes[name].default in attributes[name].allowedTokens


@pytest.mark.parametrize(
    ("name", "type_name", "animated", "text"),
    [
        ("strength", "double", True, "Units: none. Range: 0 to 1."),
        ("azimuth", "double", False, "Units: degrees. Range: 0 to 180."),
        ("seed", "int64", False, "Range: 0 to 9223372036854775807."),
        ("viewCount", "int", False, "Range: 1 to 64."),
        ("steps", "token[]", False, "Range: one or more of shape, colour, without repeats."),
        ("styleWeights", "double[]", True, "Range: each at least 0."),
        ("reach", "double", False, "Range: above 0 and at most 0.5."),
    ],
)
def test_a_request_takes_what_its_setting_takes(
    name: str, type_name: str, animated: bool, text: str
) -> None:
    layer = Sdf.Layer.OpenAsAnonymous(str(SOURCE))
    item = layer.GetPrimAtPath(f"/{schema.STYLE_API}").attributes[f"{REQUEST_PREFIX}{name}"]
    assert str(item.typeName) == type_name
    assert (item.variability == Sdf.VariabilityVarying) == animated
    assert text in item.customData["userDocBrief"]


@needs_usd(26, 11)
def test_a_look_claims_a_capability():
    from pxr import UsdProfiles

    registry = UsdProfiles.ProfileRegistry
    assert {"usdSmoke", "usdSmoke.look"} <= {str(name) for name in registry.GetAllCapabilities()}
    kind = Tf.Type.FindByName("UsdSmokeUsdSmokeLookAPI")
    assert "usdSmoke.look" in {str(name) for name in registry.GetSchemaImpliedCapabilities(kind)}

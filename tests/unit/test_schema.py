"""The schema plug-in: known to USD when registered in time, applies to Volumes alone, is current.

USD reads schemas once in a process, so each case runs in a process of its own.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from pxr import Sdf

from usdsmoke import schema

PROJECT = Path(__file__).resolve().parents[2]
SOURCE = PROJECT / "schemas" / "usdSmoke" / "schema.usda"
GENERATOR = PROJECT / "tools" / "generate_schema.py"

ATTRIBUTES = {  # name: (type, fallback)
    schema.EXTINCTION_PER_DENSITY: ("float", 1.0),
    schema.EMISSION_MODE: ("token", schema.EMISSION_ABSOLUTE),
    schema.COLOR_SPACE: ("token", schema.LIN_REC709),
    schema.RUN: ("string", ""),
    schema.STYLE: ("string[]", []),
    schema.SEED: ("int64", 0),
}

PREPARE = """
import json
from pxr import Usd, UsdGeom, UsdVol
from usdsmoke.schema import LOOK_API, register_schema
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


def test_registering_after_the_first_stage_answers_false() -> None:
    late = """
import json
from pxr import Usd
stage = Usd.Stage.CreateInMemory()
Usd.SchemaRegistry()
from usdsmoke.schema import register_schema
print(json.dumps([register_schema(), register_schema()]))
"""
    assert run_python(late) == [False, False]


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


def test_generated_files_are_what_the_source_generates(tmp_path: Path) -> None:
    pytest.importorskip("jinja2", reason="usdGenSchema needs jinja2, an extra of development")
    subprocess.run(
        [sys.executable, str(GENERATOR), "--out", str(tmp_path)],
        check=True,
        capture_output=True,
    )
    fresh = {p.relative_to(tmp_path): p.read_text() for p in tmp_path.rglob("*") if p.is_file()}
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
    for item in attributes:
        text = item.customData["userDocBrief"]
        assert "Units: " in text and "Range: " in text, f"{item.name}: {text}"


def test_every_token_is_among_those_that_are_allowed() -> None:
    layer = Sdf.Layer.OpenAsAnonymous(str(SOURCE))
    attributes = layer.GetPrimAtPath(f"/{schema.LOOK_API}").attributes
    for name in (schema.EMISSION_MODE, schema.COLOR_SPACE):
        assert attributes[name].default in attributes[name].allowedTokens

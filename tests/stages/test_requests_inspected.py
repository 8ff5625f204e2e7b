"""``inspect`` on requests: what counts for each Volume, and whose word it is; the document too."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from pxr import Sdf

import usdsmoke
from tests.fixtures.pipeline_fixtures import PROJECT, make_style
from tests.fixtures.usd_fixtures import (
    density_prim,
    needs_usd,
    sequence,
    world,
    write_sequence,
    write_text,
)
from usdsmoke.config.resolve import resolve_config
from usdsmoke.ui.cli.main import main
from usdsmoke.usd.request_values import REQUEST_ATTRIBUTES, REQUEST_PREFIX

CODES = (1, 2, 3)


@pytest.fixture
def stage(tmp_path: Path) -> Path:
    """A Volume with a request in a layer of its own."""
    write_sequence(tmp_path, CODES)
    make_style(tmp_path / "style.png")
    body = f"""
    def Volume "smoke"
    {{
        rel field:density = </World/smoke/density>
        {density_prim(sequence(CODES))}
    }}
"""
    write_text(tmp_path / "smoke.usda", world(body))
    request = """#usda 1.0
(
    defaultPrim = "World"
    subLayers = [@./smoke.usda@]
    timeCodesPerSecond = 25
)
over "World" {
    over "smoke" (prepend apiSchemas = ["UsdSmokeStyleAPI"]) {
        asset[] usdSmoke:request:styleImages = [@./style.png@]
        int64 usdSmoke:request:seed = 5
        double usdSmoke:request:gamma = 0.5
        double usdSmoke:request:strength.timeSamples = { 1: 0, 3: 1 }
    }
}
"""
    return write_text(tmp_path / "shot.usda", request)


def inspected(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main(["inspect", *arguments, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)["volumes"][0]["request"]
    return found


def test_a_request_that_cannot_be_read_is_a_problem_beside_its_volume(
    stage: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = stage.read_text("utf-8")
    stage.write_text(text.replace("request:gamma = 0.5", "request:gamma = -1"), "utf-8")
    assert main(["inspect", str(stage), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert [volume["prim_path"] for volume in found["volumes"]] == ["/World/smoke"]
    (problem,) = found["problems"]
    assert "request:gamma" in problem and "-1" in problem


def test_a_stage_of_invisible_volumes_is_described(
    stage: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = stage.read_text("utf-8")
    stage.write_text(text.replace("int64", 'token visibility = "invisible"\nint64', 1), "utf-8")
    assert main(["inspect", str(stage), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert [volume["prim_path"] for volume in found["volumes"]] == ["/World/smoke"]
    (problem,) = found["problems"]
    assert "invisible" in problem and "--prim" in problem


def test_every_value_comes_with_whose_word_it_is(
    stage: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write_text(
        stage.parent / "c.yaml", "optimize: {seed: 1}\nwindows: {size: 3}\nstyle: {size: 2}\n"
    )
    given = [str(stage), "--config", str(config), "--set", "optics.gamma=2", "--set=style.size=4"]
    request = inspected(capsys, *given)
    settings = request["settings"]
    assert settings["optimize.seed"] == {
        "value": 5,
        "origin": "prim",
        "attribute": "/World/smoke.usdSmoke:request:seed",
        "layer": str(stage),
    }
    assert settings["windows.size"] == {"value": 3, "origin": "config"}
    assert settings["optics.gamma"] == {"value": 2.0, "origin": "option"}
    assert settings["style.size"] == {"value": 4.0, "origin": "option"}
    assert settings["windows.overlap"] == {"value": 4, "origin": "default"}
    assert settings["optimize.strength"]["samples"] == [[1, 0.0], [2, 0.5], [3, 1.0]]
    assert request["applied"]
    assert request["styles"]["value"] == [str(stage.parent / "style.png")]
    assert request["styles"]["origin"] == "prim"


@pytest.mark.parametrize("kind", ["ready made", "file"])
def test_a_configuration_counts_as_one_in_whatever_form_it_comes(stage: Path, kind: str) -> None:
    sections = {"windows": {"size": 3}, "optimize": {"seed": 1}}
    ways: dict[str, Any] = {
        "ready made": resolve_config(sections),
        "file": write_text(stage.parent / "c.yaml", json.dumps(sections)),
    }
    found = usdsmoke.inspect(stage, settings=[ways[kind], "style.size=2"])
    settings = found["volumes"][0]["request"]["settings"]
    origins = {name: settings[name]["origin"] for name in ("windows.size", "optimize.seed")}
    assert origins == {"windows.size": "config", "optimize.seed": "prim"}
    assert settings["style.size"] == {"value": 2.0, "origin": "option"}


def test_a_style_of_the_command_is_an_option(
    stage: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = make_style(stage.parent / "other.png")
    request = inspected(capsys, str(stage), "--style", str(other))
    assert request["styles"] == {"value": [str(other)], "origin": "option"}


def test_the_text_names_attribute_and_layer(
    stage: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["inspect", str(stage), "--seed", "3"]) == 0
    out = capsys.readouterr().out
    assert re.search(
        r"style images +style\.png +</World/smoke\.\S+:styleImages> in shot\.usda", out
    )
    assert re.search(r"optimize\.strength +0\.0 at 1 to 1\.0 at 3 +</World/smoke", out)
    assert re.search(r"optimize\.seed +3 +option\n", out)
    assert re.search(r"others +\d+ settings +default\n", out)


def test_a_stage_that_asks_for_nothing_is_shown_without_a_word_of_it(
    stage: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["inspect", str(stage.parent / "smoke.usda")]) == 0
    assert "stylized with" not in capsys.readouterr().out


def test_what_does_not_count_is_noted(stage: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = stage.read_text().replace('(prepend apiSchemas = ["UsdSmokeStyleAPI"])', "")
    assert main(["inspect", str(write_text(stage, text))]) == 0
    assert "note: usdSmoke:request:gamma, usdSmoke:request:seed" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("target", "message"),
    [("/World/none", "no prim </World/none>"), ("/World/camera", "has horizontalAperture 0")],
)
def test_a_camera_that_nothing_can_be_seen_through_is_a_problem(
    stage: Path, target: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = stage.read_text(encoding="utf-8")
    camera = f"rel usdSmoke:request:camera = <{target}>"
    text = text.replace("int64 usd", f"{camera}\n        int64 usd", 1)
    end = text.rindex("}")
    film = 'def Camera "camera" {\nfloat horizontalAperture = 0\n}\n'
    write_text(stage, f"{text[:end]}{film}{text[end:]}")
    assert main(["inspect", str(stage), "--json"]) == 1
    (problem,) = json.loads(capsys.readouterr().out)["problems"]
    assert message in problem


@pytest.mark.parametrize("command", ["inspect", pytest.param("validate", marks=needs_usd(26, 5))])
def test_a_schema_that_came_too_late_is_told_and_requests_are_read_all_the_same(
    stage: Path, command: str
) -> None:
    code = f"""
from pxr import Usd
stage = Usd.Stage.CreateInMemory()
Usd.SchemaRegistry()
from usdsmoke.ui.cli.main import main
from usdsmoke.config.resolve import resolve_config
main([{command!r}, {str(stage)!r}])
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd=PROJECT,
        env={"PATH": "", "PXR_PLUGINPATH_NAME": "", "PYTHONPATH": str(PROJECT)},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("import usdsmoke first") == 1
    if command == "inspect":
        assert re.search(r"optimize\.seed +5 ", done.stdout)


def test_the_document_lists_every_attribute_with_type_and_setting() -> None:
    layer = Sdf.Layer.OpenAsAnonymous(str(PROJECT / "schemas/usdSmoke/schema.usda"))
    schema = layer.GetPrimAtPath("/UsdSmokeStyleAPI")
    text = (PROJECT / "docs/settings.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| `(\S+)` \| `(\S+)` \| (yes )?\|$", text, flags=re.M)
    expected = {
        (
            row.name.removeprefix(REQUEST_PREFIX),
            str(schema.attributes[row.name].typeName),
            row.setting,
            "yes " if row.control else "",
        )
        for row in REQUEST_ATTRIBUTES
    } | {
        ("styleImages", "asset[]", "--style", ""),
        ("camera", "rel", "views.camera", ""),
        ("mask", "rel", "stage.mask", ""),
    }
    assert set(rows) == expected
    assert len(schema.properties) == len(expected)

"""Runs in light: the files, the look and its pictures say what scatters, and how often."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd

from tests.fixtures.grids_fixtures import raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import Shot, make_shot
from tests.fixtures.preview_fixtures import parts
from tests.fixtures.smoke_fixtures import puff
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.pictures.preview import preview
from usdsmoke.pipeline import StylizeResult, stylize
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.read import GridRequest, read_grids

QUICK = [
    "optimize.iterations=3",
    "optimize.steps=[colour]",
    "optimize.error_budget=false",
    "optimize.threads=1",
    "views.image_size=16",
    "views.pool=2",
    "layer.contact_sheet=16",
    "windows.size=2",
    "windows.overlap=1",
    "optics.sun=[0,0,1]",
    "optics.sky=[0.5,0.4,0.3]",
]


@pytest.fixture(params=["albedo", "both"])
def finished(request, tmp_path: Path) -> tuple[str, Shot, StylizeResult]:
    """Two windows of a shot without lights; the middle frame is blended."""
    shot = make_shot(tmp_path, 3)
    for code in (1, 2, 3):
        write_raw(shot.stage.parent / f"cache/smoke.{code:04d}.vdb", raw_grid(puff(8)))
    settings = [*QUICK, f"colour.target={request.param}"]
    return request.param, shot, stylize(shot.stage, shot.style, shot.output, settings)


def test_a_painted_albedo_is_in_the_files_the_look_and_its_pictures(finished) -> None:
    target, shot, result = finished
    most = 1 if target == "albedo" else 0.5
    names = {"density", "Cd"} | ({"emission"} if target == "both" else set())
    for file_path in result.frames:
        assert {grid.name for grid in read_header(file_path).grids} == names
        (albedo,) = read_grids(file_path, [GridRequest("Cd")], GridsConfig())
        assert 0 <= albedo.values.min() and 0.1 < albedo.values.max() <= most * (1 + 1e-6)
    stage = Usd.Stage.Open(str(result.root_stage))
    prim = stage.GetPrimAtPath("/World/smoke")
    said = {name: prim.GetAttribute(f"usdSmoke:{name}") for name in ("scatterField", "albedo")}
    assert {name: value.Get() for name, value in said.items()} == {
        "scatterField": "Cd",
        "albedo": most,
    }
    assert np.allclose(prim.GetAttribute("usdSmoke:lights").Get()[0], (0, 0, 1))
    exposure = prim.GetAttribute("usdSmoke:exposure")
    assert exposure.HasAuthoredValue() is (target == "albedo")
    told = [warning for warning in result.warnings if "optics.exposure" in warning]
    assert len(told) == (target == "albedo")
    (storm,) = (
        child
        for child in prim.GetChild("look_material").GetChildren()
        if child.GetName() == "glslfx_volume"
    )
    assert storm.GetAttribute("inputs:scatter").GetConnections()
    assert bool(storm.GetAttribute("inputs:emission")) is (target == "both")
    text = (shot.output / "look.glslfx").read_text()
    assert "HdGet_scatter" in text and ("HdGet_emission(" in text) is (target == "both")
    assert all(sheet.is_file() for sheet in result.contact_sheets)
    (file_path,) = preview(result.root_stage, shot.folder / "a.exr", frames="2", width=16).files
    assert parts(file_path)["emission"][1].max() > 0.01


def test_a_look_for_bounces_says_so_and_is_painted_and_shown_for_them(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, 1)
    write_raw(shot.stage.parent / "cache/smoke.0001.vdb", raw_grid(puff(8)))
    colours, shown, sheets = [], [], []
    for bounces in ("false", "true"):
        settings = [*QUICK, "optics.albedo=0.9", f"optics.bounces={bounces}"]
        result = stylize(shot.stage, shot.style, tmp_path / bounces, settings)
        stage = Usd.Stage.Open(str(result.root_stage))
        said = stage.GetPrimAtPath("/World/smoke").GetAttribute("usdSmoke:bounces")
        assert (said.Get(), said.HasAuthoredValue()) == ((bounces == "true",) * 2)
        (emission,) = read_grids(result.frames[0], [GridRequest("emission")], GridsConfig())
        (file_path,) = preview(result.root_stage, tmp_path / f"{bounces}.exr", width=16).files
        colours.append(float(emission.values.mean()))
        shown.append(float(parts(file_path)["emission"][1].mean()))
        sheets.append(result.contact_sheets[0].read_bytes())
    assert colours[0] != colours[1] and sheets[0] != sheets[1]
    assert shown[0] < shown[1]

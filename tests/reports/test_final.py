"""``usdsmoke report --final``: what is drawn, scored and written; the path tracer is a stand-in."""

import importlib.util
import json
import sys
import types
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from tests.fixtures.pipeline_fixtures import make_style
from tests.fixtures.preview_fixtures import look_of_four_frames
from tests.fixtures.usd_fixtures import make_look, plume_stage, write_text
from usdsmoke.base.errors import MissingPackage, StageError
from usdsmoke.ui.cli.main import main
from usdsmoke.work_precision import check_final, final

SUN = (
    'def DistantLight "sun"\n{\n    float inputs:intensity = 6\n    bool inputs:normalize = 1\n}\n'
)
HAS_MITSUBA = importlib.util.find_spec("mitsuba") is not None


class Dark:
    """A path tracer whose pictures hold one bright pixel of what is scattered, brighter with each
    bounce, and of what glows."""

    bounces: ClassVar[list[int]] = []

    def __init__(self, density, gamma_w, scattering, colour):
        self.lights = scattering.lights

    def glow(self, colours, view, samples, seed, bounces):
        Dark.bounces.append(bounces)
        picture = np.zeros((view.height, view.width, 3), np.float32)
        picture[-1, -1] = colours.values.mean() if colours else 0
        return picture

    def lit(self, view, samples, seed, bounces):
        picture = self.glow(None, view, samples, seed, bounces)
        picture[0, 0] = bounces * len(self.lights)
        return picture


@pytest.fixture
def lit_look(tmp_path: Path) -> Path:
    """A look of a smoke that scatters, on a stage with a sun."""
    look_of_four_frames(tmp_path)
    text = f"""#usda 1.0
(
    subLayers = [@{tmp_path / "out/shot_look.usda"}@]
    metersPerUnit = 0.5
    upAxis = "Z"
    timeCodesPerSecond = 25
)
over "World"
{{
    over "smoke"
    {{
        float usdSmoke:albedo = 0.8
    }}
    {SUN}
}}
"""
    return write_text(tmp_path / "lit.usda", text)


@pytest.fixture
def dark(monkeypatch: pytest.MonkeyPatch) -> type[Dark]:
    monkeypatch.setitem(sys.modules, "mitsuba", types.ModuleType("mitsuba"))
    monkeypatch.setattr(final, "TracedSmoke", Dark)
    Dark.bounces = []
    return Dark


def test_pictures_are_scored_and_written_beside_the_path_tracers(lit_look, dark, tmp_path, capsys):
    style, output = make_style(tmp_path / "style.png"), tmp_path / "report"
    arguments = ["report", str(lit_look), "--final", "--style", str(style), "-o", str(output)]
    assert main([*arguments, "--frames", "2", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["time_code"] == 2 and said["prim_path"] == "/World/smoke"
    assert set(said["loss"]) == {"glow alone", "as painted", "once, traced", "all bounces, traced"}
    assert len(set(said["loss"].values())) == 4
    once, final = said["light"]["once, traced"], said["light"]["all bounces, traced"]
    assert said["bounces_add"] == pytest.approx(final / once - 1) and final > 10 * once
    assert set(dark.bounces) == {0, 1, 64}  # a glow that is not scattered, light once, and all
    assert {path.name for path in output.iterdir()} == {"final.png", "final.json"}
    assert json.loads((output / "final.json").read_text())["loss"] == said["loss"]


def test_pictures_are_exposed_as_the_look_says(lit_look, dark, tmp_path):
    style, words = make_style(tmp_path / "style.png"), lit_look.read_text(encoding="utf-8")
    plain, _ = check_final(lit_look, style, tmp_path / "plain")
    albedo = "float usdSmoke:albedo = 0.8"
    lit_look.write_text(words.replace(albedo, f"{albedo}\n        float usdSmoke:exposure = 1"))
    exposed, _ = check_final(lit_look, style, tmp_path / "exposed")
    assert exposed.light == pytest.approx({name: 2 * v for name, v in plain.light.items()})


def test_the_painted_picture_has_the_bounces_that_the_look_was_painted_for(
    lit_look, dark, tmp_path
):
    style, words = make_style(tmp_path / "style.png"), lit_look.read_text(encoding="utf-8")
    once, _ = check_final(lit_look, style, tmp_path / "once")
    albedo = "float usdSmoke:albedo = 0.8"
    lit_look.write_text(words.replace(albedo, f"{albedo}\n        bool usdSmoke:bounces = 1"))
    often, _ = check_final(lit_look, style, tmp_path / "often")
    assert often.light["glow alone"] == once.light["glow alone"]
    lit = [look.light["as painted"] - look.light["glow alone"] for look in (once, often)]
    assert lit[1] > 1.1 * lit[0] > 0


def test_a_stage_without_a_look_is_refused(dark, tmp_path):
    look_of_four_frames(tmp_path)
    with pytest.raises(StageError, match="look"):
        check_final(tmp_path / "shot.usda", make_style(tmp_path / "a.png"), tmp_path / "report")
    assert not (tmp_path / "report").exists()


@pytest.mark.parametrize("empty", [False, True])
def test_the_frame_nearest_to_the_middle_that_has_a_look_is_drawn(empty, dark, tmp_path):
    stage = plume_stage(tmp_path / "in", (1, 2, 3, 4, 5))
    (tmp_path / "out").mkdir()
    look = make_look(stage, tmp_path / "out", frames="1-2", empty=empty)
    found, _ = check_final(look.root_stage, make_style(tmp_path / "a.png"), tmp_path / "report")
    assert found.time_code == 2
    with pytest.raises(StageError, match="timeCode 5"):
        check_final(look.root_stage, tmp_path / "a.png", tmp_path / "r", {"stage.frames": "5"})


@pytest.mark.skipif(HAS_MITSUBA, reason="Mitsuba 3 is installed")
def test_without_mitsuba_the_error_says_how_to_install_it(lit_look, tmp_path):
    with pytest.raises(MissingPackage, match="install mitsuba"):
        check_final(lit_look, make_style(tmp_path / "a.png"), tmp_path / "report")

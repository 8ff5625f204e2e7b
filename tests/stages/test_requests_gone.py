"""Images of a request that are gone: who minds, and who does not."""

from pathlib import Path

import pytest

from tests.fixtures.pipeline_fixtures import make_style
from tests.fixtures.usd_fixtures import write_text
from tests.stages.test_requests import write_stage
from usdsmoke import pipeline, stylize, verify
from usdsmoke.pipeline import Request
from usdsmoke.usd.inspect import inspect

CAMERA = """def Camera "camera"
    {
        double3 xformOp:translate = (1, 0, 9)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
"""


@pytest.mark.usefixtures("core")
def test_an_image_that_is_gone_matters_only_to_who_would_take_it(tmp_path: Path) -> None:
    request = "asset[] @@styleImages = [@./style.png@]\nrel @@camera = </World/camera>"
    animated = "double @@strength.timeSamples = { 1: 0.25, 3: 0.5 }"
    stage = write_stage(tmp_path / "in", smoke=f"{request}\n{animated}")
    text = stage.read_text(encoding="utf-8").rstrip().removesuffix("}")
    write_text(stage, f"{text}{CAMERA}}}\n")
    style = make_style(tmp_path / "in/style.png")
    look = stylize(stage, None, tmp_path / "out").look_layer
    assert verify(look) == []
    kept = style.rename(tmp_path / "kept.png")
    assert [change.kind for change in verify(look)] == ["style-missing"]  # the stage is the same
    plan = pipeline.plan_request(Request(stage, kept, tmp_path / "other"))
    assert plan.volumes[0].config.optimize.strength == 0.5
    (volume,) = inspect(stage, style=kept)["volumes"]
    assert volume["request"]["styles"] == {"value": [str(kept)], "origin": "option"}

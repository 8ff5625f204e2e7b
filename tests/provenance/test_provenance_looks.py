"""Records of runs whose Volumes ask for settings of their own, and of assets with several looks."""

from pathlib import Path

import pytest
from PIL import Image

from tests.fixtures.pipeline_fixtures import Shot, run
from tests.stages.test_requests import flat_style, write_stage
from usdsmoke.audit import provenance, rerun, verify
from usdsmoke.base.errors import LayerError
from usdsmoke.pipeline import StylizeResult, stylize

RED = "asset[] @@styleImages = [@./red.png@]\nint64 @@seed = 2"
BLUE = "asset[] @@styleImages = [@./blue.png@]"


@pytest.fixture
def asked(tmp_path: Path, core: object) -> tuple[Path, StylizeResult]:
    """Two Volumes with images of their own, one of which asks for a seed; and a result of both."""
    stage = write_stage(tmp_path / "in", smoke=RED, steam=BLUE)
    flat_style(tmp_path / "in/red.png", (255, 0, 0))
    flat_style(tmp_path / "in/blue.png", (0, 0, 255))
    return stage, stylize(stage, None, tmp_path / "out", settings=["shape.iterations=[5]"])


def test_images_that_prims_bring_are_on_record_and_compared(
    asked: tuple[Path, StylizeResult],
) -> None:
    stage, result = asked
    (record,) = provenance(result.root_stage)
    assert {style.file for style in record.record.styles} == {"../in/blue.png", "../in/red.png"}
    assert verify(result.root_stage) == []
    Image.new("RGB", (8, 8), (250, 0, 0)).save(stage.parent / "red.png")
    (change,) = verify(result.root_stage)
    assert (change.kind, change.file) == ("style-edited", str(stage.parent / "red.png"))


def test_a_changed_request_is_a_changed_stage(asked: tuple[Path, StylizeResult]) -> None:
    stage, result = asked
    stage.write_text(stage.read_text().replace("seed = 2", "seed = 4"))
    (change,) = verify(result.root_stage)
    assert (change.kind, change.file) == ("stage-edited", str(stage))
    assert change.expected == '</World/smoke> request {"optimize": {"seed": 2}}'
    assert change.found == '</World/smoke> request {"optimize": {"seed": 4}}'


def test_prims_and_the_command_have_the_same_say_once_more(
    asked: tuple[Path, StylizeResult], tmp_path: Path
) -> None:
    again = rerun(asked[1].root_stage, tmp_path / "again")
    assert (again.n_frames, again.differences) == (6, ())
    (one,), (other,) = provenance(asked[1].look_layer), provenance(tmp_path / "again")
    assert one.record.explicit == other.record.explicit == ("shape.iterations",)


@pytest.mark.usefixtures("core")
def test_an_asset_leads_to_all_of_its_looks_and_each_can_be_made_again(shot: Shot) -> None:
    run(shot, "layer.mode=reference", "layer.look=fire")
    ice = run(shot, "layer.mode=reference", "layer.look=ice", "optimize.seed=1")
    asset = ice.root_stage
    assert {found.record.seed for found in provenance(asset)} == {0, 1}
    assert verify(asset) == [] and verify(shot.output) == []
    with pytest.raises(LayerError, match=r"several looks: .*fire.*ice"):
        rerun(asset, shot.folder / "again")
    again = rerun(ice.look_layer, shot.folder / "again")
    assert again.differences == ()
    (record,) = provenance(again.result.root_stage)
    assert record.record.seed == 1

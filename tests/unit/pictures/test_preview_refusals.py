"""Previews that cannot be drawn: what is said, and that nothing is written."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.fixtures.preview_fixtures import add_camera, look_of_four_frames
from tests.fixtures.usd_fixtures import file_hashes, plume_stage, world, write_text, write_vdb
from usdsmoke.base.errors import (
    ConfigError,
    GridError,
    PlanError,
    StageError,
    VolumeNotFound,
    WriteFailed,
)
from usdsmoke.pictures.preview import preview

pytestmark = pytest.mark.usefixtures("quick_grids")


@pytest.fixture
def look(tmp_path: Path) -> Path:
    """The root layer of a look of four frames."""
    return look_of_four_frames(tmp_path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"output": "a.tif"}, r"\.tif.*\.png.*\.exr"),
        ({"output": "a"}, r"suffix.*\.png"),
        ({"background": "white"}, "white.*grey, black, none"),
        ({"width": 0}, "--width is 0"),
        ({"width": 10, "size": (3, 4)}, "--width and --size"),
        ({"size": (40_000, 40_000)}, "40000 x 40000.*16 million"),
        ({"size": (3900, 3900), "compare": True}, "6 pictures of 3900 x 3900"),
        ({"background": "none"}, "3 pictures.*transparent"),
        ({"settings": "windows.size=3"}, "windows.size.*stage"),
        ({"frames": "1-"}, "cannot read the frames '1-'"),
    ],
)
def test_what_cannot_be_fulfilled_is_refused_and_nothing_written(
    options: Mapping[str, object], message: str, look: Path, tmp_path: Path
) -> None:
    before = file_hashes(tmp_path)
    words = {"output": "a.png", **options}
    words["output"] = tmp_path / str(words["output"])
    with pytest.raises(ConfigError, match=message):
        preview(look, **words)  # type: ignore[arg-type]
    assert file_hashes(tmp_path) == before


def test_what_is_not_on_the_stage_is_said_with_what_is(look: Path, tmp_path: Path) -> None:
    target = tmp_path / "a.png"
    stage = add_camera(look, "/cameras/side", (0.0, -50.0, 0.0))
    with pytest.raises(StageError, match=r"no prim </cameras/top>.*</cameras/side>"):
        preview(stage, target, camera="/cameras/top")
    with pytest.raises(StageError, match="/World/smoke> has 1-4"):
        preview(look, target, frames="9")
    with pytest.raises(VolumeNotFound, match="no Volume"):
        preview(write_text(tmp_path / "no.usda", world("")), target)
    with pytest.raises(StageError, match="by usdsmoke"):
        preview(tmp_path / "in/shot.usda", target, compare=True)
    with pytest.raises(VolumeNotFound, match="root layer"):
        preview(look.with_name("look.usda"), target)
    with pytest.raises(StageError, match="no file"):
        preview(tmp_path / "none.usda", target)
    with pytest.raises(WriteFailed, match=r"no folder .*none"):
        preview(look, tmp_path / "none/a.png")
    assert not target.exists()


def test_a_grid_that_cannot_be_used_is_met_before_anything_is_written(tmp_path: Path) -> None:
    stage = plume_stage(tmp_path)
    write_vdb(tmp_path / "cache/smoke.0003.vdb", grid_class="level set")
    with pytest.raises(GridError, match="level set"):
        preview(stage, tmp_path / "a.exr", frames="2-3", width=16)
    assert not list(tmp_path.glob("*.exr"))


def test_a_frame_that_does_not_fit_the_memory_is_refused(
    look: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("usdsmoke.pictures.preview_smoke.available_memory_gib", lambda: 0.25)
    with pytest.raises(PlanError, match=r"timeCode 1 needs about .* 24 voxels.* 0\.2 GiB"):
        preview(look, tmp_path / "a.png")
    assert not (tmp_path / "a.png").exists()

"""A shot for a farm: three windows that overlap, and what one process makes of it."""

import re
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.pipeline_fixtures import FakeCore, Shot, contents, copied, make_shot, run, stand_in
from usdsmoke.pipeline import Request, run_window

__all__ = ["OPTIONS", "WINDOWS", "Outcome", "farm", "outcome", "run_folder", "whole", "windows_in"]

WINDOWS = ["windows.size=3", "windows.overlap=2"]  # 1-3 and on to 5, 4-6 and on to 7, 7
OPTIONS = [part for text in WINDOWS for part in ("--set", text)]

Outcome = tuple[dict[float, object], str]


@pytest.fixture(scope="session")
def farm_source(tmp_path_factory: pytest.TempPathFactory) -> Shot:
    """Seven frames; copies of one shot, because VDB files written again have other bytes."""
    return make_shot(tmp_path_factory.mktemp("farm") / "source", n_frames=7)


@pytest.fixture
def farm(tmp_path: Path, farm_source: Shot, core: FakeCore) -> Shot:
    """Seven frames, three windows."""
    return copied(farm_source, tmp_path / "shot")


@pytest.fixture(scope="session")
def whole(farm_source: Shot) -> Outcome:
    """What one process makes of the same shot."""
    with pytest.MonkeyPatch.context() as patch:
        stand_in(patch)
        return outcome(run(copied(farm_source, "whole"), *WINDOWS).root_stage)


def outcome(root_stage: Path) -> Outcome:
    """Content hashes by timeCode, and the look layer's text without clock times and run id."""
    (look,) = root_stage.parent.glob("look*.usda")
    text = look.read_text()
    run_id = re.search(r'string run = "([^"]+)"', text)
    assert run_id is not None
    for name in (run_id[1], run_id[1].replace("-", "")[:8]):
        text = text.replace(name, "RUN")
    text = re.sub(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", "TIME", text)
    clock = r'(\\"(?:seconds|stylize|coarse|shape|colour|estimates)\\": )[\d.e-]+'
    text = re.sub(clock, r"\1SECONDS", text)
    text = re.sub(r'( seconds\\": )\{.*?\}', r"\1SECONDS", text)  # figures over the frames
    return contents(root_stage), re.sub(r'(layerHash|recordHash) = "\w+"', r"\1 = HASH", text)


def windows_in(shot: Shot, order: Sequence[int]) -> None:
    for window in order:
        run_window(Request(shot.stage, shot.style, shot.output, WINDOWS), window)


def run_folder(shot: Shot) -> Path:
    (record,) = shot.output.glob("vdb/*/run.json")
    return record.parent

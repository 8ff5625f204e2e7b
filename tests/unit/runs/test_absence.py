"""Why an entry of the error budget has no figure, or not one of every pair: the true reason."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.fixtures.pipeline_fixtures import make_shot
from usdsmoke import pipeline
from usdsmoke.base.frame_report import FrameReport, TemporalErrors
from usdsmoke.pipeline import Request
from usdsmoke.runs.budget import ErrorBudget, run_budget
from usdsmoke.ui.cli.budget_text import budget_text

ALONE = FrameReport(voxels=5)
PAIR = FrameReport(temporal=TemporalErrors(0.1, 0.2))
EMPTY = FrameReport(left_out="empty frame")


def budget_of(
    folder: Path, reports: Sequence[FrameReport], *settings: str, n_frames: int = 4
) -> ErrorBudget:
    """Of a shot whose frames had these reports."""
    shot = make_shot(folder, n_frames)
    plan = pipeline.plan_request(Request(shot.stage, shot.style, shot.output, list(settings)))
    names = [frame.file_name for frame in plan.volumes[0].frames]
    return run_budget(plan, dict(zip(names, reports, strict=True)))


@pytest.mark.parametrize(
    ("settings", "reasons"),
    [
        (
            ["optimize.error_budget=false"],
            dict.fromkeys(["quadrature", "resolution", "unseen views"], "optimize.error_budget"),
        ),
        (
            ["windows.size=1"],
            {"temporal, colour": "windows.size is 1", "windows, density": "windows.size is 1"},
        ),
        (["windows.size=2", "windows.overlap=0"], {"windows, density": "windows.overlap is 0"}),
        ([], {"windows, density": "there is one window", "optimiser, shape": "too few iterations"}),
        (
            ["optimize.steps=[shape]"],
            {"quadrature": "opacity", "temporal, colour": "no colour", "view sampling": "few"},
        ),
        (["optimize.steps=[colour]"], {"transport": "no shape", "optimiser, shape": "no shape"}),
        (
            ["views.azimuth=0", "views.elevation=0"],
            dict.fromkeys(["view sampling", "unseen views"], "all views are the same"),
        ),
        (["views.pool=1"], {"view sampling": "views.pool is 1"}),
        (["shape.interpolation=linear"], {"optimiser's transport": "is linear"}),
    ],
)
def test_the_reason_is_the_setting_that_is_to_blame(
    settings: list[str], reasons: dict[str, str], tmp_path: Path
) -> None:
    found = budget_of(tmp_path, [ALONE] * 4, *settings).left_out
    for name, text in reasons.items():
        assert text in found[name], found[name]


def test_one_frame_has_no_frame_before_it(tmp_path: Path) -> None:
    found = budget_of(tmp_path, [ALONE], n_frames=1).left_out
    assert "one frame" in found["temporal, displacement"]


def test_frames_that_were_left_out_are_the_reason_for_everything(tmp_path: Path) -> None:
    found = budget_of(tmp_path, [EMPTY] * 4).left_out
    for name in ("quadrature", "transport", "optimiser, colour", "temporal, colour"):
        assert "empty frame" in found[name]


def test_the_border_between_windows_is_named_as_not_measured(tmp_path: Path) -> None:
    budget = budget_of(tmp_path, [ALONE, PAIR, ALONE, PAIR], "windows.size=2", "windows.overlap=0")
    note = budget.notes["temporal, colour"]
    assert note.startswith("2 of 3 pairs") and "border (2-3)" in note
    assert note in budget_text(budget)
    assert ErrorBudget.from_json(budget.to_json()) == budget


def test_a_frame_without_effect_is_no_border(tmp_path: Path) -> None:
    note = budget_of(tmp_path, [ALONE, EMPTY, PAIR, PAIR]).notes["temporal, colour"]
    assert note.startswith("2 of 3 pairs") and "border" not in note and "not 1 where" in note


@pytest.mark.parametrize(("speed", "told"), [(0.0, True), (1.0, False), (2.0, True)])
def test_a_pattern_of_its_own_speed_is_named_as_the_reference(
    speed: float, told: bool, tmp_path: Path
) -> None:
    settings = [f"windows.pattern_speed={speed}", "stage.motion=estimate"]
    notes = budget_of(tmp_path, [ALONE, PAIR, PAIR, PAIR], *settings).notes
    assert ("windows.pattern_speed" in notes.get("temporal, colour", "")) == told


def test_windows_that_overlap_have_every_pair(tmp_path: Path) -> None:
    settings = ["windows.size=2", "windows.overlap=1"]
    note = budget_of(tmp_path, [ALONE, PAIR, PAIR, PAIR], *settings).notes["temporal, colour"]
    assert note.startswith("3 of 3 pairs") and "in overlaps" in note

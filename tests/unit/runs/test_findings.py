"""What deserves a look in a run: found in reports, each with its cause and its remedy."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.fixtures.budget_fixtures import GOOD, budget_of
from usdsmoke.base.frame_report import (
    Estimate,
    FrameErrors,
    FrameReport,
    LightReport,
    LookReport,
    StepReport,
    TemporalErrors,
    TransportReport,
)
from usdsmoke.config.settings import Config
from usdsmoke.runs.budget import ErrorBudget, Finding
from usdsmoke.runs.budget.findings import find_frame
from usdsmoke.ui.cli.budget_text import budget_text


def test_ordinary_frames_have_no_finding(tmp_path: Path) -> None:
    warm = replace(
        GOOD,
        shape=StepReport(loss=(1.9,), fallen=0.1),
        colour=StepReport(loss=(1.4,), fallen=0.2),
        temporal=TemporalErrors(0.2, 0.1),
    )
    goes_on = replace(GOOD, colour=StepReport(loss=(1.6,), fallen=0.3))  # from a coarse step
    plume = replace(GOOD, shape=StepReport(loss=(4.0, 3.1, 2.1), fallen=1.9))
    far = replace(GOOD, colour=StepReport(loss=(9.3, 7.0, 4.8), fallen=4.5, remaining=0.1))
    empty = FrameReport(left_out="empty frame")
    budget = budget_of(tmp_path, [GOOD, warm, empty, warm, goes_on, plume])
    assert budget.findings == budget_of(tmp_path, [far]).findings == ()
    assert {budget.verdict(estimate.name) for estimate in budget.estimates} == {"fine"}


@pytest.mark.parametrize(
    ("changes", "row", "setting"),
    [
        (
            {"transport": replace(GOOD.transport, largest_displacement=1e-9)},
            "motionless mass",
            "optimize.steps",
        ),
        (
            {"transport": TransportReport(1.0, 0.0, folded=0.0, motionless=1.0)},
            "motionless mass",
            "optimize.steps",
        ),
        ({"voxels_written": 980}, "mass", "shape.reach"),
        ({"voxels_written": 0}, "mass", "shape.reach"),
        (
            {"colour": StepReport(loss=(9.4, 7.0, 6.3), fallen=3.1)},
            "optimiser, colour",
            "colour.iterations",
        ),
        ({"errors": FrameErrors(resolution=Estimate(2.27))}, "resolution", "grids.refine"),
        (
            {"transport": replace(GOOD.transport, folded=0.15)},
            "folded smoke",
            "shape.reach",
        ),
    ],
)
def test_what_went_wrong_is_named_with_its_row_and_its_remedy(
    changes: dict[str, Any], row: str, setting: str, tmp_path: Path
) -> None:
    budget = budget_of(tmp_path, [replace(GOOD, **changes)])
    found = {(finding.row, finding.setting) for finding in budget.findings}
    assert (row, setting) in found
    assert budget.verdict(row) == f"change {setting}"
    assert all(finding.place.endswith(".vdb") for finding in budget.findings)
    assert ErrorBudget.from_json(budget.to_json()) == budget
    if row in {estimate.name for estimate in budget.estimates}:
        assert f"change {setting}" in budget_text(budget)


STILL = {"transport": replace(GOOD.transport, largest_displacement=1e-9)}
FAST = {"colour": StepReport(loss=(9.0, 9.0, 9.0), fallen=0.0)}
COARSE = {"errors": FrameErrors(resolution=Estimate(2.0), pixel_filter=Estimate(2.0))}
UNSTEADY = {"temporal": TemporalErrors(0.2, 0.9)}
SLOW = {"colour": StepReport(loss=(9.0, 9.0, 8.9), fallen=0.1, way=0.02)}


@pytest.mark.parametrize(
    ("changes", "row", "settings"),
    [
        (STILL, "motionless mass", ["losses.keep=1000000.0"]),
        (STILL, "motionless mass", ["losses.content=1000000.0"]),
        (STILL, "motionless mass", ["optics.gamma_shape=0.001"]),
        (STILL, "motionless mass", ["optics.depth_shape=1000000.0"]),
        ({"voxels_written": 500}, "mass", ["grids.prune=0.5"]),
        ({"voxels_written": 500}, "mass", ["grids.half=true"]),
        (
            {"errors": FrameErrors(storage_density=Estimate(0.7))},
            "storage, density",
            ["grids.prune=0.5"],
        ),
        ({}, "optimiser, shape", ["shape.reach=1e-05"]),
        (FAST, "optimiser, colour", ["optimize.iterations=30"]),
        (
            {"colour": StepReport(loss=(1.5,), remaining=1.2)},
            "optimiser, colour",
            ["optimize.iterations=30"],
        ),
        (SLOW, "optimiser, colour", ["colour.learning_rate=0.001"]),
        (FAST, "optimiser, colour", ["colour.learning_rate=1000.0"]),
        (FAST, "optimiser, colour", ["losses.nearest=1000000.0"]),
        (COARSE, "resolution", ["views.image_size=32"]),
        (COARSE, "pixel filter", ["views.image_size=32"]),
        (UNSTEADY, "temporal, colour", ["windows.pattern_speed=4.0"]),
    ],
)
def test_the_setting_that_is_named_is_the_one_that_was_changed(
    changes: dict[str, Any], row: str, settings: list[str], tmp_path: Path
) -> None:
    budget = budget_of(tmp_path, [replace(GOOD, **changes)], settings=settings)
    assert budget.verdict(row) == f"change {settings[0].partition('=')[0]}"


@pytest.mark.parametrize(
    ("reason", "settings", "wanted"),
    [
        ("the mask is 0 wherever there is smoke", [], ["stage.mask"]),
        ("outside the camera's frustum", [], ["views.camera"]),
        ("outside the camera's clipping planes (10 and 100)", [], ["views.camera"]),
        ("empty frame", [], [""]),
        ("losses.style is 0", ["losses.style=0"], []),
        ("strength 0", ["optimize.strength=0"], []),
    ],
)
def test_a_shot_of_which_nothing_is_stylized_says_so(
    reason: str, settings: list[str], wanted: list[str], tmp_path: Path
) -> None:
    left_out = FrameReport(left_out=reason)
    budget = budget_of(tmp_path, [left_out, left_out], settings=settings)
    assert [finding.setting for finding in budget.findings] == wanted
    assert all(reason in text for text in budget.warnings)
    assert budget_of(tmp_path / "part", [left_out, GOOD], settings=settings).findings == ()


def test_a_camera_with_few_pixels_is_told_to_have_more() -> None:
    config = Config.model_validate({"views": {"camera": "/cam", "camera_width": 8}})
    found = list(find_frame("a.vdb", replace(GOOD, **COARSE), config))
    assert {finding.setting for finding in found} == {"views.camera_width"}


def test_a_velocity_that_does_not_move_the_smoke_speaks_against_steadiness(tmp_path: Path) -> None:
    doubt = "the densities agree better against it. Check the direction."
    warm = replace(GOOD, temporal=TemporalErrors(0.2, 0.1), velocity_doubt=doubt)
    budget = budget_of(tmp_path, [GOOD, warm, warm])
    (told,) = budget.warnings
    assert "agree better against it" in told and told.endswith("Check the direction.")
    (steady,) = [part for part in budget.verdicts if part.about == "steadiness over time"]
    assert steady.verdict == "look at it" and "against it" in steady.why


def test_smoke_that_no_potential_moves_is_told_once() -> None:
    moved = TransportReport(1.0, 0.0, motionless=1.0)
    for shape in (StepReport(), StepReport(loss=(4.0,))):
        (finding,) = find_frame("a.vdb", replace(GOOD, shape=shape, transport=moved), Config())
        assert (finding.row, finding.setting) == ("motionless mass", "optimize.steps")


@pytest.mark.parametrize(
    ("views", "wanted"), [({"camera": "/cam"}, "views.camera"), ({}, "views.image_size")]
)
def test_a_step_with_iterations_that_does_nothing_is_laid_to_its_pictures(
    views: dict[str, str], wanted: str
) -> None:
    idle = replace(GOOD, shape=StepReport(), transport=TransportReport(1.0, 0.0, folded=0.0))
    (finding,) = find_frame("a.vdb", idle, Config(views=views))
    assert finding.setting == wanted


@pytest.mark.parametrize(
    ("look", "light", "wanted"),
    [
        (LookReport(0.0, 0.1, shown=0.9), None, "colour.iterations"),
        (LookReport(0.0, 0.1, shown=0.2), None, "style.size"),
        (LookReport(0.3, 0.5), None, "colour.iterations"),
        (LookReport(0.3, 0.5, white=0.001), None, ""),
        (LookReport(0.3, 0.5), LightReport(0.3, 0.1, 1.2, -2.0), "optics.albedo"),
        (LookReport(0.3, 0.5), LightReport(0.08, 0.0, 0.1, 4.0), "colour.iterations"),
    ],
)
def test_pictures_unlike_the_style_have_the_remedy_of_their_cause(
    look: LookReport, light: LightReport | None, wanted: str, tmp_path: Path
) -> None:
    unfinished = replace(
        GOOD, look=look, light=light, colour=StepReport(loss=(9.0, 1.0), remaining=0.4)
    )
    (found,) = [f for f in budget_of(tmp_path, [unfinished]).findings if f.row]
    assert found.setting == wanted
    if wanted == "colour.iterations":  # a step that is done does not get farther with more
        done = replace(unfinished, colour=StepReport(loss=(9.0, 1.0), remaining=0.01))
        (found,) = [f for f in budget_of(tmp_path / "done", [done]).findings if f.row]
        assert found.setting == "style.size"


def test_a_mask_may_be_why_the_loss_hardly_falls() -> None:
    report, plain = replace(GOOD, **FAST), Config()
    masked = Config(stage=plain.stage.replace(mask="fade"))
    (finding,), (usual,) = (find_frame("a.vdb", report, config) for config in (masked, plain))
    assert "mask" in finding.remedy and "mask" not in usual.remedy


@pytest.mark.parametrize("place", [0, 1])
def test_of_two_neighbours_the_one_with_three_times_the_loss_is_named(
    place: int, tmp_path: Path
) -> None:
    reports = [replace(GOOD, temporal=TemporalErrors(0.1, 0.1))] * 2
    reports[place] = replace(reports[place], colour=StepReport(loss=(4.6,)))
    (finding,) = budget_of(tmp_path, reports).findings
    assert finding.place.endswith(f".{place + 1:04}.vdb")
    assert finding.row == "optimiser, colour" and "3.1 times" in finding.cause


def test_frames_with_an_empty_one_between_them_are_not_compared(tmp_path: Path) -> None:
    worse = replace(GOOD, colour=StepReport(loss=(9.0,)))
    reports = [GOOD, FrameReport(left_out="empty frame"), worse]
    assert budget_of(tmp_path, reports).findings == ()


def test_a_pattern_that_runs_away_from_its_smoke_is_not_given_more_iterations(
    tmp_path: Path,
) -> None:
    colour = StepReport(loss=(9.0, 1.0), remaining=0.4)
    poor = replace(GOOD, look=LookReport(0.0, 0.1, shown=0.9), colour=colour)
    for speed, setting in ((-8, "windows.pattern_speed"), (0, "colour.iterations")):
        settings, folder = [f"windows.pattern_speed={speed}"], tmp_path / f"{speed}"
        found = {f.setting for f in budget_of(folder, [poor], settings=settings).findings}
        assert found == {setting}


def test_a_cold_step_without_iterations_is_named_by_itself(tmp_path: Path) -> None:
    idle = replace(GOOD, shape=StepReport(), transport=TransportReport(1.0, 0.0, folded=0.0))
    none = ["shape.iterations=[0,0,0]"]
    (finding,) = budget_of(tmp_path, [idle], settings=none).findings
    assert finding.setting == "shape.iterations" and "no iterations" in finding.cause
    warm = replace(idle, temporal=TemporalErrors(0.2, 0.1))
    assert budget_of(tmp_path, [GOOD, warm], settings=none).findings == ()


def test_a_hundred_frames_with_one_finding_are_one_sentence() -> None:
    findings = [Finding(f"{n}.vdb", "mass", f"{n} voxels are gone", "Look") for n in range(100)]
    (text,) = ErrorBudget((), {}, {}, {}, tuple(findings)).warnings
    assert text == "0.vdb and 99 more: 0 voxels are gone. Look."

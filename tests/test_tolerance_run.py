"""A run with a tolerance: its settings, its calibration in the output folder, what is told."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.pipeline_fixtures import Shot, make_shot
from tests.unit.runs.test_choice import MEASURED
from usdsmoke import pipeline
from usdsmoke.audit import rerun
from usdsmoke.base.errors import PlanError
from usdsmoke.pipeline import Request, assemble, run_window, stylize
from usdsmoke.planning.job import Job
from usdsmoke.planning.plan import Plan
from usdsmoke.runs import tolerance as pipeline_tolerance
from usdsmoke.ui.cli.main import main
from usdsmoke.work_precision import make_report


@pytest.fixture
def shot(tmp_path: Path) -> Shot:
    return make_shot(tmp_path)


@pytest.fixture
def measurements(core: Any, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How often a frame was measured."""
    counted: list[int] = []

    def measure(job: Any) -> dict[str, Any]:
        counted.append(1)
        return MEASURED

    monkeypatch.setattr(pipeline_tolerance, "_measure", measure)
    return counted


def run(shot: Shot, target: float | None = 0.3, *more: str, output: str = "out") -> Plan:
    settings = [] if target is None else [f"optimize.target_error={target}"]
    return stylize(shot.stage, shot.style, shot.folder / output, settings=[*settings, *more]).plan


def test_settings_are_chosen_and_the_plan_tells_why(shot: Shot, measurements: list[int]) -> None:
    plan = run(shot)
    assert (plan.config.views.image_size, plan.config.views.pool) == (80, 4)
    assert plan.config.grids.half and plan.config.shape.interpolation == "linear"
    assert "settings for a tolerance of 0.3" in plan.notes
    assert any(text.startswith("views.image_size=80: resolution 0.02") for text in plan.notes)


def test_what_is_set_wins_and_is_named(shot: Shot, measurements: list[int]) -> None:
    plan = run(shot, 0.3, "views.image_size=192", "grids.half=false")
    assert plan.config.views.image_size == 192 and not plan.config.grids.half
    assert any(text.startswith("views.image_size=192 as ") for text in plan.notes)


def test_a_frame_is_measured_once_for_all_tolerances(shot: Shot, measurements: list[int]) -> None:
    for target in (0.3, 0.1, 0.3):
        settings = {"optimize": {"target_error": target}}
        stylize(shot.stage, shot.style, shot.output, settings=settings, force=True)
    assert len(measurements) == 1
    (kept,) = shot.output.glob("vdb/calibration/*.json")
    assert json.loads(kept.read_text()) == MEASURED


def test_other_inputs_are_measured_anew(shot: Shot, measurements: list[int]) -> None:
    run(shot)
    stylize(
        shot.stage, shot.style, shot.output, force=True,
        settings={"optimize": {"target_error": 0.3}, "shape": {"reach": 0.1}},
    )  # fmt: skip
    assert len(measurements) == 2


def test_without_a_tolerance_nothing_is_measured(shot: Shot, measurements: list[int]) -> None:
    assert run(shot, None).config.views.image_size == 192
    assert not measurements and not (shot.output / "vdb/calibration").exists()


def test_windows_run_one_by_one_choose_the_same(shot: Shot, measurements: list[int]) -> None:
    settings = {"optimize": {"target_error": 0.3}, "windows": {"size": 2, "overlap": 0}}
    for window in (0, 1):
        run_window(Request(shot.stage, shot.style, shot.output, settings), window)
    result = assemble(shot.output)
    assert result.plan.config.views.image_size == 80 and len(measurements) == 1


def test_a_rerun_has_the_settings_that_were_chosen(shot: Shot, measurements: list[int]) -> None:
    result = stylize(shot.stage, shot.style, shot.output, settings=["optimize.target_error=0.3"])
    again = rerun(result.look_layer, shot.folder / "again")
    assert again.differences == () and len(measurements) == 1
    assert again.result.plan.config.grids == result.plan.config.grids


def dry_plan(shot: Shot, *more: str) -> str:
    settings = ["optimize.target_error=0.3", *more]
    return "\n".join(
        pipeline.plan_request(Request(shot.stage, shot.style, shot.output, settings)).notes
    )


def test_a_plan_alone_says_that_the_choice_is_still_to_come(
    shot: Shot, measurements: list[int]
) -> None:
    assert "settings are not final: a run with --tolerance 0.3" in dry_plan(shot)
    assert not measurements and not shot.output.exists()


def test_a_plan_alone_takes_a_calibration_that_is_there(
    shot: Shot, measurements: list[int]
) -> None:
    ran = run(shot, 0.3)
    found = pipeline.plan_request(
        Request(shot.stage, shot.style, shot.output, ["optimize.target_error=0.3"])
    )
    optimize = found.config.optimize.replace(threads=ran.config.optimize.threads, device="cpu")
    assert found.config.replace(optimize=optimize) == ran.config
    assert found.notes == ran.notes
    assert len(measurements) == 1
    assert "settings are not final" in dry_plan(shot, "shape.reach=0.1")  # other inputs


def test_a_report_is_on_the_settings_that_were_chosen(
    shot: Shot, measurements: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Job] = []

    def stop(job: Job, *more: Any) -> None:
        opened.append(job)
        raise PlanError("seen enough")

    monkeypatch.setattr("usdsmoke.work_precision.report.open_case", stop)
    with pytest.raises(PlanError, match="seen enough"):
        make_report(shot.stage, shot.style, shot.output, settings=["optimize.target_error=0.3"])
    assert opened[0].config.views.image_size == 80 and len(measurements) == 1
    assert opened[0].plan.notes[0] == "settings for a tolerance of 0.3"
    assert not (shot.output / "vdb").exists()


def test_the_option_of_the_command(
    shot: Shot, measurements: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(shot.arguments("--tolerance", "0.3")) == 0
    assert "settings for a tolerance of 0.3" in capsys.readouterr().err
    assert main(shot.arguments("--tolerance", "0", "--force")) == 1
    assert "--tolerance is 0" in capsys.readouterr().err

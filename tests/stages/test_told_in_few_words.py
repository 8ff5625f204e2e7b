"""What a person reads of a run, and small faults of stages that stay out of results."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf

from tests.fixtures.pipeline_fixtures import Shot, make_shot, run
from tests.fixtures.usd_fixtures import density_prim, sequence, volume_prim, world
from usdsmoke.pictures import compose_sheet
from usdsmoke.pipeline import plan
from usdsmoke.planning.plan import Plan
from usdsmoke.runs.budget import ErrorBudget, Finding
from usdsmoke.runs.budget.error_budget import ErrorEstimate
from usdsmoke.runs.budget.rows import ROWS
from usdsmoke.ui.cli.budget_text import budget_text
from usdsmoke.ui.cli.main import main
from usdsmoke.ui.cli.plan_text import plan_text

LIGHTS = """
def DistantLight "sun"
{
    float inputs:intensity = 3
}
def DomeLight "sky"
{
    float inputs:intensity = 1
}
"""


def many_volumes(folder: Path, n_volumes: int, more: str = "") -> Shot:
    """Volumes with fields and a mesh of remarks each, on one sequence."""
    shot = make_shot(folder, n_frames=3, names=("density", "heat", "vel"))
    prims = density_prim(sequence((1, 2, 3)))
    body = "".join(volume_prim(prims, f"smoke_{n}") for n in range(n_volumes))
    shot.stage.write_text(world(body + more))
    return shot


def check_few(found: Plan) -> list[str]:
    """Ten lines, none of which wraps; the first names the stage's file, wherever it is."""
    few, whole = plan_text(found).splitlines(), plan_text(found, True)
    assert len(few) <= 10
    assert max(map(len, few[1:])) <= 100
    assert all(note in whole for note in found.notes)
    assert all(f"{item.what}: {item.reason}" in whole for item in found.omitted)
    return few


def test_the_plan_of_a_shot_is_ten_lines_and_the_rest_stands_behind_verbose(shot: Shot) -> None:
    found = plan(shot.stage, shot.style, shot.output, {"windows.size": 2, "stage.frames": "1-3"})
    few, all_of_it = check_few(found), plan_text(found, True).splitlines()
    assert not any("total variation" in line for line in few)
    assert any("total variation" in line for line in all_of_it)
    assert any("velocity grids" in line and "stage.motion" in line for line in few)


@pytest.mark.parametrize(
    ("n_volumes", "more", "settings"),
    [
        (2, LIGHTS, ["windows.size=1", "optics.bounces=true"]),
        (6, LIGHTS, ["stage.frames=1-2", "windows.size=1", "layer.contact_sheet=0"]),
        (1, "", ["stage.frames=1-2", "layer.copy_fields=[heat]", "optics.frames=3"]),
    ],
    ids=["two Volumes", "six Volumes", "one Volume"],
)
def test_the_plan_of_any_shot_is_ten_short_lines(
    tmp_path: Path, n_volumes: int, more: str, settings: list[str]
) -> None:
    shot = many_volumes(tmp_path, n_volumes, more)
    few = check_few(plan(shot.stage, shot.style, shot.output, settings))
    assert few[1].startswith("  </World/smoke_0>: ")
    if n_volumes == 6:
        assert few[3] == "  and 4 more Volumes: 8 frames in 8 windows"
        assert "more remark" in few[-1] and "and 5 more" in "".join(few)


@pytest.mark.usefixtures("core")
def test_the_plan_of_a_look_that_grows_is_ten_lines_and_begins_with_that(tmp_path: Path) -> None:
    shot = many_volumes(tmp_path, 2, LIGHTS)
    settings = ("windows.size=1", "layer.contact_sheet=0")
    run(shot, *settings, "stage.frames=1-2")
    few = check_few(plan(shot.stage, shot.style, shot.output, settings))
    assert "grows from the frames 1,2 to 1-3" in few[3]
    assert "kept: timeCodes 1,2, extinction" in few[4] and "to do: timeCode 3" in few[5]


def test_grids_without_a_relationship_are_named_where_the_result_is_without_them(
    tmp_path: Path,
) -> None:
    shot = make_shot(tmp_path, n_frames=1, names=("density", "flame", "heat", "vel"))

    def told(*settings: str) -> str:
        return plan_text(plan(shot.stage, shot.style, shot.output, settings))

    assert "left out: grids flame, heat of </World/smoke>" in told()
    assert "left out: grid flame of" in told("layer.copy_fields=[heat]")
    assert "grid heat" in told("stage.mask=flame")
    assert "left out: grid" not in told("layer.copy_fields=[all]")


@pytest.mark.usefixtures("core")
def test_the_plan_of_a_refused_repetition_speaks_of_no_measuring(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, n_frames=3)
    found = plan(shot.stage, shot.style, shot.output, ["stage.frames=1-2"])
    assert any("measured" in note for note in found.notes)
    run(shot, "stage.frames=1-2")
    again = plan(shot.stage, shot.style, shot.output, ["stage.frames=1-2"])
    assert not any("measured" in note for note in again.notes)


@pytest.mark.usefixtures("core")
def test_rows_without_a_figure_stand_together_by_their_reason(shot: Shot) -> None:
    budget = run(shot).error_budget
    assert budget is not None
    lines = budget_text(budget).splitlines()
    reasons = [line.rpartition(": ")[2] for line in lines if line.startswith("without ")]
    assert len(reasons) == len(set(reasons))
    listed = {name for line in lines if line.startswith("without ") for name in budget.left_out
              if name in line}  # fmt: skip
    assert listed == set(budget.left_out)
    assert any("4 frames" in line and "fewer than 5 frames" in line for line in lines)


def full_budget() -> ErrorBudget:
    estimates = (ErrorEstimate(row.name, 0.1, 0.1, row.relative_to, 1, 0.0, "") for row in ROWS)
    return ErrorBudget(tuple(estimates), {}, {"shape": 1.0})


def test_the_end_of_a_run_is_a_verdict_a_row_worst_first() -> None:
    budget, bad, odd = full_budget(), "mass", "resolution"
    names = {item.name for item in budget.estimates}
    findings = (
        Finding("smoke.0001.vdb", odd, "it is odd", "Look"),
        Finding("smoke.0001.vdb", bad, "it is large", "Set it", "shape.reach"),
    )
    budget = replace(budget, findings=findings)
    few = budget_text(budget, everything=False).splitlines()
    rows = few[1 : few.index(next(line for line in few if line.startswith("--verbose")))]
    verdicts = [line.split("  ")[0] for line in rows]
    assert verdicts[:2] == ["change shape.reach", "look at it"]
    assert set(verdicts[2:]) == {"fine"} and len(rows) <= 8
    assert "it is large" in rows[0] and "it is odd" in rows[1]
    assert [(item.verdict, item.error) for item in budget.verdicts[:2]] == [
        ("change shape.reach", bad), ("look at it", odd),
    ]  # fmt: skip
    whole = budget_text(budget).splitlines()
    assert all(any(row.startswith(name) for row in whole) for name in names)
    assert max(map(len, few[:-1])) <= 100


@pytest.mark.usefixtures("core")
def test_the_notes_of_a_run_stand_at_its_end(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = shot.arguments("--frames", "1-2")
    assert main([*arguments, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["warnings"] and found["verdicts"]
    assert {"about", "verdict", "why", "error", "largest"} == found["verdicts"][0].keys()
    assert main([*arguments, "--force"]) == 0
    last = capsys.readouterr().out.splitlines()[-len(found["warnings"]) :]
    assert last == [f"note: {text}" for text in found["warnings"]]


def test_every_error_belongs_to_a_verdict() -> None:
    budget = full_budget()
    for row in ROWS:
        one = replace(budget, findings=(Finding("a.vdb", row.name, "bad", "Look"),))
        assert [item.error for item in one.verdicts if item.verdict != "fine"] == [row.name]
        assert all(item.why for item in one.verdicts)
    dark = replace(budget, findings=(Finding("a", "", "dark", "Set it", "optics.exposure"),))
    assert dark.verdicts[0].verdict == "change optics.exposure"


def test_the_title_of_a_narrow_sheet_is_whole() -> None:
    picture = np.zeros((16, 16, 3), np.float32)
    title = "</World/a_rather_long_name/of_a_volume>, shot_020_fx_v013.usda"
    sheet = compose_sheet(title, [[("timeCode 1", picture)]], [])
    ink = np.argwhere((sheet[:30] > sheet[0, 0] + 0.2).any(axis=-1))
    assert ink[:, 1].max() < sheet.shape[1] - 4
    longer = compose_sheet(f"{title}, more", [[("timeCode 1", picture)]], [])
    assert longer.shape[1] > sheet.shape[1]


@pytest.mark.usefixtures("core")
def test_a_default_prim_that_is_not_there_is_not_copied(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, n_frames=1)
    shot.stage.write_text(
        shot.stage.read_text().replace('defaultPrim = "World"', 'defaultPrim = "X"')
    )
    result = run(shot)
    for layer in (result.root_stage, result.look_layer):
        assert not Sdf.Layer.FindOrOpen(str(layer)).HasDefaultPrim()

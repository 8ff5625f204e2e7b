"""What a person reads of a run, and small faults of stages that stay out of results."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf

from tests.fixtures.pipeline_fixtures import Shot, make_shot, run
from usdsmoke.pictures import compose_sheet
from usdsmoke.pipeline import plan
from usdsmoke.runs.budget import Finding
from usdsmoke.ui.cli.budget_text import budget_text
from usdsmoke.ui.cli.text import plan_text


def test_the_plan_of_a_shot_is_ten_lines_and_the_rest_stands_behind_verbose(
    shot: Shot,
) -> None:
    found = plan(shot.stage, shot.style, shot.output, {"windows.size": 2, "stage.frames": "1-3"})
    few, all_of_it = plan_text(found).splitlines(), plan_text(found, True).splitlines()
    assert len(few) <= 10
    assert not any("total variation" in line for line in few)
    assert any("total variation" in line for line in all_of_it)
    assert any("velocity grids" in line for line in few)  # what matters


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


@pytest.mark.usefixtures("core")
def test_errors_that_are_fine_are_a_line_and_rows_on_request(shot: Shot) -> None:
    budget = run(shot).error_budget
    assert budget is not None
    bad, *fine = (item.name for item in budget.estimates)
    budget = replace(budget, findings=(Finding("smoke.0001.vdb", bad, "it is large", "Look"),))
    few = budget_text(budget, everything=False).splitlines()
    assert [line.split("  ")[0] for line in few[:2]] == ["error", bad]
    assert few[1].endswith("look at it") and all(name in few[2] for name in fine)
    rows = budget_text(budget).splitlines()
    assert all(any(row.startswith(name) for row in rows) for name in (bad, *fine))


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

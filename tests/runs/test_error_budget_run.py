"""The error budget of whole runs: in the result, in run.json, in the layer's record, in print."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.fixtures.grids_fixtures import raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, make_shot
from tests.fixtures.smoke_fixtures import frame_of, puff
from tests.fixtures.stylize_fixtures import quick_config, run_core
from usdsmoke.audit import provenance
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.config.settings import Config
from usdsmoke.pipeline import assemble, stylize
from usdsmoke.runs.budget import ErrorBudget
from usdsmoke.runs.budget.error_budget import make_budget
from usdsmoke.ui.cli.main import main
from usdsmoke.vdb.read import GridRequest, read_grids


@pytest.fixture
def shot(tmp_path: Path) -> Shot:
    return make_shot(tmp_path)


@pytest.mark.usefixtures("core")
def test_the_same_budget_stands_in_result_record_and_layer(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    result = stylize(shot.stage, shot.style, shot.output)
    budget = result.error_budget
    assert budget is not None and budget["temporal, colour"].mean == 0.5
    (kept,) = shot.output.glob("vdb/*/run.json")
    assert json.loads(kept.read_text())["error_budget"] == budget.to_json()
    (found,) = provenance(result.look_layer)
    assert ErrorBudget.from_json(found.record.error_budget) == budget
    assert main(["provenance", str(result.look_layer)]) == 0
    assert "temporal, colour: mean 0.5" in capsys.readouterr().out
    again = assemble(shot.output)
    assert again.error_budget == budget and again.seconds == result.seconds


@pytest.mark.usefixtures("core")
def test_the_parts_of_a_run_s_time_add_up(shot: Shot, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(shot.arguments("--json", "--set", "windows.size=2")) == 0
    seconds = json.loads(capsys.readouterr().out)["seconds"]
    (kept,) = shot.output.glob("vdb/*/run.json")
    assert json.loads(kept.read_text())["seconds"] == seconds
    whole = seconds.pop("all")
    assert sum(seconds.values()) == pytest.approx(whole)
    assert set(seconds) >= {
        "reading",
        "coarse step",
        "writing",
        "hashing",
        "verifying",
        "assembling",
        "the rest",
    }


@pytest.mark.usefixtures("core")
def test_the_command_prints_it_as_a_table_and_as_json(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(shot.arguments("--verbose")) == 0
    printed = capsys.readouterr().out
    assert "temporal, colour" in printed and "without quadrature:" in printed
    assert main(["assemble", str(shot.output), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["error_budget"]
    assert {entry["name"] for entry in found["estimates"]} >= {"storage, density"}


@pytest.mark.usefixtures("core")
def test_storage_is_the_difference_between_files(shot: Shot, core: FakeCore) -> None:
    exact = stylize(shot.stage, shot.style, shot.output)
    rough = stylize(
        shot.stage, shot.style, shot.folder / "half", settings={"grids": {"half": True}}
    )
    differences = []
    for one, other in zip(exact.frames, rough.frames, strict=True):
        wanted = [GridRequest("density")]
        (a,), (b,) = (read_grids(file, wanted, GridsConfig()) for file in (one, other))
        size = np.abs(a.values).sum(dtype=float)
        differences.append(np.abs(a.values - b.values).sum(dtype=float) / size)
    assert exact.error_budget is not None and rough.error_budget is not None
    assert exact.error_budget["storage, density"].largest == 0
    assert rough.error_budget["storage, density"].largest == pytest.approx(max(differences))


@pytest.mark.usefixtures("core")
def test_smoke_that_16_bits_lose_is_told(shot: Shot) -> None:
    for code in (1, 2, 3):
        faint = np.full((4, 3, 2), 1e-8)
        write_raw(shot.stage.parent / f"cache/smoke.{code:04d}.vdb", raw_grid(faint))
    result = stylize(shot.stage, shot.style, shot.output, {"grids": {"half": True}})
    assert result.error_budget is not None
    assert result.error_budget["storage, density"].largest == 1
    told = [text for text in result.warnings if "grids.half" in text]
    assert any("storage, density is 100.0%" in text for text in told)


def test_a_real_frame_has_an_estimate_of_everything_in_it() -> None:
    frames = [frame_of(puff(14, seed), time_code=1.0 + seed) for seed in range(2)]
    budget = make_budget(frame.report for frame in run_core(frames, estimating()))
    assert set(budget.left_out) == {
        "windows, density", "windows, emission", "storage, density", "storage, emission",
        *(name for name in budget.left_out if name.startswith("temporal") and "frames" in name),
    }  # fmt: skip
    assert all(np.isfinite(entry.mean) for entry in budget.estimates)


def test_grey_smoke_has_no_quadrature_and_a_slab_no_other_views() -> None:
    config = estimating(optimize={"error_budget": True, "steps": ["shape"]})
    slab = puff(14)[:, :, 6:7]
    budgets = [
        make_budget([run_core([frame_of(density)], config)[0].report])
        for density in (puff(14), slab)
    ]
    assert all("opacity" in budget.left_out["quadrature"] for budget in budgets)
    assert ["unseen views" in budget.left_out for budget in budgets] == [False, True]


def test_the_estimates_do_not_change_the_result_and_can_be_left_out() -> None:
    results = [
        run_core([frame_of(puff(12))], estimating(optimize={"error_budget": wanted}))[0]
        for wanted in (True, False)
    ]
    for name in ("density", "emission"):
        one, other = (getattr(result, name).values for result in results)
        assert np.array_equal(one, other)
    left_out = make_budget([results[1].report]).left_out
    assert {"quadrature", "resolution", "unseen views"} <= set(left_out)


def test_an_empty_frame_has_none() -> None:
    (frame,) = run_core([frame_of(np.zeros((4, 4, 4)))], estimating())
    assert make_budget([frame.report]).estimates == ()


def estimating(**sections: Mapping[str, Any]) -> Config:
    steps = {"shape": {"iterations": [30]}, "colour": {"iterations": [33]}}
    return quick_config(**{"optimize": {"error_budget": True}, **steps, **sections})

"""Whether a run has kept its tolerance: which rows are judged, by what, and what is said."""

import json

import pytest

from usdsmoke.runs.error_bounds import PARTS, Tolerance, judge
from usdsmoke.runs.error_budget import ErrorBudget, make_budget
from usdsmoke.ui.cli.budget_text import budget_text

REPORTS = [
    {
        "errors": {"resolution": {"value": value, "seconds": 0.1}},
        "shape": {"transport error": {"value": 0.001}, "mass error": 0.9},
    }
    for value in (0.01, 0.06)
]


def test_the_discretisation_s_parts_add_up_to_the_tolerance() -> None:
    assert PARTS["resolution"] + PARTS["transport"] + PARTS["storage, density"] == 1.0


def test_a_row_is_judged_by_the_frame_that_has_most() -> None:
    found = judge(0.1, {"resolution": 0.06, "transport": 0.025}, {})
    assert [item.kept for item in found.verdicts] == [False, True]
    assert [item.bound for item in found.verdicts] == pytest.approx([0.05, 0.025])
    assert found.to_dict()["kept"] is False


def test_what_is_not_kept_has_a_warning_that_says_what_to_do() -> None:
    found = judge(0.1, {name: 1.0 for name in PARTS}, {})
    assert len(found.warnings) == len(PARTS)
    for name, text in zip(PARTS, found.warnings, strict=True):
        assert text.startswith(f"the tolerance of 0.1 is not kept: {name} is 100.00%, of ")
        assert " set " in text or "has to be larger" in text


def test_what_was_not_estimated_is_named() -> None:
    found = judge(0.1, {"transport": 0.0}, {"resolution": "optimize.error_budget is off"})
    assert found.unknown == {"resolution": "optimize.error_budget is off"}
    assert str(found) == "0.1: kept by all 1 bounded errors; not estimated: resolution"


def test_a_budget_without_a_tolerance_judges_nothing() -> None:
    budget = make_budget(REPORTS)
    assert budget.tolerance is None and "bound" not in budget_text(budget)
    assert not any(text.startswith("tolerance") for text in budget.texts)


def test_table_record_and_json_say_the_same() -> None:
    budget = make_budget(REPORTS, target=0.1)
    table = budget_text(budget)
    rows = {line.split("  ")[0]: line for line in table.splitlines()}
    assert rows["resolution"].endswith("5.00% NOT KEPT") and rows["mass"].endswith("-")
    assert rows["transport"].endswith("2.50% kept")
    assert "tolerance of 0.1: NOT kept by resolution (6.00%, of 5.00%)" in table
    assert any(
        text.startswith("tolerance=0.1: NOT kept by resolution (6.00%") for text in budget.texts
    )
    kept = json.loads(json.dumps(budget.to_dict()))
    assert kept["tolerance"]["kept"] is False
    assert ErrorBudget.from_dict(kept) == budget
    assert Tolerance.from_dict(kept["tolerance"]) == budget.tolerance

"""Whether a run has kept its tolerance: which errors are judged, by what, and what is said."""

import json

import pytest

from usdsmoke.base.frame_report import Estimate, FrameErrors, FrameReport, TransportReport
from usdsmoke.runs.budget import ROWS, ErrorBudget, make_budget
from usdsmoke.ui.cli.text import budget_text

BOUNDED = {row.name: row for row in ROWS if row.share is not None}


def reports(*resolutions: float) -> list[FrameReport]:
    return [
        FrameReport(
            transport=TransportReport(error=Estimate(0.001), mass_error=0.9),
            errors=FrameErrors(resolution=Estimate(value, 0.1)),
        )
        for value in resolutions
    ]


def test_the_parts_of_discretisation_add_up_to_the_tolerance() -> None:
    names = ("resolution", "transport", "storage, density")
    assert sum(BOUNDED[name].bound(0.1) for name in names) == pytest.approx(0.1)


def test_an_error_without_a_share_has_no_bound() -> None:
    for row in ROWS:
        if row.name not in BOUNDED:
            with pytest.raises(ValueError, match=row.name):
                row.bound(0.1)


def test_every_bounded_error_has_advice_and_every_name_is_there_once() -> None:
    assert len({row.name for row in ROWS}) == len(ROWS) == 19
    assert all(row.advice for row in BOUNDED.values())


def test_a_row_is_judged_by_the_frame_that_has_most() -> None:
    found = make_budget(reports(0.01, 0.06), target=0.1).tolerance
    assert [item.kept for item in found.rows] == [False, True]
    assert [item.bound for item in found.rows] == pytest.approx([0.05, 0.025])
    assert not found.kept


def test_what_is_not_kept_has_a_warning_that_says_what_to_do() -> None:
    (text,) = make_budget(reports(0.06), target=0.1).tolerance.warnings
    assert "0.1" in text and "resolution" in text and "6.00%" in text
    assert BOUNDED["resolution"].advice[1:] in text


def test_what_was_not_estimated_is_named() -> None:
    found = make_budget(reports(0.0), target=0.1).tolerance
    assert found.unknown.keys() == BOUNDED.keys() - {"resolution", "transport"}
    assert "kept by all 2" in str(found) and "quadrature" in str(found)


def test_a_budget_without_a_tolerance_judges_nothing() -> None:
    budget = make_budget(reports(0.06))
    assert budget.tolerance is None and "bound" not in budget_text(budget)


def test_table_and_json_say_the_same() -> None:
    budget = make_budget(reports(0.01, 0.06), target=0.1)
    table = budget_text(budget)
    rows = {line.split("  ")[0]: line for line in table.splitlines()}
    assert rows["resolution"].endswith("5.00% NOT KEPT") and rows["mass"].endswith("-")
    assert rows["transport"].endswith("2.50% kept")
    assert "NOT kept by resolution (6.00%" in table
    kept = json.loads(json.dumps(budget.to_json()))
    assert kept["tolerance"]["kept"] is False
    assert ErrorBudget.from_json(kept) == budget

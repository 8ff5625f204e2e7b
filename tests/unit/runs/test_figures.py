"""Figures of many frames: mean and largest over those that have them."""

import pytest

from usdsmoke.base.frame_report import (
    FrameReport,
    OverlapReport,
    StepReport,
    TemporalErrors,
    TransportReport,
)
from usdsmoke.runs.budget import mean_entries, step_seconds, summarize_figures
from usdsmoke.runs.budget.error_budget import Figure, figures_of

FIRST = FrameReport(
    voxels=5,
    shape=StepReport(loss=(3.0, 2.0), seconds=1.5),
    transport=TransportReport(0.5, 0.25, linear_difference=0.125, mass_error=-0.5),
    colour=StepReport(loss=(1.0, 0.5), seconds=0.25),
)
SECOND = FrameReport(
    shape=StepReport(loss=(2.5, 4.0), seconds=0.5),
    transport=TransportReport(mass_error=0.25),
    temporal=TemporalErrors(displacement=0.75),
    overlap=OverlapReport((0, 1), 0.5, density=0.0625),
)


def test_every_figure_of_a_report_has_a_name():
    assert figures_of(FIRST) == {
        "shape seconds": 1.5,
        "shape largest displacement": 0.25,
        "shape mass error": 0.5,
        "shape linear transport difference": 0.125,
        "shape loss": 2.0,
        "colour seconds": 0.25,
        "colour loss": 0.5,
    }
    assert figures_of(SECOND)["temporal error displacement"] == 0.75
    assert figures_of(SECOND)["overlap difference density"] == 0.0625


def test_mean_and_largest_are_over_the_frames_that_have_the_figure():
    found = summarize_figures([FIRST, SECOND, FrameReport(left_out="empty frame")])
    assert found["shape loss"] == Figure(3.0, 4.0, 2)
    assert found["shape mass error"] == Figure(0.375, 0.5, 2)  # a loss does not offset a gain
    assert found["colour loss"] == Figure(0.5, 0.5, 1)
    assert list(found) == sorted(found)


def test_what_is_not_finite_is_no_figure():
    report = FrameReport(colour=StepReport(seconds=float("nan")), temporal=TemporalErrors())
    assert figures_of(report) == {}


def test_means_are_over_the_frames_that_have_the_number():
    def temporal(report):
        return report.temporal

    reports = [FIRST, SECOND, FrameReport(temporal=TemporalErrors(0.25))]
    assert mean_entries(reports, temporal, "colour", "displacement") == {"displacement": 0.5}
    assert mean_entries([FIRST], temporal, "colour", "displacement") is None


def test_temporal_errors_of_two_versions_are_mixed_where_both_have_them():
    mixed = TemporalErrors(1.0, None).mixed(TemporalErrors(0.0, 0.5), 0.25)
    assert mixed == TemporalErrors(0.25, 0.5)


def test_seconds_of_a_step_add_up_over_frames():
    assert step_seconds([FIRST, SECOND]) == {"shape": pytest.approx(2.0), "colour": 0.25}
    assert step_seconds([FrameReport()]) == {}

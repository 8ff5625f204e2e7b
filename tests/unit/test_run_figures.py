"""Figures of many frames: from their places in reports, mean and largest over those with them."""

import pytest

from usdsmoke.runs.metrics import Figure, figures_of, step_seconds, summarize_figures

FIRST = {
    "voxels": 5,
    "shape": {
        "loss": [3.0, 2.0],
        "seconds": 1.5,
        "cap": 0.5,
        "largest displacement": 0.25,
        "cheap scheme differs": 0.125,
        "mass error": -0.5,
    },
    "colour": {"loss": [1.0, 0.5], "seconds": 0.25},
}
SECOND = {
    "shape": {"loss": [2.5, 4.0], "seconds": 0.5, "mass error": 0.25},
    "temporal error": {"displacement": 0.75},
    "overlap": {"windows": [0, 1], "weight": 0.5, "difference": {"density": 0.0625}},
}


def test_every_figure_of_a_report_has_a_name():
    assert figures_of(FIRST) == {
        "shape seconds": 1.5,
        "shape largest displacement": 0.25,
        "shape mass error": 0.5,
        "shape cheap scheme differs": 0.125,
        "shape loss": 2.0,
        "colour seconds": 0.25,
        "colour loss": 0.5,
    }
    assert figures_of(SECOND)["temporal error displacement"] == 0.75
    assert figures_of(SECOND)["overlap difference density"] == 0.0625


def test_mean_and_largest_are_over_the_frames_that_have_the_figure():
    found = summarize_figures([FIRST, SECOND, {"voxels": 0, "left out": "empty frame"}])
    assert found["shape loss"] == Figure(3.0, 4.0, 2)
    assert found["shape mass error"] == Figure(0.375, 0.5, 2)  # gains do not make up for losses
    assert found["colour loss"] == Figure(0.5, 0.5, 1)
    assert list(found) == sorted(found)
    assert str(found["shape loss"]) == "mean 3, max 4, frames 2"


def test_what_is_no_number_is_no_figure():
    report = {"shape": {"loss": [], "seconds": float("nan")}, "temporal error": None, "loss": 0.5}
    assert figures_of(report) == {}


def test_seconds_of_a_step_add_up_over_frames():
    assert step_seconds([FIRST, SECOND]) == {"shape": pytest.approx(2.0), "colour": 0.25}
    assert step_seconds([{"voxels": 0}]) == {}

"""What the sentences say follows from the points."""

from dataclasses import replace

from tests.report_fixtures import point, result_of
from usdsmoke.work_precision.conclude import conclude
from usdsmoke.work_precision.records import Spread


def test_a_cheaper_point_of_the_same_error_is_named_with_its_ratio() -> None:
    found = conclude(
        result_of(
            [
                point("ours", "8", 0.1, 1.3, configured=True),
                point("ours", "16", 0.05, 2.6),
                point("other", "7", 0.1, 1.0),
            ]
        )
    )
    assert found.verdict == (
        "The configured point (ours, 8) is within 1.3x of the cheapest at its error: other, 7."
    )
    assert found.sentences["ours"] == (
        "Beside what is configured, 16 takes 2x the time and lowers the error by 50.0%."
    )
    assert found.sentences["other"] == "7 takes 0.77x the time and leaves the error as it is."


def test_the_cheapest_point_is_told_to_be_it() -> None:
    found = conclude(
        result_of(
            [point("ours", "8", 0.1, 1.0, configured=True), point("other", "7", 0.5, 0.2)],
            y_label="size of the file [bytes]",
        )
    )
    assert "is the cheapest of those measured at its error" in found.verdict
    assert found.sentences["other"] == (
        "It does not come down to the configured error: 7 has 5x the error at 0.2x the size."
    )


def test_a_point_far_too_dear_is_told_by_the_share_of_its_cost() -> None:
    points = [point("ours", "8", 0.1, 10.0, configured=True), point("other", "7", 0.09, 2.5)]
    assert conclude(result_of(points)).verdict == (
        "The configured point (ours, 8) could be had in 0.25x of its time: other, 7."
    )


def test_differences_within_the_spread_of_the_runs_count_as_none() -> None:
    noisy = [
        point("ours", "8", 0.10, 1.0, configured=True),
        point("ours", "16", 0.095, 2.0),
    ]
    noisy = [type(p)(**{**p.__dict__, "error": Spread(p.error.median, 0.09, 0.11)}) for p in noisy]
    sentence = conclude(result_of(noisy)).sentences["ours"]
    assert sentence.endswith("16 takes 2x the time and changes the error by no more than the runs "
                             "differ.")  # fmt: skip


def test_costs_within_the_spread_of_the_runs_count_as_equal() -> None:
    points = [point("ours", "8", 0.1, 1.1, configured=True), point("other", "7", 0.1, 1.0)]
    noisy = [replace(p, cost=Spread(p.cost.median, 0.9, 1.2)) for p in points]
    assert "is the cheapest of those measured" in conclude(result_of(noisy)).verdict
    assert "is within 1.1x of the cheapest" in conclude(result_of(points)).verdict


def test_what_the_best_point_of_another_curve_gains_is_told() -> None:
    points = [
        point("rule", "2e-3", 0.1, 1.0, configured=True),
        point("number", "60 (1x)", 0.1, 1.0),
        point("number", "120 (2x)", 0.099, 2.1),
    ]
    assert conclude(result_of(points)).sentences["number"] == (
        "60 (1x) takes the same time within the runs' spread and leaves the error as it is; "
        "120 (2x) takes 2.1x and lowers the error by 1.0%."
    )


def test_the_order_is_fitted_where_the_curve_has_numbers() -> None:
    points = [
        point("ours", f"{h:g}", h**2, 1 / h, setting=h, configured=h == 0.5)
        for h in (1.0, 0.5, 0.25)
    ]
    found = conclude(result_of(points, setting="the step"))
    assert found.sentences["ours"].endswith("Fitted order in the step: 2.0.")


def test_an_exact_point_beside_an_inexact_one() -> None:
    points = [point("float", "0", 0.0, 100.0, configured=True), point("half", "0", 3e-4, 60.0)]
    found = conclude(result_of(points))
    assert found.sentences["half"] == (
        "It is not exact as what is configured is; 0 has an error of 0.0003 at 0.6x the time."
    )


def test_without_the_configured_point_nothing_is_said_of_it() -> None:
    found = conclude(result_of([point("a", "1", 0.2, 1.0), point("a", "2", 0.1, 2.0)]))
    assert found.verdict == "What is configured is not among these points."
    assert found.sentences["a"] == "The least error is that of 2."


def test_a_ratio_between_points_is_called_what_it_is_and_both_points_are_named() -> None:
    points = [
        point("cubic", "whole", 0.1, 1.0, configured=True),
        point("linear", "half", 0.05, 1.55),
        point("linear", "whole", 0.2, 0.4),
    ]
    found = conclude(result_of(points))
    assert found.sentences["linear"] == (
        "It reaches the configured error at about 0.79x the time, between half (1.6x, lowers the "
        "error by 50.0%) and whole (0.4x, raises the error to 2x)."
    )
    assert found.verdict == (
        "The configured point (cubic, whole) is the cheapest of those measured at its error; "
        "between two measured points linear reaches it at about 0.79x its time."
    )
    unset = [points[0], *(replace(p, offered=False) for p in points[1:])]
    assert conclude(result_of(unset)).verdict.endswith("0.79x its time, to which no setting leads.")


def test_a_dearer_curve_does_not_stand_against_the_verdict() -> None:
    points = [
        point("cubic", "whole", 0.1, 1.0, configured=True),
        point("linear", "half", 0.05, 16.0),
        point("linear", "whole", 0.2, 2.0),
    ]
    found = conclude(result_of(points))
    assert "at about 5.7x the time" in found.sentences["linear"]
    assert found.verdict.endswith("is the cheapest of those measured at its error.")


def test_every_ratio_without_about_is_that_of_a_measured_point() -> None:
    points = [
        point("ours", "1", 0.1, 1.0, configured=True),
        point("other", "4", 0.02, 1.33),
        point("other", "1", 0.3, 1.2),
    ]
    sentence = conclude(result_of(points)).sentences["other"]
    assert sentence.startswith(
        "It reaches the configured error at about 1.3x the time, between 4 ("
    )
    cheap = [*points[:2], replace(points[2], cost=Spread(1.5, 1.5, 1.5))]  # rough and dear
    assert conclude(result_of(cheap)).sentences["other"] == (
        "4 takes 1.3x the time and lowers the error by 80.0%."
    )


def test_a_cheaper_point_that_is_as_good_by_noise_alone_is_named_so() -> None:
    points = [point("ours", "12", 0.10, 1.0, configured=True), point("ours", "1", 0.12, 0.8)]
    noisy = [replace(p, error=Spread(p.error.median, 0.09, 0.13)) for p in points]
    assert conclude(result_of(noisy)).verdict.endswith(
        "ours, 1 (as far as the runs can tell: their errors overlap)."
    )


def test_no_order_is_fitted_to_the_error_of_the_reference() -> None:
    errors = [0.16, 0.04, 0.01, 0.004, 0.004]  # the last two are the reference's
    points = [
        point("ours", f"{n}", error, 2.0**n, setting=0.5**n, configured=n == 0)
        for n, error in enumerate(errors)
    ]
    found = conclude(result_of(points, setting="the step", uncertain=0.003))
    assert found.sentences["ours"].endswith("Fitted order in the step: 2.0, from 3 points.")


def test_points_of_the_configured_cost_are_told_by_their_errors() -> None:
    points = [
        point("pool", "12", 0.01, 1.0, configured=True),
        point("pool", "1", 0.2, 1.01),
        point("pool", "4", 0.03, 0.98),
        point("pool", "64", 0.005, 1.02),
    ]
    assert conclude(result_of(points)).sentences["pool"] == (
        "Beside what is configured, 1 takes the same time within the runs' spread and raises the "
        "error to 20x; 64 takes the same time within the runs' spread and lowers the error by "
        "50.0%."
    )


def test_two_runs_tell_no_difference_of_a_tenth_in_time() -> None:
    points = [
        point("rule", "2e-3", 0.1, 1.12, configured=True),
        point("rule", "5e-4", 0.1, 1.0),
    ]
    of_two = [replace(p, n_runs=2) for p in points]
    assert "is the cheapest of those measured" in conclude(result_of(of_two)).verdict
    assert (
        "takes the same time within the runs' spread and leaves the error as it is"
        in (conclude(result_of(of_two)).sentences["rule"])
    )
    assert "is within 1.1x of the cheapest" in conclude(result_of(points)).verdict


def test_errors_that_differ_by_less_than_the_references_are_not_told_apart() -> None:
    points = [
        point("number", "360", 0.010, 2.0, configured=True),
        point("number", "180", 0.012, 1.0),
        point("number", "90", 0.020, 0.5),
    ]
    found = conclude(result_of(points, uncertain=0.003))
    assert found.verdict == (
        "The configured point (number, 360) could be had in 0.5x of its time: number, 180 (as far "
        "as the references can tell: they differ by more)."
    )
    assert found.sentences["number"].endswith(
        "180 takes 0.5x the time and changes the error by no more than the references differ."
    )
    assert "is the cheapest" in conclude(result_of(points, uncertain=0.001)).verdict


def test_what_no_setting_leads_to_is_not_recommended() -> None:
    points = [
        point("float32", "as they come", 0.1, 2.0, configured=True),
        point("float32", "channels last", 0.1, 1.0, offered=False),
    ]
    assert conclude(result_of(points)).verdict == (
        "The configured point (float32, as they come) is the cheapest of those measured at its "
        "error that a setting leads to; float32, channels last would take 0.5x the time, and no "
        "setting leads there."
    )

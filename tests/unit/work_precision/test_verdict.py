"""A sweep's verdict follows from its points."""

from dataclasses import replace

from tests.fixtures.report_fixtures import point, result_of
from usdsmoke.work_precision.page import costs_more, verdict_on
from usdsmoke.work_precision.records import Point, Spread

CONFIGURED = point("ours", "8", 0.1, 1.3, configured=True)
CHEAPER = point("other", "7", 0.1, 1.0)
FINER = point("ours", "16", 0.05, 2.6)
ROUGHER = point("ours", "4", 0.5, 0.2)
NO_CHEAPER = "No other point has its error for less time."


def spread(found: Point, low: float, high: float) -> Point:
    """The same point with errors of several runs."""
    return replace(found, error=Spread(found.error.median, low, high))


def test_a_cheaper_point_of_the_same_error_is_named_with_its_ratio() -> None:
    verdict = verdict_on(result_of([CONFIGURED, CHEAPER, ROUGHER]))
    assert "7" in verdict and "0.77x the time" in verdict


def test_a_cheaper_and_more_accurate_point_is_named() -> None:
    better = point("other", "7", 0.01, 0.65)
    assert "0.5x the time" in verdict_on(result_of([CONFIGURED, better, ROUGHER]))


def test_a_cheaper_point_with_a_larger_error_is_no_gain() -> None:
    assert NO_CHEAPER in verdict_on(result_of([CONFIGURED, ROUGHER, FINER]))


def test_what_more_accuracy_costs_is_said() -> None:
    verdict = verdict_on(result_of([CONFIGURED, ROUGHER, FINER]))
    assert "16 lowers the error by 50% at 2x the time" in verdict


def test_errors_within_the_spread_of_the_runs_are_equal() -> None:
    noisy = [spread(CONFIGURED, 0.09, 0.11), spread(point("ours", "16", 0.095, 2.0), 0.09, 0.11)]
    assert "lowers" not in verdict_on(result_of(noisy))
    cheap = [spread(CONFIGURED, 0.09, 0.11), spread(point("ours", "4", 0.105, 0.13), 0.1, 0.11)]
    assert "0.1x the time" in verdict_on(result_of(cheap))


def test_errors_that_the_reference_cannot_tell_apart_are_equal() -> None:
    assert "lowers" in verdict_on(result_of([CONFIGURED, FINER]))
    assert "lowers" not in verdict_on(result_of([CONFIGURED, FINER], uncertain=0.06))


def test_costs_within_the_spread_of_the_runs_are_equal() -> None:
    slow = replace(CONFIGURED, cost=Spread(1.3, 0.9, 1.5))
    assert not costs_more(slow, CHEAPER) and costs_more(CONFIGURED, CHEAPER)
    assert not costs_more(
        replace(CONFIGURED, n_runs=2), replace(CHEAPER, n_runs=2, cost=Spread(1.2, 1.2, 1.2))
    )


def test_bytes_are_a_size_and_an_exact_point_needs_no_ratio() -> None:
    exact = point("float", "32", 0.0, 4.0, configured=True)
    verdict = verdict_on(result_of([exact, ROUGHER], y_label="size of the file [bytes]"))
    assert "less size" in verdict
    assert "Only" in verdict_on(result_of([exact]))
    assert "not among" in verdict_on(result_of([ROUGHER, FINER]))

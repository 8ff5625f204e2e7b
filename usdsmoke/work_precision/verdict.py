"""One sentence on a sweep: whether another point is cheaper or more accurate."""

from usdsmoke.work_precision.records import Point, SweepResult

_EQUAL = 1.02  # ratio of errors that count as equal
_CLOSE = 1.05  # ratio of costs that count as equal
_CLOSE_OF_TWO = 1.15  # the same for points of two runs, whose spread says little


def verdict_on(result: SweepResult) -> str:
    """What the points say about the configured one.

    Errors count as equal within the spread of the runs, within 2 %, and where the reference cannot
    tell them apart. Costs count as equal within the spread of the runs and within 5 %.
    """
    chosen, points = result.configured, result.points
    if chosen is None:
        return "The configured settings are not among these points."
    if len(points) == 1:
        return "Only the configured settings were measured."
    noun = "size" if "byte" in result.plan.y_label else "time"
    uncertain = result.plan.uncertain
    as_good = [p for p in points if p is chosen or not _differs(p, chosen, uncertain)]
    as_good += [p for p in points if p not in as_good and p.error.median < chosen.error.median]
    cheapest = min(as_good, key=lambda p: p.cost.median)
    finest = min(points, key=lambda p: p.error.median)
    text = f"Configured: {chosen.label}. "
    if cheapest is not chosen and costs_more(chosen, cheapest):
        text += f"{_named(cheapest, chosen)} has no larger error at {_cost(cheapest, chosen)} "
        text += f"the {noun}."
    else:
        text += f"No other point has its error for less {noun}."
    if finest not in (chosen, cheapest) and _differs(finest, chosen, uncertain):
        share = 1 - finest.error.median / chosen.error.median
        text += f" {_named(finest, chosen)} lowers the error by {share:.0%} at "
        text += f"{_cost(finest, chosen)} the {noun}."
    return text


def costs_more(point: Point, other: Point) -> bool:
    """Whether a point costs more than another, beyond what runs differ."""
    close = _CLOSE_OF_TWO if 1 < min(point.n_runs, other.n_runs) <= 2 else _CLOSE
    if point.cost.median <= other.cost.median * close:
        return False
    return point.cost.low > other.cost.high or point.n_runs == 1


def ratio_text(ratio: float) -> str:
    """A ratio as text.

    >>> ratio_text(1.26), ratio_text(0.043), ratio_text(137.2)
    ('1.3x', '0.043x', '137x')
    """
    return f"{ratio:.2g}x" if ratio < 100 else f"{ratio:.0f}x"


def _differs(point: Point, chosen: Point, uncertain: float) -> bool:
    low, high = sorted((point.error.median, chosen.error.median))
    if high - low <= uncertain or high <= low * _EQUAL:
        return False
    has_spread = any(p.error.high > p.error.low for p in (point, chosen))
    return not (has_spread and point.error.overlaps(chosen.error))


def _named(point: Point, chosen: Point) -> str:
    return point.label if point.curve == chosen.curve else f"{point.curve}, {point.label},"


def _cost(point: Point, chosen: Point) -> str:
    return ratio_text(point.cost.median / chosen.cost.median)

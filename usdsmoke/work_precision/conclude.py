"""What follows from a sweep's points, in sentences: one for every curve, one on what is configured.

Errors and costs that lie within the spread of the runs count as equal. Ratios belong to points
that were measured; where a curve passes the configured error between two of them, the sentence says
so, names both and calls the ratio between them what it is: about so much.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from usdsmoke.work_precision.fit import Crossing, crossing, fitted_order
from usdsmoke.work_precision.records import Plan, Point, SweepResult

__all__ = ["conclude", "times"]

_EQUAL = 1.02  # ratio of errors up to which they count as equal
_CLOSE = 1.05  # ratio of costs up to which two points cost the same
_CLOSE_OF_TWO = 1.15  # the same of points of two runs or one, whose spread says little
_ABOVE = 3.0  # times the reference's own error, from which on an order is fitted to an error


@dataclass(frozen=True)
class _Unit:
    """What points are compared in."""

    noun: str  # of the cost
    uncertain: float  # errors that differ by less are not told apart by the reference


def conclude(result: SweepResult) -> SweepResult:
    """The same sweep with its sentences."""
    chosen = next((point for point in result.points if point.configured), None)
    unit = _Unit("size" if "byte" in result.plan.y_label else "time", result.plan.uncertain)
    sentences = {
        curve: f"{_of_curve(points, chosen, unit)}{_order(points, result.plan)}"
        for curve, points in result.curves.items()
    }
    verdict = _verdict(result, chosen, unit)
    return replace(result, sentences=sentences, verdict=verdict)


def times(ratio: float) -> str:
    """A ratio as text.

    >>> times(1.26), times(0.043), times(137.2)
    ('1.3x', '0.043x', '140x')
    """
    digits = 2 if ratio < 100 else 2 - len(str(int(ratio)))
    return f"{ratio:.2g}x" if digits == 2 else f"{round(ratio, digits):.0f}x"


def _verdict(result: SweepResult, chosen: Point | None, unit: _Unit) -> str:
    if chosen is None:
        return "What is configured is not among these points."
    points, name = result.points, f"The configured point ({chosen.curve}, {chosen.label})"
    if len(points) == 1:
        return f"{name} is the only one that was measured."
    good = [p for p in points if p is chosen or _as_good(p, chosen, unit)]
    best = min((p for p in good if p.offered or p is chosen), key=lambda p: p.cost.median)
    if best is chosen or not _costs_more(chosen, best):
        rest = _without_setting(good, chosen, unit) or _cheaper_between(result, chosen, unit)
        return f"{name} is the cheapest of those measured at its error{rest}."
    ratio = chosen.cost.median / best.cost.median
    other = f"{best.curve}, {best.label}{_as_far(best, chosen)}"
    if ratio < 2:
        return f"{name} is within {times(ratio)} of the cheapest at its error: {other}."
    return f"{name} could be had in {times(1 / ratio)} of its {unit.noun}: {other}."


def _without_setting(good: Sequence[Point], chosen: Point, unit: _Unit) -> str:
    """What would be cheaper, but that no setting leads there."""
    best = min(good, key=lambda p: p.cost.median)
    if best is chosen or best.offered or not _costs_more(chosen, best):
        return ""
    far = _as_far(best, chosen)
    return (
        f" that a setting leads to; {best.curve}, {best.label}{far} would take "
        f"{_ratio(best, chosen)} the {unit.noun}, and no setting leads there"
    )


def _as_far(point: Point, chosen: Point) -> str:
    """A point that is as good by the spread of the runs or of the references is named so."""
    if point.error.median <= chosen.error.median * _EQUAL:
        return ""
    if chosen.error.high > chosen.error.low and point.error.overlaps(chosen.error):
        return " (as far as the runs can tell: their errors overlap)"
    return " (as far as the references can tell: they differ by more)"


def _cheaper_between(result: SweepResult, chosen: Point, unit: _Unit) -> str:
    """Curves that pass the configured error for less, between points of other errors."""
    found = {curve: _passes(points, chosen) for curve, points in result.curves.items()}
    cheaper = [
        f"{curve} reaches it at about {times(at.cost / chosen.cost.median)} its {unit.noun}"
        f"{_unset(result.curves[curve])}"
        for curve, at in found.items()
        if at is not None and at.cost * _CLOSE < chosen.cost.median
    ]
    return f"; between two measured points {', '.join(cheaper)}" if cheaper else ""


def _unset(points: Sequence[Point]) -> str:
    return "" if any(point.offered for point in points) else ", to which no setting leads"


def _passes(points: Sequence[Point], chosen: Point) -> Crossing | None:
    """Where a curve without the configured point passes its error, if no point of it is there."""
    if chosen.error.median <= 0 or any(point is chosen for point in points):
        return None
    if any(abs(point.error.median / chosen.error.median - 1) <= _EQUAL - 1 for point in points):
        return None
    errors, costs = [p.error.median for p in points], [p.cost.median for p in points]
    return crossing(chosen.error.median, errors, costs)


def _of_curve(points: Sequence[Point], chosen: Point | None, unit: _Unit) -> str:
    if chosen is None:
        best = min(points, key=lambda p: p.error.median)
        return f"The least error is that of {best.label}."
    if any(point is chosen for point in points):
        return _around(points, chosen, unit)
    at = _passes(points, chosen)
    if at is not None:
        fine, rough = points[at.finer], points[at.rougher]
        return (
            f"It reaches the configured error at about {times(at.cost / chosen.cost.median)} the "
            f"{unit.noun}, between {fine.label} ({_ratio(fine, chosen)}, "
            f"{_change(fine, chosen, unit)}) and {rough.label} ({_ratio(rough, chosen)}, "
            f"{_change(rough, chosen, unit)})."
        )
    return _against(points, chosen, unit)


def _around(points: Sequence[Point], chosen: Point, unit: _Unit) -> str:
    """What the neighbours of the configured point gain and lose, and points of its own cost."""
    if len(points) == 1:
        return "Nothing but what is configured was measured on this curve."
    others = [p for p in points if p is not chosen]
    dearer = [p for p in others if _costs_more(p, chosen)]
    cheaper = [p for p in others if _costs_more(chosen, p)]
    equal = [p for p in others if p not in dearer and p not in cheaper]
    named = []
    if dearer:
        named.append(min(dearer, key=lambda p: p.cost.median))
    if cheaper:
        named.append(max(cheaper, key=lambda p: p.cost.median))
    if equal:
        named.append(max(equal, key=lambda p: p.error.median))
        named.append(min(equal, key=lambda p: p.error.median))
    texts = [
        f"{point.label} {_takes(point, chosen, unit)} and {_change(point, chosen, unit)}"
        for number, point in enumerate(named)
        if point not in named[:number]
    ]
    return f"Beside what is configured, {'; '.join(texts)}."


def _against(points: Sequence[Point], chosen: Point, unit: _Unit) -> str:
    """A curve that the configured point is not on, by its measured points."""
    good = [point for point in points if _as_good(point, chosen, unit)]
    if not good:
        return _never(points, chosen, unit)
    best = min(good, key=lambda p: p.cost.median)
    text = f"{best.label} {_takes(best, chosen, unit)} and {_change(best, chosen, unit)}"
    finest = min(points, key=lambda p: p.error.median)
    if finest is best or not finest.error.median < chosen.error.median:
        return f"{text}."
    change = _change(finest, chosen, unit)
    return f"{text}; {finest.label} takes {_ratio(finest, chosen)} and {change}."


def _never(points: Sequence[Point], chosen: Point, unit: _Unit) -> str:
    best = min(points, key=lambda p: p.error.median)
    if chosen.error.median > 0:
        return (
            f"It does not come down to the configured error: {best.label} has "
            f"{times(best.error.median / chosen.error.median)} the error at "
            f"{_ratio(best, chosen)} the {unit.noun}."
        )
    return (
        f"It is not exact as what is configured is; {best.label} has an error of "
        f"{best.error.median:.2g} at {_ratio(best, chosen)} the {unit.noun}."
    )


def _takes(point: Point, chosen: Point, unit: _Unit) -> str:
    if _costs_more(point, chosen) or _costs_more(chosen, point):
        return f"takes {_ratio(point, chosen)} the {unit.noun}"
    return f"takes the same {unit.noun} within the runs' spread"


def _costs_more(point: Point, other: Point) -> bool:
    close = _CLOSE_OF_TWO if 1 < min(point.n_runs, other.n_runs) <= 2 else _CLOSE
    if point.cost.median <= other.cost.median * close:
        return False
    return point.cost.low > other.cost.high or point.n_runs == 1


def _as_good(point: Point, chosen: Point, unit: _Unit) -> bool:
    if point.error.median <= chosen.error.median * _EQUAL + unit.uncertain:
        return True
    return chosen.error.high > chosen.error.low and point.error.overlaps(chosen.error)


def _ratio(point: Point, chosen: Point) -> str:
    return times(point.cost.median / chosen.cost.median)


def _change(point: Point, chosen: Point, unit: _Unit) -> str:
    """What becomes of the error when another point is taken."""
    found, wanted = point.error, chosen.error
    if found.median == wanted.median:
        return "leaves the error as it is"
    if found.high > found.low and found.overlaps(wanted):
        return "changes the error by no more than the runs differ"
    if abs(found.median - wanted.median) <= unit.uncertain:
        return "changes the error by no more than the references differ"
    if found.median == 0:
        return "is exact"
    if wanted.median == 0:
        return f"is not exact any more: {found.median:.2g}"
    if found.median > wanted.median:
        change = found.median / wanted.median - 1
        grown = f"by {change:.1%}" if change < 1 else f"to {times(change + 1)}"
        return f"raises the error {grown}"
    return f"lowers the error by {1 - found.median / wanted.median:.1%}"


def _order(points: Sequence[Point], plan: Plan) -> str:
    """The fitted order; errors of the reference's own size say nothing about a method."""
    if not plan.setting:
        return ""
    numbers = [(p.setting, p.error.median) for p in points if p.setting is not None]
    fit = [(h, e) for h, e in numbers if e > _ABOVE * plan.uncertain]
    order = fitted_order([h for h, _ in fit], [e for _, e in fit])
    if order is None:
        return ""
    rest = f", from {len(fit)} points" if len(fit) < len(numbers) else ""
    return f" Fitted order in {plan.setting}: {order:.1f}{rest}."

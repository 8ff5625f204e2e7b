"""What follows from a sweep's points, in sentences: one for every curve, one on what is configured.

Errors and costs that lie within the spread of the runs count as equal.
"""

from collections.abc import Sequence
from dataclasses import replace

from usdsmoke.report.fit import cost_at, fitted_order
from usdsmoke.report.records import Point, SweepResult

__all__ = ["conclude", "times"]

_EQUAL = 1.02  # ratio of errors up to which they count as equal
_CLOSE = 1.05  # ratio of costs up to which two points cost the same


def conclude(result: SweepResult) -> SweepResult:
    """The same sweep with its sentences."""
    chosen = next((point for point in result.points if point.configured), None)
    noun = "size" if "byte" in result.plan.y_label else "time"
    sentences = {
        curve: _of_curve(points, chosen, noun, result.plan.setting)
        for curve, points in result.curves.items()
    }
    return replace(result, sentences=sentences, verdict=_verdict(result.points, chosen, noun))


def times(ratio: float) -> str:
    """A ratio as text.

    >>> times(1.26), times(0.043), times(137.2)
    ('1.3x', '0.043x', '140x')
    """
    digits = 2 if ratio < 100 else 2 - len(str(int(ratio)))
    return f"{ratio:.2g}x" if digits == 2 else f"{round(ratio, digits):.0f}x"


def _verdict(points: Sequence[Point], chosen: Point | None, noun: str) -> str:
    if chosen is None:
        return "What is configured is not among these points."
    name = f"The configured point ({chosen.curve}, {chosen.label})"
    if len(points) == 1:
        return f"{name} is the only one that was measured."
    best = min(
        (p for p in points if p is chosen or _as_good(p, chosen)), key=lambda p: p.cost.median
    )
    ratio = chosen.cost.median / best.cost.median
    if best is chosen or not _costs_more(chosen, best):
        return f"{name} is the cheapest of those measured at its error."
    other = f"{best.curve}, {best.label}"
    if ratio < 2:
        return f"{name} is within {times(ratio)} of the cheapest at its error: {other}."
    return f"{name} could be had in {times(1 / ratio)} of its {noun}: {other}."


def _of_curve(points: Sequence[Point], chosen: Point | None, noun: str, setting: str) -> str:
    order = _order(points, setting)
    if chosen is None:
        best = min(points, key=lambda p: p.error.median)
        return f"The least error is that of {best.label}.{order}"
    if any(point is chosen for point in points):
        return f"{_around(points, chosen, noun)}{order}"
    return f"{_against(points, chosen, noun)}{order}"


def _around(points: Sequence[Point], chosen: Point, noun: str) -> str:
    """What the neighbours of the configured point gain and lose."""
    dearer = [p for p in points if _costs_more(p, chosen)]
    cheaper = [p for p in points if _costs_more(chosen, p)]
    texts = []
    if dearer:
        other = min(dearer, key=lambda p: p.cost.median)
        texts.append(f"{other.label} takes {_ratio(other, chosen)} the {noun} and "
                     f"{_change(other, chosen)}")  # fmt: skip
    if cheaper:
        other = max(cheaper, key=lambda p: p.cost.median)
        texts.append(f"{other.label} takes {_ratio(other, chosen)} the {noun} and "
                     f"{_change(other, chosen)}")  # fmt: skip
    if len(points) == 1:
        return "Nothing but what is configured was measured on this curve."
    if not texts:
        return "Nothing else on this curve costs more or less than what is configured."
    return f"Beside what is configured, {'; '.join(texts)}."


def _against(points: Sequence[Point], chosen: Point, noun: str) -> str:
    """A curve without the configured point, beside it."""
    good = [point for point in points if _as_good(point, chosen)]
    if good:
        best = min(good, key=lambda p: p.cost.median)
        ratio = _between(points, chosen) or best.cost.median / chosen.cost.median
        text = f"It has the configured error at {times(ratio)} the {noun} ({best.label})"
        finest = min(points, key=lambda p: p.error.median)
        if finest is best or not finest.error.median < chosen.error.median:
            return f"{text}."
        more = f"{finest.label} takes {_ratio(finest, chosen)} and {_change(finest, chosen)}"
        return f"{text}; {more}."
    best = min(points, key=lambda p: p.error.median)
    return (
        f"It does not come down to the configured error: {best.label} has "
        f"{times(best.error.median / chosen.error.median)} the error at {_ratio(best, chosen)} "
        f"the {noun}."
        if chosen.error.median > 0
        else f"It is not exact as what is configured is; {best.label} has an error of "
        f"{best.error.median:.2g} at {_ratio(best, chosen)} the {noun}."
    )


def _between(points: Sequence[Point], chosen: Point) -> float | None:
    errors, costs = [p.error.median for p in points], [p.cost.median for p in points]
    found = cost_at(chosen.error.median, errors, costs) if chosen.error.median > 0 else None
    return None if found is None else found / chosen.cost.median


def _costs_more(point: Point, other: Point) -> bool:
    if point.cost.median <= other.cost.median * _CLOSE:
        return False
    return point.cost.low > other.cost.high or point.n_runs == 1


def _as_good(point: Point, chosen: Point) -> bool:
    if point.error.median <= chosen.error.median * _EQUAL:
        return True
    return chosen.error.high > chosen.error.low and point.error.overlaps(chosen.error)


def _ratio(point: Point, chosen: Point) -> str:
    return times(point.cost.median / chosen.cost.median)


def _change(point: Point, chosen: Point) -> str:
    """What becomes of the error when another point is taken."""
    found, wanted = point.error, chosen.error
    if found.median == wanted.median:
        return "leaves the error as it is"
    if found.high > found.low and found.overlaps(wanted):
        return "changes the error by no more than the runs differ"
    if found.median == 0:
        return "is exact"
    if wanted.median == 0:
        return f"is not exact any more: {found.median:.2g}"
    if found.median > wanted.median:
        change = found.median / wanted.median - 1
        grown = f"by {change:.1%}" if change < 1 else f"to {times(change + 1)}"
        return f"raises the error {grown}"
    return f"lowers the error by {1 - found.median / wanted.median:.1%}"


def _order(points: Sequence[Point], setting: str) -> str:
    numbers = [(p.setting, p.error.median) for p in points if p.setting is not None]
    if not setting or not numbers:
        return ""
    order = fitted_order([h for h, _ in numbers], [e for _, e in numbers])
    return "" if order is None else f" Fitted order in {setting}: {order:.1f}."

"""The report as one HTML file with its verdicts and diagrams: no script, no font, nothing external.

Diagrams have the error to the right and the cost upwards, both logarithmic.
"""

import base64
import io
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from usdsmoke.work_precision.records import Point, Report, Spread, SweepResult

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


_COLOURS = ("#0b6e99", "#c8501e", "#3a7d2c", "#8a4fa3", "#a07900", "#5b5b5b")
_MARKERS = "osD^vP"
_LEAST_SPAN = 1.3  # of an axis, end by beginning
_INCHES, _DPI = (9.2, 4.4), 105


def draw_sweep(result: SweepResult) -> bytes:
    """The diagram of a sweep, a PNG file's bytes.

    Medians are joined along each curve; bars reach from the smallest to the largest run. The
    configured point has a ring. Errors of 0 stand beyond a line at the left, where the axis says 0.

    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=_INCHES, dpi=_DPI, layout="constrained")
    axes = figure.subplots()
    axes.set(xscale="log", yscale="log", xlabel=result.plan.x_label, ylabel=result.plan.y_label)
    exact = _place_of_zero(result.points)
    least = min((p.cost.median for p in result.points if p.cost.median > 0), default=1.0)
    for number, (curve, points) in enumerate(result.curves.items()):
        colour = _COLOURS[number % len(_COLOURS)]
        marker = _MARKERS[number % len(_MARKERS)]
        _draw_curve(axes, curve, points, (colour, marker), (exact, least))
    chosen = [point for point in result.points if point.configured]
    for point in chosen:
        axes.plot(
            point.error.median or exact, point.cost.median or least, "o", markersize=17,
            fillstyle="none", color="black", markeredgewidth=1.6, label="configured", zorder=5,
        )  # fmt: skip
    own = _own_error(result)
    if own is not None:
        axes.dataLim.update_from_data_x([own], ignore=False)
    _widen(axes)
    if own is not None:
        axes.axvline(own, color="#777777", linestyle="--", linewidth=1,
                     label="how far the two references differ")  # fmt: skip
    axes.grid(True, which="both", color="#e6e6e6", linewidth=0.6)
    axes.set_axisbelow(True)
    _plain_ticks(axes)
    if any(point.error.median == 0 for point in result.points):
        _name_exact(axes, exact, all(point.error.median == 0 for point in result.points))
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def _own_error(result: SweepResult) -> float | None:
    """The distance of the references, if points come near it."""
    own = result.plan.uncertain
    is_near = own > 0 and any(0 < point.error.low < 10 * own for point in result.points)
    return own if is_near else None


def _draw_curve(
    axes: Any,
    curve: str,
    points: Sequence[Point],
    look: tuple[str, str],
    zeros: tuple[float, float],
) -> None:
    x = [_bar(p.error, zeros[0]) for p in points]
    y = [_bar(p.cost, zeros[1]) for p in points]
    colour, marker = look
    axes.errorbar(
        [middle for _, middle, _ in x], [middle for _, middle, _ in y],
        xerr=_lengths(x), yerr=_lengths(y), color=colour, marker=marker, markersize=5,
        linewidth=1.2, elinewidth=0.8, capsize=2, label=curve,
    )  # fmt: skip


def _bar(spread: Spread, zero: float) -> tuple[float, float, float]:
    """Low, middle and high on an axis that has no 0: it is drawn at ``zero``."""
    middle = spread.median or zero
    return min(spread.low or zero, middle), middle, max(spread.high, middle)


def _lengths(bars: Sequence[tuple[float, float, float]]) -> list[list[float]]:
    return [[middle - low for low, middle, _ in bars], [high - middle for _, middle, high in bars]]


def _place_of_zero(points: Sequence[Point]) -> float:
    """Where errors of 0 are drawn."""
    positive = [value for p in points for value in (p.error.low, p.error.median) if value > 0]
    return min(positive, default=1.0) / 5


def _name_exact(axes: Any, exact: float, alone: bool) -> None:
    """The axis says 0 where the exact points are, and no number beyond the line before them."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    if alone:
        axes.xaxis.set_major_locator(FixedLocator([exact]))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: "0"))
        return
    end = exact * 5**0.5
    axes.axvspan(axes.get_xlim()[0], end, color="#f4f4f4", zorder=0)
    axes.axvline(end, color="#aaaaaa", linewidth=1)
    shown = axes.xaxis.get_major_formatter()
    axes.xaxis.set_major_formatter(
        FuncFormatter(lambda value, place: "" if value < end else shown(value, place))
    )
    axes.annotate("0", (exact, 0), xycoords=("data", "axes fraction"), xytext=(0, -4),
                  textcoords="offset points", ha="center", va="top")  # fmt: skip


def _widen(axes: Any) -> None:
    """Room around points that (nearly) agree: no axis is shown that spans round-off.

    Before limits are asked for: matplotlib warns where those of one point differ by round-off.
    """
    data = axes.dataLim
    for low, high, add in (
        (*data.intervalx, data.update_from_data_x),
        (*data.intervaly, data.update_from_data_y),
    ):
        if high / low < _LEAST_SPAN:
            middle = (low * high) ** 0.5
            add([middle / _LEAST_SPAN**0.5, middle * _LEAST_SPAN**0.5], ignore=False)


def _plain_ticks(axes: Any) -> None:
    """Numbers at more than whole powers of ten where an axis spans little."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        if high / low < 100:
            steps = (1, 1.2, 1.5, 2, 3, 5, 7) if high / low < 4 else (1, 2, 5)
            axis.set_major_locator(LogLocator(subs=steps, numticks=30))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
            axis.set_minor_formatter(NullFormatter())


def make_page(
    report: Report, pictures: Mapping[str, bytes], films: Mapping[str, bytes] | None = None
) -> str:
    """The report as HTML, from the template ``page.html.j2``.

    Args:
        pictures: a PNG file's bytes by the sweep's name.
        films: a WebP file's bytes by the name of a sweep that has one.
    """
    text: str = _template().render(
        report=report, images=_in_base64(pictures), films=_in_base64(films or {})
    )
    return text


def _in_base64(files: Mapping[str, bytes]) -> dict[str, str]:
    return {name: base64.b64encode(data).decode("ascii") for name, data in files.items()}


def number(value: float) -> str:
    """A number for the tables.

    >>> number(0.0012345), number(0.0), number(123456.0)
    ('0.00123', '0', '123,456')
    """
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def _ratio(value: float, configured: float) -> str:
    return ratio_text(value / configured) if configured > 0 else "-"


@cache
def _template() -> Any:
    import jinja2

    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters.update(number=number, ratio=_ratio)
    text = Path(__file__).with_name("page.html.j2").read_text(encoding="utf-8")
    return environment.from_string(text)

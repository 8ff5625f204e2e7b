"""Work-precision diagrams: error to the right, cost upwards, both logarithmic."""

import io
from collections.abc import Sequence
from typing import Any

from usdsmoke.errors import MissingExtra
from usdsmoke.report.records import Point, SweepResult

__all__ = ["check_matplotlib", "draw_sweep"]

_COLOURS = ("#0b6e99", "#c8501e", "#3a7d2c", "#8a4fa3", "#a07900", "#5b5b5b")
_MARKERS = "osD^vP"
_LEAST_SPAN = 1.3  # of an axis, end by beginning
_INCHES, _DPI = (9.2, 4.4), 105


def check_matplotlib() -> None:
    """Refuse early where diagrams cannot be drawn.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise MissingExtra(
            "the report's diagrams are drawn by matplotlib, which is not installed; install the "
            "extra 'report': pip install 'usdsmoke[report]'"
        ) from None


def draw_sweep(result: SweepResult) -> bytes:
    """The diagram of a sweep, a PNG file's bytes.

    Medians are joined along each curve; bars reach from the smallest to the largest run. The
    configured point has a ring. Errors of 0 stand at the left edge, named exact.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    check_matplotlib()
    from matplotlib.figure import Figure

    figure = Figure(figsize=_INCHES, dpi=_DPI, layout="constrained")
    axes = figure.subplots()
    axes.set(xscale="log", yscale="log", xlabel=result.plan.x_label, ylabel=result.plan.y_label)
    exact = _place_of_zero(result.points)
    for number, (curve, points) in enumerate(result.curves.items()):
        colour = _COLOURS[number % len(_COLOURS)]
        marker = _MARKERS[number % len(_MARKERS)]
        _draw_curve(axes, curve, points, colour, marker, exact)
    chosen = [point for point in result.points if point.configured]
    for point in chosen:
        axes.plot(
            point.error.median or exact, point.cost.median, "o", markersize=17, fillstyle="none",
            color="black", markeredgewidth=1.6, label="configured", zorder=5,
        )  # fmt: skip
    if result.plan.floor is not None:
        axes.axvline(
            result.plan.floor, color="#777777", linestyle="--", linewidth=1, label="reference"
        )
    if any(point.error.median == 0 for point in result.points):
        axes.axvline(exact, color="#cccccc", linewidth=1)
        axes.annotate("exact", (exact, 1), xycoords=("data", "axes fraction"), fontsize=8,
                      xytext=(3, -10), textcoords="offset points", color="#666666")  # fmt: skip
    axes.grid(True, which="both", color="#e6e6e6", linewidth=0.6)
    axes.set_axisbelow(True)
    _widen(axes)
    _plain_ticks(axes)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def _draw_curve(
    axes: Any, curve: str, points: Sequence[Point], colour: str, marker: str, exact: float
) -> None:
    x = [point.error.median or exact for point in points]
    y = [point.cost.median for point in points]
    sideways = [
        [p.error.median - p.error.low for p in points],
        [p.error.high - p.error.median for p in points],
    ]
    upwards = [
        [p.cost.median - p.cost.low for p in points],
        [p.cost.high - p.cost.median for p in points],
    ]
    axes.errorbar(
        x, y, xerr=sideways, yerr=upwards, color=colour, marker=marker, markersize=5,
        linewidth=1.2, elinewidth=0.8, capsize=2, label=curve,
    )  # fmt: skip


def _place_of_zero(points: Sequence[Point]) -> float:
    """Where errors of 0 are drawn."""
    least = min((p.error.low for p in points if p.error.low > 0), default=1.0)
    return least / 5


def _widen(axes: Any) -> None:
    """Room around points that (nearly) agree: no axis is shown that spans round-off."""
    for limits, change in ((axes.get_xlim(), axes.set_xlim), (axes.get_ylim(), axes.set_ylim)):
        low, high = limits
        if high / low < _LEAST_SPAN:
            middle = (low * high) ** 0.5
            change(middle / _LEAST_SPAN**0.5, middle * _LEAST_SPAN**0.5)


def _plain_ticks(axes: Any) -> None:
    """Numbers at more than whole powers of ten where an axis spans little."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        if high / low < 100:
            steps = (1, 1.2, 1.5, 2, 3, 5, 7) if high / low < 4 else (1, 2, 5)
            axis.set_major_locator(LogLocator(subs=steps, numticks=30))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
            axis.set_minor_formatter(NullFormatter())

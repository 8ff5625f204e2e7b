"""Figures of a run: mean and largest over its frames, for the provenance record."""

import math
from collections.abc import Callable, Iterable

from usdsmoke.base.frame_report import FrameReport
from usdsmoke.base.record_format import Figure


def figures_of(report: FrameReport) -> dict[str, float]:
    """The figures of one frame by name, those that are finite.

    Displacements are in stage units; a mass error has no sign, so that a loss does not offset a
    gain.
    """
    found: dict[str, float | None] = {}
    for name, step in report.steps.items():
        found[f"{name} seconds"] = step.seconds
        found[f"{name} loss"] = step.loss[-1] if step.loss else None
    if (moved := report.transport) is not None:
        found["shape largest displacement"] = moved.largest_displacement
        found["shape linear transport difference"] = moved.linear_difference
        found["shape mass error"] = None if moved.mass_error is None else abs(moved.mass_error)
    if (temporal := report.temporal) is not None:
        found["temporal error displacement"] = temporal.displacement
        found["temporal error colour"] = temporal.colour
    if (overlap := report.overlap) is not None:
        found["overlap difference density"] = overlap.density
        found["overlap difference emission"] = overlap.emission
    return {n: value for n, value in found.items() if value is not None and math.isfinite(value)}


def summarize_figures(reports: Iterable[FrameReport]) -> dict[str, Figure]:
    """Mean and largest of every figure, by name in the order of names."""
    values: dict[str, list[float]] = {}
    for report in reports:
        for name, value in figures_of(report).items():
            values.setdefault(name, []).append(value)
    return {
        name: Figure(math.fsum(found) / len(found), max(found), len(found))
        for name, found in sorted(values.items())
    }


def mean_entries(
    reports: Iterable[FrameReport], part: Callable[[FrameReport], object | None], *names: str
) -> dict[str, float] | None:
    """Means over the frames that have the number; None where no frame has any.

    Args:
        reports: of the frames.
        part: of a report.
        names: of the numbers in it.
    """
    parts = [found for report in reports if (found := part(report)) is not None]
    values = {
        name: [v for item in parts if (v := getattr(item, name)) is not None] for name in names
    }
    return {name: sum(found) / len(found) for name, found in values.items() if found} or None

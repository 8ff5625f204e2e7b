"""What the reports of many frames come to: mean and largest of every figure, for the record.

A frame's report stands in full in ``run.json`` and in the manifests of windows. Its figures are
seconds and loss at the end of each step, what the transport did to the mass, how far the cheap
transport scheme was off, and the errors between frames and between windows.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = [
    "STEPS",
    "Figure",
    "figures_of",
    "mean_entries",
    "mixed_errors",
    "step_seconds",
    "summarize_figures",
]

STEPS = ("shape", "colour")
_OF_A_STEP = ("seconds", "largest displacement", "mass error", "cheap scheme differs")


@dataclass(frozen=True)
class Figure:
    """One figure over the frames that have it."""

    mean: float
    largest: float
    n_frames: int

    def __str__(self) -> str:
        return f"mean {self.mean:.6g}, max {self.largest:.6g}, frames {self.n_frames}"


def figures_of(report: Mapping[str, Any]) -> dict[str, float]:
    """The figures of one frame's report by name; those it lacks are left out.

    The mass error counts without its sign, or gains would make up for losses in the mean.
    """
    figures: dict[str, Any] = {}
    for step in STEPS:
        part = report.get(step)
        if isinstance(part, Mapping):
            figures |= {f"{step} {name}": part.get(name) for name in _OF_A_STEP}
            figures[f"{step} loss"] = _last(part.get("loss"))
    for title, values in (
        ("temporal error", report.get("temporal error")),
        ("overlap difference", (report.get("overlap") or {}).get("difference")),
    ):
        figures |= {f"{title} {name}": value for name, value in (values or {}).items()}
    numbers = {
        name: float(value)
        for name, value in figures.items()
        if isinstance(value, (int, float)) and math.isfinite(value)
    }
    return {name: abs(value) if "mass" in name else value for name, value in numbers.items()}


def summarize_figures(reports: Iterable[Mapping[str, Any]]) -> dict[str, Figure]:
    """Mean and largest of every figure, by name in the order of names."""
    values: dict[str, list[float]] = {}
    for report in reports:
        for name, value in figures_of(report).items():
            values.setdefault(name, []).append(value)
    return {
        name: Figure(math.fsum(found) / len(found), max(found), len(found))
        for name, found in sorted(values.items())
    }


def step_seconds(reports: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """Seconds that each step took over all frames; a step that no frame had is left out."""
    seconds: dict[str, float] = {}
    for report in reports:
        figures = figures_of(report)
        for step in STEPS:
            if (value := figures.get(f"{step} seconds")) is not None:
                seconds[step] = seconds.get(step, 0.0) + value
    return seconds


def _last(losses: Any) -> Any:
    """The loss at the end of the last octave."""
    return losses[-1] if isinstance(losses, list) and losses else losses


def mean_entries(found: Iterable[Mapping[str, Any] | None]) -> dict[str, float] | None:
    """The mean of every entry, over the mappings that have it; None where there is none."""
    values: dict[str, list[float]] = {}
    for numbers in found:
        for name, value in (numbers or {}).items():
            if value is not None:
                values.setdefault(name, []).append(float(value))
    return {name: sum(values[name]) / len(values[name]) for name in sorted(values)} or None


def mixed_errors(reports: Sequence[Mapping[str, Any]], weight: float) -> dict[str, float]:
    """The temporal errors of both versions, mixed; one's alone where the other has none."""
    tail, head = (report.get("temporal error") or {} for report in reports)
    mixed = {}
    for kind in (*tail, *(kind for kind in head if kind not in tail)):
        values = [errors[kind] for errors in (tail, head) if errors.get(kind) is not None]
        if len(values) == 2:
            mixed[kind] = weight * values[0] + (1 - weight) * values[1]
        elif values:
            mixed[kind] = values[0]
    return mixed

"""What is left of each error of a run, and other figures: mean and largest over its frames."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from usdsmoke.base.frame_report import FrameReport
from usdsmoke.base.json_records import JsonRecord
from usdsmoke.base.record_format import Figure
from usdsmoke.planning.plan import Plan
from usdsmoke.runs.budget.clock import step_seconds
from usdsmoke.runs.budget.finding import Finding, finding_texts
from usdsmoke.runs.budget.findings import find_volume
from usdsmoke.runs.budget.planned import PlannedVolume, temporal_note
from usdsmoke.runs.budget.rows import ROWS, ErrorRow
from usdsmoke.runs.budget.verdicts import FINE, LOOK, Verdict, judge_parts, urgency


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
    """Means over the frames that have the number; None where no frame has any."""
    parts = [found for report in reports if (found := part(report)) is not None]
    values = {
        name: [v for item in parts if (v := getattr(item, name)) is not None] for name in names
    }
    return {name: sum(found) / len(found) for name, found in values.items() if found} or None


@dataclass(frozen=True)
class ErrorEstimate:
    """One error over the frames that have it."""

    name: str
    mean: float
    largest: float
    relative_to: str
    n_frames: int
    seconds: float  # that estimating it took, over all frames
    how: str


@dataclass(frozen=True)
class ErrorBudget(JsonRecord):
    """The errors of a run, why it has no figure for others, and the time of its parts."""

    estimates: tuple[ErrorEstimate, ...]
    left_out: Mapping[str, str]  # why, by name
    seconds: Mapping[str, float]  # of the steps, and of the estimates
    notes: Mapping[str, str] = field(default_factory=dict)  # what an estimate leaves out
    findings: tuple[Finding, ...] = ()  # what deserves a look

    def __getitem__(self, name: str) -> ErrorEstimate:
        """The estimate of this name; KeyError if there is none."""
        return {estimate.name: estimate for estimate in self.estimates}[name]

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return finding_texts(self.findings)

    def verdict(self, name: str) -> str:
        """What to make of a row: it is fine, deserves a look, or asks for another setting."""
        found = [finding for finding in self.findings if finding.row == name]
        if not found:
            return FINE
        settings = [finding.setting for finding in found if finding.setting]
        return f"change {settings[0]}" if settings else LOOK

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """What to make of each part of the result, worst first."""
        largest = {estimate.name: estimate.largest for estimate in self.estimates}
        causes = {finding.row: finding.cause for finding in reversed(self.findings)}
        return judge_parts(largest, self.verdict, causes)

    @property
    def worst_first(self) -> list[ErrorEstimate]:
        """The estimates by how urgent their verdicts are."""
        return sorted(self.estimates, key=lambda item: urgency(self.verdict(item.name)))


def run_budget(
    plan: Plan,
    reports: Mapping[str, FrameReport],
    scenes: Sequence[Mapping[str, Any]] = (),
) -> ErrorBudget:
    """The errors of a run, with the reason for each that has no figure.

    Args:
        plan: of the run.
        reports: of the frames, by file name.
        scenes: what was measured of each Volume; none: nothing is found out about them.
    """
    volumes = [
        PlannedVolume(
            volume,
            tuple(reports.get(frame.file_name) for frame in volume.frames),
            scenes[number] if number < len(scenes) else {},
        )
        for number, volume in enumerate(plan.volumes)
    ]
    # In the order of names: the last bits of a sum must not depend on who ran which window.
    ordered = [reports[name] for name in sorted(reports)]
    return make_budget(ordered, volumes)


def make_budget(
    reports: Iterable[FrameReport], volumes: Sequence[PlannedVolume] = ()
) -> ErrorBudget:
    """The budget of frames whose reports are given.

    Args:
        reports: of the frames.
        volumes: those of the run, for the reason where there is no figure, and for findings.
    """
    reports = list(reports)
    estimates, left_out, notes = [], {}, {}
    for row in ROWS:
        estimate = _over_frames(row, reports)
        if estimate is None:
            reasons = dict.fromkeys(filter(None, map(row.why_absent, volumes)))
            left_out[row.name] = "; ".join(reasons) or row.without
            continue
        estimates.append(estimate)
        if row.temporal and volumes and (note := temporal_note(volumes, *row.temporal)):
            notes[row.name] = note
    seconds = step_seconds(reports)
    seconds["estimates"] = math.fsum(estimate.seconds for estimate in estimates)
    findings = tuple(finding for volume in volumes for finding in find_volume(volume))
    return ErrorBudget(tuple(estimates), left_out, seconds, notes, findings)


def _over_frames(row: ErrorRow, reports: Sequence[FrameReport]) -> ErrorEstimate | None:
    """Mean and largest over the frames that have a finite figure; None where no frame has."""
    found = [estimate for report in reports if (estimate := row.of_frame(report)) is not None]
    found = [estimate for estimate in found if math.isfinite(estimate.value)]
    if not found:
        return None
    errors = [abs(estimate.value) for estimate in found]  # a loss of mass does not offset a gain
    seconds = math.fsum(estimate.seconds for estimate in found)
    return ErrorEstimate(
        row.name,
        math.fsum(errors) / len(errors),
        max(errors),
        row.relative_to,
        len(errors),
        seconds,
        row.how,
    )

"""What is left of each error of a run, and other figures: mean and largest over its frames."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from usdsmoke.base.frame_report import FrameReport
from usdsmoke.base.json_records import JsonRecord
from usdsmoke.base.record_format import Figure
from usdsmoke.planning.plan import Plan
from usdsmoke.runs.budget.clock import step_seconds
from usdsmoke.runs.budget.rows import ROWS, ErrorRow, PlannedVolume, temporal_note


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


_ADVICE = {row.name: row.advice for row in ROWS}


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
class Verdict:
    """A bounded error at the end of a run."""

    name: str
    value: float  # the largest over the frames that have it
    bound: float
    kept: bool  # whether the value is not above the bound

    def __str__(self) -> str:
        return f"{self.value:.2%}, bound {self.bound:.2%}"


@dataclass(frozen=True)
class Tolerance:
    """Whether a run kept the tolerance that its settings were chosen for."""

    target: float
    kept: bool  # whether all rows are
    rows: tuple[Verdict, ...]
    unknown: Mapping[str, str]  # bounded errors that were not estimated, and why

    @property
    def broken(self) -> tuple[Verdict, ...]:
        """What is above its bound."""
        return tuple(verdict for verdict in self.rows if not verdict.kept)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is above its bound, with what to do and the tolerance that would be kept."""
        return tuple(
            f"the tolerance of {self.target:g} is not kept: {item.name} is {item}. "
            f"{_ADVICE[item.name][:1].upper()}{_ADVICE[item.name][1:]}. {self._least(item)}"
            for item in self.broken
        )

    def _least(self, item: Verdict) -> str:
        """The smallest tolerance, in hundredths, that an error of a result keeps."""
        least = math.ceil(100.0 * self.target * item.value / item.bound) / 100.0
        if least > 1.0:
            return "No tolerance up to 1, the maximum, would be kept with this error."
        return f"With this error, a tolerance of {least:g} would be kept."

    def __str__(self) -> str:
        if self.broken:
            names = "; ".join(f"{item.name} ({item})" for item in self.broken)
            found = f"{self.target:g}: NOT kept by {names}"
        else:
            found = f"{self.target:g}: kept by all {len(self.rows)} bounded errors"
        names_of: dict[str, list[str]] = {}
        for name, why in self.unknown.items():
            names_of.setdefault(why, []).append(name)
        unknown = "; ".join(f"{'; '.join(names)} ({why})" for why, names in names_of.items())
        return f"{found}; not estimated: {unknown}" if unknown else found


@dataclass(frozen=True)
class ErrorBudget(JsonRecord):
    """The errors of a run, why it has no figure for others, and the time of its parts."""

    estimates: tuple[ErrorEstimate, ...]
    left_out: Mapping[str, str]  # why, by name
    seconds: Mapping[str, float]  # of the steps, and of the estimates
    notes: Mapping[str, str] = field(default_factory=dict)  # what an estimate leaves out
    tolerance: Tolerance | None = None  # None without ``optimize.target_error``

    def __getitem__(self, name: str) -> ErrorEstimate:
        """The estimate of this name; KeyError if there is none."""
        return {estimate.name: estimate for estimate in self.estimates}[name]


def run_budget(plan: Plan, reports: Mapping[str, FrameReport]) -> ErrorBudget:
    """The errors of a run, with the reason for each that has no figure."""
    volumes = [
        PlannedVolume(volume, tuple(reports.get(frame.file_name) for frame in volume.frames))
        for volume in plan.volumes
    ]
    # In the order of names: the last bits of a sum must not depend on who ran which window.
    ordered = [reports[name] for name in sorted(reports)]
    return make_budget(ordered, volumes, plan.config.optimize.target_error)


def make_budget(
    reports: Iterable[FrameReport],
    volumes: Sequence[PlannedVolume] = (),
    target: float | None = None,
) -> ErrorBudget:
    """The budget of frames whose reports are given.

    Args:
        reports: of the frames.
        volumes: those of the run, for the reason where there is no figure.
        target: the tolerance that the settings were chosen for. Each error that it bounds is
            judged by its largest value.
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
    tolerance = None if target is None else _judge(target, estimates, left_out)
    return ErrorBudget(tuple(estimates), left_out, seconds, notes, tolerance)


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


def _judge(
    target: float, estimates: Sequence[ErrorEstimate], left_out: Mapping[str, str]
) -> Tolerance:
    largest = {estimate.name: estimate.largest for estimate in estimates}
    rows, unknown = [], {}
    for row in ROWS:
        if row.share is not None and row.name in largest:
            value, bound = largest[row.name], row.bound(target)
            rows.append(Verdict(row.name, value, bound, value <= bound))
        elif row.share is not None:
            unknown[row.name] = left_out[row.name]
    return Tolerance(target, all(row.kept for row in rows), tuple(rows), unknown)

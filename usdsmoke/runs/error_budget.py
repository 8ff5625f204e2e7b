"""The error budget of a run: what is left of each error, from the reports of its frames.

Every entry is relative, and says to what. Most are estimates, made from the frame itself by
``core.error_estimates``; mass, storage and the temporal error are measured.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeGuard

from usdsmoke.runs.error_bounds import Tolerance, judge

__all__ = ["ErrorBudget", "ErrorEstimate", "make_budget"]

_Value = Callable[[Mapping[str, Any]], tuple[Any, Any]]  # report -> value, seconds it took
_STEPS = ("shape", "colour")


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

    def __str__(self) -> str:
        return (
            f"mean {self.mean:.6g}, max {self.largest:.6g}, of {self.relative_to}, frames "
            f"{self.n_frames}, seconds {self.seconds:.3f}, {self.how}"
        )


@dataclass(frozen=True)
class ErrorBudget:
    """The errors of a run, what it has no figure for, and the time of its parts."""

    estimates: tuple[ErrorEstimate, ...]
    left_out: Mapping[str, str]  # why, by name
    seconds: Mapping[str, float]  # of the steps, and of the estimates
    notes: Mapping[str, str] = field(default_factory=dict)  # what an estimate does not hold
    tolerance: Tolerance | None = None  # how it was kept; None where none was asked for

    def __getitem__(self, name: str) -> ErrorEstimate:
        """The estimate of this name; KeyError if it was left out."""
        return {estimate.name: estimate for estimate in self.estimates}[name]

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "estimates": [dataclasses.asdict(estimate) for estimate in self.estimates],
            "left_out": dict(self.left_out),
            "seconds": dict(self.seconds),
            "notes": dict(self.notes),
            "tolerance": None if self.tolerance is None else self.tolerance.to_dict(),
        }

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> "ErrorBudget":
        """The budget that ``to_dict`` gave."""
        estimates = tuple(ErrorEstimate(**values) for values in found["estimates"])
        kept = found.get("tolerance")
        tolerance = None if kept is None else Tolerance.from_dict(kept)
        notes = found.get("notes", {})
        return cls(estimates, found["left_out"], found["seconds"], notes, tolerance)

    @property
    def texts(self) -> list[str]:
        """``name=figures`` for a record, then what was left out."""
        found = [
            f"{estimate.name}={estimate}{f' ({note})' if note else ''}"
            for estimate in self.estimates
            for note in [self.notes.get(estimate.name, "")]
        ]
        found += [f"{name}=left out: {why}" for name, why in self.left_out.items()]
        return found if self.tolerance is None else [*found, f"tolerance={self.tolerance}"]


@dataclass(frozen=True)
class _Kind:
    name: str
    relative_to: str
    how: str
    value: _Value
    without: str  # why no frame has it, if nothing else is known of the run


def make_budget(
    reports: Iterable[Mapping[str, Any]],
    reasons: Mapping[str, str] | None = None,
    notes: Mapping[str, str] | None = None,
    target: float | None = None,
) -> ErrorBudget:
    """The budget of frames whose reports are given, in the order of the result's files.

    Args:
        reports: of the frames; empty ones do not count.
        reasons: why no frame has an entry, by its name, where that is known.
        notes: what an entry does not hold, by its name.
        target: a tolerance that the settings were chosen for; each entry that it bounds is judged
            by its largest value.
    """
    reports = [report for report in reports if report]
    estimates, left_out = [], {}
    for kind in _KINDS:
        found = [kind.value(report) for report in reports]
        values = [(abs(float(value)), float(took or 0.0)) for value, took in found if _is(value)]
        if not values:
            left_out[kind.name] = (reasons or {}).get(kind.name) or kind.without
            continue
        errors = [error for error, _ in values]
        mean, took = math.fsum(errors) / len(errors), math.fsum(seconds for _, seconds in values)
        estimates.append(
            ErrorEstimate(
                kind.name, mean, max(errors), kind.relative_to, len(values), took, kind.how
            )
        )
    seconds = {}
    for step in _STEPS:
        spent = [_part(report, step).get("seconds") for report in reports]
        if any(_is(value) for value in spent):
            seconds[step] = math.fsum(value for value in spent if _is(value))
    seconds["estimates"] = math.fsum(estimate.seconds for estimate in estimates)
    known = {name: note for name, note in (notes or {}).items() if name not in left_out}
    tolerance = None
    if target is not None:
        largest = {estimate.name: estimate.largest for estimate in estimates}
        tolerance = judge(target, largest, left_out)
    return ErrorBudget(tuple(estimates), left_out, seconds, known, tolerance)


def _part(report: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = report.get(name)
    return found if isinstance(found, Mapping) else {}


def _is(value: Any) -> TypeGuard[float]:
    return isinstance(value, (int, float)) and math.isfinite(value)


def _estimated(name: str) -> _Value:
    def value(report: Mapping[str, Any]) -> tuple[Any, Any]:
        found = _part(_part(report, "errors"), name)
        return found.get("value"), found.get("seconds")

    return value


def _transport(report: Mapping[str, Any]) -> tuple[Any, Any]:
    found = _part(_part(report, "shape"), "transport error")
    return found.get("value"), found.get("seconds")


def _told(part: str, name: str) -> _Value:
    return lambda report: (_part(report, part).get(name), 0.0)


def _remaining(step: str) -> _Value:
    """Octaves differ in their pictures, and warm frames hardly fall: the loss is the unit."""

    def value(report: Mapping[str, Any]) -> tuple[Any, Any]:
        found = _part(report, step)
        remaining, losses = found.get("remaining"), found.get("loss")
        end = losses[-1] if isinstance(losses, Sequence) and losses else None
        if not (_is(end) and _is(remaining)):
            return None, 0.0
        return (min(remaining / end, 1.0) if end > 0 else 0.0), 0.0

    return value


def _view_spread(report: Mapping[str, Any]) -> tuple[Any, Any]:
    last = next((step for step in reversed(_STEPS) if _part(report, step)), _STEPS[0])
    return _part(report, last).get("view spread"), 0.0


def _overlap(name: str) -> _Value:
    return lambda report: (_part(_part(report, "overlap"), "difference").get(name), 0.0)


_PICTURE, _END = "the picture", "its final loss"
_NO_SHAPE, _NO_COLOUR = "no shape step", "no colour step"
_FEW = "too few iterations, or no such step"
_KINDS: Sequence[_Kind] = (
    _Kind("quadrature", _PICTURE, "slabs of 1, 2 and 4 steps", _estimated("quadrature"),
          "no colour step: opacity needs no sum along the ray"),
    _Kind("resolution", _PICTURE, "voxels and pixels of 1, 2 and 4 times the size",
          _estimated("resolution"), "no frame takes effect"),
    _Kind("transport", "the density", "voxels of 1, 2 and 4 times the size",
          _transport, _NO_SHAPE),
    _Kind("optimiser's transport", "the density", "the linear scheme against the final one",
          _told("shape", "cheap scheme differs"), "no shape step, or the same scheme"),
    _Kind("mass", "the density", "measured before it is corrected",
          _told("shape", "mass error"), _NO_SHAPE),
    _Kind("optimiser, shape", _END, "tails fitted to the loss", _remaining("shape"), _FEW),
    _Kind("optimiser, colour", _END, "tails fitted to the loss", _remaining("colour"), _FEW),
    _Kind("view sampling", "the loss", "standard error over the pool of views", _view_spread,
          _FEW),
    _Kind("unseen views", "the loss", "views beside the pool against its own",
          _estimated("unseen views"), "one view, or no frame takes effect"),
    _Kind("temporal, displacement", "the displacement", "measured against the frame before",
          _told("temporal error", "displacement"), "no frame follows another"),
    _Kind("temporal, colour", "the colours", "measured against the frame before",
          _told("temporal error", "colour"), "no frame follows another, or no colour step"),
    _Kind("windows, density", "the density", "measured before they are blended",
          _overlap("density"), "no frame is in two windows"),
    _Kind("windows, emission", "the emission", "measured before they are blended",
          _overlap("emission"), "no frame is in two windows, or no colour step"),
    _Kind("storage, density", "the density", "measured: half floats and pruning",
          _estimated("storage density"), "not measured"),
    _Kind("storage, emission", "the emission", "measured: half floats and pruning",
          _estimated("storage emission"), _NO_COLOUR),
)  # fmt: skip

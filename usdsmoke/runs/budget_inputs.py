"""The error budget of a run: its frames' figures, and why an entry has none or not all of them."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan
from usdsmoke.runs.error_budget import ErrorBudget, make_budget

__all__ = ["run_budget"]

_Reports = Mapping[str, Mapping[str, Any]]  # of frames, by the name of their files
_KINDS = {"displacement": "shape", "colour": "colour"}  # of temporal errors: their step
_SHORT = "too few iterations in the last octave to fit a tail to"


def run_budget(plan: Plan, reports: _Reports) -> ErrorBudget:
    """The errors of a run's frames, with the true reason for what is missing.

    Args:
        plan: of the run.
        reports: of the frames, by the names of their files.
    """
    volumes = plan.volumes
    found = [_reasons(volume, _of(volume, reports)) for volume in volumes]
    reasons = {name: _joined(each[name] for each in found) for name in (found[0] if found else ())}
    # In the order of names: a sum's last bits must not depend on who ran which window.
    ordered = [reports[name] for name in sorted(reports)]
    target = plan.config.optimize.target_error
    return make_budget(ordered, reasons, _notes(volumes, reports), target)


def _of(volume: VolumePlan, reports: _Reports) -> list[Mapping[str, Any]]:
    return [reports.get(frame.file_name, {}) for frame in volume.frames]


def _joined(texts: Iterable[str]) -> str:
    return "; ".join(dict.fromkeys(text for text in texts if text))


def _reasons(volume: VolumePlan, reports: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Why a Volume without this figure has none, by name."""
    config = volume.config
    missing = {
        step: "" if step in config.optimize.steps else f"no {step} step"
        for step in ("shape", "colour")
    }
    idle = _idle(reports)
    shape, colour = missing["shape"] or idle, missing["colour"] or idle
    off = idle or ("" if config.optimize.error_budget else "optimize.error_budget is off")
    thin = all(1 in frame.size.box for frame in volume.frames)
    alone, apart = _why_no_pair(volume), _why_no_overlap(volume)
    linear = config.shape.interpolation == "linear"
    return {
        "quadrature": f"{missing['colour']}: opacity needs no sum along the ray"
        if missing["colour"]
        else off,
        "resolution": off,
        "transport": shape,
        "optimiser's transport": shape
        or ("shape.interpolation is linear, as in the optimiser" if linear else ""),
        "mass": shape,
        "optimiser, shape": shape or _SHORT,
        "optimiser, colour": colour or _SHORT,
        "view sampling": idle or _SHORT,
        "unseen views": off or ("the smoke is one voxel thick and has one view" if thin else ""),
        "temporal, displacement": missing["shape"] or idle or alone,
        "temporal, colour": missing["colour"] or idle or alone,
        "windows, density": apart,
        "windows, emission": missing["colour"] or apart,
        "storage, emission": missing["colour"],
    }


def _idle(reports: Sequence[Mapping[str, Any]]) -> str:
    """Why nothing was done to any frame, or "" if something was."""
    why = dict.fromkeys(str(report.get("left out", "")) for report in reports)
    if not why or "" in why:
        return ""
    return f"no frame takes effect ({', '.join(why)})"


def _why_no_pair(volume: VolumePlan) -> str:
    """Why no frame of a Volume was compared with the one before."""
    if len(volume.frames) == 1:
        return "there is one frame only"
    if volume.config.windows.size == 1:
        return "windows.size is 1: frames are made one by one, without a look at the one before"
    if not list(_neighbours(volume)):
        return "there is a cut between any two frames"
    if all(len(window.time_codes) + len(window.beyond) == 1 for window in volume.windows):
        return "no two frames share a window"
    return "no two neighbouring frames take effect"


def _why_no_overlap(volume: VolumePlan) -> str:
    """Why no frame of a Volume was computed twice."""
    windows = volume.config.windows
    if len(volume.windows) == 1:
        return "there is one window only"
    if windows.size == 1:
        return "windows.size is 1: such windows share no frames"
    return "windows.overlap is 0" if windows.overlap == 0 else "there is a cut between any windows"


def _notes(volumes: Sequence[VolumePlan], reports: _Reports) -> dict[str, str]:
    """What the temporal errors do not hold: not every frame is compared with the one before."""
    notes = {}
    for kind, step in _KINDS.items():
        measured, borders, others, where = 0, 0, 0, list[str]()
        for volume in volumes:
            if step not in volume.config.optimize.steps:
                continue
            for before, after in _neighbours(volume):
                if kind in (_report(reports, after).get("temporal error") or {}):
                    measured += 1
                elif _at_border(volume, after):
                    borders += 1
                    where.append(f"{before.source.time_code:g}-{after.source.time_code:g}")
                else:
                    others += 1
        texts = [f"{measured} of {measured + borders + others} pairs of neighbouring frames"]
        if borders:
            texts.append(f"not those on both sides of a window's border ({_few(where)})")
        if others:
            texts.append(f"not {others} where a frame is not stylized")
        texts += _ways(volumes)
        if len(texts) > 1:
            notes[f"temporal, {kind}"] = ", ".join(texts)
    return notes


def _ways(volumes: Sequence[VolumePlan]) -> list[str]:
    """How pairs are compared where it is not as usual."""
    texts = []
    moving = [
        frame.velocity is not None or volume.config.stage.motion == "estimate"
        for volume in volumes
        for frame in volume.frames
    ]
    if not any(moving):
        texts.append("compared in place, as there is no velocity")
    if any(volume.twice_frames for volume in volumes):
        texts.append("each window's version by itself where windows overlap")
    return texts


def _neighbours(volume: VolumePlan) -> Iterator[tuple[FramePlan, FramePlan]]:
    """Frames that follow each other without a cut, whatever windows they are in."""
    for pair in pairwise(volume.frames):
        if tuple(frame.source.time_code for frame in pair) not in volume.cuts:
            yield pair


def _at_border(volume: VolumePlan, frame: FramePlan) -> bool:
    """Whether a frame is the first of its window, and no window before goes on to it."""
    code = frame.source.time_code
    first = any(window.time_codes[0] == code for window in volume.windows)
    return first and not any(code in window.beyond for window in volume.windows)


def _report(reports: _Reports, frame: FramePlan) -> Mapping[str, Any]:
    return reports.get(frame.file_name, {})


def _few(texts: Sequence[str]) -> str:
    return (
        ", ".join(texts) if len(texts) <= 6 else f"{', '.join(texts[:5])} and {len(texts) - 5} more"
    )

"""The rows of the error budget: each error, and why it may be missing, is declared here, once.

To add an error: put its estimate into ``FrameReport``, and declare a row here and in ``ROWS``. The
table at the end of a run, the provenance record and the findings (``findings``) take it from there.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

from usdsmoke.base.frame_report import Estimate, FrameReport, StepReport
from usdsmoke.planning.plan import FramePlan, VolumePlan

_MOST_NAMED = 6


@dataclass(frozen=True)
class PlannedVolume:
    """A Volume with the reports of its frames. Each reason is "" where it does not apply."""

    plan: VolumePlan
    reports: tuple[FrameReport | None, ...]  # of ``plan.frames``; None without one
    scene: Mapping[str, Any] = field(default_factory=dict)  # as measured; empty: not known

    def without_step(self, step: str) -> str:
        """Why a step is not run: shape or colour."""
        return "" if step in self.plan.config.optimize.steps else f"no {step} step"

    @property
    def no_shape(self) -> str:
        """Why there is nothing of the shape step."""
        return self.without_step("shape") or self.idle

    @property
    def no_colour(self) -> str:
        """Why there is nothing of the colour step."""
        return self.without_step("colour") or self.idle

    @cached_property
    def idle(self) -> str:
        """Why no frame is stylized."""
        why = dict.fromkeys("" if report is None else report.left_out for report in self.reports)
        return "" if not why or "" in why else f"no frame is stylized ({', '.join(why)})"

    @property
    def no_estimates(self) -> str:
        """Why nothing is estimated of the finished frames."""
        on = self.plan.config.optimize.error_budget
        return self.idle or ("" if on else "optimize.error_budget is off")

    @property
    def one_view(self) -> str:
        """Why there is only one view."""
        thin = all(1 in frame.size.box for frame in self.plan.frames)
        return "the smoke is one voxel thick and has one view" if thin else ""

    @property
    def one_scheme(self) -> str:
        """Why the optimiser's transport scheme has no error of its own."""
        linear = self.plan.config.shape.interpolation == "linear"
        return "shape.interpolation is linear, as in the optimiser" if linear else ""

    @property
    def no_pairs(self) -> str:
        """Why no frame is compared with the one before."""
        windows = self.plan.windows
        if len(self.plan.frames) == 1:
            return "there is one frame only"
        if self.plan.config.windows.size == 1:
            return "windows.size is 1: frames are stylized one by one, without the frame before"
        if not list(neighbours(self.plan)):
            return "there is a cut between any two frames"
        if all(len(window.time_codes) + len(window.overlap) == 1 for window in windows):
            return "no two frames share a window"
        compared = any(report and report.temporal for report in self.reports)
        return "no two neighbouring frames " + (
            "have smoke in common" if compared else "are stylized"
        )

    @property
    def no_overlap(self) -> str:
        """Why no frame is computed twice."""
        windows = self.plan.config.windows
        if len(self.plan.windows) == 1:
            return "there is one window only"
        if windows.size == 1:
            return "windows.size is 1: such windows share no frames"
        return (
            "windows.overlap is 0" if windows.overlap == 0 else "there is a cut between any windows"
        )


def temporal_note(volumes: Sequence[PlannedVolume], kind: str, step: str) -> str:
    """What a temporal error leaves out: not every frame is compared with the one before.

    Returns:
        "" where all pairs of neighbouring frames are compared as usual.
    """
    measured, n_unlike, n_others, borders = 0, 0, 0, list[str]()
    for volume in volumes:
        if volume.without_step(step):
            continue
        names = [frame.file_name for frame in volume.plan.frames]
        reports = dict(zip(names, volume.reports, strict=True))
        for before, after in neighbours(volume.plan):
            report = reports[after.file_name]
            if report and report.temporal and getattr(report.temporal, kind) is not None:
                measured += 1
            elif _at_border(volume.plan, after):
                borders.append(f"{before.source.time_code:g}-{after.source.time_code:g}")
            elif report and report.temporal:
                n_unlike += 1
            else:
                n_others += 1
    n_pairs = measured + len(borders) + n_unlike + n_others
    texts = [f"{measured} of {n_pairs} pairs of neighbouring frames"]
    if borders:
        texts.append(f"not those on both sides of a window's border ({_shortened(borders)})")
    if n_unlike:
        texts.append(f"not {n_unlike} that have no smoke in common")
    if n_others:
        texts.append(f"not {n_others} where a frame is not stylized")
    texts += _unusual_ways([volume.plan for volume in volumes])
    return ", ".join(texts) if len(texts) > 1 else ""


def _unusual_ways(volumes: Sequence[VolumePlan]) -> list[str]:
    """How pairs are compared where it is not as usual."""
    moving = any(
        frame.velocity is not None or volume.config.stage.motion == "estimate"
        for volume in volumes
        for frame in volume.frames
    )
    texts = [] if moving else ["compared in place, as there is no velocity"]
    if any(volume.overlap_frames for volume in volumes):
        texts.append("each window's version separately, where windows overlap")
    return texts


def neighbours(volume: VolumePlan) -> Iterator[tuple[FramePlan, FramePlan]]:
    """Frames that follow each other without a cut, in whatever windows."""
    for pair in pairwise(volume.frames):
        if tuple(frame.source.time_code for frame in pair) not in volume.cuts:
            yield pair


def _at_border(volume: VolumePlan, frame: FramePlan) -> bool:
    """Whether a frame is the first of its window and no earlier window computes it."""
    code = frame.source.time_code
    first = any(window.time_codes[0] == code for window in volume.windows)
    return first and not any(code in window.overlap for window in volume.windows)


def _shortened(texts: Sequence[str]) -> str:
    if len(texts) <= _MOST_NAMED:
        return ", ".join(texts)
    return f"{', '.join(texts[: _MOST_NAMED - 1])} and {len(texts) - _MOST_NAMED + 1} more"


@dataclass(frozen=True)
class ErrorRow:
    """One error of a run."""

    name: str
    relative_to: str
    how: str  # it is estimated or measured
    of_frame: Callable[[FrameReport], Estimate | None]  # None: the frame has no such figure
    # Why no frame of a Volume has the figure; "" where the Volume gives no reason.
    why_absent: Callable[[PlannedVolume], str]
    without: str  # why no frame has it, where no Volume gives a reason
    advice: str  # what to do about a large one
    setting: str = ""  # that the advice is about; "" where input or result is to be looked at
    most: float = 1.0  # above it the figure says that something is wrong: its natural bound
    temporal: tuple[str, str] | None = None  # field of ``TemporalErrors``, and its step


def _figure(part: object | None, name: str) -> Estimate | None:
    """A number of a part of a report; it takes no time of its own."""
    value = None if part is None else getattr(part, name)
    return None if value is None else Estimate(value)


def _remaining(step: StepReport | None) -> Estimate | None:
    """Relative to the final loss: octaves have different pictures, and warm frames hardly fall."""
    if step is None or step.remaining is None or not step.loss or not math.isfinite(step.loss[-1]):
        return None
    end = step.loss[-1]
    return Estimate(min(step.remaining / end, 1.0) if end > 0 else 0.0)


_PICTURE, _DENSITY, _LOSS = "the picture", "the density", "the loss"
_SMOKE = "the voxels with smoke"
_NO_FRAME, _NO_SHAPE, _NO_COLOUR = "no frame is stylized", "no shape step", "no colour step"
_TOO_FEW = "its last octave has too few iterations to extrapolate"
_BEFORE_BLENDING = "measured before they are blended"

QUADRATURE = ErrorRow(
    name="quadrature",
    relative_to=_PICTURE,
    how="slabs of 1, 2 and 4 steps",
    of_frame=lambda report: report.errors.quadrature,
    why_absent=lambda volume: (
        f"{text}: opacity needs no sum along the ray"
        if (text := volume.without_step("colour"))
        else volume.no_estimates
    ),
    without="no colour step: opacity needs no sum along the ray",
    advice="set grids.refine=2: the step along the rays is a voxel",
    setting="grids.refine",
)
RESOLUTION = ErrorRow(
    name="resolution",
    relative_to=_PICTURE,
    how="voxels and pixels of 1, 2 and 4 times the size",
    of_frame=lambda report: report.errors.resolution,
    why_absent=lambda volume: volume.no_estimates,
    without=_NO_FRAME,
    advice="set grids.refine=2, or look at the result closely: strokes are as fine as the pixels",
    setting="grids.refine",
)
TRANSPORT = ErrorRow(
    name="transport",
    relative_to=_DENSITY,
    how="voxels of 1, 2 and 4 times the size",
    of_frame=lambda report: None if report.transport is None else report.transport.error,
    why_absent=lambda volume: volume.no_shape,
    without=_NO_SHAPE,
    advice="set grids.refine=2, or a smaller shape.reach",
    setting="shape.reach",
)
LINEAR_TRANSPORT = ErrorRow(
    name="optimiser's transport",
    relative_to=_DENSITY,
    how="the linear scheme against the final one",
    of_frame=lambda report: _figure(report.transport, "linear_difference"),
    why_absent=lambda volume: volume.no_shape or volume.one_scheme,
    without="no shape step, or the same scheme",
    advice="set a smaller shape.reach",
    setting="shape.reach",
)


def _of_transport(name: str, how: str, field: str, most: float) -> ErrorRow:
    """A figure of the report of the transport that is measured where there is a shape step."""
    return ErrorRow(
        name=name,
        relative_to=_SMOKE if field == "folded" else _DENSITY,
        how=how,
        of_frame=lambda report: _figure(report.transport, field),
        why_absent=lambda volume: volume.no_shape,
        without=_NO_SHAPE,
        advice="leave the step out with optimize.steps=[colour]"
        if field == "motionless"
        else "set a smaller shape.reach",
        setting="optimize.steps" if field == "motionless" else "shape.reach",
        most=most,
    )


MASS = _of_transport("mass", "measured before it is corrected", "mass_error", 0.25)
FOLDED = _of_transport(
    "folded smoke", "voxels at which the determinant is not above 0", "folded", 0.05
)
UNREAD = _of_transport("mass, unread", "mass of which less than a twentieth is read", "unread", 0.1)
READ_TWICE = _of_transport(
    "mass, read twice", "mass that is read more than twice", "read_twice", 0.2
)
MOTIONLESS = _of_transport(
    "motionless mass", "mass that the shape step cannot move", "motionless", 0.5
)
SHAPE_OPTIMISER = ErrorRow(
    name="optimiser, shape",
    relative_to="its final loss",
    how="tails fitted to the loss, to four times as long",
    of_frame=lambda report: _remaining(report.shape),
    why_absent=lambda volume: volume.no_shape,
    without=_TOO_FEW,
    advice="set more shape.iterations",
    setting="shape.iterations",
    most=0.5,
)
COLOUR_OPTIMISER = ErrorRow(
    name="optimiser, colour",
    relative_to="its final loss",
    how="tails fitted to the loss, to four times as long",
    of_frame=lambda report: _remaining(report.colour),
    why_absent=lambda volume: volume.no_colour,
    without=_TOO_FEW,
    advice="set more colour.iterations",
    setting="colour.iterations",
    most=0.5,
)
VIEW_SAMPLING = ErrorRow(
    name="view sampling",
    relative_to=_LOSS,
    how="standard error over the pool of views",
    of_frame=lambda report: _figure(report.last_step, "view_spread"),
    why_absent=lambda volume: volume.idle,
    without=_TOO_FEW,
    advice="set a larger views.pool",
    setting="views.pool",
)
UNSEEN_VIEWS = ErrorRow(
    name="unseen views",
    relative_to=_LOSS,
    how="views beside the pool against its own",
    of_frame=lambda report: report.errors.unseen_views,
    why_absent=lambda volume: volume.no_estimates or volume.one_view,
    without="one view, or no frame is stylized",
    advice="set a larger views.pool",
    setting="views.pool",
)


def _temporal(kind: str, step: str, setting: str, n: int) -> ErrorRow:
    """Over n frames."""
    field = kind if n == 1 else f"{kind}_{n}"
    return ErrorRow(
        name=f"temporal, {kind}" + ("" if n == 1 else f", {n} frames"),
        relative_to="a pattern drawn anew",
        how=f"measured against {'the frame' if n == 1 else f'{n} frames'} before",
        of_frame=lambda report: _figure(report.temporal, field),
        why_absent=lambda volume: volume.without_step(step) or volume.idle or volume.no_pairs,
        without=f"no chain of {n + 1} frames, or no {step} step",
        temporal=(field, step) if n == 1 else None,
        most=1.2,  # noise drawn anew: 1
        advice=f"change {setting}, or look at the sequence",
        setting=setting,
    )


_MOVED = ("displacement", "shape", "windows.steadiness")
_PATTERNS = (_MOVED, ("colour", "colour", "colour.warm_rate"))
TEMPORAL = tuple(_temporal(*pattern, n) for n in (1, 4, 8) for pattern in _PATTERNS)
OVERLAP_DENSITY = ErrorRow(
    name="windows, density",
    relative_to=_DENSITY,
    how=_BEFORE_BLENDING,
    of_frame=lambda report: _figure(report.overlap, "density"),
    why_absent=lambda volume: volume.no_overlap,
    without="no frame is in two windows",
    advice="set a larger windows.overlap",
    setting="windows.overlap",
)
OVERLAP_EMISSION = ErrorRow(
    name="windows, emission",
    relative_to="the emission",
    how=_BEFORE_BLENDING,
    of_frame=lambda report: _figure(report.overlap, "emission"),
    why_absent=lambda volume: volume.without_step("colour") or volume.no_overlap,
    without="no frame is in two windows, or no colour step",
    advice="set a larger windows.overlap",
    setting="windows.overlap",
)
STORAGE_DENSITY = ErrorRow(
    name="storage, density",
    relative_to=_DENSITY,
    how="measured: half floats and pruning",
    of_frame=lambda report: report.errors.storage_density,
    why_absent=lambda volume: "",
    without="not measured",
    advice="set grids.half=false and grids.prune=0",
    setting="grids.prune",
)
STORAGE_EMISSION = ErrorRow(
    name="storage, emission",
    relative_to="the emission",
    how="measured: half floats and pruning",
    of_frame=lambda report: report.errors.storage_emission,
    why_absent=lambda volume: volume.without_step("colour"),
    without=_NO_COLOUR,
    advice="set grids.half=false and grids.prune=0",
    setting="grids.prune",
)

ROWS = (
    QUADRATURE,
    RESOLUTION,
    TRANSPORT,
    LINEAR_TRANSPORT,
    MASS,
    FOLDED,
    UNREAD,
    READ_TWICE,
    MOTIONLESS,
    SHAPE_OPTIMISER,
    COLOUR_OPTIMISER,
    VIEW_SAMPLING,
    UNSEEN_VIEWS,
    *TEMPORAL,
    OVERLAP_DENSITY,
    OVERLAP_EMISSION,
    STORAGE_DENSITY,
    STORAGE_EMISSION,
)

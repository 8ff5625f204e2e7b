"""The rows of the error budget: each error, and why it may be missing, is declared here, once.

To add an error: put its estimate into ``FrameReport``, and declare a row here and in ``ROWS``. The
table at the end of a run, the provenance record and the findings (``findings``) take it from there.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from usdsmoke.base.frame_report import Estimate, FrameReport, StepReport
from usdsmoke.runs.budget.planned import PlannedVolume


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
_TOO_SHORT = "its last octave has too few iterations, or too small steps, to extrapolate"
_BEFORE_BLENDING = "measured before they are blended"

QUADRATURE = ErrorRow(
    name="quadrature",
    relative_to=_PICTURE,
    how="measured against rays through the smoke",
    of_frame=lambda report: report.errors.quadrature,
    why_absent=lambda volume: (
        f"{text}: opacity needs no sum along the ray"
        if (text := volume.without_step("colour"))
        else volume.no_estimates
    ),
    without="no colour step: opacity needs no sum along the ray",
    advice="set a larger grids.refine than the record has: the step along the rays is a voxel",
    setting="grids.refine",
    most=0.25,
)
RESOLUTION = ErrorRow(
    name="resolution",
    relative_to=_PICTURE,
    how="voxels and pixels of 1, 2 and 4 times the size",
    of_frame=lambda report: report.errors.resolution,
    why_absent=lambda volume: volume.no_estimates,
    without=_NO_FRAME,
    advice="set a larger grids.refine than the record has, or look at the result closely: strokes "
    "are as fine as the pixels",
    setting="grids.refine",
    most=0.5,
)
PIXEL_FILTER = ErrorRow(
    name="pixel filter",
    relative_to=_PICTURE,
    how="pixels as averages of four samples against one",
    of_frame=lambda report: report.errors.pixel_filter,
    why_absent=lambda volume: volume.no_estimates,
    without=_NO_FRAME,
    advice="set a larger style.size than the record has: strokes are as fine as the pixels",
    setting="style.size",
)
TRANSPORT = ErrorRow(
    name="transport",
    relative_to=_DENSITY,
    how="the look-up against the sampling theorem's and every second voxel, and corrected mass",
    of_frame=lambda report: None if report.transport is None else report.transport.error,
    why_absent=lambda volume: volume.no_shape,
    without=_NO_SHAPE,
    advice="set a larger grids.refine than the record has, or a smaller shape.reach",
    setting="shape.reach",
    most=0.25,
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
    most=0.5,
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


MASS = _of_transport("mass", "measured before it is corrected", "mass_error", 0.1)
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
    without=_TOO_SHORT,
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
    without=_TOO_SHORT,
    advice="set more colour.iterations",
    setting="colour.iterations",
    most=0.5,
)
VIEW_SAMPLING = ErrorRow(
    name="view sampling",
    relative_to=_LOSS,
    how="standard error over the pool of views",
    of_frame=lambda report: _figure(report.last_step, "view_spread"),
    why_absent=lambda volume: volume.idle or volume.no_spread,
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
        why_absent=lambda volume: volume.without_step(step) or volume.idle or volume.no_chain(n),
        without=f"no chain of {n + 1} frames, or no {step} step",
        temporal=(field, step) if n == 1 else None,
        most=0.5 if n == 1 else 0.8,  # a pattern drawn anew: 1
        advice=f"look at the sequence; if it flickers, check that the smoke has the right "
        f"velocity, or change {setting}",
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


def _storage(kind: str, relative_to: str, without: str) -> ErrorRow:
    """What writing a grid loses."""
    return ErrorRow(
        name=f"storage, {kind}",
        relative_to=relative_to,
        how="measured: half floats and pruning",
        of_frame=lambda report: getattr(report.errors, f"storage_{kind}"),
        why_absent=lambda volume: volume.without_step("colour") if kind == "emission" else "",
        without=without,
        most=0.01,  # rounding to 16 bits loses a twentieth of that, unless numbers are too small
        advice="set grids.half=false and grids.prune=0",
        setting="grids.half",
    )


STORAGE_DENSITY = _storage("density", _DENSITY, "not measured")
STORAGE_EMISSION = _storage("emission", "the emission", _NO_COLOUR)

ROWS = (
    QUADRATURE,
    RESOLUTION,
    PIXEL_FILTER,
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

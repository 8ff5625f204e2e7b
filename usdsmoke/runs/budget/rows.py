"""The rows of the error budget: each error is declared here, once.

To add an error: put its estimate into ``FrameReport``, and declare a row here and in ``ROWS``. The
table at the end of a run, the provenance record and ``--tolerance`` take it from there.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from usdsmoke.base.frame_report import Estimate, FrameReport, StepReport
from usdsmoke.runs.budget.absence import PlannedVolume

SAFETY = 2.0  # between an estimate before the run and its bound
PICTURE_SAFETY = 4.0  # of the resolution: strokes get finer while the optimiser goes on


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
    share: float | None = None  # of a tolerance, that this error may have; None: not bounded
    advice: str = ""  # what to set where the bound is not kept
    safety: float = SAFETY  # factor between an estimate before the run and the bound
    temporal: tuple[str, str] | None = None  # field of ``TemporalErrors``, and its step

    def bound(self, tolerance: float) -> float:
        """The part of a tolerance that this error may have.

        Raises:
            ValueError: it is not bounded.
        """
        if self.share is None:
            raise ValueError(f"a tolerance does not bound {self.name}")
        return self.share * tolerance


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
_NO_FRAME, _NO_SHAPE, _NO_COLOUR = "no frame is stylized", "no shape step", "no colour step"
_TOO_FEW = "too few iterations in the last octave to fit a tail to"
_BEFORE_BLENDING = "measured before they are blended"
_AGAINST_BEFORE = "measured against the frame before"

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
    share=1 / 2,  # slabs are part of what the resolution's estimate changes
    advice="set grids.refine=2: the step along the rays is a voxel",
)
RESOLUTION = ErrorRow(
    name="resolution",
    relative_to=_PICTURE,
    how="voxels and pixels of 1, 2 and 4 times the size",
    of_frame=lambda report: report.errors.resolution,
    why_absent=lambda volume: volume.no_estimates,
    without=_NO_FRAME,
    share=1 / 2,
    advice="the strokes are about as fine as the pixels, so larger pictures and finer voxels "
    "hardly change it; a tolerance that can be kept is larger",
    safety=PICTURE_SAFETY,
)
TRANSPORT = ErrorRow(
    name="transport",
    relative_to=_DENSITY,
    how="voxels of 1, 2 and 4 times the size",
    of_frame=lambda report: None if report.transport is None else report.transport.error,
    why_absent=lambda volume: volume.no_shape,
    without=_NO_SHAPE,
    share=1 / 4,
    advice="set grids.refine=2, or a smaller shape.reach",
)
LINEAR_TRANSPORT = ErrorRow(
    name="optimiser's transport",
    relative_to=_DENSITY,
    how="the linear scheme against the final one",
    of_frame=lambda report: _figure(report.transport, "linear_difference"),
    why_absent=lambda volume: volume.no_shape or volume.one_scheme,
    without="no shape step, or the same scheme",
)
MASS = ErrorRow(
    name="mass",
    relative_to=_DENSITY,
    how="measured before it is corrected",
    of_frame=lambda report: _figure(report.transport, "mass_error"),
    why_absent=lambda volume: volume.no_shape,
    without=_NO_SHAPE,
)
SHAPE_OPTIMISER = ErrorRow(
    name="optimiser, shape",
    relative_to="its final loss",
    how="tails fitted to the loss",
    of_frame=lambda report: _remaining(report.shape),
    why_absent=lambda volume: volume.no_shape,
    without=_TOO_FEW,
    share=1.0,
    advice="set more shape.iterations",
)
COLOUR_OPTIMISER = ErrorRow(
    name="optimiser, colour",
    relative_to="its final loss",
    how="tails fitted to the loss",
    of_frame=lambda report: _remaining(report.colour),
    why_absent=lambda volume: volume.no_colour,
    without=_TOO_FEW,
    share=1.0,
    advice="set more colour.iterations",
)
VIEW_SAMPLING = ErrorRow(
    name="view sampling",
    relative_to=_LOSS,
    how="standard error over the pool of views",
    of_frame=lambda report: _figure(report.last_step, "view_spread"),
    why_absent=lambda volume: volume.idle,
    without=_TOO_FEW,
    share=1.0,
    advice="set a larger views.pool",
)
UNSEEN_VIEWS = ErrorRow(
    name="unseen views",
    relative_to=_LOSS,
    how="views beside the pool against its own",
    of_frame=lambda report: report.errors.unseen_views,
    why_absent=lambda volume: volume.no_estimates or volume.one_view,
    without="one view, or no frame is stylized",
    share=1.0,
    advice="set a larger views.pool",
)
TEMPORAL_DISPLACEMENT = ErrorRow(
    name="temporal, displacement",
    relative_to="the displacement",
    how=_AGAINST_BEFORE,
    of_frame=lambda report: _figure(report.temporal, "displacement"),
    why_absent=lambda volume: volume.no_shape or volume.no_pairs,
    without="no frame follows another",
    temporal=("displacement", "shape"),
)
TEMPORAL_COLOUR = ErrorRow(
    name="temporal, colour",
    relative_to="the colours",
    how=_AGAINST_BEFORE,
    of_frame=lambda report: _figure(report.temporal, "colour"),
    why_absent=lambda volume: volume.no_colour or volume.no_pairs,
    without="no frame follows another, or no colour step",
    temporal=("colour", "colour"),
)
OVERLAP_DENSITY = ErrorRow(
    name="windows, density",
    relative_to=_DENSITY,
    how=_BEFORE_BLENDING,
    of_frame=lambda report: _figure(report.overlap, "density"),
    why_absent=lambda volume: volume.no_overlap,
    without="no frame is in two windows",
)
OVERLAP_EMISSION = ErrorRow(
    name="windows, emission",
    relative_to="the emission",
    how=_BEFORE_BLENDING,
    of_frame=lambda report: _figure(report.overlap, "emission"),
    why_absent=lambda volume: volume.without_step("colour") or volume.no_overlap,
    without="no frame is in two windows, or no colour step",
)
STORAGE_DENSITY = ErrorRow(
    name="storage, density",
    relative_to=_DENSITY,
    how="measured: half floats and pruning",
    of_frame=lambda report: report.errors.storage_density,
    why_absent=lambda volume: "",
    without="not measured",
    share=1 / 4,  # of 16-bit floats and of pruning together
    advice="set grids.half=false and grids.prune=0",
)
STORAGE_EMISSION = ErrorRow(
    name="storage, emission",
    relative_to="the emission",
    how="measured: half floats and pruning",
    of_frame=lambda report: report.errors.storage_emission,
    why_absent=lambda volume: volume.without_step("colour"),
    without=_NO_COLOUR,
    share=1 / 4,
    advice="set grids.half=false and grids.prune=0",
)

ROWS = (
    QUADRATURE,
    RESOLUTION,
    TRANSPORT,
    LINEAR_TRANSPORT,
    MASS,
    SHAPE_OPTIMISER,
    COLOUR_OPTIMISER,
    VIEW_SAMPLING,
    UNSEEN_VIEWS,
    TEMPORAL_DISPLACEMENT,
    TEMPORAL_COLOUR,
    OVERLAP_DENSITY,
    OVERLAP_EMISSION,
    STORAGE_DENSITY,
    STORAGE_EMISSION,
)

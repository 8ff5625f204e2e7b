"""The report of one frame: what its steps did, and what is known of its errors.

The core makes it, and tells how far it is meanwhile. The run's folder keeps it as JSON, and the
error budget of a run is made from the reports of its frames (``runs.budget``).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from usdsmoke.base.json_records import JsonRecord


@dataclass(frozen=True)
class Progress:
    """One iteration of one step on one frame."""

    step: str  # "shape" or "colour"
    time_code: float
    frame: int  # 0-based, within the window
    n_frames: int  # of the window
    octave: int  # 0-based, coarse to fine
    n_octaves: int
    iteration: int  # 0-based, over all octaves of this step and frame
    n_iterations: int  # of this step and frame
    loss: float


ProgressCallback = Callable[[Progress], None]
DIM = 0.02  # of the pictures' light: less is not seen
TINTED = 0.05  # of the brightest channel: a style that needs the faintest one cannot be shown
# of ``StepReport.way``: behind less, the rows on the end of the optimisation are left out, as they
# would be wrong by more than a factor of 2
SHORTEST_WAY = 0.2


@dataclass(frozen=True)
class Estimate:
    """One error of a frame, relative; the row of the error budget says to what."""

    value: float
    seconds: float = 0.0  # that the estimate took
    order: float | None = None  # of convergence, fitted; None where no order is fitted


@dataclass(frozen=True)
class StepReport:
    """How the shape step or the colour step ended. Losses have no unit."""

    seconds: float = 0.0
    loss: tuple[float, ...] = ()  # smoothed, at the end of each octave, coarse to fine
    iterations: tuple[int, ...] = ()  # of each octave
    rollbacks: int = 0
    restored: int = 0  # octaves that end with an earlier state, because the last one was worse
    ended: tuple[str, ...] = ()  # why each octave ended: "iterations" or "converged"
    # From the losses of the last octave; None where it has too few iterations or too small steps.
    fallen: float | None = None  # in all octaves, in units of the last one's loss
    fallen_in_last_octave: float | None = None
    remaining: float | None = (
        None  # by how much a run four times as long would end lower, predicted
    )
    view_spread: float | None = None  # standard error of its mean over the views, relative to it
    # Sum of the optimiser's rates in the last octave: how far an unknown can get. From black to
    # white, or from rest to the largest displacement, is 1.
    way: float | None = None

    @property
    def is_short(self) -> bool:
        """Whether the last octave's steps are too small to tell where its loss would go."""
        return self.way is not None and self.way < SHORTEST_WAY


@dataclass(frozen=True)
class TransportReport:
    """How the density was moved. Mass and differences are relative to the sum of the density."""

    cap: float = 0.0  # largest displacement that is allowed, stage units
    largest_displacement: float = 0.0  # stage units
    linear_difference: float | None = None  # of the linear scheme; None where it is the one used
    error: Estimate | None = None  # of the scheme used; None where nothing was moved
    mass_error: float | None = None  # gain of mass before it is corrected; negative is a loss
    # How evenly smoke is read; None where nothing was moved.
    folded: float | None = None  # of the voxels with smoke, those where space folds
    unread: float | None = None  # of the mass, that of which less than a twentieth is read
    read_twice: float | None = None  # of the mass, that which is read more than twice
    motionless: float | None = None  # of the mass under the mask, that which cannot be moved


@dataclass(frozen=True)
class LightReport:
    """What lamps do in the pictures of lit smoke."""

    share: float  # of the pictures' light, that which lamps give
    outshone: float  # of the pixels with smoke, those where it is brighter than the style's white
    reach: float  # brightness of smoke in the light over the style's white; of white smoke where
    # colours are albedos
    # optics.exposure at which that is a half, or 1 where colours are albedos; None for none
    advised: float | None
    # The least of the light's red, green and blue in the pictures, over the greatest.
    faintest: float = 1.0

    @property
    def is_tinted(self) -> bool:
        """Whether the lamps give nearly all light, and hardly any of one colour."""
        return self.share > 1 - DIM and self.faintest < TINTED


@dataclass(frozen=True)
class LookReport:
    """How the finished pictures compare with the style as a whole, in display-encoded colours."""

    colour_off: float  # difference of the mean colours, in the channel where it is largest
    contrast: float  # deviation of the colours around their mean, over the style's
    shown: float = 1.0  # of the style's deviation, that which is left at the pictures' size
    white: float = 1.0  # linear luminance that one pixel of the style in a hundred is above


@dataclass(frozen=True)
class SightReport:
    """What stands between a shot's camera and the smoke that it looks at."""

    close: float  # of the picture, hidden by smoke of which a voxel fills an eighth of its width
    clipped: float  # of the mass that the film shows, that before or behind the clipping planes


@dataclass(frozen=True)
class FrameErrors:
    """What is estimated or measured of a finished frame; None where it does not apply."""

    quadrature: Estimate | None = None  # of voxels on pixels and slabs, relative to the picture
    resolution: Estimate | None = None  # of voxels and pixels, relative to the picture
    pixel_filter: Estimate | None = None  # of points for pixels, relative to the picture
    unseen_views: Estimate | None = None  # style loss of other views, relative to that of the pool
    storage_density: Estimate | None = None  # lost by pruning and 16-bit floats
    storage_emission: Estimate | None = None


@dataclass(frozen=True)
class TemporalErrors:
    """The share of a pattern that does not move with its smoke, from 0 to about 1; see
    ``core.sequence.steadiness``. None where there is no frame so many steps before."""

    displacement: float | None = None  # against the frame before
    colour: float | None = None
    displacement_4: float | None = None  # against the fourth frame before
    colour_4: float | None = None
    displacement_8: float | None = None
    colour_8: float | None = None

    @staticmethod
    def of(displacement: Mapping[int, float], colour: Mapping[int, float]) -> "TemporalErrors":
        """From errors by the number of steps: 1, 4 and 8."""
        return TemporalErrors(
            *(found.get(steps) for steps in (1, 4, 8) for found in (displacement, colour))
        )

    def mixed(self, other: "TemporalErrors", weight: float) -> "TemporalErrors":
        """Both, weighted; one alone where the other has none.

        Args:
            weight: of this one, 0 to 1.
        """

        def mix(mine: float | None, theirs: float | None) -> float | None:
            if mine is None or theirs is None:
                return theirs if mine is None else mine
            return weight * mine + (1 - weight) * theirs

        return TemporalErrors(
            *(mix(mine, getattr(other, name)) for name, mine in vars(self).items())
        )


@dataclass(frozen=True)
class OverlapReport:
    """A frame that two windows compute: how far apart both versions are before they are blended."""

    windows: tuple[int, int]  # numbers of the earlier and the later window
    weight: float  # of the earlier one, 0 to 1
    density: float | None = None  # difference relative to their size
    emission: float | None = None


@dataclass(frozen=True)
class FrameReport(JsonRecord):
    """Everything that is known of one frame when it is finished."""

    keeps_defaults = False

    voxels: int = 0  # with smoke
    voxels_outside_camera: int | None = None  # of these; None where the camera does not matter
    warnings: tuple[str, ...] = ()
    left_out: str = ""  # why nothing is done; "" for a frame that is stylized
    sight: SightReport | None = None  # None without a camera
    extinction: float = 0.0  # 1/stage unit per density
    # Optical depth of thick columns in the pictures of the last step; None: not measured.
    depth: float | None = None
    gamma_is_set: bool = False  # for the last step; else the smoke has chosen the extinction
    gamma_is_own: bool = False  # the frame's gamma is animated, so it is not that of the run
    depth_by_side: tuple[float, float] | None = None  # least and most over the views, about
    shape: StepReport | None = None  # None where the step is not run
    transport: TransportReport | None = None  # None without a shape step
    colour: StepReport | None = None
    light: LightReport | None = None  # None where no light is scattered
    look: LookReport | None = None  # None without a colour step
    errors: FrameErrors = field(default_factory=FrameErrors)
    temporal: TemporalErrors | None = None  # None without a frame before it in the window
    overlap: OverlapReport | None = None  # None for a frame of one window
    velocity_doubt: str = ""  # why the velocity before it seems wrong, and what to do; "": it fits
    # Between the steps: the density is moved, and results are averaged and compared with those of
    # neighbouring frames. Without the estimate of the error.
    transport_seconds: float = 0.0
    voxels_written: int | None = None  # with smoke in the result; None: not written yet

    def with_transport_time(self, seconds: float) -> "FrameReport":
        """The report with more seconds of transport."""
        return replace(self, transport_seconds=self.transport_seconds + seconds)

    @property
    def steps(self) -> Mapping[str, StepReport]:
        """The steps that were run, by name, in their order."""
        steps = {"shape": self.shape, "colour": self.colour}
        return {name: step for name, step in steps.items() if step is not None}

    @property
    def last_step(self) -> StepReport | None:
        """The step that was run last."""
        return self.colour or self.shape

    @property
    def estimate_seconds(self) -> float:
        """Seconds that all estimates took, that of the transport included."""
        found = [estimate for estimate in vars(self.errors).values() if estimate is not None]
        if self.transport is not None and self.transport.error is not None:
            found.append(self.transport.error)
        return math.fsum(estimate.seconds for estimate in found)

    @property
    def storage_seconds(self) -> float:
        """Seconds that it took to measure what the file loses."""
        found = (self.errors.storage_density, self.errors.storage_emission)
        return math.fsum(estimate.seconds for estimate in found if estimate is not None)

"""One frame on its way through the chain of a window, and what all of its frames share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from usdsmoke.base.frame_report import FrameReport
from usdsmoke.base.settings import Config
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.sequence.start import Carried, CoarseStart
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.steps.optimize import Minimum
from usdsmoke.core.style.targets import StyleTargets
from usdsmoke.core.views.scene import Scene
from usdsmoke.core.views.visibility import EffectMask, Visibility

__all__ = ["Job", "Link", "Watch"]

Watch = Callable[[str, Sequence[int]], Callable[[int, Minimum], None]]


@dataclass(frozen=True)
class Job:
    """What all frames of a window share."""

    targets: StyleTargets
    scene: Scene
    config: Config
    device: torch.device
    time_codes_per_second: float
    starts: Callable[[float], CoarseStart | None]
    watch: Callable[[float], Watch]  # by timeCode
    keeps_carried: bool = False  # whether links keep what their next ones start from
    known: Carried | None = None  # of a frame that is not optimised once more

    def seconds(self, earlier: "Link", later: "Link") -> float:
        """Time between two frames, as the pattern goes: ``windows.pattern_speed`` times as fast.

        The earlier frame's speed holds, whichever of the two the other one's result is carried to.
        """
        span = later.frame.time_code - earlier.frame.time_code
        return span / self.time_codes_per_second * earlier.config.windows.pattern_speed


@dataclass
class Link:
    """One frame on its way through the chain."""

    frame: VolumeFrame
    density: DenseField  # refined, then moved; all of it
    source: ActiveSmoke  # what is worked on: the visible smoke and a little around
    smoke: ActiveSmoke  # what is painted: of the moved density, without what is around
    mask: EffectMask | None
    left_out: str  # why nothing is done; "" when there is something to do
    coarse: CoarseStart | None
    config: Config  # the job's, with the frame's own controls
    scene: Scene  # likewise, with its camera
    targets: StyleTargets  # likewise
    visibility: Visibility | None = None  # None: all of the smoke is worked on
    rests: bool = False  # left out for its strength of 0: what comes after it starts anew
    report: FrameReport = field(default_factory=FrameReport)  # replaced as steps are done
    free: Displacement | None = None  # before it is held below the cap: what is carried along
    settled: Displacement | None = None  # averaged with the following frame's
    displacement: Displacement | None = None  # what the density was moved by, at full strength
    carried: Carried | None = None  # where the job asks for it
    painted: ActiveSmoke | None = None
    colours: Tensor | None = None  # display-encoded [N 3], of the painted voxels

    @property
    def paint(self) -> tuple[ActiveSmoke, Tensor] | None:
        """The painted voxels and their colours; None where there are none."""
        if self.painted is None or self.colours is None or len(self.painted.ijk) == 0:
            return None
        return self.painted, self.colours

    @property
    def in_effect(self) -> bool:
        """Whether the result differs from the source."""
        return not self.left_out and self.config.optimize.strength > 0

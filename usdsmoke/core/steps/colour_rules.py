"""What colours are held to while they are optimised: their range, hues of the style, no speckle.

All along, colours are brought to hues that the style has: pictures hardly hold those of dark smoke,
nor those that cancel in them. Towards the end of an octave hues are blended with those of the
voxels beside, because views leave each other speckle; the last iterations mend what the style loses
by that. A warm frame gets such colours from its neighbour, and mixed anew in each frame they would
blur: only the hues of the change are blended. Brightness is sharpened then, as far as the loss
falls: what differs from voxel to voxel is found last.

In the finest octave, a voxel is not brighter than all but one of the six beside it, nor darker. The
views of the pool disagree about single voxels: they fit each its own, and other views see grain. In
coarser octaves a single voxel may become a mark of the style. Colours that are carried from another
frame, or painted by a network, begin without grain, and are left free.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.memory import SHARED_ROWS, share_rows
from usdsmoke.core.smoke.schedule import has_one_view
from usdsmoke.core.smoke.spread import Surroundings, blend_chroma, luma_detail
from usdsmoke.core.smoke.srgb import BRIGHTEST, luma
from usdsmoke.core.steps.sharpen import sharpened
from usdsmoke.core.steps.targets import StepProblem
from usdsmoke.core.style.hues import Hues
from usdsmoke.core.views.optics import opacity
from usdsmoke.core.views.scene import Scene


@dataclass(frozen=True)
class ColourRules:
    """What colours are held to during an octave."""

    #: the largest display-encoded value
    limit: float = 1.0
    #: what is done to all colours [N 3] before the last iterations
    blended: Callable[[Tensor], Tensor] | None = None
    #: of colours [N 3] the detail [N 1] that is raised then
    detail: Callable[[Tensor], Tensor] | None = None
    #: the hues that colours are brought to again and again
    style: Hues | None = None
    #: of lumas [N], how far those of rows [M] outlie, which is taken away again and again
    speckle: Callable[[Tensor, Tensor], Tensor] | None = None

    def in_style(self, colours: Tensor, begun: Tensor | None) -> Tensor:
        """Colours [N 3] with hues of the style, see ``Hues.nearest``, and without speckle."""
        if self.speckle is not None:
            rows = torch.arange(len(colours), device=colours.device)
            found = self.speckle(luma(colours), rows)[:, None]
            colours = (colours - found).clamp_(0, self.limit)
        if self.style is None:
            return colours
        return self.style.nearest(colours, begun).clamp(0, self.limit)

    def clip(self, unknown: Tensor) -> None:
        """Bring the colours [M 3] that are optimised into their range, in place."""

        def clip_part(part: slice) -> None:
            unknown[part].clamp_(0, self.limit)

        share_rows(clip_part, len(unknown), SHARED_ROWS, unknown.device)

    def hold(self, unknown: Tensor, begun: Tensor, rows: Tensor, light: Tensor) -> None:
        """Bring the colours [M 3] that are optimised to the style, in place.

        Args:
            begun: what they began with.
            rows: which of all they are, [M].
            light: lumas of all colours [N]; those of the rows are overwritten, the others, which
                no view shows, are those that the octave began with.
        """
        if self.style is not None:
            self.style.bring(unknown, begun, self.limit)
        if self.speckle is not None:
            light[rows] = luma(unknown)
            unknown.sub_(self.speckle(light, rows)[:, None]).clamp_(0, self.limit)

    def changed(self, colours: Tensor, loss: Callable[[Tensor], float] | None) -> Tensor:
        """All colours [N 3] before the last iterations: blended, and sharpened by a loss if there
        is one."""
        assert self.blended is not None
        colours = self.blended(colours).clamp(0, self.limit)
        if self.detail is None or loss is None:
            return colours
        return sharpened(colours, self.detail(colours), self.limit, loss)


def find_rules(
    problem: StepProblem, painted: ActiveSmoke, begun: Tensor | None, has_speckle: bool
) -> ColourRules:
    """The rules of an octave.

    Args:
        painted: its voxels that are painted.
        begun: the colours of a start that is nearly right.
        has_speckle: its voxels are what is written, and may stand out.
    """
    around = Surroundings(painted, opacity_alone(painted, problem.scene))
    blended, detail = partial(_blended, around, begun), partial(luma_detail, around)
    # what scatters light has the hues of its albedo
    hues = problem.targets.hues if problem.lighting is None else None
    # a single view has nothing to disagree with
    agrees = has_one_view(problem.config.views, problem.smoke.thin_axis is not None)
    speckle = around.outlying if has_speckle and not agrees else None
    return ColourRules(limit_of(problem), blended, detail, hues, speckle)


def limit_of(problem: StepProblem) -> float:
    """The largest display-encoded value of a colour: ``BRIGHTEST``, or 1 for an albedo."""
    return 1.0 if problem.config.colour.target == "albedo" else BRIGHTEST


def opacity_alone(painted: ActiveSmoke, scene: Scene) -> Tensor:
    """The opacity of each voxel by itself, [N]."""
    return opacity(painted.density * (scene.gamma_w * painted.voxel_volume / painted.voxel_size**2))


def _blended(around: Surroundings, begun: Tensor | None, colours: Tensor) -> Tensor:
    """Colours [N 3] with blended hues; where they begin with a neighbour's, of the change alone."""
    if begun is None:
        return blend_chroma(around, colours)
    return begun + blend_chroma(around, colours - begun)

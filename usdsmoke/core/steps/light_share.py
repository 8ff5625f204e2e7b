"""How much of a painted frame's light comes from lamps, and whether it outshines the style."""

import math

import torch
from torch import Tensor

from usdsmoke.base.frame_report import LightReport
from usdsmoke.core.smoke.active import ActiveSmoke, coarsen, sample_colours
from usdsmoke.core.smoke.levels import bounded
from usdsmoke.core.smoke.srgb import decode_srgb
from usdsmoke.core.steps.pictures import ColourView, prepare_views
from usdsmoke.core.steps.targets import StepProblem
from usdsmoke.core.views.scene import frame_views

N_VIEWS = 4
FACTOR = 2  # voxels and pixels are this many times as large: shares need no detail
LIT = 0.95  # rank of the pixels that count as smoke in the light
ADVISED = 0.5  # of the style's white, which an advised exposure brings these to
_WEIGHTS = (0.2126, 0.7152, 0.0722)  # luminance of linear Rec.709


def light_report(problem: StepProblem, painted: ActiveSmoke, colours: Tensor) -> LightReport | None:
    """Measured on a few views of a coarser copy; None where no light is scattered.

    Args:
        problem: of the colour step.
        painted: the voxels that have colours.
        colours: display-encoded [N 3].
    """
    if problem.lighting is None or len(painted.ijk) == 0:
        return None
    scene, config = problem.scene, problem.config
    octave = coarsen(bounded(problem.smoke))
    share = None if problem.mask is None else problem.mask.at(octave.positions)
    here = octave if share is None else octave.take(share > 0)
    if len(here.ijk) == 0:
        return None
    linear = decode_srgb(sample_colours(painted, colours, here.positions)[0])
    directions = frame_views(
        octave, config.views.replace(pool=N_VIEWS), scene, config.optimize.seed, FACTOR
    )
    views = prepare_views(
        octave, directions, scene.gamma_w, scene.exposure, share, problem.lighting
    )
    with torch.no_grad():
        return _report(list(views), linear, problem.targets.white, scene.stops)


def _report(
    views: list[ColourView], linear: Tensor, white: float, stops: float
) -> LightReport | None:
    scattered = torch.cat([_pixels(view.scattered) for view in views])
    emitted = torch.cat([_pixels(view.image.apply(linear)) for view in views])
    alpha = torch.cat([view.alpha.reshape(-1).double() for view in views])
    total = float((scattered + emitted).sum())
    smoke = alpha > 0.5 * float(alpha.max())
    if not total > 0 or not bool(smoke.any()):
        return None
    weights = scattered.new_tensor(_WEIGHTS)
    brightness = (scattered @ weights)[smoke] / alpha[smoke] / max(white, 1e-3)
    lit = float(torch.quantile(brightness, LIT))
    return LightReport(
        share=float(scattered.sum()) / total,
        outshone=float((brightness > 1).double().mean()),
        advised=round(stops + math.log2(ADVISED / lit), 1) if lit > 0 else stops,
    )


def _pixels(picture: Tensor | None) -> Tensor:
    """[P 3] in double precision."""
    if picture is None:
        raise ValueError("a view without scattered light")
    return picture.reshape(-1, 3).double()

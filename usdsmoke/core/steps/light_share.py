"""What a painted frame's pictures show: of its lamps, and of the style as a whole."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.frame_report import LightReport, LookReport
from usdsmoke.base.volume import Scattering, VolumeFrame
from usdsmoke.config.look_sections import MOST_STOPS
from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.active import ActiveSmoke, activate, coarsen, sample_colours
from usdsmoke.core.smoke.levels import bounded
from usdsmoke.core.smoke.srgb import decode_srgb, luminance
from usdsmoke.core.steps.pictures import ColourView, prepare_views
from usdsmoke.core.steps.targets import StepProblem, StyleTargets
from usdsmoke.core.views.lighting import Lighting, light_smoke
from usdsmoke.core.views.scene import Scene, frame_views
from usdsmoke.core.views.visibility import frame_visibility

_N_VIEWS = 4
_FACTOR = 2  # voxels and pixels are this many times as large: shares need no detail
_LIT = 0.95  # rank of the pixels that count as smoke in the light
_ADVISED = 0.5  # of the style's white, which an advised exposure brings these to


def picture_reports(
    problem: StepProblem, painted: ActiveSmoke, colours: Tensor
) -> tuple[LightReport | None, LookReport | None]:
    """Measured on a few views of a coarser copy; None where nothing is painted.

    There is no light's report where the pictures show no light of lamps.

    Args:
        problem: of the colour step.
        painted: the voxels that have colours.
        colours: display-encoded [N 3].
    """
    if len(painted.ijk) == 0:
        return None, None
    octave = coarsen(bounded(problem.smoke))
    share = None if problem.mask is None else problem.mask.at(octave.positions)
    here = octave if share is None else octave.take(share > 0)
    if len(here.ijk) == 0:
        return None, None
    linear = decode_srgb(sample_colours(painted, colours, here.positions)[0])
    with torch.no_grad():
        views = _views(octave, problem.scene, problem.config, problem.lighting, share)
        look = _look(views, linear, problem.targets)
        return _light(views, here, linear, problem), look


def _light(
    views: Sequence[ColourView], here: ActiveSmoke, linear: Tensor, problem: StepProblem
) -> LightReport | None:
    lighting = problem.lighting
    if lighting is None:
        return None
    shown, lit_white = _all_pixels([view.shown(linear) for view in views]), _lit(views, here)
    lamps = shown if lighting.weighs_light else _all_pixels(lit_white)
    total, brightness = float(shown.sum()), _brightness(views, lit_white)
    if len(brightness) == 0:
        return None
    channels = _all_pixels(lit_white).sum(0)
    brightness = brightness / max(problem.targets.white, 1e-3)
    lit, target = float(brightness.quantile(_LIT)), 1.0 if lighting.weighs_light else _ADVISED
    return LightReport(
        share=float(lamps.sum()) / total if total > 0 else 0.0,
        outshone=0.0 if lighting.weighs_light else float((brightness > 1).double().mean()),
        reach=lit,
        advised=_advised(problem.scene.stops, target / lit) if lit > 0 else None,
        faintest=float(channels.min() / channels.max()) if float(channels.max()) > 0 else 1.0,
    )


def _look(views: Sequence[ColourView], linear: Tensor, targets: StyleTargets) -> LookReport:
    """Mean and deviation of the pictures' colours, weighted by opacity, beside the style's."""
    pictures = _all_pixels([view.unpremultiplied(linear, targets.background) for view in views])
    weight = torch.cat([view.alpha.flatten().double() for view in views])[:, None]
    weight = weight / weight.sum().clamp_min(torch.finfo(weight.dtype).tiny)
    mean = (weight * pictures).sum(0)
    deviation = float((weight * (pictures - mean).square()).sum().sqrt())
    wanted, spread = targets.colours
    off = float((mean - wanted.to(mean)).abs().max())
    contrast = deviation / spread if spread > 0 else 1.0
    return LookReport(off, contrast, targets.shown, targets.white)


def _advised(stops: float, factor: float) -> float | None:
    """The exposure at which light is that many times as bright; None beyond the limits."""
    advised = round(stops + math.log2(factor), 1)
    return advised if abs(advised) <= MOST_STOPS else None


def white_exposure(frames: Sequence[VolumeFrame], config: Config, scene: Scene) -> float:
    """The exposure in stops at which white smoke in the light is white, seen through the frames'
    cameras; 0 without light.

    Where that is beyond what ``optics.exposure`` takes, the nearest that it does.

    Args:
        frames: the same that the scene is measured on; empty frames are skipped.
        scene: measured.
    """
    found = []
    for frame in frames:
        smoke = activate(frame.density, frame.density_to_stage, torch.device("cpu"))
        scattering = Scattering(frame.lights, config.albedo, config.optics.anisotropy)
        lighting = light_smoke(smoke, scene.gamma_w, scattering)
        if lighting is None:
            continue
        visibility = frame_visibility(frame, smoke, 0.0, config.views.camera_margin)
        seen = smoke if visibility is None else visibility.visible(smoke)
        if len(seen.ijk) == 0:
            continue
        octave = coarsen(bounded(seen))
        views = _views(octave, replace(scene, camera=frame.camera), config, lighting, None)
        brightness = _brightness(views, _lit(views, octave))
        if len(brightness) and (lit := float(brightness.quantile(_LIT))) > 0:
            found.append(-math.log2(lit))
    stops = float(np.median(found)) if found else 0.0
    return min(max(stops, -MOST_STOPS), MOST_STOPS)


def _views(
    octave: ActiveSmoke,
    scene: Scene,
    config: Config,
    lighting: Lighting | None,
    share: Tensor | None,
) -> list[ColourView]:
    pool, seed = config.views.replace(pool=_N_VIEWS), config.optimize.seed
    directions = frame_views(octave, pool, scene, seed, _FACTOR)
    made = prepare_views(octave, directions, scene.gamma_w, scene.exposure, share, lighting)
    made.prepare(range(len(made)))
    return list(made)


def _lit(views: Sequence[ColourView], painted: ActiveSmoke) -> list[Tensor]:
    """What lamps alone give the pictures, on white where colours weigh it, [H W 3] each."""
    colours = painted.positions.new_zeros(len(painted.ijk), 3).to(views[0].alpha)
    return [view.shown(colours if view.light is None else colours + 1) for view in views]


def _brightness(views: Sequence[ColourView], lit: Sequence[Tensor]) -> Tensor:
    """Luminance of the pixels with smoke in ``_lit``, over their opacity, [P]."""
    found = []
    for view, picture in zip(views, lit, strict=True):
        smoke = view.alpha > 0.5 * view.alpha.max()
        light = luminance(picture[smoke].double())
        found.append(light / view.alpha[smoke])
    return torch.cat(found)


def _all_pixels(pictures: Sequence[Tensor]) -> Tensor:
    """[P 3] in double precision."""
    return torch.cat([picture.reshape(-1, 3).double() for picture in pictures])

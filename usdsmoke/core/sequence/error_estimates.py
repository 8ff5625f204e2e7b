"""What is left of a finished frame's errors, estimated from the frame itself.

Each estimate looks at one view, or a few, of what was found: a small part of the frame's own time,
which is measured and kept with it. What transport and optimiser can tell of themselves stands in
the reports of the steps.
"""

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.frame_report import SHORTEST_WAY, Estimate, FrameErrors, StepReport
from usdsmoke.config.look_sections import OpticsConfig
from usdsmoke.core.fields.richardson import StepError
from usdsmoke.core.sequence.frame_state import OpenedFrame, PaintedFrame
from usdsmoke.core.sequence.picture_errors import (
    Painted,
    fit_blocks,
    pixel_filter_error,
    quadrature_error,
    resolution_error,
)
from usdsmoke.core.smoke.levels import bounded
from usdsmoke.core.smoke.memory import run_on
from usdsmoke.core.smoke.schedule import (
    has_one_view,
    last_octave,
    pool_size,
    view_ranges,
    views_aside,
    views_in_front,
)
from usdsmoke.core.smoke.srgb import decode_srgb
from usdsmoke.core.smoke.voxels import FLOOR_TIMES
from usdsmoke.core.steps.colour import FAINT
from usdsmoke.core.steps.loss_tail import likely_difference, remaining_decrease, spread_of_mean
from usdsmoke.core.steps.optimize import Minimum
from usdsmoke.core.steps.pictures import ColourView, grey_view, prepare_views
from usdsmoke.core.steps.targets import StepProblem
from usdsmoke.core.views.cameras import View, draw_views, orbit_view
from usdsmoke.core.views.project import column_map
from usdsmoke.core.views.scene import frame_views, thick_column

Item = TypeVar("Item")

N_UNSEEN = 2  # views that were not optimised, as far apart as possible
N_SEEN = 8  # that were: with four, three of six scenes are told 2.4 to 4.5 times the truth
OTHER_SEED = 0x0DD5EED  # of their angles
_LEAST_LOSS = 1e-30  # nothing is left of a first loss
# Share of the loss that four times as many iterations gain, where the rates of the last octave add
# up to 1; less by the way to the power of .7. From runs of 30 to 160 iterations in each octave on
# puffs, filaments and two plumes (benchmarks/results/optimiser_error.md).
USUALLY_LEFT = {"colour": 0.205, "shape": 0.125}


def frame_errors(frame: PaintedFrame) -> FrameErrors:
    """Errors of a finished frame: quadrature, resolution, pixel filter, unseen views.

    Without colours there is no quadrature error: opacity is exact. If all views are the same, none
    is unseen. There is no error at all for a frame that is left out or not optimised, and without
    ``optimize.error_budget``.

    Args:
        frame: at the end of its chain.
    """
    if not _is_wanted(frame) or frame.independent:
        return FrameErrors()
    quadrature = None
    view = fit_blocks(_views(frame, 1, frame.config.optimize.seed)[0])
    painted = painted_frame(frame, view)
    gamma_w = frame.scene.gamma_w
    if frame.paint is None:
        gamma_w = frame.scene.gamma_w_shape
    with torch.no_grad():
        picture = painted.picture(view, gamma_w)
        if frame.paint is not None:
            quadrature = _timed(lambda: quadrature_error(painted, view, gamma_w, picture))
        resolution = _timed(lambda: resolution_error(painted, view, gamma_w, picture))
        filtered = _timed(lambda: pixel_filter_error(painted, view, gamma_w, picture))
    colours = None if frame.paint is None else frame.paint[1]
    unseen = frame.unseen
    if unseen is None:
        problem = frame.problem(frame.smoke) if colours is None else frame.colour_problem()
        unseen = unseen_views(frame, problem, colours, n_views=frame.n_views)
    return FrameErrors(quadrature, resolution, filtered, unseen)


def unseen_views(
    frame: OpenedFrame,
    problem: StepProblem,
    colours: Tensor | None,
    seen: Sequence[ColourView] = (),
    n_views: int = 0,
) -> Estimate | None:
    """How far the style loss of views nobody optimised differs from that of optimised ones.

    None where there are no errors (``frame_errors``), and where all views are the same.

    Args:
        frame: with its density moved.
        problem: of its last step.
        colours: display-encoded [N 3], of the painted voxels; None: the grey pictures are compared.
        seen: views that the colours were optimised with; without any they are made anew.
        n_views: that the last octave had; 0: ``views.pool``.
    """
    config = frame.config
    if not _is_wanted(frame) or has_one_view(config.views, frame.smoke.thin_axis is not None):
        return None

    def estimate() -> float:
        unseen = _views(frame, N_UNSEEN, config.optimize.seed ^ OTHER_SEED, "poisson")
        steps = config.shape if colours is None else config.colour
        seed = config.optimize.seed + len(steps.iterations) - 1
        views = config.views.replace(pool=n_views or config.views.pool)
        views = views if colours is None else views_in_front(views)
        again = [] if seen else _spread(_views(frame, views.pool, seed))
        made = [*again, *unseen]
        if colours is None:
            losses = _grey_losses(problem, made)
        else:
            losses = _colour_losses(problem, colours, [*_spread(seen), *_looks(problem, made)])
        return likely_difference(losses[:-N_UNSEEN], losses[-N_UNSEEN:])

    with torch.no_grad():
        return _timed(estimate)


def _is_wanted(frame: OpenedFrame) -> bool:
    """Whether errors are estimated."""
    return frame.in_effect and frame.config.optimize.error_budget and len(frame.smoke.ijk) > 0


def thick_depth(frame: PaintedFrame) -> float | None:
    """Optical depth of the frame's thick columns in the pictures of the last step.

    Thick is the default of ``optics.percentile``, also if it is set. None for a frame that is left
    out. Also without ``optimize.error_budget``: 60 ms for a million voxels.
    """
    scene, views = frame.scene, frame.config.views
    if not frame.in_effect or len(frame.smoke.ijk) == 0:
        return None
    gamma_w = scene.gamma_w_shape if frame.paint is None else scene.gamma_w
    smoke, floor = frame.smoke, frame.source.voxels.floor
    if floor > 0:  # which is not even any more where smoke was moved
        smoke = smoke.take(smoke.density > FLOOR_TIMES * floor)
    return gamma_w * thick_column(smoke, views, scene, OpticsConfig().percentile)


def gamma_is_set(frame: PaintedFrame) -> bool:
    """Whether the last step's extinction is set; else the smoke has chosen it."""
    optics = frame.config.optics
    return (optics.gamma_shape if frame.paint is None else optics.gamma) is not None


def depth_by_side(frame: PaintedFrame, depth: float | None) -> tuple[float, float] | None:
    """Least and most of ``thick_depth`` over the directions of the views, about.

    The largest lump of smoke is taken for an ellipsoid with its spread, whose chord through the
    middle is (d S^-1 d)^(-1/2) along d, with the covariance S. None where ``thick_depth`` is, for a
    slab, with a camera, and where the extinction is set.

    Args:
        depth: ``thick_depth`` of the frame.
    """
    views, up_axis = frame.config.views, frame.scene.up_axis
    if depth is None or views.camera or gamma_is_set(frame) or frame.smoke.thin_axis is not None:
        return None
    voxels = frame.smoke.voxels.main_part().largest_lump()
    spread = np.cov(voxels.positions.T, aweights=bounded(voxels).density, ddof=0)
    squares, axes = np.linalg.eigh(spread + voxels.edges.T @ voxels.edges / 12)
    squares = np.maximum(squares, 1e-12 * squares.max())  # round-off, where smoke is far apart
    azimuth, elevation = view_ranges(views)

    def chord(around: float, above: float) -> float:
        angles = views.centre_azimuth + around * azimuth, views.centre_elevation + above * elevation
        along = orbit_view(*angles, up_axis, np.zeros(3), 1, 1, 1.0).forward
        return float(((along @ axes) ** 2 / squares).sum()) ** -0.5

    chords = [chord(around / 8, above) for around in range(-8, 9) for above in (-1, 0, 1)]
    return depth * min(chords) / chord(0, 0), depth * max(chords) / chord(0, 0)


def tail_figures(step: str, ends: Sequence[Minimum], pool: int, count: int) -> dict[str, float]:
    """What the last octave's losses tell of the optimiser and of the views.

    Args:
        step: shape or colour.
        ends: how the octaves of a step ended.
        pool: different views that were drawn from.
        count: views an iteration.

    Returns:
        those fields of ``StepReport`` that the iterations suffice for.
    """
    if not ends:
        return {}
    losses, rates, end = ends[-1].losses, ends[-1].rates, ends[-1].smoothed
    way = math.fsum(rates)
    # octaves weigh their parts differently: the first loss is told in the last one's units
    first = end * math.prod(each.losses[0] / max(each.smoothed, _LEAST_LOSS) for each in ends)
    found = {
        "fallen": max(first - end, 0.0),
        "fallen_in_last_octave": max(losses[0] - end, 0.0),
        "remaining": math.nan
        if way < SHORTEST_WAY
        else remaining_decrease(losses, rates, USUALLY_LEFT[step]),
        "view_spread": spread_of_mean(losses, pool, count),
        "way": way,
    }
    return {name: value for name, value in found.items() if math.isfinite(value)}


def step_report(
    step: str, ends: Sequence[Minimum], frame: OpenedFrame, started: float, n_views: int = 0
) -> StepReport:
    """How the octaves of a step ended; ``n_views`` as of ``PaintedFrame``."""
    views, is_thin = frame.config.views, frame.source.thin_axis is not None
    pool = n_views or pool_size(views, is_thin)
    figures = tail_figures(step, ends, pool, views.count)
    n_aside = views_aside(views.replace(pool=pool), False, is_thin) if step == "colour" else 0
    if n_aside and ends:  # the other sides differ from what the camera sees more than views do
        seed = frame.config.optimize.seed + last_octave(frame.config.colour.iterations)
        n, front = min(views.count, pool), pool - n_aside
        drawn = [draw_views(k, n, pool, seed) for k in range(len(ends[-1].losses))]
        losses = [x for x, of in zip(ends[-1].losses, drawn, strict=True) if max(of) < front]
        figures["view_spread"] = spread_of_mean(losses, front, views.count)
    return StepReport(
        seconds=time.perf_counter() - started,
        loss=tuple(end.smoothed for end in ends),
        iterations=tuple(end.iteration + 1 for end in ends),
        rollbacks=sum(end.rollbacks for end in ends),
        restored=sum(end.restored for end in ends),
        ended=tuple(end.reason for end in ends),
        **{name: value for name, value in figures.items() if math.isfinite(value)},
    )


def painted_frame(frame: PaintedFrame, view: View) -> Painted:
    """The frame as it is written: colours times strength and mask; grey without any.

    Args:
        view: that the light of lamps goes to, where colours are albedos.
    """
    smoke, paint = frame.smoke, frame.paint
    if paint is None:
        return Painted(smoke, None)
    light, share = smoke.density.new_zeros(len(smoke.ijk), 3), _share(frame)
    here = slice(None) if share is None else share > 0
    part = 1.0 if share is None else share[share > 0, None]
    light[here] = decode_srgb(paint[1]) * (frame.config.optimize.strength * part)
    if (lighting := frame.lighting()) is not None and lighting.weighs_light:
        light *= lighting.on(smoke.positions).scattered(view.forward)
    return Painted(smoke, light)


def _share(of: OpenedFrame | StepProblem) -> Tensor | None:
    return None if of.mask is None else of.mask.at(of.smoke.positions)


def _views(frame: OpenedFrame, pool: int, seed: int, sampling: str | None = None) -> list[View]:
    """A pool of views of the finished smoke."""
    views = frame.config.views
    views = views.replace(pool=pool, sampling=sampling or views.sampling)
    return frame_views(frame.smoke, views, frame.scene, seed)


def _spread(views: Sequence[Item]) -> Sequence[Item]:
    """``N_SEEN`` of the views at most."""
    return views[:: max(1, len(views) // N_SEEN)][:N_SEEN]


def _looks(problem: StepProblem, views: Sequence[View]) -> Sequence[ColourView]:
    """The maps of the painted voxels, made as in the colour step."""
    smoke, scene, share = problem.smoke, problem.scene, _share(problem)
    lighting = problem.lighting
    made = prepare_views(smoke, views, scene.gamma_w, scene.exposure, share, lighting, FAINT)
    made.prepare(range(len(views)))
    return made


def _colour_losses(
    problem: StepProblem, colours: Tensor, looks: Sequence[ColourView]
) -> list[float]:
    targets, linear = problem.targets, decode_srgb(colours)
    loss = targets.at(1)

    def colour_loss(look: ColourView) -> float:
        return float(loss(look.unpremultiplied(linear, targets.background), look.guide))

    return run_on(colours.device, [partial(colour_loss, look) for look in looks])


def _grey_losses(problem: StepProblem, views: Sequence[View]) -> list[float]:
    smoke, scene, share = problem.smoke, problem.scene, _share(problem)
    loss = problem.targets.at(1, grey=True)

    def grey_loss(view: View) -> float:
        image = column_map(smoke.positions, smoke.edges, view)
        look = grey_view(image, smoke.density, share, scene.gamma_w_shape, scene.exposure_shape)
        return float(loss(look.over_grey(look.grey, scene.grey_mean), look.guide))

    return run_on(smoke.density.device, [partial(grey_loss, view) for view in views])


def _timed(estimate: Callable[[], StepError | float]) -> Estimate:
    started = time.perf_counter()
    found = estimate()
    seconds = time.perf_counter() - started
    if isinstance(found, StepError):
        return Estimate(found.value, seconds, found.order)
    return Estimate(found, seconds)

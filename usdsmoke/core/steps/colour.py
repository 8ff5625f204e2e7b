r"""The colour step: RGB on fixed density. [Christen2020, eq. 6 and section 3.1]

Unknowns are the display-encoded colours of the active voxels: what they emit, in [0, BRIGHTEST], or
the albedo that weighs the light in them (``colour.target``), in [0, 1]. The density is fixed.
Octaves go coarse to fine; a finer one starts from the interpolated colours of the one before. The
first one starts from white noise, which density multiplies in the picture, as the paper does.

Colours keep ``colour_rules`` all along. At the end of each octave, voxels that hardly any light of
the pictures comes from take the colours of the smoke around them: what no view sees would keep the
noise that it starts with.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import count

import torch
from torch import Tensor

from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.active import ActiveSmoke, octaves_to_do, sample_colours
from usdsmoke.core.smoke.levels import bounded
from usdsmoke.core.smoke.memory import LazyList
from usdsmoke.core.smoke.noise import white_noise
from usdsmoke.core.smoke.schedule import last_octave, views_aside
from usdsmoke.core.smoke.spread import spread_colours
from usdsmoke.core.smoke.srgb import encode_srgb, luma
from usdsmoke.core.steps.colour_rules import ColourRules, find_rules, limit_of, opacity_alone
from usdsmoke.core.steps.optimize import Adam, Descent, Minimum, minimize, minimize_and_mend
from usdsmoke.core.steps.pictures import ColourView, ViewPool, prepare_views
from usdsmoke.core.steps.targets import StepProblem, StyleTargets
from usdsmoke.core.style.losses import PictureLoss
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.optics import opacity
from usdsmoke.core.views.project import column_map
from usdsmoke.core.views.scene import Scene, frame_views
from usdsmoke.core.views.visibility import EffectMask

# share of a voxel's light in the view that sees most of it, where half of its colour is its
# neighbourhood's; a mean over views would blur whatever is hidden from the other side
DIM = 0.1
FAINT = 2e-4  # share of a pixel's opacity up to which it leaves voxels out: 0.5 % of its light
WARM_EPSILON = 0.3  # of Adam, in units of the first gradients' root mean square: 10 % less temporal
# error at equal style than with Adam's own steps, of one size everywhere (40 voxels, 16 frames)
JUDGING = 3  # iterations whose pictures tell how much detail to add
HELD_EVERY = 6  # iterations; on a million voxels, holding colours takes about as long as one

Look = Callable[[Sequence[ColourView], Tensor], None]


def run_colour_step(
    problem: StepProblem,
    iterations: Sequence[int],
    start: Tensor | None = None,
    watch: Callable[[int, Minimum], None] | None = None,
    warm: bool = False,
    look: Look | None = None,
    carried: bool = False,
) -> tuple[Tensor, list[Minimum]]:
    """Colours of one frame, coarse to fine.

    Args:
        problem: the (moved) density at full resolution. Voxels where the mask is 0 are not painted,
            and only hide what is behind them.
        iterations: per octave, coarse to fine; an octave with 0 is skipped.
        start: display-encoded colours [N 3] of the painted voxels, carried over from a neighbouring
            frame; only octaves with iterations refine them. None starts from ``colour.init`` at the
            coarsest octave.
        watch: called with the octave and the optimiser's state after every iteration.
        warm: the start is nearly right, such as a neighbour's result: ``colour.warm_rate`` of the
            learning rate, and steps that follow the gradient's size, see ``WARM_EPSILON``.
        look: called with the views of the octave of the smoke's own voxels, without those of sides
            that a camera does not see, and its colours [N 3].
        carried: no single voxels stand out in the start, which is a neighbour's or a network's.

    Returns:
        Display-encoded colours [N 3] of the painted voxels, in [0, ``limit_of``], in the smoke's
        order, and how each octave ended.
    """
    smoke, mask, scene, config = problem.smoke, problem.mask, problem.scene, problem.config
    start = None if start is None else start.clamp(0, limit_of(problem))
    painted = painted_part(problem)
    colours, before, ends = start, painted, list[Minimum]()
    last = last_octave(iterations)
    for number, factor, octave, n_iterations in _octaves(problem, iterations):
        share = _share(octave, mask)
        here = _painted(octave, share)
        if len(here.ijk) == 0:  # the mask is finer than this octave
            continue
        seed, is_coarse = config.optimize.seed + number, number != last or scene.is_coarse_step
        pool = colour_pool(replace(problem, smoke=octave), factor, seed, is_coarse)
        begun = _colours_on(here, before, colours, problem)
        told = None if watch is None else partial(watch, number)
        known = begun if warm else None
        rules = find_rules(problem, here, known, octave is smoke and not carried)
        loss, background = problem.targets.at(factor), problem.targets.background
        descent = _descent(config, n_iterations, warm)
        colours, end = optimize_colours(pool, begun, loss, background, descent, told, rules)
        before = here
        if end is None:
            continue
        ends.append(end)
        if not warm:
            colours = _completed(pool.drawn(end.iteration + 1), here, colours, share, scene, factor)
        colours = rules.in_style(colours, known)
        if look is not None and octave is smoke:
            look(pool.drawn_in_front(end.iteration + 1), colours)
    if start is not None and colours is not None and before.voxel_size > painted.voxel_size:
        return _changed(painted, start, before, colours).clamp(0, limit_of(problem)), ends
    return _colours_on(painted, before, colours, problem), ends


def _octaves(
    problem: StepProblem, iterations: Sequence[int]
) -> Iterator[tuple[int, int, ActiveSmoke, int]]:
    """See ``octaves_to_do``; the finest one is the smoke itself."""
    # blocks of voxels: one opaque voxel would make all of its coarse one opaque
    limited = bounded(problem.smoke)
    for number, factor, octave, n in octaves_to_do(limited, iterations, problem.scene.pixel_size):
        yield number, factor, problem.smoke if octave is limited else octave, n


def _descent(config: Config, n_iterations: int, warm: bool) -> Descent:
    """The descent of an octave."""
    rate = config.colour.learning_rate * (config.colour.warm_rate if warm else 1.0)
    epsilon = WARM_EPSILON if warm else Adam.epsilon
    return Descent(rate, n_iterations, config.optimize.tolerance, epsilon)


def optimize_colours(
    pool: ViewPool[ColourView],
    colours: Tensor,
    loss: PictureLoss,
    background: Tensor,
    descent: Descent,
    watch: Callable[[Minimum], None] | None = None,
    rules: ColourRules | None = None,
) -> tuple[Tensor, Minimum | None]:
    """Colours that give the pictures the style, one octave.

    Args:
        pool: the views.
        colours: start, [N 3], display-encoded.
        loss: of every picture.
        background: linear colour [3] behind the smoke, the style's mean, so that the border is no
            outlier.
        descent: its rate is in display-encoded units.
        watch: called with the optimiser's state after every iteration.
        rules: None leaves hues free, and keeps to [0, 1].

    Returns:
        Colours [N 3] and how the optimisation ended, see ``minimize_and_mend``.
    """
    pool, shown = _in_sight(pool, descent.n_iterations, len(colours))
    found = colours.detach().clone(memory_format=torch.contiguous_format)
    begun, rules, turn = found[shown], rules or ColourRules(), count()
    rows, light = shown.nonzero().squeeze(1), luma(found)
    unknown = begun.clone().requires_grad_(True)
    # epsilon is in units of the mean over all voxels
    epsilon = descent.epsilon * math.sqrt(len(unknown) / max(len(colours), 1))

    objective = partial(pictures_loss, pool, unknown, loss, background)

    def clip() -> None:
        rules.clip(unknown)
        if next(turn) % HELD_EVERY == 0:
            rules.hold(unknown, begun, rows, light)

    def judged(colours: Tensor) -> float:
        here = colours[shown]
        return sum(float(pictures_loss(pool, here, loss, background, n)) for n in range(JUDGING))

    def change(n_after: int) -> None:
        found[shown] = unknown
        found.copy_(rules.changed(found, judged if n_after else None))
        unknown.copy_(found[shown])

    state, descent = None, replace(descent, passage=pool.passage, epsilon=epsilon)
    if rules.blended is None:
        states = minimize(objective, [unknown], descent, clip)
    else:
        states = minimize_and_mend(objective, [unknown], descent, change, clip)
    for state in states:
        if watch is not None:
            watch(state)
    found[shown] = unknown.detach()
    return found, state


def _in_sight(
    pool: ViewPool[ColourView], n_iterations: int, n_voxels: int
) -> tuple[ViewPool[ColourView], Tensor]:
    """The pool for the voxels that so many iterations show, made for these; and which, [N] bool.

    Opaque smoke hides most of itself: what is left out has no slope and would not be moved.
    """
    n_evaluated = n_iterations + 1  # the last state's loss may be asked for
    pool.prepare(n_evaluated)
    drawn = pool.drawn(n_evaluated)
    shown = torch.zeros(n_voxels, dtype=torch.bool, device=drawn[0].alpha.device)
    for view in drawn:
        shown[view.image.rows] = True
    views = LazyList(len(pool.views), lambda number: pool.views[number].among(shown))
    return replace(pool, views=views), shown


def pictures_loss(
    pool: ViewPool[ColourView],
    colours: Tensor,
    loss: PictureLoss,
    background: Tensor,
    iteration: int,
) -> Tensor:
    """Mean loss of an iteration's pictures; arguments as of ``optimize_colours``.

    Gradients: through ``colours``.
    """

    def view_loss(view: ColourView, encoded: Tensor) -> Tensor:
        return loss(view.picture(encoded, background), view.guide, view.content, iteration)

    return pool.mean_loss(colours, iteration, view_loss)


def painted_part(problem: StepProblem) -> ActiveSmoke:
    """The voxels of a problem that are painted."""
    return _painted(problem.smoke, _share(problem.smoke, problem.mask))


def colour_pool(
    problem: StepProblem, factor: int, seed: int, is_coarse: bool = False
) -> ViewPool[ColourView]:
    """The views of a problem at 1/factor of full size; some are of the sides that a camera misses.

    Args:
        problem: its smoke has voxels ``factor`` times as large as the source's.
        seed: of the views.
        is_coarse: finer octaves follow.
    """
    smoke, views, scene = problem.smoke, problem.config.views, problem.scene
    n_aside = views_aside(views, is_coarse, smoke.thin_axis is not None)
    found = frame_views(smoke, views, scene, seed, factor, n_aside)
    n_front = len(found) - n_aside
    return ViewPool(_prepared(problem, found, factor), views.count, seed, n_front)


def initial_colours(smoke: ActiveSmoke, init: str, seed: int) -> Tensor:
    """Display-encoded start colours [N 3]: white noise keyed by voxel, or plain white density."""
    if init == "noise":
        return white_noise(smoke.ijk, 3, seed).to(smoke.density.dtype)
    return torch.ones(len(smoke.ijk), 3, dtype=smoke.density.dtype, device=smoke.ijk.device)


def _share(smoke: ActiveSmoke, mask: EffectMask | None) -> Tensor | None:
    return None if mask is None else mask.at(smoke.positions)


def _painted(smoke: ActiveSmoke, share: Tensor | None) -> ActiveSmoke:
    return smoke if share is None else smoke.take(share > 0)


def _prepared(problem: StepProblem, views: Sequence[View], factor: int) -> Sequence[ColourView]:
    """The views of one octave, with their content pictures if a loss uses them."""
    octave, scene, targets = problem.smoke, problem.scene, problem.targets
    share, lighting = _share(octave, problem.mask), problem.lighting
    plain = prepare_views(octave, views, scene.gamma_w, scene.exposure, share, lighting, FAINT)
    loss = targets.at(factor)
    if not loss.uses_content:
        return plain

    def with_content(number: int) -> ColourView:
        view = plain[number]
        picture = _content_picture(octave, views[number], view.guide, targets, scene)
        return replace(view, content=loss.content(picture))

    return LazyList(len(views), with_content)


def _completed(
    views: Sequence[ColourView],
    painted: ActiveSmoke,
    colours: Tensor,
    share: Tensor | None,
    scene: Scene,
    factor: int,
) -> Tensor:
    """Colours [N 3], those of hidden voxels from around them; ``share`` is that of all voxels."""
    part = None if share is None else share[share > 0]
    seen = _seen(views, painted, part, scene, factor)
    return spread_colours(painted, colours, seen**2 / (seen**2 + DIM**2))


def _seen(
    views: Sequence[ColourView],
    painted: ActiveSmoke,
    share: Tensor | None,
    scene: Scene,
    factor: int,
) -> Tensor:
    """The share of each voxel's light that reaches the picture that it reaches best, [N]; >= 0.

    About the transmittance in front of it; 1 is a voxel by itself with nothing in front.
    """
    light = _reaching(views[0])
    for view in views[1:]:
        light = torch.maximum(light, _reaching(view))
    alone = opacity_alone(painted, scene) * (painted.voxel_size / (factor * scene.pixel_size)) ** 2
    alone = alone if share is None else alone * share
    return light / alone.clamp_min(torch.finfo(light.dtype).tiny)


def _reaching(view: ColourView) -> Tensor:
    """How much of each voxel's colour reaches a picture, [N]; in the dark an albedo hardly does."""
    weight = view.image.total_weights()
    return weight if view.light is None else weight * view.light.mean(dim=1).clamp(max=1)


def _content_picture(
    smoke: ActiveSmoke, view: View, guide: Tensor, targets: StyleTargets, scene: Scene
) -> Tensor:
    """The smoke's grey picture with the style's brightness and contrast, [H W 3]."""
    image = column_map(smoke.positions, smoke.edges, view, smoke.density.dtype)
    columns = image.apply(smoke.density[:, None])[..., 0]
    grey = opacity(scene.gamma_w_shape * columns) * scene.exposure_shape
    mean, deviation = targets.brightness
    light = mean + (grey - scene.grey_mean) / max(scene.grey_deviation, 0.05) * deviation
    background = luma(encode_srgb(targets.background))
    composite = guide * light.clamp(0, 1) + (1 - guide) * background
    return composite[..., None].expand(-1, -1, 3)


def _changed(painted: ActiveSmoke, start: Tensor, blocks: ActiveSmoke, colours: Tensor) -> Tensor:
    """The start's colours with the change that blocks of voxels have; what is finer stays."""
    change = colours - sample_colours(painted, start, blocks.positions)[0]
    return start + sample_colours(blocks, change, painted.positions)[0]


def _colours_on(
    octave: ActiveSmoke, before: ActiveSmoke, colours: Tensor | None, problem: StepProblem
) -> Tensor:
    """Colours of the octave before at the voxels of this one; where it has none, initial ones.

    ``colours`` None means that there is no octave before. A mask may leave out all voxels around a
    painted one.
    """
    if before is octave and colours is not None:
        return colours
    init, seed = problem.config.colour.init, problem.config.optimize.seed
    if colours is None:
        return initial_colours(octave, init, seed)
    found, near = sample_colours(before, colours, octave.positions)
    lacking = near[:, 0] == 0
    if bool(lacking.any()):
        found[lacking] = initial_colours(octave.take(lacking), init, seed)
    return found

r"""The colour step: RGB on fixed density. [Christen2020, eq. 6 and section 3.1]

With the density fixed, a view's picture is a fixed sparse linear map of the voxel colours, computed
once per view and octave. Unknowns are the display-encoded colours of the active voxels, clipped to
[0, 1]. Octaves go coarse to fine; a finer one starts from the interpolated colours of the one
before. The first one starts from white noise, which density multiplies in the picture, as the paper
does.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor

from usdsmoke.base.settings import Config
from usdsmoke.core.smoke.active import ActiveSmoke, octaves_to_do, sample_colours
from usdsmoke.core.smoke.memory import LazyList, accumulate
from usdsmoke.core.smoke.noise import white_noise
from usdsmoke.core.smoke.srgb import decode_srgb, encode_srgb, luminance
from usdsmoke.core.steps.optimize import Adam, Minimum, minimize
from usdsmoke.core.style.picture_loss import Content, PictureLoss
from usdsmoke.core.style.targets import StyleTargets
from usdsmoke.core.views.cameras import View, draw_views
from usdsmoke.core.views.optics import opacity
from usdsmoke.core.views.project import SparseImage, colour_map, column_map
from usdsmoke.core.views.scene import Scene, frame_views
from usdsmoke.core.views.visibility import EffectMask

__all__ = ["ColourView", "initial_colours", "optimize_colours", "prepare_views", "run_colour_step"]

WARM_EPSILON = 0.3  # of Adam, in units of the first gradients' root mean square: 10 % less temporal
# error at equal style than with Adam's own steps, of one size everywhere (40 voxels, 16 frames)
LATER_RATE = 0.7  # octaves after the first start near their goal
THIN = 0.05  # exposed opacity at which a pixel of the straight picture is half background


@dataclass(frozen=True)
class ColourView:
    """A view's linear map from the painted voxels' colours to its picture."""

    image: SparseImage
    alpha: Tensor  # [H W], opacity of the painted smoke as it is seen
    thin: float = THIN  # opacity at which a pixel of the straight picture is half background
    content: Content | None = None

    @property
    def guide(self) -> Tensor:
        """T of the guidance mask, [H W] in [0, 1): the share of smoke in the straight picture."""
        return self.alpha / (self.alpha + self.thin)

    def straight_picture(self, colours: Tensor, background: Tensor) -> Tensor:
        """Display-encoded picture [H W 3] of linear colours [N 3], their opacity divided out.

        Where there is (nearly) no smoke it tends to the linear background [3]. This is what the
        network sees: thin smoke is then painted like thick smoke. Seen through its opacity, it
        would have to take impossible colours to look like the style, and ends in tints that the
        style does not have.
        """
        alpha = self.alpha[..., None]
        light = self.image.apply(colours) + self.thin * background
        return encode_srgb(light / (alpha + self.thin))


def prepare_views(
    smoke: ActiveSmoke,
    views: Sequence[View],
    gamma_w: float,
    exposure: float = 1.0,
    shown: Tensor | None = None,
) -> Sequence[ColourView]:
    """The linear maps of all views of one octave, each made when it is first looked at.

    Args:
        smoke: all of it, painted or not.
        gamma_w: extinction per density, 1/stage unit.
        exposure: see ``Scene``.
        shown: see ``project.colour_map``.
    """
    positions, step = smoke.positions, smoke.voxel_size

    def make(number: int) -> ColourView:
        image, alpha = colour_map(
            positions, smoke.density, smoke.voxel_volume, gamma_w, views[number], step, shown
        )
        return ColourView(image, alpha, THIN / exposure)

    return LazyList(len(views), make)


def initial_colours(smoke: ActiveSmoke, init: str, seed: int) -> Tensor:
    """Display-encoded start colours [N 3]: white noise keyed by voxel, or plain white density."""
    if init == "noise":
        return white_noise(smoke.ijk, 3, seed).to(smoke.density.dtype)
    return torch.ones(len(smoke.ijk), 3, dtype=smoke.density.dtype, device=smoke.ijk.device)


def optimize_colours(
    views: Sequence[ColourView],
    colours: Tensor,
    judge: PictureLoss,
    background: Tensor,
    rate: float,
    n_iterations: int,
    n_views: int = 1,
    seed: int = 0,
    tolerance: float = 0.0,
    watch: Callable[[Minimum], None] | None = None,
    adam: Adam | None = None,
) -> tuple[Tensor, Minimum | None]:
    """Colours that give the pictures the style, one octave.

    Args:
        views: the pool; see ``views.draw_views``.
        colours: start, [N 3], display-encoded, in [0, 1].
        judge: of every picture.
        background: linear colour [3] behind the smoke, the style's mean, so that the border is no
            outlier.
        rate: Adam's step in display-encoded units.
        n_iterations: at most this many.
        n_views: pictures per iteration.
        seed: of the order of views.
        adam: its settings; moments are changed in place.

    Returns:
        Colours [N 3] and how the optimisation ended.
    """
    unknown = colours.detach().clone().requires_grad_(True)
    n_views = min(n_views, len(views))  # twice the same view tells nothing

    def term(view: ColourView, iteration: int, linear: Tensor) -> Tensor:
        picture = view.straight_picture(linear, background)
        return judge(picture, view.guide, view.content, iteration)

    def objective(iteration: int) -> Tensor:
        drawn = draw_views(iteration, n_views, len(views), seed)
        terms = [partial(term, views[number], iteration) for number in drawn]
        return accumulate(decode_srgb(unknown), terms) / n_views

    def clip() -> None:
        unknown.clamp_(0, 1)

    state = None
    for state in minimize(objective, [unknown], rate, n_iterations, clip, tolerance, adam):
        if watch is not None:
            watch(state)
    return unknown.detach(), state


def run_colour_step(
    smoke: ActiveSmoke,
    start: Tensor | None,
    targets: StyleTargets,
    scene: Scene,
    config: Config,
    iterations: Sequence[int],
    watch: Callable[[int, Minimum], None] | None = None,
    mask: EffectMask | None = None,
    warm: bool = False,
) -> tuple[Tensor, list[Minimum]]:
    """Colours of one frame, coarse to fine.

    Args:
        smoke: the (moved) density at full resolution.
        start: display-encoded colours [N 3] of the painted voxels, carried over from a neighbouring
            frame; only octaves with iterations left refine them. None starts from ``colour.init``
            at the coarsest one.
        iterations: per octave, coarse to fine; an octave with 0 is passed over.
        watch: called with the octave and the optimiser's state after every iteration.
        mask: voxels where it is 0 are not painted, and only hide what is behind them.
        warm: the start is nearly right, such as a neighbour's result: ``colour.warm_rate`` of the
            learning rate, and steps that follow the gradient's size, see ``WARM_EPSILON``.

    Returns:
        Display-encoded colours [N 3] in [0, 1] of the painted voxels, in the smoke's order, and how
        each octave ended.
    """
    painted = _painted(smoke, _shown(smoke, mask))
    fresh = partial(Adam, epsilon=WARM_EPSILON) if warm else Adam
    rate = config.colour.learning_rate * (config.colour.warm_rate if warm else 1.0)
    colours, before = start, painted
    ends: list[Minimum] = []
    for number, factor, octave, n_iterations in octaves_to_do(smoke, iterations):
        shown = _shown(octave, mask)
        here = _painted(octave, shown)
        if len(here.ijk) == 0:  # the mask is finer than this octave
            continue
        seed = config.optimize.seed + number
        colours, end = optimize_colours(
            _octave_views(octave, shown, targets, scene, config, seed, factor),
            _colours_on(here, before, colours, config),
            targets.at(factor),
            targets.background,
            rate * (LATER_RATE if number else 1.0),
            n_iterations,
            config.views.count,
            seed,
            config.optimize.tolerance,
            partial(watch, number) if watch is not None else None,
            fresh(),
        )
        before = here
        ends += [end] if end is not None else []
    return _colours_on(painted, before, colours, config), ends


def _shown(smoke: ActiveSmoke, mask: EffectMask | None) -> Tensor | None:
    return None if mask is None else mask.at(smoke.positions)


def _painted(smoke: ActiveSmoke, shown: Tensor | None) -> ActiveSmoke:
    return smoke if shown is None else smoke.take(shown > 0)


def _octave_views(
    octave: ActiveSmoke,
    shown: Tensor | None,
    targets: StyleTargets,
    scene: Scene,
    config: Config,
    seed: int,
    factor: int,
) -> Sequence[ColourView]:
    """The pool of views of one octave, with their content pictures if a loss wants them."""
    views = frame_views(octave, config.views, scene, seed, factor)
    made = prepare_views(octave, views, scene.gamma_w, scene.exposure, shown)
    judge = targets.at(factor)
    if not judge.wants_content:
        return made

    def with_content(number: int) -> ColourView:
        ours, view = made[number], views[number]
        picture = _content_picture(octave, view, ours.guide, targets, scene)
        return replace(ours, content=judge.remember(picture))

    return LazyList(len(views), with_content)


def _content_picture(
    smoke: ActiveSmoke, view: View, guide: Tensor, targets: StyleTargets, scene: Scene
) -> Tensor:
    """The smoke's grey picture with the style's brightness and contrast, [H W 3]."""
    image = column_map(smoke.positions, smoke.voxel_volume, view, smoke.density.dtype)
    columns = image.apply(smoke.density[:, None])[..., 0]
    grey = opacity(scene.gamma_w_shape * columns) * scene.exposure_shape
    mean, deviation = targets.brightness
    light = mean + (grey - scene.grey_mean) / max(scene.grey_deviation, 0.05) * deviation
    behind = luminance(encode_srgb(targets.background))
    filled = guide * light.clamp(0, 1) + (1 - guide) * behind
    return filled[..., None].expand(-1, -1, 3)


def _colours_on(
    octave: ActiveSmoke, before: ActiveSmoke, colours: Tensor | None, config: Config
) -> Tensor:
    """Colours of the octave before at the voxels of this one; where it has none, as at the start.

    None is where a step starts from. A mask may leave out all that a painted voxel lies between.
    """
    if before is octave and colours is not None:
        return colours
    fresh = initial_colours(octave, config.colour.init, config.optimize.seed)
    if colours is None:
        return fresh
    found, near = sample_colours(before, colours, octave.positions)
    return torch.where(near > 0, found, fresh)

r"""The colour step: RGB on fixed density. [Christen2020, eq. 6 and section 3.1]

With the density fixed, a view's picture is a fixed sparse linear map of the voxel colours, computed
once per view and octave. Unknowns are the display-encoded colours of the active voxels, clipped to
[0, 1]. Octaves go coarse to fine; a finer one starts from the interpolated colours of the one
before. The first one starts from white noise, which density multiplies in the picture, as the paper
does.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from usdsmoke.config import Config
from usdsmoke.core.losses import StyleTarget, total_variation
from usdsmoke.core.noise import white_noise
from usdsmoke.core.optimize import Minimum, minimize
from usdsmoke.core.project import SparseImage, colour_map
from usdsmoke.core.scene import Scene, frame_views
from usdsmoke.core.smoke import ActiveSmoke, octaves_to_do, sample_colours
from usdsmoke.core.style import decode_srgb, encode_srgb
from usdsmoke.core.targets import StyleTargets
from usdsmoke.core.views import View

__all__ = ["ColourView", "initial_colours", "optimize_colours", "prepare_views", "run_colour_step"]

LATER_RATE = 0.7  # octaves after the first start near their goal
THIN = 0.05  # opacity at which a pixel of the straight picture is half background


@dataclass(frozen=True)
class ColourView:
    """A view's linear map from voxel colours to its picture, and its opacity [H W]."""

    image: SparseImage
    alpha: Tensor

    @property
    def guide(self) -> Tensor:
        """T of the guidance mask, [H W] in [0, 1): the share of smoke in the straight picture."""
        return self.alpha / (self.alpha + THIN)

    def straight_picture(self, colours: Tensor, background: Tensor) -> Tensor:
        """Display-encoded picture [H W 3] of linear colours [N 3], their opacity divided out.

        Where there is (nearly) no smoke it tends to the linear background [3]. This is what the
        network sees: thin smoke is then painted like thick smoke. Seen through its opacity, it
        would have to take impossible colours to look like the style, and ends in tints that the
        style does not have.
        """
        alpha = self.alpha[..., None]
        return encode_srgb((self.image.apply(colours) + THIN * background) / (alpha + THIN))


def prepare_views(smoke: ActiveSmoke, views: Sequence[View], gamma_w: float) -> list[ColourView]:
    """The linear maps of all views of one octave."""
    positions = smoke.positions
    step = smoke.voxel_size
    return [
        ColourView(*colour_map(positions, smoke.density, smoke.voxel_volume, gamma_w, view, step))
        for view in views
    ]


def initial_colours(smoke: ActiveSmoke, init: str, seed: int) -> Tensor:
    """Display-encoded start colours [N 3]: white noise keyed by voxel, or plain white density."""
    if init == "noise":
        return white_noise(smoke.ijk, 3, seed).to(smoke.density.dtype)
    return torch.ones(len(smoke.ijk), 3, dtype=smoke.density.dtype, device=smoke.ijk.device)


def optimize_colours(
    views: Sequence[ColourView],
    colours: Tensor,
    targets: Sequence[StyleTarget],
    background: Tensor,
    rate: float,
    n_iterations: int,
    n_views: int = 1,
    tv_weight: float = 0.0,
    tolerance: float = 0.0,
    watch: Callable[[Minimum], None] | None = None,
) -> tuple[Tensor, Minimum | None]:
    """Colours that give the pictures the style, one octave.

    Args:
        views: the pool; iteration t sees views t * n_views, ... of it, modulo its size.
        colours: start, [N 3], display-encoded, in [0, 1].
        targets: one per style image; their losses are added.
        background: linear colour [3] behind the smoke, the style's mean, so that the border is no
            outlier.
        rate: Adam's step in display-encoded units.
        n_iterations: at most this many.
        n_views: pictures per iteration.

    Returns:
        Colours [N 3] and how the optimisation ended.
    """
    unknown = colours.detach().clone().requires_grad_(True)

    def objective(iteration: int) -> Tensor:
        linear = decode_srgb(unknown)
        total = linear.new_zeros(())
        for number in range(n_views):
            view = views[(iteration * n_views + number) % len(views)]
            picture = view.straight_picture(linear, background)
            for target in targets:
                total = total + target.loss(picture, view.guide)
            if tv_weight:
                total = total + tv_weight * total_variation(picture)
        return total / n_views

    def clip() -> None:
        unknown.clamp_(0, 1)

    state = None
    for state in minimize(objective, [unknown], rate, n_iterations, clip, tolerance):
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
) -> tuple[Tensor, list[Minimum]]:
    """Colours of one frame, coarse to fine.

    Args:
        smoke: the (moved) density at full resolution.
        start: display-encoded colours [N 3] carried over from a neighbouring frame; only octaves
            with iterations left refine them. None starts from ``colour.init`` at the coarsest one.
        iterations: per octave, coarse to fine; an octave with 0 is passed over.
        watch: called with the octave and the optimiser's state after every iteration.

    Returns:
        Display-encoded colours [N 3] in [0, 1], and how each octave ended.
    """
    colours, before, ends = start, smoke, []
    for number, factor, octave, n_iterations in octaves_to_do(smoke, iterations):
        colours = _colours_on(octave, before, colours, config)
        rate = config.colour.learning_rate * (1.0 if number == 0 else LATER_RATE)
        views = frame_views(octave, config, scene, config.optimize.seed + number, factor)
        colours, end = optimize_colours(
            prepare_views(octave, views, scene.gamma_w),
            colours,
            targets.at(factor),
            targets.background,
            rate,
            n_iterations,
            config.views.count,
            config.losses.total_variation,
            config.optimize.tolerance,
            partial(watch, number) if watch is not None else None,
        )
        before = octave
        ends += [end] if end is not None else []
    return _colours_on(smoke, before, colours, config), ends


def _colours_on(
    octave: ActiveSmoke, before: ActiveSmoke, colours: Tensor | None, config: Config
) -> Tensor:
    """Colours of the octave before at the voxels of this one; None is where a step starts from."""
    if colours is None:
        return initial_colours(octave, config.colour.init, config.optimize.seed)
    return colours if before is octave else sample_colours(before, colours, octave.positions)[0]

r"""The shape step: density moved by an optimised displacement. [Christen2020, eqs. 4-5; Kim2019]

The grey picture is the opacity 1 - exp(-gamma * column): it needs column sums only, which are
linear in density. The unknown is a potential on the voxels; its curl (or gradient) is the
displacement u, and the density becomes d(x - u(x)).

Deviations from the reference, each against a fault seen there:

- |u| is capped smoothly at ``shape.reach`` of the smoke's longest side, and fades with the smoothed
  density, or a bright rim grows along the border of what moved;
- the guide T is the *source's* silhouette: one that follows the moved smoke lets the optimiser
  cheat;
- Adam on a pyramid of coefficients scaled to displacement in place of Laplacian-normalised ascent;
- lengths are in stage units, so octaves and crops agree.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor

from usdsmoke.config import Config
from usdsmoke.core.grey import GreyView, look_at
from usdsmoke.core.lattice import Lattice, field_from_box, grow, surround
from usdsmoke.core.mask import EffectMask
from usdsmoke.core.optimize import Adam, Minimum, minimize
from usdsmoke.core.picture_loss import PictureLoss
from usdsmoke.core.potential import Potential, border_mask, carry_levels, displacement_from
from usdsmoke.core.project import column_map
from usdsmoke.core.resample import Pyramid
from usdsmoke.core.scene import Scene, frame_views
from usdsmoke.core.smoke import ActiveSmoke, octaves_to_do
from usdsmoke.core.summed import sum_terms
from usdsmoke.core.targets import StyleTargets
from usdsmoke.core.transport import Scheme, correct_mass, warp
from usdsmoke.core.views import draw_views
from usdsmoke.core.warm import departure_points
from usdsmoke.volume import DenseField, VolumeFrame

__all__ = ["Displaced", "run_shape_step"]

N_CHANNELS = {"stream": 3, "potential": 1, "mixed": 4}
N_LEVELS = 5  # of the coefficient pyramid
ROOM = 2  # empty voxels around the smoke, whose displacement ends at its border
FAINTEST = 1e-6  # of the largest density


@dataclass(frozen=True)
class Displaced:
    """The moved density of one frame, and what the next one starts from."""

    density: DenseField
    potential: Potential
    report: dict[str, Any]


class _Octave:
    """The shape step's problem at one resolution."""

    def __init__(
        self,
        smoke: ActiveSmoke,
        mask: EffectMask | None,
        cap: float,
        judge: PictureLoss,
        scene: Scene,
        config: Config,
        seed: int,
        factor: int,
    ) -> None:
        self.lattice = surround(smoke, ROOM)
        self.density = self.lattice.fill(smoke)
        self.effect = _effect(self.density, self.lattice, mask)
        # nothing moves where the effect and its neighbours are 0: no smoke can come to other voxels
        self.active = torch.nonzero((self.density > 0) | grow(self.effect > 0))
        self._config, self._cap, self._judge, self._seed = config, cap, judge, seed
        self._behind = scene.grey_mean
        positions = self.lattice.positions(self.active)
        shown = None if mask is None else mask.at(positions)
        still = self.density[tuple(self.active.T)]
        self._views = []
        for view in frame_views(smoke, config, scene, seed, factor):
            image = column_map(positions, smoke.voxel_volume, view)
            look = look_at(image, still, shown, scene.gamma_w_shape, scene.exposure_shape)
            if judge.wants_content:
                content = judge.remember(look.filled(look.grey, self._behind))
                look = replace(look, content=content)
            self._views.append(look)

    def moved(self, potential: Tensor) -> Tensor:
        """Moved density at the active voxels, [N]; the cheap scheme."""
        u = displacement_from(
            potential, self.effect, self._config.shape.displacement, self._cap, self.lattice
        )
        chosen = u[tuple(self.active.T)]
        return warp(self.density, chosen, active_ijk=self.active, scheme="linear")

    def loss(self, potential: Tensor, iteration: int) -> Tensor:
        """Style loss of the moved smoke's pictures, and what leaves the source's silhouette."""
        n_views, keep = self._config.views.count, self._config.losses.keep

        def term(view: GreyView, density: Tensor) -> Tensor:
            grey = view.picture(density)
            picture = view.filled(grey, self._behind)
            loss = self._judge(picture, view.guide, view.content, iteration)
            return loss + keep * view.leaving(grey) if keep else loss

        drawn = draw_views(iteration, n_views, len(self._views), self._seed)
        terms = [partial(term, self._views[number]) for number in drawn]
        return sum_terms(self.moved(potential), terms) / n_views


def _effect(density: Tensor, lattice: Lattice, mask: EffectMask | None) -> Tensor:
    """The share of the displacement that is kept, [I J K]: 0 at the smoke's border."""
    return border_mask(density) * _shares(density, lattice, mask)


def _shares(density: Tensor, lattice: Lattice, mask: EffectMask | None) -> Tensor:
    """The mask's values on a box, [I J K]."""
    if mask is None:
        return torch.ones_like(density)
    share = mask.at(lattice.positions().to(density.device))
    return share.view(lattice.shape).to(density)


def run_shape_step(
    density: DenseField,
    source: ActiveSmoke,
    frame: VolumeFrame,
    before: Displaced | None,
    seconds: float,
    targets: StyleTargets,
    scene: Scene,
    config: Config,
    iterations: Sequence[int],
    watch: Callable[[int, Minimum], None] | None = None,
    mask: EffectMask | None = None,
) -> Displaced:
    """One frame's density, moved so that its grey pictures take the style's structure.

    Args:
        density: the frame's (refined) density; ``source`` holds its active voxels.
        frame: gives the velocity that carries ``before`` along.
        before: the neighbouring frame's result to start from.
        seconds: time since that frame.
        iterations: per octave, coarse to fine; an octave with 0 is passed over.
        watch: called with the octave and the optimiser's state after every iteration.
        mask: scales the displacement in space.
    """
    cap = config.shape.reach * _longest_side(source)
    potential, ends, carried = None, [], None
    for number, factor, smoke, n_iterations in octaves_to_do(source, iterations):
        seed, judge = config.optimize.seed + number, targets.at(factor, grey=True)
        octave = _Octave(smoke, mask, cap, judge, scene, config, seed, factor)
        if potential is None:
            base = _first_potential(octave.lattice, frame, before, seconds, config, octave.density)
        else:
            base = potential.on(octave.lattice)
        told = partial(watch, number) if watch is not None else None
        values, adam, end = _optimize_octave(octave, base, cap, config, n_iterations, carried, told)
        potential, carried = Potential(values, octave.lattice), (adam, octave.lattice)
        ends += [end] if end is not None else []
    if potential is None:
        lattice = surround(source, ROOM)
        still = source.density.new_zeros(*lattice.shape, N_CHANNELS[config.shape.displacement])
        potential = Potential(still, lattice)
    moved, report = _move_finally(density, source, mask, potential, cap, config)
    return Displaced(moved, potential, {"ends": ends, **report})


def _longest_side(smoke: ActiveSmoke) -> float:
    low, high = smoke.box
    sides = np.linalg.norm(smoke.index_to_stage[:3, :3], axis=1)
    return float(max((high - low + 1) * sides))


def _first_potential(
    lattice: Lattice,
    frame: VolumeFrame,
    before: Displaced | None,
    seconds: float,
    config: Config,
    like: Tensor,
) -> Tensor:
    """Where the first octave starts: nothing moved, or the neighbour's potential carried along."""
    if before is None:
        return like.new_zeros(*lattice.shape, N_CHANNELS[config.shape.displacement])
    places = lattice.positions().to(like.device)
    return before.potential.on(lattice, departure_points(frame, places, seconds))


def _optimize_octave(
    octave: _Octave,
    base: Tensor,
    cap: float,
    config: Config,
    n_iterations: int,
    before: tuple[Adam, Lattice] | None,
    watch: Callable[[Minimum], None] | None,
) -> tuple[Tensor, Adam, Minimum | None]:
    """One octave, from a potential [I J K C] and the moments (and lattice) of the octave before.

    Returns:
        The potential, Adam's moments, and how the optimisation ended.
    """
    pyramid = Pyramid.zeros(octave.lattice.shape, base.shape[-1], N_LEVELS, base)
    spacing = max(octave.lattice.spacing)
    # a coefficient of 1 moves smoke by about the cap on any level: one rate serves all
    scales = [
        cap * spacing * max(n / m for n, m in zip(octave.lattice.shape, level.shape, strict=False))
        for level in pyramid.levels
    ]
    unknowns = [level.requires_grad_(True) for level in pyramid.levels]
    adam = Adam()
    if before is not None and config.optimize.carry_moments:
        adam = before[0].carried(partial(carry_levels, unknowns, octave.lattice, before[1]))

    def potential() -> Tensor:
        levels = tuple(u * s for u, s in zip(unknowns, scales, strict=True))
        return base + Pyramid(levels, pyramid.method).expand()

    rate, tolerance = config.shape.learning_rate, config.optimize.tolerance
    steps = minimize(
        lambda iteration: octave.loss(potential(), iteration),
        unknowns, rate, n_iterations, tolerance=tolerance, adam=adam,
    )  # fmt: skip
    state = None
    for state in steps:
        if watch is not None:
            watch(state)
    with torch.no_grad():
        return potential(), adam, state


def _move_finally(
    density: DenseField,
    source: ActiveSmoke,
    mask: EffectMask | None,
    potential: Potential,
    cap: float,
    config: Config,
) -> tuple[DenseField, dict[str, Any]]:
    """The full density moved by the accurate scheme, and how far the cheap one is off."""
    lattice = surround(source, ROOM)
    box = lattice.fill(source)
    effect = _effect(box, lattice, mask)
    u = config.optimize.strength * displacement_from(
        potential.on(lattice), effect, config.shape.displacement, cap, lattice
    )
    moved = warp(box, u, scheme=cast(Scheme, config.shape.interpolation)).clamp_min(0)
    # round-off of the spline is no smoke: it would fill the box with active voxels
    moved = torch.where(moved > FAINTEST * box.max(), moved, torch.zeros_like(moved))
    sides = u.new_tensor(lattice.spacing)
    report = {"largest displacement": float((u * sides).norm(dim=-1).max()), "cap": cap}
    if config.shape.interpolation != "linear":
        active = torch.nonzero((box > 0) | (moved > 0))
        cheap = warp(box, u[tuple(active.T)], active_ijk=active, scheme="linear")
        difference = (cheap - moved[tuple(active.T)]).abs().sum() / moved.sum().clamp_min(1e-30)
        report["cheap scheme differs"] = float(difference)
    # a curl reaches one voxel beyond the mask, and a factor would reach everywhere
    here = _shares(box, lattice, mask) > 0
    corrected, report["mass error"] = correct_mass(moved[here], box[here])
    result = box.clone()
    result[here] = corrected if config.shape.mass_correction else moved[here]
    return field_from_box(density, result.cpu().numpy(), lattice.low), report

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
  of each level only the nodes that the smoke's displacement depends on;
- lengths are in stage units, so octaves and crops agree.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from operator import truediv

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.machine import give_back_memory
from usdsmoke.base.settings import Config
from usdsmoke.core.fields.displacement import SparseDisplacement, clamp_displacement
from usdsmoke.core.fields.lattice import Lattice, grow, surround
from usdsmoke.core.fields.potential import (
    Displacement,
    Potential,
    unclamped_displacement,
)
from usdsmoke.core.fields.pyramid import SparsePyramid, expand_levels
from usdsmoke.core.fields.sample import sample_linear
from usdsmoke.core.fields.sparse_map import Nodes
from usdsmoke.core.fields.transport import warp
from usdsmoke.core.smoke.active import ActiveSmoke, octaves_to_do
from usdsmoke.core.smoke.memory import LazyList, accumulate
from usdsmoke.core.steps.grey import GreyView, look_at
from usdsmoke.core.steps.move import PADDING, effect_on, shares_on
from usdsmoke.core.steps.optimize import Minimum, minimize
from usdsmoke.core.style.picture_loss import PictureLoss
from usdsmoke.core.style.targets import StyleTargets
from usdsmoke.core.views.cameras import draw_views
from usdsmoke.core.views.project import column_map
from usdsmoke.core.views.scene import Scene, frame_views
from usdsmoke.core.views.visibility import EffectMask

__all__ = ["Start", "longest_move", "run_shape_step"]

Start = Callable[[Lattice], Tensor]

N_CHANNELS = {"stream": 3, "potential": 1, "mixed": 4}
N_LEVELS = 5  # of the coefficient pyramid


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
        start: Start | None,
        n_channels: int,
    ) -> None:
        self.lattice = surround(smoke, PADDING)
        self.density = self.lattice.fill(smoke)
        self._share = shares_on(self.lattice, mask, self.density)
        self.effect = effect_on(self.density, self._share)
        self.base = None if start is None else start(self.lattice)
        self._config, self._cap, self._judge, self._seed = config, cap, judge, seed
        self._sides = self.density.new_tensor(self.lattice.spacing)
        reached, moving = self._reached(), Nodes.where(self.effect > 0)
        self.active = torch.nonzero(reached)
        where = tuple(self.active.T)
        # component by component, because that is how the look-up takes them
        self._arrivals = self.active.T.to(self.density, memory_format=torch.contiguous_format).T
        self.pyramid = SparsePyramid(moving, N_LEVELS, self.density)
        self._moves = SparseDisplacement(
            Nodes.where(reached), moving, self.effect, self._kind,
            self.lattice.spacing, n_channels,
        )  # fmt: skip
        self._base_there = None if self.base is None else self.base[where]
        self._shown = None if self._share is None else self._share[where]
        self._behind = scene.grey_mean
        positions = self.lattice.positions(self.active)
        still = self.density[where]
        views = frame_views(smoke, config.views, scene, seed, factor)

        shown, behind = self._shown, self._behind  # not ``self``: a cycle would outlive the octave

        def look(number: int) -> GreyView:
            image = column_map(positions, smoke.voxel_volume, views[number])
            found = look_at(image, still, shown, scene.gamma_w_shape, scene.exposure_shape)
            if not judge.wants_content:
                return found
            return replace(found, content=judge.remember(found.filled(found.grey, behind)))

        self._views = LazyList(len(views), look)
        self._n_drawn = min(config.views.count, len(self._views))  # twice the same tells nothing

    def _reached(self) -> Tensor:
        """Voxels that smoke is in or can come to, [I J K] bool.

        A potential moves nothing where the effect and its neighbours are 0; what is carried along
        may have smoke elsewhere.
        """
        reached = (self.density > 0) | grow(self.effect > 0)
        if self.base is not None:
            u = clamp_displacement(self.base, self._cap, self._share).div_(self._sides)
            reached |= grow(warp(self.density, u, scheme="linear") > 0)
        return reached

    @property
    def _kind(self) -> str:
        return self._config.shape.displacement

    def moved(self, potential: Tensor) -> Tensor:
        """Moved density at the active voxels, [N]; the cheap scheme.

        Args:
            potential: [n C] at the pyramid's nodes of the finest level.

        Raises:
            NonFiniteError: the displacement is not finite.
        """
        unclamped = self._moves.apply(potential)
        if self._base_there is not None:
            unclamped = unclamped + self._base_there
        clamped = clamp_displacement(unclamped, self._cap, self._shown)
        # what never changes, ``warp`` would look through for NaN in every iteration
        return sample_linear(self.density, self._arrivals - clamped / self._sides)

    def loss(self, potential: Tensor, iteration: int) -> Tensor:
        """Style loss of the moved smoke's pictures, and what leaves the source's silhouette."""
        n_views, keep = self._n_drawn, self._config.losses.keep

        def term(view: GreyView, density: Tensor) -> Tensor:
            grey = view.picture(density)
            picture = view.filled(grey, self._behind)
            loss = self._judge(picture, view.guide, view.content, iteration)
            return loss + keep * view.leaving(grey) if keep else loss

        drawn = draw_views(iteration, n_views, len(self._views), self._seed)
        terms = [partial(term, self._views[number]) for number in drawn]
        return accumulate(self.moved(potential), terms) / n_views


def run_shape_step(
    source: ActiveSmoke,
    start: Start | None,
    targets: StyleTargets,
    scene: Scene,
    config: Config,
    iterations: Sequence[int],
    watch: Callable[[int, Minimum], None] | None = None,
    mask: EffectMask | None = None,
    slower: float = 1.0,
) -> tuple[Displacement, list[Minimum]]:
    """What moves one frame's smoke so that its grey pictures take the style's structure.

    Args:
        source: the smoke at full resolution.
        start: lattice -> displacement [I J K 3] along its axes, stage units, to start from; None
            starts from rest.
        iterations: per octave, coarse to fine; an octave with 0 is passed over.
        watch: called with the octave and the optimiser's state after every iteration.
        mask: scales the displacement in space.
        slower: share of the learning rate, in (0, 1].

    Returns:
        The displacement, before it is clamped to the cap and before ``optimize.strength``, and how
        each octave ended.
    """
    cap, rate = longest_move(source, config), slower * config.shape.learning_rate
    potential, ends, done = None, [], None
    n_channels = _n_channels(config.shape.displacement, source)
    for number, factor, smoke, n_iterations in octaves_to_do(source, iterations):
        seed, judge = config.optimize.seed + number, targets.at(factor, grey=True)
        octave = _Octave(smoke, mask, cap, judge, scene, config, seed, factor, start, n_channels)
        first = _potential_on(octave.lattice, potential, n_channels, octave.density)
        told = partial(watch, number) if watch is not None else None
        values, end = _optimize_octave(octave, first, cap, config, n_iterations, rate, told)
        potential = Potential(values, octave.lattice)
        ends += [end] if end is not None else []
        done = (octave.lattice, octave.effect, octave.base) if smoke is source else None
        del octave  # with its views, which are most of a step's memory
    give_back_memory()  # the octaves' pieces, before dense boxes are made
    if done is not None:  # the box at full resolution is there
        lattice, effect, base = done
    else:
        lattice = surround(source, PADDING)
        density = lattice.fill(source)
        effect = effect_on(density, shares_on(lattice, mask, density))
        base = None if start is None else start(lattice)
    found = _potential_on(lattice, potential, n_channels, source.density)
    unclamped = unclamped_displacement(found, effect, config.shape.displacement, lattice, base)
    return Displacement(lattice.to_stage(unclamped), lattice), ends


def longest_move(source: ActiveSmoke, config: Config) -> float:
    """The cap of the displacement, stage units."""
    low, high = source.box
    sides = np.linalg.norm(source.index_to_stage[:3, :3], axis=1)
    return config.shape.reach * float(max((high - low + 1) * sides))


def _n_channels(kind: str, source: ActiveSmoke) -> int:
    """Of the potential: in a slab only a stream function's component across it moves anything."""
    return 1 if kind == "stream" and source.thin_axis is not None else N_CHANNELS[kind]


def _potential_on(
    lattice: Lattice, potential: Potential | None, n_channels: int, like: Tensor
) -> Tensor:
    if potential is not None:
        return potential.on(lattice)
    return like.new_zeros(*lattice.shape, n_channels)


def _optimize_octave(
    octave: _Octave,
    base: Tensor,
    cap: float,
    config: Config,
    n_iterations: int,
    rate: float,
    watch: Callable[[Minimum], None] | None,
) -> tuple[Tensor, Minimum | None]:
    """One octave, from a potential [I J K C].

    Returns:
        The potential, and how the optimisation ended.
    """
    pyramid, spacing = octave.pyramid, max(octave.lattice.spacing)
    # a coefficient of 1 moves smoke by about the cap on the finest level, and by less on coarser
    # ones, whose neighbours agree and add up: with as much on all levels frames end as near to the
    # style, but carried ones change by a tenth more at an equal distance (64 voxels, 12 frames)
    scales = [
        cap * spacing * math.sqrt(max(map(truediv, octave.lattice.shape, shape)))
        for shape in pyramid.nodes.shapes
    ]
    unknowns = pyramid.nodes.zeros(base.shape[-1], base)
    for level in unknowns:
        level.requires_grad_(True)
    base_there = pyramid.chosen(base)

    def scaled() -> list[Tensor]:
        return [u * s for u, s in zip(unknowns, scales, strict=True)]

    steps = minimize(
        lambda iteration: octave.loss(base_there + pyramid.expand(scaled()), iteration),
        unknowns, rate, n_iterations, tolerance=config.optimize.tolerance,
    )  # fmt: skip
    state = None
    for state in steps:
        if watch is not None:
            watch(state)
    with torch.no_grad():
        return base + expand_levels(pyramid.nodes.fill(scaled())), state

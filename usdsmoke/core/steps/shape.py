r"""The shape step: density moved by an optimised displacement. [Christen2020, eqs. 4-5; Kim2019]

The grey picture is the opacity 1 - exp(-gamma * column). The unknown is a potential on the voxels.
Its curl (or gradient) is a velocity, whose flow over a unit of time is the displacement u, and the
density becomes d(x - u(x)).

Deviations from the reference, each against a fault seen there:

- the velocity's length is clamped smoothly to ``shape.reach`` of the smoke's extent, and fades at
  the border of thick smoke; otherwise a bright rim grows along the border of the moved smoke;
- the smoke follows the velocity's flow, and folding is penalised: a displacement taken at once
  folds a seventh of a plume of 64 voxels (decision 018);
- outliers of density count as much as the dense smoke: one voxel would own every measure;
- the guide T is the *source's* silhouette: the optimiser would exploit one that follows the moved
  smoke;
- Adam on a pyramid of coefficients scaled to displacement in place of Laplacian-normalised ascent;
  of each level only the nodes that the smoke's displacement depends on;
- lengths are in stage units, so octaves and crops agree.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import truediv

import torch
from torch import Tensor

from usdsmoke.base.machine import give_back_memory
from usdsmoke.core.fields.displacement import SparseDisplacement, clamp_displacement
from usdsmoke.core.fields.flow import flow, flow_at
from usdsmoke.core.fields.folding import FoldingPenalty, softened
from usdsmoke.core.fields.lattice import Lattice, grow
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
from usdsmoke.core.smoke.levels import bounded
from usdsmoke.core.smoke.memory import LazyList
from usdsmoke.core.steps.move import effect_on, fade_of, moves_along, shares_on, smoke_box
from usdsmoke.core.steps.optimize import Descent, Minimum, minimize
from usdsmoke.core.steps.pictures import GreyView, ViewPool, grey_view
from usdsmoke.core.steps.targets import StepProblem
from usdsmoke.core.views.project import column_map
from usdsmoke.core.views.scene import frame_views

Start = Callable[[Lattice], Tensor]

N_CHANNELS = {"stream": 3, "potential": 1, "mixed": 4}  # of the potential
N_LEVELS = 5  # of the coefficient pyramid
# Weights of the penalties, relative to the style's (decision 018)
FOLDING_WEIGHT = 10.0  # on folding
MASS_WEIGHT = 0.75  # on the change of mass, of which LARGE_CHANGE is one: darkness is cheap style
LARGE_CHANGE = 0.05  # of the mass


@dataclass(frozen=True)
class _Reach:
    """How far smoke is moved, stage units; of the full resolution."""

    limit: float
    fade: float  # see ``move.fade_of``


class _Octave:
    """The shape step's problem at one resolution."""

    def __init__(
        self,
        problem: StepProblem,
        factor: int,
        seed: int,
        reach: _Reach,
        n_channels: int,
        start: Start | None,
        steadiness: float,
    ) -> None:
        smoke, mask, scene, config = problem.smoke, problem.mask, problem.scene, problem.config
        self.lattice = smoke_box(smoke, reach.fade)
        self.density = self.lattice.fill(smoke)
        self._share = shares_on(self.lattice, mask, self.density)
        self.effect = effect_on(self.density, self.lattice, reach.fade, self._share)
        self.base = None if start is None else start(self.lattice)
        self.limit, self._keep = reach.limit, config.losses.keep
        self._kind = config.shape.displacement
        self._loss = loss = problem.targets.at(factor, grey=True)
        self._sides = self.density.new_tensor(self.lattice.spacing)
        reached, moving = self._reached(), Nodes.where(self.effect > 0)
        self.active = torch.nonzero(reached)
        where, active = tuple(self.active.T), Nodes.where(reached)
        # component by component, because that is how the look-up takes them
        self._arrivals = self.active.T.to(self.density, memory_format=torch.contiguous_format).T
        self.pyramid = SparsePyramid(moving, N_LEVELS, self.density)
        self._moves = SparseDisplacement(
            active, moving, self.effect, self._kind, self.lattice.spacing, n_channels,
        )  # fmt: skip
        self._folding = None
        if self.density.numel() > 1:
            self._folding = FoldingPenalty(Nodes.where(self.density > 0), active, self.density)
        self._weight, self._active = config.losses.style, active
        self._steadiness = steadiness
        self._mass = self.density.sum()
        self._base_there = None if self.base is None else self.base[where]
        self._share_there = None if self._share is None else self._share[where]
        positions = self.lattice.positions(self.active)
        still = self.density[where]
        self._shares = still / still.sum()
        views = frame_views(smoke, config.views, scene, seed, factor)

        self._background = background = scene.grey_mean
        share = self._share_there  # not ``self``: a cycle would outlive the octave

        def make_view(number: int) -> GreyView:
            image = column_map(positions, smoke.edges, views[number])
            view = grey_view(image, still, share, scene.gamma_w_shape, scene.exposure_shape)
            if not loss.uses_content:
                return view
            return replace(view, content=loss.content(view.over_grey(view.grey, background)))

        self._pool = ViewPool(LazyList(len(views), make_view), config.views.count, seed)

    def _reached(self) -> Tensor:
        """Voxels that smoke is in or can come to, [I J K] bool.

        A potential moves nothing where the effect and its neighbours are 0; a start may move smoke
        elsewhere.
        """
        reached = (self.density > 0) | grow(self.effect > 0)
        if self.base is not None:
            velocity = clamp_displacement(self.base, self.limit, self._share).div_(self._sides)
            reached |= grow(warp(self.density, flow(velocity), scheme="linear") > 0)
        return reached

    @property
    def can_move(self) -> bool:
        """Whether the potential has an effect on any voxel."""
        return moves_along(self.lattice.shape, self._kind) and bool((self.effect > 0).any())

    def prepare(self, n_iterations: int) -> None:
        """Make the views that so many iterations draw."""
        self._pool.prepare(n_iterations)

    @property
    def passage(self) -> int:
        """Iterations that see every view once."""
        return self._pool.passage

    def displacement(self, change: Tensor) -> Tensor:
        """The displacement of the active voxels, [N 3] index units.

        Args:
            change: of the velocity against the start's, [N 3], stage units.

        Raises:
            NonFiniteError: the displacement is not finite.
        """
        unclamped = change
        if self._base_there is not None:
            unclamped = unclamped + self._base_there
        clamped = clamp_displacement(unclamped, self.limit, self._share_there)
        return flow_at(clamped / self._sides, self._active, self._arrivals)

    def loss(self, potential: Tensor, iteration: int) -> Tensor:
        """Style loss of the moved smoke's pictures, and penalties: what leaves the source's
        silhouette, what mass is gained or lost, what folds, and what leaves the start.

        Args:
            potential: [n C] at the pyramid's nodes of the finest level.
            iteration: its number.
        """

        def view_loss(view: GreyView, density: Tensor) -> Tensor:
            grey = view.picture(density)
            picture = view.over_grey(grey, self._background)
            loss = self._loss(picture, view.guide, view.content, iteration)
            return loss + self._keep * view.outside_change(grey) if self._keep else loss

        change = self._moves.apply(potential)
        u = self.displacement(change)
        # not ``warp``: it would check the density, which never changes, in every iteration
        moved = sample_linear(self.density, self._arrivals - u)
        loss = self._pool.mean_loss(moved, iteration, view_loss)
        gain = (moved.sum() / self._mass - 1) / LARGE_CHANGE
        loss = loss + self._weight * MASS_WEIGHT * softened(gain)
        if self._folding is not None:
            loss = loss + self._weight * FOLDING_WEIGHT * self._folding(u)
        if self._steadiness:
            away = (change / self.limit).square().sum(1) @ self._shares
            loss = loss + self._weight * self._steadiness * away
        return loss


def run_shape_step(
    problem: StepProblem,
    iterations: Sequence[int],
    start: Start | None = None,
    watch: Callable[[int, Minimum], None] | None = None,
    rate_share: float = 1.0,
    steadiness: float = 0.0,
) -> tuple[Displacement, list[Minimum]]:
    """What moves one frame's smoke so that its grey pictures take the style's structure.

    An octave in which nothing can move, such as a row of voxels by a stream function, is left out.

    Args:
        problem: the smoke at full resolution; the mask scales the displacement in space.
        iterations: per octave, coarse to fine; an octave with 0 is skipped.
        start: lattice -> velocity [I J K 3] along its axes, stage units per unit of time, to start
            from; None starts from rest.
        watch: called with the octave and the optimiser's state after every iteration.
        rate_share: share of the learning rate, in (0, 1].
        steadiness: weight of the change against the start, as a share of the largest
            displacement, squared, mean over the smoke; see ``windows.steadiness``.

    Returns:
        The velocity, before it is clamped and before ``optimize.strength``, and how each octave
        ended.
    """
    source, config = bounded(problem.smoke), problem.config
    reach = _Reach(max_displacement(source, config.shape.reach), fade_of(source))
    rate, tolerance = rate_share * config.shape.learning_rate, config.optimize.tolerance
    kind, potential, ends, box = config.shape.displacement, None, [], None
    # in a slab only a stream function's component across it moves anything
    n_channels = 1 if kind == "stream" and source.thin_axis is not None else N_CHANNELS[kind]
    todo = octaves_to_do(source, iterations, problem.scene.pixel_size)
    for number, factor, smoke, n_iterations in todo:
        here, seed = replace(problem, smoke=smoke), config.optimize.seed + number
        octave = _Octave(here, factor, seed, reach, n_channels, start, steadiness)
        first = _potential_on(octave.lattice, potential, n_channels, octave.density)
        watch_octave = partial(watch, number) if watch is not None else None
        descent = Descent(rate, n_iterations, tolerance)
        values, end = _optimize_octave(octave, first, descent, watch_octave)
        potential = Potential(values, octave.lattice)
        ends += [end] if end is not None else []
        box = (octave.lattice, octave.effect, octave.base if smoke is source else None)
        del octave  # with its views, which are most of a step's memory
    give_back_memory()  # fragments of the octaves, before dense boxes are made
    if box is None:
        lattice = smoke_box(source, reach.fade)
        density = lattice.fill(source)
        effect = effect_on(density, lattice, reach.fade, shares_on(lattice, problem.mask, density))
        box = (lattice, effect, None if start is None else start(lattice))
    lattice, effect, base = box
    found = _potential_on(lattice, potential, n_channels, source.density)
    unclamped = unclamped_displacement(found, effect, kind, lattice, base)
    moved = Displacement(lattice.to_stage(unclamped), lattice)
    if todo and todo[-1][2] is not source:
        moved = _between_blocks(moved, smoke_box(source, reach.fade), start)
    return moved, ends


def _between_blocks(blocks: Displacement, lattice: Lattice, start: Start | None) -> Displacement:
    """What moves blocks, on their voxels, and the start.

    The curl of an interpolated potential would have kinks between blocks, and smoke would fold.
    """
    velocity = blocks.on(lattice)
    if start is not None:
        velocity = velocity + start(lattice)
    return Displacement(lattice.to_stage(velocity), lattice)


def max_displacement(source: ActiveSmoke, share: float) -> float:
    """What displacements are clamped to, stage units: ``share`` of the smoke's extent."""
    return share * source.extent


def _potential_on(
    lattice: Lattice, potential: Potential | None, n_channels: int, like: Tensor
) -> Tensor:
    if potential is not None:
        return potential.on(lattice)
    return like.new_zeros(*lattice.shape, n_channels)


def _optimize_octave(
    octave: _Octave,
    base: Tensor,
    descent: Descent,
    watch: Callable[[Minimum], None] | None,
) -> tuple[Tensor, Minimum | None]:
    """One octave, from a potential [I J K C].

    Returns:
        The potential, and how the optimisation ended.
    """
    if not octave.can_move:
        return base, None
    octave.prepare(descent.n_iterations)
    pyramid, spacing = octave.pyramid, max(octave.lattice.spacing)
    # a coefficient of 1 moves smoke by about the limit on the finest level, and by less on coarser
    # ones, whose neighbours agree and add up: with as much on all levels frames end as near to the
    # style, but carried ones change by a tenth more at an equal distance (64 voxels, 12 frames)
    scales = [
        octave.limit * spacing * math.sqrt(max(map(truediv, octave.lattice.shape, shape)))
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
        unknowns,
        replace(descent, passage=octave.passage),
    )
    state = None
    for state in steps:
        if watch is not None:
            watch(state)
    with torch.no_grad():
        return base + expand_levels(pyramid.nodes.fill(scaled())), state

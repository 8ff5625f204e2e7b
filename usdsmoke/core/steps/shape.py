r"""The shape step: density moved by an optimised displacement. [Christen2020, eqs. 4-5; Kim2019]

The grey picture is the opacity 1 - exp(-gamma * column). The unknown is a potential on the voxels.
Its curl (or gradient) is a velocity, whose flow over a unit of time is the displacement u, and the
density becomes d(x - u(x)).

Deviations from the reference, each against a fault seen there:

- the velocity's length is clamped smoothly to ``shape.reach`` of the smoke's extent, and fades at
  the border of thick smoke; otherwise a bright rim grows along the border of the moved smoke;
- the smoke follows the velocity's flow, and folding is penalised: a displacement taken at once
  folds a seventh of a plume of 64 voxels (decision 018);
- where a shot has many voxels, blocks of two of them move, and pictures are theirs (decisions 038
  and 077);
- outliers of density count as much as the dense smoke: one voxel would own every measure;
- the guide T is the *source's* silhouette: the optimiser would exploit one that follows the moved
  smoke;
- Adam on a pyramid of coefficients scaled to displacement in place of Laplacian-normalised ascent;
  of each level only the nodes that the smoke's displacement depends on;
- lengths are in stage units, so octaves and crops agree.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from operator import truediv

import torch
from torch import Tensor

from usdsmoke.base.machine import give_back_memory
from usdsmoke.core.fields.folding import softened
from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.fields.potential import Displacement, Potential
from usdsmoke.core.fields.pyramid import expand_levels
from usdsmoke.core.fields.sample import sample_linear
from usdsmoke.core.smoke.active import ActiveSmoke, octaves_to_do
from usdsmoke.core.smoke.levels import bounded
from usdsmoke.core.smoke.memory import LazyList, accumulate_beside
from usdsmoke.core.smoke.schedule import OCTAVE_SCALE
from usdsmoke.core.steps.motion import Motion, MotionBox, Start
from usdsmoke.core.steps.move import fade_of, movable_blocks, near_smoke, smoke_box
from usdsmoke.core.steps.optimize import Descent, Minimum, minimize
from usdsmoke.core.steps.pictures import GreyView, ViewPool, grey_view
from usdsmoke.core.steps.targets import StepProblem
from usdsmoke.core.views.project import column_map
from usdsmoke.core.views.scene import frame_views

N_CHANNELS = {"stream": 3, "potential": 1, "mixed": 4}  # of the potential
# Weights of the penalties, relative to the style's (decision 018)
FOLDING_WEIGHT = 10.0  # on folding
# on that of blocks: between them, slopes are interpolated, so that voxels fold more (decision 038)
BLOCK_FOLDING_WEIGHT = 100.0
MASS_WEIGHT = 0.75  # on the change of mass, of which LARGE_CHANGE is one: darkness is cheap style
LARGE_CHANGE = 0.05  # of the mass


class _Octave:
    """The shape step's problem at one resolution."""

    def __init__(
        self, problem: StepProblem, motion: Motion, factor: int, seed: int, steadiness: float,
        folding: float,
    ) -> None:  # fmt: skip
        smoke, mask, scene, config = problem.smoke, problem.mask, problem.scene, problem.config
        self._loss = loss = problem.targets.at(factor, grey=True)
        self._keep, self._weight = config.losses.keep, config.losses.style
        self._pixel = factor * scene.pixel_size
        self._steadiness, self._folding, self.motion = steadiness, folding, motion
        box, reached = motion.box, motion.reached
        self._density, self._arrivals, self._mass = box.density, reached.arrivals, box.density.sum()
        positions, still = box.lattice.positions(reached.ijk), box.density[tuple(reached.ijk.T)]
        share = None if mask is None else mask.at(positions).to(still)
        views = frame_views(smoke, config.views, scene, seed, factor)
        self._background = background = scene.grey_mean

        # names of this function instead of ``self``: a cycle would outlive the octave
        def make_view(number: int) -> GreyView:
            image = column_map(positions, smoke.edges, views[number])
            view = grey_view(image, still, share, scene.gamma_w_shape, scene.exposure_shape)
            if not loss.uses_content:
                return view
            return replace(view, content=loss.content(view.over_grey(view.grey, background)))

        self._pool = ViewPool(LazyList(len(views), make_view), config.views.count, seed)

    def prepare(self, n_iterations: int) -> None:
        """Make the views that so many iterations draw."""
        self._pool.prepare(n_iterations)

    @property
    def passage(self) -> int:
        """Iterations that see every view once."""
        return self._pool.passage

    def loss(self, potential: Tensor, iteration: int) -> Tensor:
        """Style loss of the moved smoke's pictures, and penalties: what leaves the source's
        silhouette, what mass is gained or lost, what folds, and what leaves the start.

        Args:
            potential: [n C] at the nodes of the finest level of the motion's pyramid.
            iteration: its number.
        """

        def view_loss(view: GreyView, density: Tensor) -> Tensor:
            grey = view.picture(density)
            picture = view.over_grey(grey, self._background)
            loss = self._loss(picture, view.guide, view.content, iteration)
            return loss + self._keep * view.outside_change(grey) if self._keep else loss

        def moved_loss(u: Tensor) -> Tensor:
            # not ``warp``: it would check the density, which never changes, in every iteration
            moved = sample_linear(self._density, self._arrivals - u)
            gain = (moved.sum() / self._mass - 1) / LARGE_CHANGE
            loss = self._pool.mean_loss(moved, iteration, view_loss)
            return loss + self._weight * MASS_WEIGHT * softened(gain)

        def folding(u: Tensor) -> Tensor:
            return self._weight * self._folding * self.motion.folding(u)

        change = self.motion.change(potential)
        loss = accumulate_beside(self.motion.displacement(change), moved_loss, folding)
        if self._steadiness:
            departure = self.motion.departure(change / self._pixel)
            loss = loss + self._weight * self._steadiness * departure
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
        start: what to start from, see ``MotionBox.of``; None starts from rest.
        watch: called with the octave and the optimiser's state after every iteration.
        rate_share: share of the learning rate, in (0, 1].
        steadiness: weight of the change against the start, in the octave's pixels (of blocks, in
            the voxels'), squared, mean over the smoke; see ``windows.steadiness``.

    Returns:
        The velocity of the blocks, before it is clamped and before ``optimize.strength``, and how
        each octave ended.
    """
    source, config = bounded(problem.smoke), problem.config
    limit, fade = max_displacement(source, config.shape.reach), fade_of(source)
    descent = Descent(rate_share * config.shape.learning_rate, 0, config.optimize.tolerance)
    kind = config.shape.displacement
    n_channels = _n_channels(kind, source)
    blocks = movable_blocks(source, problem.scene)

    box: MotionBox | None = None
    potential, ends = None, []
    todo = octaves_to_do(source, iterations, problem.scene.pixel_size)
    if blocks is not source and todo and todo[-1][2] is source:
        # it is done on the blocks, which are the voxels of the octave before (decision 058)
        todo = [octave for octave in todo if octave[0] != todo[-1][0] - 1]
    for number, factor, smoke, n_iterations in todo:
        if smoke is source and blocks is not source:  # finer pictures hardly move blocks better
            smoke, factor = blocks, factor * OCTAVE_SCALE
            steadiness *= OCTAVE_SCALE**2  # changes still count in the shot's pixels
        here, seed = replace(problem, smoke=smoke), config.optimize.seed + number
        is_between = blocks is not source and len(smoke.ijk) == len(blocks.ijk)
        folding = BLOCK_FOLDING_WEIGHT if is_between else FOLDING_WEIGHT
        box = MotionBox.of(smoke, problem.mask, fade, start)
        motion = Motion(box, limit, kind, n_channels)
        octave = _Octave(here, motion, factor, seed, steadiness, folding)
        first = _potential_on(box.lattice, potential, n_channels, box.density)
        watch_octave = partial(watch, number) if watch is not None else None
        descent = replace(descent, n_iterations=n_iterations, passage=octave.passage)
        values, end = _optimize_octave(octave, first, descent, watch_octave)
        potential = Potential(values, box.lattice)
        ends += [end] if end is not None else []
        del octave, motion  # with the views, which are most of a step's memory
    give_back_memory()  # fragments of the octaves, before dense boxes are made
    if box is None:
        box = MotionBox.of(blocks, problem.mask, fade, start)
    values = _potential_on(box.lattice, potential, n_channels, box.density)
    return _velocity(box, values, kind, blocks, fade, start), ends


def _velocity(
    box: MotionBox, potential: Tensor, kind: str, blocks: ActiveSmoke, fade: float,
    start: Start | None,
) -> Displacement:  # fmt: skip
    """What a potential [I J K C] on the last octave's box adds to the start, on that of blocks."""
    change, base, lattice = box.change(potential, kind), box.base, smoke_box(blocks, fade)
    if box.lattice.spacing != lattice.spacing:
        change = Displacement(box.lattice.to_stage(change), box.lattice).on(lattice)
        near = near_smoke(lattice.fill(blocks), lattice, fade)
        base = None if start is None else start(lattice, near)
    found = change if base is None else change + base
    return Displacement(lattice.to_stage(found), lattice)


def max_displacement(source: ActiveSmoke, share: float) -> float:
    """What displacements are clamped to, stage units: ``share`` of the smoke's extent."""
    return share * source.extent


def _n_channels(kind: str, source: ActiveSmoke) -> int:
    """In a slab only a stream function's component across it moves anything."""
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
    descent: Descent,
    watch: Callable[[Minimum], None] | None,
) -> tuple[Tensor, Minimum | None]:
    """One octave, from a potential [I J K C].

    Returns:
        The potential, and how the optimisation ended.
    """
    motion = octave.motion
    if not motion.can_move:
        return base, None
    octave.prepare(descent.n_iterations)
    pyramid, spacing = motion.pyramid, max(motion.box.lattice.spacing)
    # a coefficient of 1 moves smoke by about the limit on the finest level, and by less on coarser
    # ones, whose neighbours agree and add up: with as much on all levels frames end as near to the
    # style, but carried ones change by a tenth more at an equal distance (64 voxels, 12 frames)
    scales = [
        motion.limit * spacing * math.sqrt(max(map(truediv, motion.box.lattice.shape, shape)))
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
        descent,
    )
    state = None
    for state in steps:
        if watch is not None:
            watch(state)
    with torch.no_grad():
        return base + expand_levels(pyramid.nodes.fill(scaled())), state

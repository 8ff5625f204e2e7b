r"""What moves the smoke of one octave: the flow of a potential's velocity, on blocks of voxels.

A potential on the blocks is derived, clamped to a velocity, and followed for a unit of time. Where
a shot has many voxels, blocks are at least two of them long (``move.movable_blocks``): motion of
single ones takes two to three times as long, and hardly brings coloured pictures nearer to the
style.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor

from usdsmoke.core.fields.displacement import SparseDisplacement, clamp_displacement
from usdsmoke.core.fields.flow import flow, flow_at
from usdsmoke.core.fields.folding import FoldingPenalty
from usdsmoke.core.fields.lattice import Lattice, grow
from usdsmoke.core.fields.potential import unclamped_displacement
from usdsmoke.core.fields.pyramid import SparsePyramid
from usdsmoke.core.fields.sparse_map import Nodes
from usdsmoke.core.fields.transport import warp
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.memory import run_on
from usdsmoke.core.steps.move import effect_on, moves_along, near_smoke, shares_on, smoke_box
from usdsmoke.core.views.visibility import EffectMask

Start = Callable[[Lattice, Tensor], Tensor]

N_LEVELS = 5  # of the coefficient pyramid


@dataclass(frozen=True)
class Reached:
    """Voxels or blocks of a box that smoke is in or can come to."""

    nodes: Nodes
    ijk: Tensor  # [N 3]
    arrivals: Tensor  # [N 3] as float, component by component: that is how the look-up takes them

    @classmethod
    def where(cls, mask: Tensor, like: Tensor) -> "Reached":
        """Where a mask [I J K] bool is set, with the dtype of ``like``."""
        ijk = torch.nonzero(mask)
        arrivals = ijk.T.to(like, memory_format=torch.contiguous_format).T
        return cls(Nodes.where(mask), ijk, arrivals)


@dataclass(frozen=True)
class MotionBox:
    """Blocks of an octave's smoke in a dense box, and what a potential can do there."""

    lattice: Lattice
    density: Tensor  # [I J K]
    effect: Tensor  # [I J K], share of the motion, see ``move.effect_on``
    share: Tensor | None  # [I J K], of the mask
    base: Tensor | None  # [I J K 3], velocity that the potential's is added to; None: rest

    @classmethod
    def of(
        cls, blocks: ActiveSmoke, mask: EffectMask | None, fade: float, start: Start | None
    ) -> "MotionBox":
        """Of the smoke on blocks of voxels, or on voxels.

        Args:
            blocks: they move as a whole.
            mask: share of the effect.
            fade: see ``move.fade_of``.
            start: lattice, mask of ``move.near_smoke`` -> velocity [I J K 3] along its axes, stage
                units per unit of time. A neighbour's is carried to the mask alone.
        """
        lattice = smoke_box(blocks, fade)
        density = lattice.fill(blocks)
        share = shares_on(lattice, mask, density)
        effect = effect_on(density, lattice, fade, share)
        base = None if start is None else start(lattice, near_smoke(density, lattice, fade))
        return cls(lattice, density, effect, share, base)

    def change(self, potential: Tensor, kind: str) -> Tensor:
        """What a potential [I J K C] adds to the velocity, [I J K 3] along the axes."""
        return unclamped_displacement(potential, self.effect, kind, self.lattice)


class Motion:
    """The displacement of an octave's blocks as a function of a potential.

    Args:
        box: of the blocks.
        limit: of the velocity, stage units per unit of time.
        kind, n_channels: of the potential, see ``SparseDisplacement``.
    """

    def __init__(self, box: MotionBox, limit: float, kind: str, n_channels: int) -> None:
        density, lattice, effect, share, base = (
            box.density, box.lattice, box.effect, box.share, box.base,
        )  # fmt: skip
        self.box, self.limit, self._kind = box, limit, kind
        self._sides = density.new_tensor(lattice.spacing)
        #: blocks that smoke leaves or comes to, [I J K] bool: a potential moves nothing where the
        #: effect and its neighbours are 0; a start may move smoke elsewhere
        self.moving = grow(effect > 0)
        if base is not None:
            velocity = clamp_displacement(base, limit, share).div_(self._sides)
            self.moving |= grow(warp(density, flow(velocity), scheme="linear") > 0)
        self.reached = Reached.where((density > 0) | self.moving, density)
        nodes, active = Nodes.where(effect > 0), self.reached.nodes

        def folding() -> FoldingPenalty | None:
            if density.numel() == 1:
                return None
            return FoldingPenalty(Nodes.where(density > 0), active, density)

        def moves() -> SparseDisplacement:
            return SparseDisplacement(active, nodes, effect, kind, lattice.spacing, n_channels)

        parts: list[Callable[[], Any]] = [
            partial(SparsePyramid, nodes, N_LEVELS, density), moves, folding,
        ]  # fmt: skip
        self.pyramid, self._moves, self._folding = run_on(density.device, parts)
        where = tuple(self.reached.ijk.T)
        self._base_there = None if base is None else base[where]
        self._share_there = None if share is None else share[where]
        still = density[where]
        self._shares = still / still.sum()

    @property
    def can_move(self) -> bool:
        """Whether the potential has an effect on any block."""
        return moves_along(self.box.lattice.shape, self._kind) and bool((self.box.effect > 0).any())

    def change(self, potential: Tensor) -> Tensor:
        """The velocity's change against the start's at the active blocks, [N 3], stage units.

        Args:
            potential: [n C] at the pyramid's nodes of the finest level.
        """
        return self._moves.apply(potential)

    def displacement(self, change: Tensor) -> Tensor:
        """The displacement of the active blocks, [N 3] in blocks.

        Raises:
            NonFiniteError: the displacement is not finite.
        """
        unclamped = change
        if self._base_there is not None:
            unclamped = unclamped + self._base_there
        clamped = clamp_displacement(unclamped, self.limit, self._share_there)
        return flow_at(clamped / self._sides, self.reached.nodes, self.reached.arrivals)

    def folding(self, u: Tensor) -> Tensor:
        """The penalty on a displacement that folds, [N 3]; 0 for a single block."""
        return u.new_zeros(()) if self._folding is None else self._folding(u)

    def departure(self, change: Tensor) -> Tensor:
        """Square of a change [N 3], mean over the smoke, in the change's unit squared."""
        return change.square().sum(1) @ self._shares

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
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor

from usdsmoke.config import Config
from usdsmoke.core.lattice import field_from_box, grow, surround
from usdsmoke.core.losses import StyleTarget
from usdsmoke.core.optics import opacity
from usdsmoke.core.optimize import Minimum, minimize
from usdsmoke.core.potential import Potential, border_mask, displacement_from
from usdsmoke.core.project import SparseImage, column_map
from usdsmoke.core.resample import Pyramid
from usdsmoke.core.scene import Scene, frame_views
from usdsmoke.core.smoke import ActiveSmoke, octaves_to_do
from usdsmoke.core.targets import StyleTargets
from usdsmoke.core.transport import Scheme, correct_mass, warp
from usdsmoke.core.warm import departure_points
from usdsmoke.volume import DenseField, VolumeFrame

__all__ = ["Displaced", "run_shape_step"]

N_LEVELS = 5  # of the coefficient pyramid
ROOM = 2  # empty voxels around the smoke, whose displacement ends at its border
FAINTEST = 1e-6  # of the largest density
THIN = 0.05  # opacity at which the guidance mask is one half


@dataclass(frozen=True)
class Displaced:
    """The moved density of one frame, and what the next one starts from."""

    density: DenseField
    potential: Potential
    report: dict[str, Any]


@dataclass(frozen=True)
class _GreyView:
    """A view's sums over the voxels that smoke can come to, and the unmoved picture [H W]."""

    image: SparseImage
    grey: Tensor

    def guide(self) -> Tensor:
        """T of the guidance mask, [H W]: 1 in all but the thinnest smoke, 0 outside."""
        return self.grey / (self.grey + THIN)

    def filled(self, grey: Tensor, behind: float) -> Tensor:
        """What the network sees, [H W 3]: a grey level beyond the silhouette instead of black.

        Against black the silhouette's edge is the strongest structure of the picture, and the
        optimiser sees little else.
        """
        return (grey + (1 - self.guide()) * behind)[..., None].expand(-1, -1, 3)

    def picture(self, density: Tensor, gamma_w: float) -> Tensor:
        return opacity(gamma_w * self.image.apply(density[:, None])[..., 0])


class _Octave:
    """The shape step's problem at one resolution."""

    def __init__(
        self, smoke: ActiveSmoke, cap: float, scene: Scene, config: Config, seed: int, factor: int
    ) -> None:
        self.lattice = surround(smoke, ROOM)
        self.density = self.lattice.fill(smoke)
        self.mask = border_mask(self.density)
        # nothing moves where the mask and its neighbours are 0: no smoke can come to other voxels
        self.active = torch.nonzero((self.density > 0) | grow(self.mask > 0))
        self._kind, self._cap, self._gamma_w = config.shape.displacement, cap, scene.gamma_w_shape
        self._behind = scene.grey_mean
        positions = self.lattice.positions(self.active)
        still = self.density[tuple(self.active.T)]
        self._views = []
        for view in frame_views(smoke, config, scene, seed, factor):
            image = column_map(positions, smoke.voxel_volume, view)
            self._views.append(
                _GreyView(image, opacity(self._gamma_w * image.apply(still[:, None])[..., 0]))
            )

    def moved(self, potential: Tensor) -> Tensor:
        """Moved density at the active voxels, [N]; the cheap scheme."""
        u = displacement_from(potential, self.mask, self._kind, self._cap, self.lattice)
        chosen = u[tuple(self.active.T)]
        return warp(self.density, chosen, active_ijk=self.active, scheme="linear")

    def loss(
        self,
        potential: Tensor,
        targets: Sequence[StyleTarget],
        keep: float,
        iteration: int,
        n_views: int,
    ) -> Tensor:
        """Style loss of the moved smoke's pictures, and what leaves the source's silhouette."""
        density = self.moved(potential)
        total = density.new_zeros(())
        for number in range(n_views):
            view = self._views[(iteration * n_views + number) % len(self._views)]
            grey = view.picture(density, self._gamma_w)
            picture = view.filled(grey, self._behind)
            for target in targets:
                total = total + target.loss(picture, view.guide())
            if keep:
                total = total + keep * ((grey - view.grey).abs() * (1 - view.grey)).mean()
        return total / n_views


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
) -> Displaced:
    """One frame's density, moved so that its grey pictures take the style's structure.

    Args:
        density: the frame's (refined) density; ``source`` holds its active voxels.
        frame: gives the velocity that carries ``before`` along.
        before: the neighbouring frame's result to start from.
        seconds: time since that frame.
        iterations: per octave, coarse to fine; an octave with 0 is passed over.
        watch: called with the octave and the optimiser's state after every iteration.
    """
    low, high = source.box
    sides = np.linalg.norm(source.index_to_stage[:3, :3], axis=1)
    cap = config.shape.reach * float(max((high - low + 1) * sides))
    n_channels = {"stream": 3, "potential": 1, "mixed": 4}[config.shape.displacement]
    potential, ends = None, []
    for number, factor, smoke, n_iterations in octaves_to_do(source, iterations):
        octave = _Octave(smoke, cap, scene, config, config.optimize.seed + number, factor)
        if potential is not None:
            base = potential.on(octave.lattice)
        elif before is not None:
            places = octave.lattice.positions().to(octave.density.device)
            base = before.potential.on(octave.lattice, departure_points(frame, places, seconds))
        else:
            base = octave.density.new_zeros(*octave.lattice.shape, n_channels)
        values, end = _optimize_octave(
            octave,
            base,
            cap,
            targets.at(factor, grey=True),
            config,
            n_iterations,
            partial(watch, number) if watch is not None else None,
        )
        potential = Potential(values, octave.lattice)
        ends += [end] if end is not None else []
    if potential is None:
        lattice = surround(source, ROOM)
        potential = Potential(source.density.new_zeros(*lattice.shape, n_channels), lattice)
    moved, report = _move_finally(density, source, potential, cap, config)
    return Displaced(moved, potential, {"ends": ends, **report})


def _optimize_octave(
    octave: _Octave,
    base: Tensor,
    cap: float,
    targets: Sequence[StyleTarget],
    config: Config,
    n_iterations: int,
    watch: Callable[[Minimum], None] | None,
) -> tuple[Tensor, Minimum | None]:
    """The potential [I J K C] after one octave, starting from ``base``."""
    pyramid = Pyramid.zeros(octave.lattice.shape, base.shape[-1], N_LEVELS, base)
    spacing = max(octave.lattice.spacing)
    # a coefficient of 1 moves smoke by about the cap on any level: one rate serves all
    scales = [
        cap * spacing * max(n / m for n, m in zip(octave.lattice.shape, level.shape, strict=False))
        for level in pyramid.levels
    ]
    unknowns = [level.requires_grad_(True) for level in pyramid.levels]

    def potential() -> Tensor:
        levels = tuple(u * s for u, s in zip(unknowns, scales, strict=True))
        return base + Pyramid(levels, pyramid.method).expand()

    def objective(iteration: int) -> Tensor:
        return octave.loss(potential(), targets, config.losses.keep, iteration, config.views.count)

    state = None
    for state in minimize(
        objective,
        unknowns,
        config.shape.learning_rate,
        n_iterations,
        tolerance=config.optimize.tolerance,
    ):
        if watch is not None:
            watch(state)
    with torch.no_grad():
        return potential(), state


def _move_finally(
    density: DenseField, source: ActiveSmoke, potential: Potential, cap: float, config: Config
) -> tuple[DenseField, dict[str, Any]]:
    """The full density moved by the accurate scheme, and how far the cheap one is off."""
    lattice = surround(source, ROOM)
    box = lattice.fill(source)
    values = potential.on(lattice)
    mask = border_mask(box)
    u = config.optimize.strength * displacement_from(
        values, mask, config.shape.displacement, cap, lattice
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
    corrected, report["mass error"] = correct_mass(moved, box)
    result = corrected if config.shape.mass_correction else moved
    return field_from_box(density, result.cpu().numpy(), lattice.low), report

"""Density moved by a displacement: with which voxels, how accurately, and with what mass."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.frame_report import Estimate, TransportReport
from usdsmoke.base.volume import DenseField
from usdsmoke.config.look_sections import ShapeConfig
from usdsmoke.core.fields.displacement import clamp_displacement
from usdsmoke.core.fields.flow import flow
from usdsmoke.core.fields.folding import measure_evenness
from usdsmoke.core.fields.lattice import Lattice, field_from_box, grow, surround
from usdsmoke.core.fields.potential import Displacement, border_mask
from usdsmoke.core.fields.resample import apply_along
from usdsmoke.core.fields.transport import Scheme, correct_mass, warp
from usdsmoke.core.fields.warp_error import warp_error
from usdsmoke.core.smoke.active import ActiveSmoke, coarsen
from usdsmoke.core.smoke.levels import dense_level
from usdsmoke.core.smoke.memory import run_on
from usdsmoke.core.smoke.schedule import MANY_VOXELS
from usdsmoke.core.views.scene import Scene
from usdsmoke.core.views.visibility import EffectMask

FADE = 0.02  # of the smoke's extent: sigma of the fade towards the border
BEYOND = 1.2  # sigma; beyond a thin sheet the fade has ended there
LEAST_PADDING = 2  # voxels: slopes reach one voxel beyond the effect
LEAST_SHARE = 1e-7  # of the density of outliers: less, where there was none, is round-off


def fade_of(source: ActiveSmoke) -> float:
    """Sigma of the effect's fade towards the smoke's border, stage units.

    A share of the smoke's extent. Of the longest side of filaments or of lumps far apart it would
    be wider than the smoke itself, at a cost that follows the cube of it.
    """
    return FADE * source.extent


def smoke_box(smoke: ActiveSmoke, fade: float) -> Lattice:
    """The box in which smoke is moved: with as much room around as thin smoke's effect takes.

    Args:
        smoke: of any octave.
        fade: of the full resolution, see ``fade_of``.
    """
    sides = np.linalg.norm(smoke.index_to_stage[:3, :3], axis=1)
    return surround(smoke, _room(sides, fade))


def near_smoke(density: Tensor, lattice: Lattice, fade: float) -> Tensor:
    """Where smoke can be moved, [I J K] bool: as far around it as ``smoke_box`` reaches.

    A neighbouring frame's motion is carried here alone.

    Args:
        density: [I J K], on the lattice.
        fade: see ``fade_of``.
    """
    return grow(density > 0, _room(lattice.spacing, fade))


def _room(sides: Sequence[float], fade: float) -> list[int]:
    """Voxels along each axis, by which the effect reaches beyond thin smoke."""
    reach = np.ceil(BEYOND * fade / np.asarray(sides)).astype(int) + 1
    return [int(n) for n in np.maximum(reach, LEAST_PADDING)]


def effect_on(density: Tensor, lattice: Lattice, fade: float, share: Tensor | None) -> Tensor:
    """The share of the motion that is kept, [I J K]: 0 at the border of thick smoke.

    Args:
        density: [I J K], on the lattice.
        fade: see ``fade_of``.
        share: the mask's values there, from ``shares_on``.
    """
    inside = border_mask(density, [fade / side for side in lattice.spacing])
    return inside if share is None else inside * share


def shares_on(lattice: Lattice, mask: EffectMask | None, like: Tensor) -> Tensor | None:
    """The mask's values on a box, [I J K], with the dtype and device of ``like``; None without."""
    return None if mask is None else lattice.on_voxels(mask.at, like).to(like)


def movable_blocks(source: ActiveSmoke, scene: Scene) -> ActiveSmoke:
    """What the shape step moves as a whole: voxels, or blocks of two where the shot has many.

    If each frame were judged by its own voxels, displacement would jump where a shot grows.
    """
    return source if scene.most_voxels < MANY_VOXELS else coarsen(source)


def displacement_of(
    velocity: Displacement,
    source: ActiveSmoke,
    limit: float,
    mask: EffectMask | None = None,
    strength: float = 1.0,
) -> Displacement:
    """The displacement that smoke is moved by, on its ``smoke_box``: the flow of the velocity.

    Args:
        velocity: what the shape step found, per unit of time, on blocks of voxels.
        source: what is moved.
        limit: of its length, stage units; no displacement is longer.
        mask: share of the effect; blocks where it is 0 do not move.
        strength: the share of the unit of time that it is followed for, in [0, 1].
    """
    blocks, lattice = velocity.lattice, smoke_box(source, fade_of(source))
    share = shares_on(blocks, mask, velocity.values)
    values = clamp_displacement(blocks.from_stage(velocity.values), limit, share)
    sides = values.new_tensor(blocks.spacing)
    moved = blocks.to_stage(flow(values * (strength / sides)) * sides)
    if lattice.spacing != blocks.spacing:
        moved = apply_along(moved, lattice.matrices_from(blocks))
    return Displacement(moved, lattice)


def move_density(
    density: DenseField,
    source: ActiveSmoke,
    displacement: Displacement,
    scene: Scene,
    shape: ShapeConfig,
    mask: EffectMask | None = None,
    is_part: bool = False,
) -> tuple[DenseField, TransportReport]:
    """The full density moved by the accurate scheme, and the errors of that.

    The excess of outliers over the dense smoke is moved by the linear scheme, with a mass of its
    own: a spline through a voxel of 1e6 rings over a dozen voxels around. It counts in no error.

    Args:
        density: the frame's (refined) density; ``source`` holds its active voxels.
        displacement: on the box that ``smoke_box`` gives for the source.
        scene: of the shot.
        shape: scheme and correction of mass.
        mask: share of the effect; where it is 0 the source stays bit for bit.
        is_part: ``source`` holds only some of the active voxels, and the others are kept.
    """
    # move the box
    lattice, level = displacement.lattice, dense_level(source.density)
    whole, u = lattice.fill(source), lattice.from_stage(displacement.values)
    share, box = shares_on(lattice, mask, whole), whole.clamp(max=level)
    largest = float(u.norm(dim=-1).max())
    u.div_(box.new_tensor(lattice.spacing))
    scheme = shape.interpolation
    moved, linear = _moved(box, u, level, scheme)
    measures: list[Callable[[], Any]] = [  # the longest one first
        partial(measure_evenness, u, box),
        partial(_scheme_error, box, u, moved, scheme),
        partial(_motionless, source, scene, box, lattice, shape, mask),
    ]
    evenness, estimate, motionless = run_on(box.device, measures)

    # restore the mass, and put the box into the field
    result, mass_error = _with_mass(moved, box, shape.mass_correction, share, linear)
    if bool((excess := whole - box).any()):
        carried = warp(excess, u, scheme="linear")
        result = result + _with_mass(carried, excess, shape.mass_correction, share)[0]
        if share is not None:  # a sum of two parts has round-off
            result = torch.where(share > 0, result, whole)
    values, low = result.cpu().numpy(), lattice.low
    changed = _changed(whole, result, share if is_part else None, density)
    if changed is not None:
        values, low = _among_the_rest(density, values, low, changed.cpu().numpy())
    report = TransportReport(
        largest_displacement=largest,
        linear_difference=None if linear is None else _difference(linear, moved),
        error=_with_correction(estimate, mass_error) if shape.mass_correction else estimate,
        mass_error=mass_error,
        folded=evenness.folded,
        unread=evenness.unread,
        read_twice=evenness.read_twice,
        motionless=motionless,
    )
    return field_from_box(density, values, low), report


def _moved(box: Tensor, u: Tensor, level: float, scheme: Scheme) -> tuple[Tensor, Tensor | None]:
    """The box moved by a displacement in voxels, and by the linear scheme if that is another one.

    Where there is smoke or something moves: round-off of the spline is not smoke, and would fill
    the box with active voxels.
    """
    active = torch.nonzero((box > 0) | (u != 0).any(dim=-1))
    where = tuple(active.T)

    def by(scheme: Scheme) -> Tensor:
        found = warp(box, u[where], active_ijk=active, scheme=scheme).clamp_min(0)
        is_smoke = (found > LEAST_SHARE * level) | (box[where] > 0)
        moved = torch.zeros_like(box)
        moved[where] = found.masked_fill_(~is_smoke, 0)
        return moved

    return by(scheme), None if scheme == "linear" else by("linear")


def move_field(
    field: DenseField, field_to_stage: np.ndarray, displacement: Displacement | None
) -> DenseField:
    """Another field, such as a temperature, moved as the density was, on its own grid.

    Values are carried, not mass. The linear scheme keeps their range and the background's voxels;
    where nothing moves the bits stay.

    Args:
        field: [I J K] or [I J K 3], whose numbers do not turn with the motion.
        field_to_stage: [4 4] its grid world to stage space.
        displacement: what the density was moved by; None moves nothing.
    """
    if displacement is None or field.is_empty or not bool(displacement.values.any()):
        return field
    to_stage = field.index_to_world @ field_to_stage
    sides = np.linalg.norm(to_stage[:3, :3], axis=1)
    reach = float(displacement.values.norm(dim=-1).max()) / sides
    shape = np.array(field.values.shape[:3])
    margin = np.where(shape > 1, np.ceil(reach).astype(int) + 1, 0)
    low, components = np.asarray(field.ijk_min) - margin, field.values.shape[3:]
    background = np.asarray(field.background, np.float32)
    values = np.broadcast_to(background, (*(shape + 2 * margin), *components)).copy()
    values[_slices(margin, field.values.shape[:3])] = field.values
    lengths = values.shape[:3]
    lattice = Lattice(low, (lengths[0], lengths[1], lengths[2]), to_stage)
    u = displacement.on(lattice)
    u /= u.new_tensor(lattice.spacing)
    excess = torch.as_tensor(values - background).to(u)
    moved = warp(excess, u).cpu().numpy() + background
    rests = (u == 0).all(dim=-1).cpu().numpy()
    moved[rests] = values[rests]
    return field_from_box(field, moved, low)


def _difference(linear: Tensor, moved: Tensor) -> float:
    """Of the linear scheme from the accurate one, relative to the mass."""
    total = float(moved.double().sum())
    return float((linear - moved).double().abs().sum()) / total if total > 0 else 0.0


def _scheme_error(box: Tensor, u: Tensor, moved: Tensor, scheme: Scheme) -> Estimate:
    started = time.perf_counter()
    error = warp_error(box, u, moved, scheme)
    return Estimate(error, time.perf_counter() - started)


def _with_correction(estimate: Estimate, mass_error: float) -> Estimate:
    """The error with that of the corrected mass, which changes values by as much."""
    changed = mass_error if math.isfinite(mass_error) else 0.0  # then nothing was corrected
    return replace(estimate, value=math.hypot(estimate.value, changed))


def moves_along(lengths: Sequence[int], kind: str) -> bool:
    """Whether potentials of a kind move anything in a box of some voxels along each axis.

    >>> moves_along([6, 1, 1], "stream")
    False
    """
    return sum(n > 1 for n in lengths) >= (2 if kind == "stream" else 1)


def _motionless(
    source: ActiveSmoke,
    scene: Scene,
    box: Tensor,
    lattice: Lattice,
    shape: ShapeConfig,
    mask: EffectMask | None,
) -> float:
    """Share of the mass under the mask that no potential can move."""
    fade, blocks = fade_of(source), movable_blocks(source, scene)
    coarse = smoke_box(blocks, fade)
    if not moves_along(coarse.shape, shape.displacement):
        return 1.0
    density = coarse.fill(blocks)
    effect = effect_on(density, coarse, fade, shares_on(coarse, mask, density))
    effect = apply_along(effect, lattice.matrices_from(coarse))
    share = shares_on(lattice, mask, box)
    mass = box.double() if share is None else box.double() * (share > 0)
    total = float(mass.sum())
    return float(mass[effect == 0].sum()) / total if total > 0 else 0.0


def _with_mass(
    moved: Tensor,
    box: Tensor,
    is_corrected: bool,
    share: Tensor | None,
    linear: Tensor | None = None,
) -> tuple[Tensor, float]:
    """The moved density, with the mass it had if that is corrected, and the error before."""
    if share is None:
        corrected, error = correct_mass(moved, box, linear)
        return corrected if is_corrected else moved, error
    # a curl reaches one voxel beyond the mask, and a factor would reach everywhere
    here, result = share > 0, box.clone()
    corrected, error = correct_mass(
        moved[here], box[here], None if linear is None else linear[here]
    )
    result[here] = corrected if is_corrected else moved[here]
    return result, error


def _changed(
    whole: Tensor, result: Tensor, share: Tensor | None, density: DenseField
) -> Tensor | None:
    """Where a box goes into the field, [I J K] bool; None: everywhere, as all around it is 0.

    Args:
        whole, result: the smoke before and after.
        share: of the part that the box holds; None: it holds all.
    """
    background = float(np.max(density.background))
    if background <= 0:
        return None if share is None else share > 0
    # fog lies around the smoke, and counts where less than it comes to
    is_smoke = (whole > 0) | (result > background)
    return is_smoke if share is None else is_smoke & (share > 0)


def _among_the_rest(
    density: DenseField, box: np.ndarray, low: np.ndarray, changed: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A field with a box put into it where that is changed, and the index of its first voxel."""
    field_low = np.asarray(density.ijk_min)
    first = np.minimum(low, field_low)
    end = np.maximum(low + box.shape, field_low + density.values.shape)
    values = np.full(tuple(end - first), density.background, np.float32)
    values[_slices(field_low - first, density.values.shape)] = density.values
    part = values[_slices(low - first, box.shape)]
    part[changed] = box[changed]
    return values, first


def _slices(low: np.ndarray, shape: tuple[int, ...]) -> tuple[slice, ...]:
    return tuple(slice(int(a), int(a) + n) for a, n in zip(low, shape, strict=True))

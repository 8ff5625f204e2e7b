r"""The smoke's velocity from two frames' densities, for shots without a velocity.

A variational estimate of the motion v for which the later frame's smoke, traced back along its own
path, agrees with the earlier frame's,

    d_after(x) = (1 + m(x)) d_before(departure(x; v)),

with a motion that varies smoothly [Horn1981] and hardly changes the smoke's volume [Corpetti2002],
robust against smoke that appears [Brox2004], and with a smooth relative change m, so that fading
or thickening is not mistaken for motion [Negahdaripour1998]. The data term is summed
over the voxels around each point of the motion's lattice [Lucas1981, Bruhn2005]. It is linearised
again after every warp, coarse to fine [Brox2004].

The unknown is a velocity, not a displacement: each warp traces back along it exactly as
``transit.Transit`` does, so that curved paths end where they should.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool3d, pad

from usdsmoke.base.errors import NonFiniteError
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.fields.resample import upsample
from usdsmoke.core.fields.sample import sample_linear, voxel_positions
from usdsmoke.core.fields.transport import backtrace, check_finite, choose_substeps
from usdsmoke.core.sequence.motion_energy import PAIRS, Prior, central_difference, solve_increment

SHORTEST = 12  # an axis is halved while this many voxels remain
LATTICE = 2  # voxels of a density's level along an axis of one voxel of its motion
REACH, REACH_SHARE = 16, 0.25  # how far around the later box the earlier smoke is looked at
# Coarse levels hold less detail to go by, and cost next to nothing.
COARSE_SMOOTHNESS, COARSE_WARPS = 2.0, 2  # times more, at each level and at all of them
LEAST_SHARE = 1e-3  # of the greatest density: thinner voxels are not used for the scale


@dataclass(frozen=True)
class MotionOptions:
    """How a motion is estimated.

    Weights are for densities whose root mean square over the smoke is 1, and voxels.
    """

    smoothness: float = 0.003  # > 0, at the finest level; larger follows eddies and noise less
    divergence: float = 1.0  # >= 0
    gain_smoothness: float = 1.0  # >= 0; of the relative change of density
    gain_size: float = 0.03  # > 0; larger explains less by smoke that fades or thickens
    outlier: float = 0.1  # > 0; a difference in density from which it counts less
    n_warps: int = 4  # >= 1, at the finest level; twice as many at the others
    n_iterations: int = 60  # >= 1, of each linear solve
    tolerance: float = 0.03  # in (0, 1), at which a linear solve ends


DEFAULT_OPTIONS = MotionOptions()


@dataclass(frozen=True)
class _Level:
    """Both densities at one resolution, and what a voxel of it measures."""

    after: Tensor  # [I J K]
    before: Tensor  # [I J K]
    spacing: tuple[float, ...]  # of its voxels, in voxels of the common size


def estimate_velocity(
    before: VolumeFrame,
    after: VolumeFrame,
    seconds: float,
    options: MotionOptions = DEFAULT_OPTIONS,
    device: torch.device | None = None,
) -> DenseField:
    """The velocity that carries ``after``'s smoke back to ``before``'s, named "vel".

    Steady during the step: traced back from ``after`` by ``seconds``, as ``transit.Transit`` does,
    it ends in ``before``. Motion of the field prims themselves is part of it. Along an axis on
    which ``after`` is one voxel thick nothing moves. Source: see the module.

    Args:
        before: the neighbouring frame; its voxels, box and place may differ.
        after: the frame that the velocity belongs to.
        seconds: from before to after, not 0; negative when ``before`` is the later frame.
        options: see ``MotionOptions``.
        device: where to compute; None means the processor.

    Returns:
        [i j k 3] float32 in ``after``'s density grid world, its units per second, on voxels twice
        as wide as the density's and around its box; place it with ``after.density_to_stage``. No
        voxels at all when ``after`` is empty, zero when only ``before`` is.

    Raises:
        NonFiniteError: seconds is 0 or not finite, or a density holds NaN or infinity.
        PlanError: the estimate ran away, see ``choose_substeps``.
    """
    if not (math.isfinite(seconds) and seconds != 0):
        raise NonFiniteError(
            f"cannot estimate a velocity over {seconds} seconds. Give two frames at different "
            "timeCodes."
        )
    place = after.density.index_to_world
    if after.density.is_empty:
        return DenseField("vel", np.zeros((0, 0, 0, 3), np.float32), (0, 0, 0), place)
    low, shape = _common_box(before, after)
    halvings = [_count_halvings(n) for n in shape]
    factors = [LATTICE if n >= 2 * LATTICE else 1 for n in shape]
    blocks = [2**n * factor for n, factor in zip(halvings, factors, strict=True)]
    padded = [-(-n // block) * block for n, block in zip(shape, blocks, strict=True)]
    lattice = np.diag([*map(float, factors), 1.0])
    lattice[3, :3] = low + (np.array(factors) - 1) / 2  # a coarse voxel's middle, in fine ones
    sizes = _axis_sizes(after)
    densities = _place_densities(before, after, low, shape, padded, device)
    if densities is None:
        lengths = [n // factor for n, factor in zip(padded, factors, strict=True)]
        values = np.zeros((*lengths, 3), np.float32)
    else:
        motion = _coarse_to_fine(_make_levels(*densities, halvings, sizes), factors, options)
        voxels = motion[:3].movedim(0, -1).double().cpu().numpy() / sizes
        values = (voxels @ place[:3, :3] / seconds).astype(np.float32)
    return DenseField("vel", values, (0, 0, 0), lattice @ place, background=(0.0, 0.0, 0.0))


def _common_box(before: VolumeFrame, after: VolumeFrame) -> tuple[np.ndarray, list[int]]:
    """First voxel and lengths, in ``after``'s index space, of a box around both frames' smoke.

    Smoke far from ``after``'s box is left out, so that the box stays in proportion to it.
    """
    lengths = np.array(after.density.values.shape)
    first = np.array(after.density.ijk_min)
    last = first + lengths - 1
    if before.density.is_empty:
        return first, [int(n) for n in lengths]
    ends = np.array(before.density.ijk_min)[:, None] + [
        [0, n - 1] for n in before.density.values.shape
    ]
    corners = np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(-1, 3)
    there = _between(before, after)
    seen = corners @ there[:3, :3] + there[3, :3]
    reach = np.maximum(REACH, np.ceil(REACH_SHARE * lengths)).astype(int)
    reach[lengths == 1] = 0
    # round-off of the transforms must not add a layer of voxels
    low = np.clip(np.floor(seen.min(axis=0) + 1e-6), first - reach, first).astype(int)
    high = np.clip(np.ceil(seen.max(axis=0) - 1e-6), last, last + reach).astype(int)
    return low, [int(n) for n in high - low + 1]


def _between(source: VolumeFrame, target: VolumeFrame) -> np.ndarray:
    """From one frame's density index space to the other's, [4 4]."""
    there, back = (
        frame.density.index_to_world @ np.asarray(frame.density_to_stage, float)
        for frame in (source, target)
    )
    return np.asarray(there @ np.linalg.inv(back))


def _axis_sizes(frame: VolumeFrame) -> np.ndarray:
    """The voxel's edges in units of their geometric mean, [3]."""
    matrix = frame.density.index_to_world @ np.asarray(frame.density_to_stage, float)
    edges = np.linalg.norm(matrix[:3, :3], axis=1)
    return np.asarray(edges / np.exp(np.log(edges).mean()))


def _place_densities(
    before: VolumeFrame,
    after: VolumeFrame,
    low: np.ndarray,
    shape: Sequence[int],
    padded: Sequence[int],
    device: torch.device | None,
) -> tuple[Tensor, Tensor] | None:
    """Densities after and before, [I J K] on the padded box in one scale; None without smoke."""
    for frame in (before, after):
        check_finite(torch.from_numpy(frame.density.values), "density")
    peak = float(after.density.values.max())
    if before.density.is_empty or peak <= 0 or not before.density.values.any():
        return None
    values = after.density.values
    thick = values[values > LEAST_SHARE * peak].astype(np.float64)
    scale = peak * math.sqrt(np.mean((thick / peak) ** 2))
    smoke_after, smoke_before = (
        torch.from_numpy((frame.density.values / scale).astype(np.float32)).to(device)
        for frame in (after, before)
    )
    start = np.array(after.density.ijk_min) - low
    ends = np.array(padded) - start - np.array(smoke_after.shape)
    margins = [int(n) for pair in zip(start[::-1], ends[::-1], strict=True) for n in pair]
    placed = pad(smoke_after, margins)
    back = torch.from_numpy(_between(after, before)).to(placed.device)
    like = placed.new_zeros((), dtype=torch.float64)
    where = voxel_positions(tuple(shape), like) + torch.as_tensor(low).to(like)
    where = where @ back[:3, :3] + back[3, :3] - torch.tensor(before.density.ijk_min).to(like)
    sampled = sample_linear(smoke_before, where.float()).reshape(tuple(shape))
    margins = [n for a in (2, 1, 0) for n in (0, padded[a] - shape[a])]
    return placed, pad(sampled, margins)


def _count_halvings(length: int) -> int:
    return max(0, int(math.log2(length / SHORTEST))) if length >= SHORTEST else 0


def _make_levels(
    after: Tensor, before: Tensor, halvings: Sequence[int], sizes: np.ndarray
) -> list[_Level]:
    """The pyramid, coarse to fine; short axes stop being halved earlier."""
    levels = [_Level(after, before, tuple(map(float, sizes)))]
    for number in range(max(halvings)):
        factors = [2 if number < n else 1 for n in halvings]
        finer = levels[0]
        spacing = tuple(s * f for s, f in zip(finer.spacing, factors, strict=True))
        coarse_after, coarse_before = (
            _pool(field[None], factors)[0] for field in (finer.after, finer.before)
        )
        levels.insert(0, _Level(coarse_after, coarse_before, spacing))
    return levels


def _pool(values: Tensor, factors: Sequence[int]) -> Tensor:
    """Means over blocks of voxels, [C I J K] to [C i j k]."""
    return avg_pool3d(values[:, None], tuple(factors))[:, 0]


def _coarse_to_fine(
    levels: Sequence[_Level], factors: Sequence[int], options: MotionOptions
) -> Tensor:
    """Motion and gain [4 i j k] on the finest level's lattice, in voxels of the common size."""
    motion: Tensor | None = None
    for number, level in enumerate(levels, 1 - len(levels)):
        finest = number == 0
        prior = Prior(
            options.smoothness * COARSE_SMOOTHNESS**-number,
            options.divergence,
            options.gain_smoothness,
            options.gain_size,
        )
        shape = [n // f for n, f in zip(level.after.shape, factors, strict=True)]
        motion = level.after.new_zeros((4, *shape)) if motion is None else _refine(motion, shape)
        spacing = [s * f for s, f in zip(level.spacing, factors, strict=True)]
        for _ in range(options.n_warps if finest else COARSE_WARPS * options.n_warps):
            tensor, slope = _linearise(level, motion, factors, options.outlier)
            motion = motion + solve_increment(
                tensor, slope, motion, prior, spacing, options.n_iterations, options.tolerance
            )
    assert motion is not None  # there is always the finest level
    return motion


def _refine(fields: Tensor, shape: Sequence[int]) -> Tensor:
    """[C i j k] on a finer lattice of the same box."""
    finer = upsample(fields.movedim(0, -1).contiguous(), shape, "linear")
    return finer.movedim(-1, 0).contiguous()


def _linearise(
    level: _Level, motion: Tensor, factors: Sequence[int], outlier: float
) -> tuple[Tensor, Tensor]:
    """Sums of psi J J^T [10 i j k] and psi J e [4 i j k] around the lattice points."""
    warped, gain = _warp_back(level, motion, factors)
    moved = (1 + gain) * warped
    error = level.after - moved
    middle = 0.5 * (level.after + moved)  # both frames' slopes: second order in what is left
    rates = [central_difference(middle, a) / level.spacing[a] for a in range(3)] + [-warped]
    # Charbonnier's penalty as a weight, from the error of the last warp
    weight = torch.rsqrt(1 + (error / outlier) ** 2)
    weighted = [weight * rate for rate in rates]
    tensor = [_pool((weighted[a] * rates[b])[None], factors)[0] for a, b in PAIRS]
    slope = [_pool((item * error)[None], factors)[0] for item in weighted]
    return torch.stack(tensor), torch.stack(slope)


def _warp_back(level: _Level, motion: Tensor, factors: Sequence[int]) -> tuple[Tensor, Tensor]:
    """The earlier density where the motion finds it, and the gain, [I J K] each.

    Paths are followed on the motion's lattice and interpolated to the voxels.
    """
    shape, fine = motion.shape[1:], level.after.shape
    blocks = motion.new_tensor(list(factors))
    velocity = motion[:3].movedim(0, -1) / (motion.new_tensor(level.spacing) * blocks)
    velocity = velocity.contiguous()
    points = voxel_positions(tuple(shape), motion)
    ends = backtrace(velocity, points, 1.0, n_substeps=choose_substeps(velocity, 1.0))
    shift = ((points - ends) * blocks).reshape(*shape, 3)
    where = voxel_positions(tuple(fine), motion) - upsample(shift, fine, "linear").reshape(-1, 3)
    gain = upsample(motion[3].contiguous(), fine, "linear")
    return sample_linear(level.before, where).reshape(fine), gain

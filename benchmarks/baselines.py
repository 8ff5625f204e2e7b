r"""A stylization of the reference's shape, to compare with: the volume part done the dense way.

This is a **labelled baseline**, written here from the description of the reference method
[Kim2019, Christen2020]; none of it is anybody else's code, and usdsmoke uses none of it. It does

- work on the whole dense box instead of the active voxels;
- turn the whole box for every view, trilinearly, and sum along an axis;
- attenuate by a first-order sum that includes the own slice, exp(-sum_{j<=i} t_j);
- move the whole box once for every view (shape step);
- leave all gradients to automatic differentiation through all of that;
- take nine views in every iteration, octaves a factor of 1.8 apart in the shape step, and full
  resolution alone in the colour step; the shape's update is the reference's: a smoothed gradient,
  each band of a Laplacian pyramid divided by its root mean square.

It is given what it has no share in: usdsmoke's features, losses, guide, exposure and straight
picture, its cap and border of displacements, and in the colour step optimiser and learning rate.
Where the reference is dearer or worse than it need be, the baseline is kinder: semi-Lagrangian
look-ups in place of a MacCormack scheme that falls back to them, rigid views, the smoke's own box
instead of the whole domain, and only the unknown's gradient is taken.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.base.volume import DenseField
from usdsmoke.config.settings import Config
from usdsmoke.core.fields.displacement import clamp_displacement, from_potential
from usdsmoke.core.fields.potential import border_mask
from usdsmoke.core.smoke.srgb import decode_srgb, encode_srgb
from usdsmoke.core.steps.move import FADE
from usdsmoke.core.steps.optimize import Descent, minimize
from usdsmoke.core.style.losses import PictureLoss
from usdsmoke.core.views.cameras import draw_views, orbit_view, sample_angles
from usdsmoke.core.views.scene import Scene

__all__ = [
    "DenseBox",
    "advect_box",
    "baseline_colour",
    "baseline_shape",
    "dense_box",
    "inclusive_weights",
    "rotate_box",
    "with_values",
]

N_VIEWS = 9
OCTAVE_SCALE = 1.8
ROOM = 2  # empty voxels around the smoke
THIN = 0.05  # as in the steps of usdsmoke
STEP = 0.002  # of the box's half length: the reference's learning rate
SMOOTHING = 1.2  # voxels
N_SPLITS = 3


@dataclass(frozen=True)
class DenseBox:
    """A dense box of smoke [D H W] = (k, j, i), cubic voxels along the stage's axes, Y up."""

    density: Tensor
    voxel: float  # stage units
    low: tuple[int, int, int]  # index of the first voxel, i j k


def dense_box(field: DenseField) -> DenseBox:
    """The box of a field's smoke with a little room.

    Args:
        field: with cubic voxels along the axes of the stage.

    Raises:
        ValueError: another transform, or no smoke.
    """
    matrix = field.index_to_world[:3, :3]
    voxel = float(matrix[0, 0])
    filled = np.argwhere(field.values > 0)
    if not np.allclose(matrix, voxel * np.eye(3)) or not len(filled):
        raise ValueError(
            f"the baseline takes smoke in cubic voxels along the axes; found {matrix.tolist()} and "
            f"{len(filled)} voxels of smoke; take another volume"
        )
    low, high = filled.min(0), filled.max(0) + 1
    values = field.values[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    values = np.pad(np.maximum(values, 0), ROOM).transpose(2, 1, 0)
    first = np.asarray(field.ijk_min) + low - ROOM
    return DenseBox(
        torch.from_numpy(np.ascontiguousarray(values, np.float32)), voxel,
        tuple(int(n) for n in first),  # type: ignore[arg-type]
    )  # fmt: skip


def rotate_box(values: Tensor, azimuth: float, elevation: float) -> Tensor:
    """A box [C D H W] turned so that the view looks along axis 1, front first; same size.

    Trilinear, zero outside; rows go down, columns right. Every voxel is read, whatever it holds.

    Gradients: through ``values``.
    """
    view = orbit_view(azimuth, elevation, "Y", np.zeros(3), 1, 1, 1.0)
    lengths = np.array(values.shape[:0:-1], float)  # W H D, as the axes x y z
    # output axes (x right, y down, z forward) in the box's, both scaled to [-1, 1]
    turn = np.stack([view.right, -view.up, view.forward], axis=1)
    theta = turn * lengths[None, :] / lengths[:, None]
    matrix = torch.tensor(np.concatenate([theta, np.zeros((3, 1))], axis=1)[None]).to(values)
    size = [1, *values.shape]
    grid = F.affine_grid(matrix, size, align_corners=False)
    return F.grid_sample(values[None], grid, align_corners=False)[0]


def inclusive_weights(depth: Tensor) -> Tensor:
    """t_i * exp(-sum_{j<=i} t_j) along axis 0, front to back: first order, own slice included.

    Args:
        depth: optical depth of every voxel, [D H W].
    """
    return depth * torch.exp(-torch.cumsum(depth, dim=0))


def advect_box(density: Tensor, displacement: Tensor) -> Tensor:
    """d(x - u(x)) of a whole box [D H W]; u is [3 D H W] in voxels, components along W, H, D.

    Semi-Lagrangian, trilinear, zero outside.

    Gradients: through ``displacement``.
    """
    identity = torch.eye(3, 4).to(density)[None]
    grid = F.affine_grid(identity, [1, 1, *density.shape], align_corners=False)
    half = torch.tensor(density.shape[::-1]).to(density) / 2
    grid = grid - (displacement.permute(1, 2, 3, 0) / half)[None]
    return F.grid_sample(density[None, None], grid, align_corners=False)[0, 0].clamp_min(0)


def baseline_shape(
    box: DenseBox, judge_at: Callable[[float], PictureLoss], scene: Scene, config: Config,
    octaves: Sequence[int],
) -> Iterator[Callable[[], Tensor]]:  # fmt: skip
    """The shape step; after every iteration yields what moves the density [D H W] when called.

    Args:
        box: unmoved.
        judge_at: the grey style loss for pictures smaller by a factor.
        scene: extinction, exposure and grey level; its pixels are as large as the box's voxels.
        config: angles and seed.
        octaves: iterations of each, coarse to fine.
    """
    whole, potential = _Pliable.of(box.density, config), torch.zeros(1, *box.density.shape)
    for number, n_iterations in enumerate(octaves):
        factor = OCTAVE_SCALE ** (len(octaves) - 1 - number)
        density = _resized(box.density[None], [round(n / factor) for n in box.density.shape])[0]
        smoke, judge = _Pliable.of(density, config), judge_at(factor)
        unknown = _resized(potential, density.shape) / factor**2
        pool = sample_angles(config.views, config.views.pool, config.optimize.seed + number)
        still = [_grey_level(density, angle, box.voxel * factor, scene) for angle in pool]
        for iteration in range(n_iterations):
            ascent = torch.zeros_like(unknown)
            for drawn in draw_views(iteration, N_VIEWS, len(pool), number):
                leaf = unknown.clone().requires_grad_(True)
                moved = _grey_level(smoke.moved(leaf), pool[drawn], box.voxel * factor, scene)
                guide = still[drawn] / (still[drawn] + THIN)
                picture = (moved + (1 - guide) * scene.grey_mean)[..., None].expand(-1, -1, 3)
                loss = judge(picture, guide, None, iteration)
                left = ((moved - still[drawn]).abs() * (1 - still[drawn]).clamp_min(0)).mean()
                ascent -= torch.autograd.grad(loss + config.losses.keep * left, leaf)[0]
            rate = STEP * density.shape[1] / 2  # of a potential whose slopes are voxels
            unknown = unknown + rate * _normalised(_blurred(ascent)) * smoke.mask
            yield partial(whole.moved_by, unknown, factor)
        potential = _resized(unknown, box.density.shape) * factor**2


@dataclass(frozen=True)
class _Pliable:
    """A dense density [D H W] and how far it may be moved: as far as usdsmoke's."""

    density: Tensor
    effect: Tensor  # [D H W], 0 at the smoke's border
    mask: Tensor  # [1 D H W], of the update, as the reference has it
    cap: float  # voxels

    @classmethod
    def of(cls, density: Tensor, config: Config) -> "_Pliable":
        sides = np.ptp(torch.nonzero(density > 0).numpy(), axis=0) + 1
        usual = density[density > 0].quantile(0.9)
        mask = (_blurred(density[None]) / usual).clamp(0, 1)
        longest = float(sides.max())
        return cls(
            density, border_mask(density, FADE * longest), mask, config.shape.reach * longest
        )

    def moved(self, potential: Tensor) -> Tensor:
        """The density moved by the gradient of a potential [1 D H W], voxel^2."""
        slopes = from_potential(potential[0] * self.effect, (1.0, 1.0, 1.0))
        u = clamp_displacement(slopes, self.cap).flip(-1)
        return advect_box(self.density, u.permute(3, 0, 1, 2))

    def moved_by(self, potential: Tensor, factor: float) -> Tensor:
        """The same by a potential on a box whose voxels are larger by a factor."""
        return self.moved(_resized(potential, self.density.shape) * factor**2)


def baseline_colour(
    box: DenseBox, judge: PictureLoss, background: Tensor, scene: Scene, config: Config,
    n_iterations: int,
) -> Iterator[Tensor]:  # fmt: skip
    """The colour step; yields display-encoded colours [3 D H W] after every iteration.

    Args:
        box: fixed density.
        judge: the style loss of full-size pictures.
        background: linear [3].
        scene: extinction and exposure; its pixels are as large as the box's voxels.
        config: angles, rate and seed.
        n_iterations: each of nine views.
    """
    generator = torch.Generator().manual_seed(config.optimize.seed)
    unknown = torch.rand(3, *box.density.shape, generator=generator).requires_grad_(True)

    def objective(iteration: int) -> Tensor:
        total = torch.zeros_like(unknown)
        value = 0.0
        for angle in sample_angles(config.views, N_VIEWS, iteration):
            picture, guide = _coloured(box, unknown, angle, background, scene)
            loss = judge(picture, guide, None, iteration) / N_VIEWS
            total += torch.autograd.grad(loss, unknown)[0]
            value += float(loss.detach())
        # the gradient is known: a linear function that has it, and the value
        surrogate = (unknown * total).sum()
        return surrogate - surrogate.detach() + value

    def clip() -> None:
        unknown.clamp_(0, 1)

    for _ in minimize(
        objective, [unknown], Descent(config.colour.learning_rate, n_iterations), clip
    ):
        yield unknown.detach()


def _grey_level(density: Tensor, angle: np.ndarray, voxel: float, scene: Scene) -> Tensor:
    """Grey picture [H W] of a box, exposed; front to back by the first-order sum."""
    turned = rotate_box(density[None], float(angle[0]), float(angle[1]))[0]
    weights = inclusive_weights(scene.gamma_w_shape * voxel * turned)
    return weights.sum(0) * scene.exposure_shape


def _coloured(
    box: DenseBox, colours: Tensor, angle: np.ndarray, background: Tensor, scene: Scene
) -> tuple[Tensor, Tensor]:
    """What the network sees of coloured smoke [H W 3], and its guide [H W]."""
    both = torch.cat([box.density[None], box.density * decode_srgb(colours)])
    turned = rotate_box(both, float(angle[0]), float(angle[1]))
    depth = scene.gamma_w * box.voxel * turned[0]
    reached = torch.exp(-torch.cumsum(depth, dim=0)) * (scene.gamma_w * box.voxel)
    light = (turned[1:] * reached).sum(1).permute(1, 2, 0)
    alpha = (turned[0] * reached).sum(0)[..., None]
    thin = THIN / scene.exposure
    picture = encode_srgb((light + thin * background) / (alpha + thin))
    return picture, (alpha / (alpha + thin))[..., 0].detach()


def _resized(values: Tensor, shape: Sequence[int]) -> Tensor:
    return F.interpolate(
        values[None], size=list(shape), mode="trilinear", align_corners=False
    )[0]  # fmt: skip


def _blurred(values: Tensor) -> Tensor:
    """A Gaussian over the three axes of [C D H W]."""
    reach = torch.arange(-4.0, 5.0)
    kernel = torch.exp(-0.5 * (reach / SMOOTHING) ** 2)
    kernel = (kernel / kernel.sum()).to(values)
    for axis in range(3):
        shape = [1, 1, 1, 1, 1]
        shape[2 + axis] = len(kernel)
        padding = [4 if n == axis else 0 for n in range(3)]
        weight = kernel.view(shape)
        values = F.conv3d(values[:, None], weight, padding=padding)[:, 0]
    return values


def _normalised(values: Tensor) -> Tensor:
    """The bands of a Laplacian pyramid of [C D H W], each divided by its root mean square."""
    bands, rest = [], values
    for _ in range(N_SPLITS):
        if min(rest.shape[1:]) < 4:
            break
        low = F.avg_pool3d(rest[None], 2, ceil_mode=True)[0]
        bands.append(rest - _resized(low, rest.shape[1:]))
        rest = low
    found = rest / rest.square().mean().sqrt().clamp_min(1e-10)
    for band in reversed(bands):
        scaled = band / band.square().mean().sqrt().clamp_min(1e-10)
        found = _resized(found, band.shape[1:]) + scaled
    return found


def with_values(field: DenseField, box: DenseBox, values: Tensor) -> DenseField:
    """The field with a box's values in the place of its own; [D H W] or [C D H W]."""
    order = (2, 1, 0) if values.ndim == 3 else (3, 2, 1, 0)
    array = np.ascontiguousarray(values.permute(*order).numpy(), np.float32)
    return replace(field, values=array, ijk_min=box.low)

"""Smoke for the core's tests: closed forms on small grids, in any place and at any resolution."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch

from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.fields.displacement import clamp_displacement, slope_matrix
from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.fields.potential import unclamped_displacement
from usdsmoke.core.smoke.active import ActiveSmoke, activate

__all__ = [
    "affine",
    "divergence",
    "frame_of",
    "gaussian_column",
    "gaussian_smoke",
    "held_in_voxels",
    "masked",
    "puff",
    "random_style",
    "smoke_of",
]


def affine(seed: int, mirrored: bool = False) -> np.ndarray:
    """A rotation, sheared, with voxels of three different sizes, moved: [4 4], row vectors."""
    generator = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn)) * (-1 if mirrored else 1)
    shear = np.eye(3) + np.triu(generator.uniform(-0.2, 0.2, (3, 3)), 1)
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag([0.8, 1.0, 1.3]) @ shear @ turn
    matrix[3, :3] = generator.uniform(-5, 5, 3)
    return matrix


def divergence(field: torch.Tensor, spacing: Sequence[float]) -> torch.Tensor:
    """Divergence [I J K] of a vector field [I J K 3], by the differences of ``displacement``."""
    slopes = [slope_matrix(n, h).to(field) for n, h in zip(field.shape, spacing, strict=False)]
    parts = [torch.tensordot(m, field[..., a], ([1], [a])) for a, m in enumerate(slopes)]
    return sum(part.movedim(0, a) for a, part in enumerate(parts))  # type: ignore[return-value]


def puff(n: int = 12, seed: int = 0, cut: float = 0.05) -> np.ndarray:
    """A ball of smoke with lumps, [n n n] float32, empty outside."""
    generator = np.random.default_rng(seed)
    centres = np.stack(np.meshgrid(*[(np.arange(n) + 0.5) / n - 0.5] * 3, indexing="ij"), axis=-1)
    density = np.exp(-((centres / 0.25) ** 2).sum(-1)) * generator.uniform(0.6, 1.0, (n, n, n))
    return np.where(density > cut, density, 0.0).astype(np.float32)


def frame_of(
    density: np.ndarray,
    time_code: float = 1.0,
    velocity: np.ndarray | None = None,
    ijk_min: tuple[int, int, int] = (0, 0, 0),
    index_to_world: np.ndarray | None = None,
) -> VolumeFrame:
    """A frame in stage space; the velocity [3] is the same everywhere, units per second."""
    matrix = np.eye(4) if index_to_world is None else index_to_world
    field = DenseField("density", np.asarray(density, np.float32), ijk_min, matrix)
    if velocity is None:
        return VolumeFrame(time_code, field, np.eye(4))
    values = np.broadcast_to(np.float32(velocity), (*density.shape, 3)).copy()
    moving = DenseField("velocity", values, ijk_min, matrix)
    return VolumeFrame(time_code, field, np.eye(4), moving, np.eye(4))


def masked(
    values: np.ndarray,
    frame: VolumeFrame | None = None,
    index_to_world: np.ndarray | None = None,
    ijk_min: tuple[int, int, int] = (0, 0, 0),
    background: float = 0.0,
    to_stage: np.ndarray | None = None,
) -> VolumeFrame:
    """A frame, a puff of 12 voxels if none is given, with a mask: on its voxels unless placed."""
    matrix = np.eye(4) if index_to_world is None else index_to_world
    field = DenseField("fade", np.asarray(values, np.float32), ijk_min, matrix, background)
    place = np.eye(4) if to_stage is None else to_stage
    plain = frame_of(puff(12)) if frame is None else frame
    return dataclasses.replace(plain, mask=field, mask_to_stage=place)


def smoke_of(density: np.ndarray, index_to_stage: np.ndarray | None = None) -> ActiveSmoke:
    """The active voxels of an array whose first voxel has index (0, 0, 0)."""
    matrix = np.eye(4) if index_to_stage is None else index_to_stage
    field = DenseField("density", np.asarray(density, np.float32), (0, 0, 0), matrix)
    return activate(field, np.eye(4), torch.device("cpu"))


def gaussian_smoke(n: int, width: float = 0.15) -> ActiveSmoke:
    """exp(-|x|^2 / (2 width^2)) on [-1/2, 1/2]^3 with n voxels a side."""
    centres = np.stack(np.meshgrid(*[(np.arange(n) + 0.5) / n - 0.5] * 3, indexing="ij"), axis=-1)
    matrix = np.diag([1 / n, 1 / n, 1 / n, 1.0])
    matrix[3, :3] = 0.5 / n - 0.5
    return smoke_of(np.exp(-(centres**2).sum(-1) / (2 * width**2)), matrix)


def gaussian_column(x: np.ndarray, y: np.ndarray, width: float = 0.15) -> np.ndarray:
    """Column integral of that density along any axis, at distances x, y from the middle."""
    return np.exp(-(x**2 + y**2) / (2 * width**2)) * width * np.sqrt(2 * np.pi)


def random_style(height: int = 24, width: int = 32, seed: int = 0) -> np.ndarray:
    """Coloured stripes and specks, [H W 3] float32 in [0, 1]."""
    generator = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    stripes = 0.5 + 0.4 * np.sin(0.9 * x + 0.4 * y)
    picture = np.stack([stripes, 0.3 + 0.0 * x, 1 - stripes], axis=-1)
    return np.clip(picture + generator.normal(0, 0.05, picture.shape), 0, 1).astype(np.float32)


def held_in_voxels(
    potential: torch.Tensor,
    mask: torch.Tensor,
    kind: str,
    cap: float,
    lattice: Lattice,
    base: torch.Tensor | None = None,
    share: torch.Tensor | None = None,
) -> torch.Tensor:
    """A potential's displacement on a box, held below the cap, [I J K 3] index units."""
    held = clamp_displacement(
        unclamped_displacement(potential, mask, kind, lattice, base), cap, share
    )
    return held / held.new_tensor(lattice.spacing)

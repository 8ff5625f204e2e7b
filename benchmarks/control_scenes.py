"""The smoke and the styles of the control pictures, by the examples' own code.

A 3-D frame of the example plume, and a 2-D one: a slice out of the middle of a finer simulation,
summed into a slab one voxel thick. The slab's density is scaled so that its thick columns weigh as
much as the volume's, in density times voxels: one gamma then means the same opacity in both.
"""

import importlib
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np

from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.pictures import read_style_image

__all__ = [
    "EXAMPLES",
    "fading_mask",
    "frame_of",
    "load_example",
    "paint_styles",
    "simulate_smoke",
    "style_pixels",
]

EXAMPLES = Path(__file__).parents[1] / "examples"
FRAMES_PER_SECOND = 24
HEIGHT = 2.0  # of the box, stage units
STEPS = {"3-D": 48, "2-D": 54}  # until the plume fills most of the box, but leans on no wall
SLICE = 0.1  # thickness of the slab's slice, as a share of the box's width
THINNEST = 2e-3  # share of the greatest density below which a voxel counts as empty
PERCENTILE = 90.0  # which columns count as the thick ones


def load_example(folder: str, name: str) -> ModuleType:
    """A module of ``examples/FOLDER``, which is no package."""
    path = str(EXAMPLES / folder)
    sys.path.insert(0, path)
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(path)


def paint_styles(names: list[str], size: int = 512, seed: int = 7) -> dict[str, np.ndarray]:
    """The example styles by name, display-encoded [size size 3] in [0, 1]."""
    paintings = load_example("styles", "paint").PAINTINGS
    return {
        name: np.asarray(paintings[name](size, seed).convert("RGB"), np.float32) / 255.0
        for name in names
    }


def style_pixels(name: str, size: int = 512) -> np.ndarray:
    """A style by the name of an example, painted at that size, or of an image file; [H W 3]."""
    return read_style_image(Path(name)).pixels if "." in name else paint_styles([name], size)[name]


def simulate_smoke(
    resolution: int, slab_resolution: int, n_steps: dict[str, int] = STEPS
) -> dict[str, np.ndarray]:
    """Densities [i j k] of the frames ``"3-D"`` and ``"2-D"``, the latter with one voxel along k.

    Args:
        resolution, slab_resolution: voxels along the box's width; the height has 5/3 as many.
        n_steps: simulation steps of each.
    """
    volume = _run_solver(resolution, n_steps["3-D"])
    whole = _run_solver(slab_resolution, n_steps["2-D"])
    n_planes = max(1, round(SLICE * slab_resolution))
    first = (slab_resolution - n_planes) // 2
    slab = whole[:, :, first : first + n_planes].sum(axis=2, keepdims=True)
    slab *= _thick_column(volume) / _thick_column(slab)
    return {"2-D": slab, "3-D": volume}


def frame_of(density: np.ndarray) -> VolumeFrame:
    """A frame of the density [i j k], Y up, in a box two stage units high."""
    smoke = np.where(density > THINNEST * density.max(), density, 0.0).astype(np.float32)
    voxel_size = HEIGHT / density.shape[1]
    index_to_world = np.diag([voxel_size, voxel_size, voxel_size, 1.0])
    return VolumeFrame(1.0, DenseField("density", smoke, (0, 0, 0), index_to_world), np.eye(4))


def fading_mask(frame: VolumeFrame, fade: float = 0.3) -> VolumeFrame:
    """The frame with a mask that is 1 at the left and falls to 0 across the smoke's middle.

    Args:
        fade: width of the fall, as a share of the smoke's own width; 5 voxels at least.
    """
    density = frame.density
    n_i = density.values.shape[0]
    filled = np.flatnonzero(density.values.any(axis=(1, 2)))
    middle = 0.5 * (filled[0] + filled[-1])
    width = max(5.0, fade * len(filled))
    ramp = np.clip(0.5 - (np.arange(n_i) - middle) / width, 0.0, 1.0)
    values = np.broadcast_to(ramp[:, None, None], density.values.shape).astype(np.float32)
    mask = DenseField("mask", np.ascontiguousarray(values), density.ijk_min, density.index_to_world)
    return replace(frame, mask=mask, mask_to_stage=frame.density_to_stage)


def _run_solver(resolution: int, n_steps: int) -> np.ndarray:
    solver_module = load_example("plume", "solver")
    solver = solver_module.SmokeSolver(resolution, solver_module.PlumeSettings())
    for _ in range(n_steps):
        solver.step(1.0 / FRAMES_PER_SECOND)
    return np.asarray(solver.density)


def _thick_column(density: np.ndarray) -> float:
    columns = density.sum(axis=2)
    return float(np.percentile(columns[columns > 0.01 * columns.max()], PERCENTILE))

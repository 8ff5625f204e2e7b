"""Six scenes of ``benchmarks.told_true``, with the same smoke at a finer resolution where known."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.control_scenes import frame_of, simulate_smoke
from benchmarks.stages import PLUME_FILE
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb.read import GridRequest, read_grids

__all__ = ["Scene", "make_scenes"]

N = 40  # voxels along the side of the analytic scenes
SLAB = 8  # of the plume's second, unused shape

Truth = Callable[[np.ndarray], np.ndarray]  # places [... 3] in voxels of the scene -> density


@dataclass(frozen=True)
class Scene:
    """A frame, and the smoke that its voxels sample.

    Attributes:
        frame: what is stylized.
        truth: the density at any place, averaged over a voxel or nearly so; None if not known.
        fine: the same on a grid ``factor`` times finer whose block means are the frame.
    """

    frame: VolumeFrame
    truth: Truth | None = None
    fine: np.ndarray | None = None
    factor: int = 1

    @property
    def known_by(self) -> str:
        """Where the moved smoke is known from."""
        if self.truth is not None:
            return "analytic"
        return "no finer smoke is known" if self.fine is None else "finer voxels"


def make_scenes(data: Path) -> dict[str, Scene]:
    """The scenes by name; those of the real plume only if its file is in ``data``."""
    fine = simulate_smoke(64, SLAB, {"3-D": 48, "2-D": 1})["3-D"]
    scenes = {
        "plume 32": _refined(fine, 2),
        "plume 64": Scene(frame_of(fine)),
        "blob": _analytic(_blob),
        "filaments": _analytic(_filaments),
    }
    if (data / PLUME_FILE).is_file():
        (density,) = read_grids(data / PLUME_FILE, [GridRequest("density")], GridsConfig())
        real = np.maximum(density.values, 0.0)
        scenes["real plume 1/4"] = _refined(real, 4)
        scenes["real plume 1/2"] = _refined(real, 2)
    return scenes


def _refined(fine: np.ndarray, factor: int) -> Scene:
    fine = np.pad(fine, [(0, -size % factor) for size in fine.shape])
    sizes = [size // factor for size in fine.shape]
    coarse = fine.reshape([n for size in sizes for n in (size, factor)]).mean(axis=(1, 3, 5))
    frame = frame_of(coarse.astype(np.float32))
    fine = np.where(np.repeat(_filled(frame, factor), factor, 2), fine, 0.0)
    return Scene(frame, None, fine.astype(np.float32), factor)


def _filled(frame: VolumeFrame, factor: int) -> np.ndarray:
    some = frame.density.values > 0
    return np.repeat(np.repeat(some, factor, 0), factor, 1)


def _analytic(function: Truth) -> Scene:
    places = np.stack(np.meshgrid(*[np.arange(N)] * 3, indexing="ij"), axis=-1)
    values = function(places.astype(float))
    matrix = np.diag([1 / N, 1 / N, 1 / N, 1.0])
    field = DenseField("density", values.astype(np.float32), (0, 0, 0), matrix)
    return Scene(VolumeFrame(1.0, field, np.eye(4)), function)


def _blob(places: np.ndarray) -> np.ndarray:
    """A Gaussian that ends where it has fallen to a thousandth."""
    square = ((places - (N - 1) / 2) ** 2).sum(-1)
    values = np.exp(-square / (2 * (N / 8) ** 2))
    return np.where(values > 1e-3, values, 0.0)


def _filaments(places: np.ndarray) -> np.ndarray:
    """Twelve helices of Gaussian section, which fade out before the grid ends.

    They are three voxels across, and less than one where they are steepest.
    """
    across, height = places[..., [0, 2]] - (N - 1) / 2, places[..., 1]
    values = np.zeros(places.shape[:-1])
    for n in range(12):
        angle = 2 * np.pi * (n / 12 + height / N * (0.5 + 0.1 * n))
        radius = N * (0.12 + 0.025 * n)
        centre = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        values += np.exp(-((across - centre) ** 2).sum(-1) / (2 * 1.2**2))
    inside = np.clip(np.minimum(height - 1.5, N - 2.5 - height) / 6, 0, 1)
    values *= np.sin(np.pi / 2 * inside) ** 2
    return np.where(values > 1e-2, values, 0.0)

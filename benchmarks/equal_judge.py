"""The judge of ``benchmarks.equal_loss``, and the smoke that it judges."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor

from benchmarks.control_scenes import frame_of, paint_styles, simulate_smoke
from benchmarks.display import composite, mean_colour
from benchmarks.held_out import Result, cover_box, draw_march, fit_view, held_out_angles
from benchmarks.measures import score_views
from benchmarks.stages import PLUME_FILE
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.schedule import view_ranges
from usdsmoke.core.smoke.srgb import encode_srgb
from usdsmoke.core.steps.targets import make_targets
from usdsmoke.core.style.style_image import scale_style
from usdsmoke.core.views.scene import Scene
from usdsmoke.vdb.read import GridRequest, read_grids

__all__ = ["Judge", "Verdict", "find_scenes", "turned_plumes"]

N_VIEWS = 6
THIN = 0.05  # as in the steps
STYLE = "strokes"
MEASURES = ("patch", "colour", "spectrum")
TURNS = (0.0, 50.0, 25.0, 75.0)  # degrees
FAINTEST = 1e-4  # share of the largest density, below which a turned plume has none


@dataclass(frozen=True)
class Verdict:
    """Mean over the held-out views."""

    loss: float
    closures: dict[str, float] = field(default_factory=dict)  # colour step; {}: too small


def find_scenes(
    names: Sequence[str], width: int, data: Path
) -> tuple[dict[str, VolumeFrame], np.ndarray]:
    """Frames by name, about ``width`` voxels across, and a painted style.

    The real plume is left out with a line on stderr when its file is missing.

    Raises:
        ValueError: an unknown name, or no scene is left.
    """
    frames = {}
    for name in names:
        if name == "plume":
            frames[name] = frame_of(simulate_smoke(width, 8, {"3-D": 48, "2-D": 1})["3-D"])
        elif name != "real_plume":
            raise ValueError(f"there is no scene {name!r}; wanted plume or real_plume")
        elif not (data / PLUME_FILE).is_file():
            print(f"real_plume left out: no {PLUME_FILE} in {data}", file=sys.stderr)
        else:
            frames[name] = read_real_plume(data / PLUME_FILE, width)
    if not frames:
        raise ValueError(f"none of the scenes {', '.join(names)} is here; name data with --data")
    return frames, paint_styles([STYLE], 256)[STYLE]


def read_real_plume(vdb_file: Path, width: int) -> VolumeFrame:
    """The real plume with blocks of voxels averaged to about ``width`` across."""
    (density,) = read_grids(vdb_file, [GridRequest("density")], GridsConfig())
    n = max(1, round(density.values.shape[0] / width))
    values = np.maximum(density.values, 0.0)
    values = np.pad(values, [(0, -size % n) for size in values.shape])
    i, j, k = (size // n for size in values.shape)
    coarse = values.reshape(i, n, j, n, k, n).mean(axis=(1, 3, 5))
    matrix = density.index_to_world.copy()
    matrix[:3, :3] *= n
    first = np.array([*(np.array(density.ijk_min) + (n - 1) / 2), 1.0])
    matrix[3, :3] = (first @ density.index_to_world)[:3]
    smoke = DenseField("density", coarse.astype(np.float32), (0, 0, 0), matrix)
    return VolumeFrame(1.0, smoke, np.eye(4))


def turned_plumes(vdb_file: Path) -> list[VolumeFrame]:
    """Four frames of the real plume at full resolution, turned by ``TURNS`` about the vertical.

    Voxels below ``FAINTEST`` of the largest density are left out.
    """
    plume = read_real_plume(vdb_file, sys.maxsize)
    frames = []
    for number, degrees in enumerate(TURNS):
        values = plume.density.values
        if degrees:
            values = ndimage.rotate(values, degrees, axes=(0, 2), reshape=False, order=1)
        values = np.where(values > FAINTEST * values.max(), values, 0).astype(np.float32)
        density = replace(plume.density, values=np.ascontiguousarray(values))
        frames.append(VolumeFrame(number + 1.0, density, plume.density_to_stage))
    return frames


class Judge:
    """Style loss of a finished frame, on views that no optimiser had; the same for everybody.

    Args:
        frame: the source.
        style: display-encoded.
        scene, config: extinction, size of pictures, range of views.
        step: "shape" judges grey pictures of density, "colour" those of emission.
        measures: the closures that are wanted.
    """

    def __init__(
        self,
        frame: VolumeFrame,
        style: np.ndarray,
        scene: Scene,
        config: Config,
        step: str,
        measures: Sequence[str] = MEASURES,
    ) -> None:
        self._step, self._scene, self._measures = step, scene, measures
        self._targets = make_targets([style], scene, config, torch.device("cpu"))
        views = config.views
        angles = held_out_angles(N_VIEWS, *view_ranges(views))
        self._gamma_w = scene.gamma_w_shape if step == "shape" else scene.gamma_w
        # all results are seen by the same cameras: those of the source with room for what moved
        room = _padded(frame.density, 4)
        seen = self._result(room, None)
        self._views = [fit_view(seen, float(a), float(e), scene.image_size) for a, e in angles]
        size = float(scene.image_size)
        self._style = scale_style(style, size, config.style, torch.zeros(())).numpy()
        self._guides = [self._drawn(room, None, view)[1] for view in self._views]

    def __call__(self, density: DenseField, emission: DenseField | None) -> Verdict:
        """Of a finished frame; ``emission`` None means white smoke in the colour step."""
        losses, images, masks = [], [], []
        for view, guide in zip(self._views, self._guides, strict=True):
            light, alpha = self._drawn(density, emission, view)
            with torch.no_grad():
                losses.append(float(self._loss(light, alpha, guide)))
            images.append(composite(light.numpy(), alpha.numpy(), mean_colour(self._style)))
            masks.append(alpha.numpy())
        closures = self._closures(images, masks) if self._step == "colour" else {}
        return Verdict(float(np.mean(losses)), closures)

    def _closures(self, images: list[np.ndarray], masks: list[np.ndarray]) -> dict[str, float]:
        try:
            scores = score_views(self._style, images, masks)
        except ValueError:  # pictures too small for a patch
            return {}
        return {name: float(scores[name]["mean"]) for name in self._measures}

    def _loss(self, light: Tensor, alpha: Tensor, guide: Tensor) -> Tensor:
        scene = self._scene
        if self._step == "shape":
            grey = alpha * scene.exposure_shape
            unmoved = guide * scene.exposure_shape
            seen = unmoved / (unmoved + THIN)
            picture = (grey + (1 - seen) * scene.grey_mean)[..., None].expand(-1, -1, 3)
            return self._targets.at(1, grey=True)(picture, seen)
        thin, deep = THIN / scene.exposure, alpha[..., None]
        picture = encode_srgb((light + thin * self._targets.background) / (deep + thin))
        return self._targets.at(1)(picture, alpha / (alpha + thin))

    def _drawn(
        self, density: DenseField, emission: DenseField | None, view: object
    ) -> tuple[Tensor, Tensor]:
        result = self._result(density, emission)
        light, alpha = draw_march(result, view)  # type: ignore[arg-type]
        return torch.from_numpy(light), torch.from_numpy(alpha)

    def _result(self, density: DenseField, emission: DenseField | None) -> Result:
        if emission is None:
            light = density.values[..., None] * np.full(3, self._gamma_w, np.float32)
            emission = replace(density, name="emission", values=light)
        return Result(density, cover_box(emission, density), np.eye(4), self._gamma_w)


def _padded(density: DenseField, room: int) -> DenseField:
    low = tuple(int(n) - room for n in density.ijk_min)
    return replace(density, values=np.pad(density.values, room), ijk_min=low)  # type: ignore[arg-type]

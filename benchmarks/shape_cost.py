"""The work that the reference code was measured on, done here and timed: one frame's shape step.

96 x 144 x 96 voxels of which 5.8 % hold smoke, a potential's displacement, the style loss of some
views an iteration, and the full resolution alone. Linux only: resident memory is read from /proc.
"""

import dataclasses
import os
import resource
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.frame_report import Progress
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.core.fields.resample import smooth
from usdsmoke.core.fields.sample import voxel_positions
from usdsmoke.core.sequence.stylize import stylize_window
from usdsmoke.core.smoke.noise import white_noise
from usdsmoke.core.style.losses import StyleTarget
from usdsmoke.core.views.scene import measure_scene

__all__ = ["SHAPE", "SHARE", "Case", "Cost", "make_plume", "measure_case", "write_vgg19"]

SHAPE = (96, 144, 96)  # i j k, j up
SHARE = 0.058  # of the voxels hold smoke
WIDTHS = (64, 64, "M", 128, 128, "M", *[256] * 4, "M", *[512] * 4, "M", *[512] * 4)  # VGG-19


@dataclasses.dataclass(frozen=True)
class Case:
    """One run."""

    features: str = "embedded"  # or "vgg19", to relu3_1 with random parameters
    views: int = 9
    threads: int = 1  # 0: as many as there are processors
    network: bool = True  # False: the mean of the picture in place of the style loss
    iterations: int = 8
    shape: tuple[int, int, int] = SHAPE
    scattered: bool = False  # the same share of the voxels, but all over the box


@dataclasses.dataclass(frozen=True)
class Cost:
    """Seconds and GiB of one run; those of an iteration are means over all but the first."""

    cpu_s: float
    wall_s: float
    set_up_cpu_s: float  # before the first iteration: style statistics, views, scene
    finish_cpu_s: float  # after the last: the smoke moved by the accurate scheme
    base_gib: float
    peak_gib: float  # above the base, up to the last iteration
    whole_peak_gib: float  # above the base, to the end
    voxels: int
    box: tuple[int, int, int]


def make_plume(
    shape: tuple[int, int, int], share: float = SHARE, seed: int = 0, scattered: bool = False
) -> np.ndarray:
    """A lumpy column of smoke that widens as it rises along j, [I J K] float32 in [0, 1].

    ``share`` of the voxels hold smoke, the others exactly 0. ``scattered`` leaves the column out:
    lumps all over the box, where nothing is gained by looking at the occupied part alone.
    """
    ijk = voxel_positions(shape, torch.empty(0)).long()
    amount = smooth(white_noise(ijk, 1, seed).reshape(shape), 0.02 * max(shape))
    amount = (amount - amount.mean()) / amount.std()
    if not scattered:
        i, j, k = (torch.linspace(-1, 1, n) for n in shape)
        width = (0.15 + 0.3 * (j + 1))[None, :, None]
        sway = 0.15 * torch.sin(3 * j)[None, :, None]
        away = ((i[:, None, None] - sway) ** 2 + k[None, None] ** 2) / width**2
        amount = amount - 3 * away**2
    faintest = torch.from_numpy(np.quantile(amount.numpy(), [1 - share])).float()
    amount = (amount - faintest).clamp_min(0)
    return (amount / amount.max()).numpy()


def make_style(size: int = 160, seed: int = 1) -> np.ndarray:
    """Blobs of colour of three sizes, [H W 3] in [0, 1]."""
    ijk = voxel_positions((size, size, 1), torch.empty(0)).long()
    noise = white_noise(ijk, 3, seed).reshape(size, size, 1, 3) - 0.5
    picture = sum(s * smooth(noise, (float(s), float(s), 0.0)) for s in (1, 3, 9))
    return (0.5 + picture[:, :, 0]).clamp(0, 1).numpy()


def write_vgg19(file_path: Path) -> None:
    """Parameters of VGG-19's shape, random as deep as relu3_1; deeper ones are one number."""
    generator, tensors = torch.Generator().manual_seed(0), {}
    index, channels = 0, 3
    for width in WIDTHS:
        if isinstance(width, str):
            index += 1
            continue
        weight = torch.full((1, 1, 1, 1), 1e-3).expand(width, channels, 3, 3)
        if channels <= 128:
            scale = (2 / (9 * channels)) ** 0.5
            weight = scale * torch.randn(width, channels, 3, 3, generator=generator)
        tensors[f"features.{index}.weight"] = weight
        tensors[f"features.{index}.bias"] = 0.1 * torch.randn(width, generator=generator)
        index, channels = index + 2, width
    torch.save(tensors, file_path)


def _settings(case: Case, vgg19_file: str) -> Config:
    features: dict[str, Any] = {"network": case.features}
    if case.features == "vgg19":
        features |= {"layers": ["relu2_1", "relu3_1"], "vgg19_file": vgg19_file}
    return resolve_config(
        {
            "views": {
                "count": case.views,
                "image_size": max(16, *case.shape),  # a voxel a pixel, as the reference draws
                "azimuth": 10.0,
                "elevation": 5.0,
            },
            "features": features,
            "shape": {"displacement": "potential", "iterations": [0, 0, case.iterations]},
            "optimize": {
                "steps": ["shape"], "tolerance": 0.0, "threads": case.threads, "device": "cpu",
            },
        }
    )  # fmt: skip


@contextmanager
def _without_network() -> Iterator[None]:
    """PATCH: the style loss of a picture is its mean; all else is done as ever."""
    real = StyleTarget.loss

    def mean(self: StyleTarget, picture: Tensor, *_: Any, **__: Any) -> Tensor:
        return picture.mean()

    StyleTarget.loss = mean  # type: ignore[method-assign]
    try:
        yield
    finally:
        StyleTarget.loss = real  # type: ignore[method-assign]


def _run(case: Case, config: Config, told: list[tuple[float, float, float]]) -> None:
    """Stylize one frame; CPU seconds, wall seconds and peak are told after every iteration."""
    density = make_plume(case.shape, scattered=case.scattered)
    field = DenseField("density", density, (0, 0, 0), np.eye(4))
    frames, styles = [VolumeFrame(1.0, field, np.eye(4))], [make_style()]

    def tell(_: Progress | None) -> None:
        told.append((time.process_time(), time.perf_counter(), _peak_gib()))

    tell(None)
    list(
        stylize_window(
            frames,
            styles,
            measure_scene(frames, config.views, config.optics, "Y", config.grids.parts),
            config,
            tell,
        )
    )
    tell(None)


def _resident_gib() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**30


def _peak_gib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def measure_case(case: Case) -> Cost:
    """Run a case in this process, after a warm-up on 8 x 12 x 8 voxels.

    The base is what is resident after the warm-up: Python, torch, this package and the network's
    parameters. Peaks are of the process; they only tell where nothing larger ran in it before.
    """
    told: list[tuple[float, float, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        vgg19_file = Path(folder) / "random.pth"
        if case.features == "vgg19":
            write_vgg19(vgg19_file)
        small = dataclasses.replace(case, shape=(8, 12, 8), iterations=1, views=1)
        _run(small, _settings(small, str(vgg19_file)), [])
        base = _resident_gib()
        config = _settings(case, str(vgg19_file))
        if case.network:
            _run(case, config, told)
        else:
            with _without_network():
                _run(case, config, told)
    begin, first, last, end = told[0], told[1], told[-2], told[-1]
    cpu, wall = ((last[n] - first[n]) / (len(told) - 3) for n in (0, 1))
    filled = np.argwhere(make_plume(case.shape, scattered=case.scattered) > 0)
    return Cost(
        cpu_s=cpu,
        wall_s=wall,
        set_up_cpu_s=first[0] - begin[0] - cpu,
        finish_cpu_s=end[0] - last[0],
        base_gib=base,
        peak_gib=last[2] - base,
        whole_peak_gib=end[2] - base,
        voxels=len(filled),
        box=tuple(int(n) for n in np.ptp(filled, axis=0) + 1),  # type: ignore[arg-type]
    )

"""One run of ``benchmarks.scaling``: an iteration's seconds, the network's part, peak memory."""

import dataclasses
import itertools
import os
import resource
import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from benchmarks.shape_cost import make_plume, make_style
from usdsmoke.base.frame_report import Progress
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.core.sequence.stylize import stylize_window
from usdsmoke.core.style.losses import StyleTarget
from usdsmoke.core.views.scene import measure_scene

__all__ = ["Case", "Cost", "measure_case", "measure_peak"]

INNER = 32  # side of the smoke that is padded
INNER_SHARE = 0.6


@dataclasses.dataclass(frozen=True)
class Case:
    """One run."""

    step: str  # shape or colour
    side: int  # of the cubic box, voxels
    share: float = 0.0  # of its voxels that hold smoke; "padded" does not look at it
    layout: str = "scattered"  # over the box; "plume"; "padded": the same smoke, more space around
    image_size: int = 64
    views: int = 1
    iterations: int = 6
    device: str = "cpu"


@dataclasses.dataclass(frozen=True)
class Cost:
    """Medians over the second half of the iterations: in the first, views' maps are made.

    CPU seconds of one thread, on a GPU wall ones.
    """

    voxels: int
    seconds: float  # of an iteration
    network_s: float  # of it: style loss of all its pictures and the gradients
    set_up_s: float
    peak_gib: float  # above what is resident after the imports and a tiny run
    network_gflop: float  # an iteration

    @property
    def volume_s(self) -> float:
        """All of an iteration but the network."""
        return self.seconds - self.network_s

    @property
    def share(self) -> float:
        """The network's share of an iteration."""
        return self.network_s / self.seconds


class _Clock:
    """Seconds and the calls of the network while it is in place."""

    def __init__(self, device: str) -> None:
        self.on_gpu = device.startswith("cuda")
        self.network = 0.0
        self.calls: list[tuple[StyleTarget, Tensor, Tensor | None, int]] = []

    def now(self) -> float:
        if self.on_gpu:
            torch.cuda.synchronize()
            return time.perf_counter()
        return time.process_time()


class _Judged(torch.autograd.Function):
    """A style loss whose gradient is taken at once, so that both can be timed."""

    @staticmethod
    def forward(ctx: Any, picture: Tensor, loss: Any, clock: _Clock) -> Tensor:
        begin = clock.now()
        value, ctx.gradient = _with_gradient(picture, loss)
        clock.network += clock.now() - begin
        return value

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None]:
        return upstream * ctx.gradient, None, None


def _with_gradient(picture: Tensor, loss: Any) -> tuple[Tensor, Tensor]:
    with torch.enable_grad():
        leaf = picture.detach().clone().requires_grad_(True)
        value = loss(leaf)
        return value.detach(), torch.autograd.grad(value, leaf)[0]


@contextmanager
def _timed_network(clock: _Clock) -> Iterator[None]:
    """PATCH: the style loss notes its seconds, gradient included; all else is done as ever."""
    real = StyleTarget.loss

    def loss(self: StyleTarget, picture: Tensor, guide: Tensor | None, draw: int = 0) -> Tensor:
        clock.calls.append((self, picture.detach(), guide, draw))
        return cast(Tensor, _Judged.apply(picture, lambda at: real(self, at, guide, draw), clock))

    StyleTarget.loss = loss  # type: ignore[method-assign]
    try:
        yield
    finally:
        StyleTarget.loss = real  # type: ignore[method-assign]


def make_smoke(case: Case) -> np.ndarray:
    """The density of a case, [n n n] float32."""
    if case.layout == "padded":
        inner = make_plume((INNER,) * 3, INNER_SHARE, scattered=True)
        room = case.side - INNER
        return np.pad(inner, [(room // 2, room - room // 2)] * 3)
    return make_plume((case.side,) * 3, case.share, scattered=case.layout == "scattered")


def _settings(case: Case) -> Config:
    pool = max(4, case.views)
    last = {"interpolation": "linear"} if case.step == "shape" else {}  # the end is not measured
    return resolve_config(
        {
            "views": {"count": case.views, "pool": pool, "image_size": case.image_size},
            case.step: {"iterations": [0, 0, case.iterations]} | last,
            "optimize": {
                "steps": [case.step], "tolerance": 0.0, "threads": 1, "device": case.device,
            },
        }
    )  # fmt: skip


def _run(case: Case, clock: _Clock, told: list[tuple[float, float, float]]) -> int:
    """Stylize a frame; seconds, the network's and the peak are told after every iteration."""
    field = DenseField("density", make_smoke(case), (0, 0, 0), np.eye(4))
    frames, config = [VolumeFrame(1.0, field, np.eye(4))], _settings(case)

    def tell(_: Progress | None) -> None:
        told.append((clock.now(), clock.network, _peak_gib(clock)))

    tell(None)
    scene = measure_scene(frames, config.views, config.optics, "Y", config.grids.parts)
    list(stylize_window(frames, [make_style()], scene, config, tell))
    tell(None)
    return int((field.values > 0).sum())


def _peak_gib(clock: _Clock) -> float:
    if clock.on_gpu:
        return torch.cuda.max_memory_allocated() / 2**30
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def _resident_gib(clock: _Clock) -> float:
    if clock.on_gpu:
        return 0.0
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**30


def measure_case(case: Case) -> Cost:
    """Run a case in this process, after a warm-up on few voxels."""
    tiny = dataclasses.replace(case, side=10, share=0.3, layout="scattered", iterations=2)
    with _timed_network(_Clock(case.device)):
        _run(tiny, _Clock(case.device), [])
    clock, told = _Clock(case.device), list[tuple[float, float, float]]()
    base = _resident_gib(clock)
    with _timed_network(clock):
        voxels = _run(case, clock, told)
    steps = list(itertools.pairwise(told[1:-1]))
    steps = steps[len(steps) // 2 :]
    seconds = [after[0] - before[0] for before, after in steps]
    network = [after[1] - before[1] for before, after in steps]
    gflop = _count_flops(clock.calls[-case.views :])
    return Cost(
        voxels=voxels,
        seconds=statistics.median(seconds),
        network_s=statistics.median(network),
        set_up_s=told[1][0] - told[0][0] - statistics.median(seconds),
        peak_gib=told[-1][2] - base,
        network_gflop=gflop,
    )


def _count_flops(calls: list[tuple[StyleTarget, Tensor, Tensor | None, int]]) -> float:
    """Of these style losses with their gradients: convolutions and matrix products, 1e9."""
    with FlopCounterMode(display=False) as counter:
        for target, picture, guide, draw in calls:
            _with_gradient(picture, lambda leaf: target.loss(leaf, guide, draw))  # noqa: B023
    return float(counter.get_total_flops()) / 1e9


def measure_peak(device: str = "cpu", repeats: int = 7) -> float:
    """GFLOP/s of one large convolution, 64 to 64 channels, 3 x 3 on 256 x 256, one thread."""
    torch.set_num_threads(1)
    clock = _Clock(device)
    maps = torch.rand(1, 64, 256, 256, device=device)
    weight = torch.rand(64, 64, 3, 3, device=device)
    flops, seconds = 2 * 64 * 64 * 9 * 256 * 256, []
    with torch.no_grad():
        for _ in range(repeats + 1):
            begin = clock.now()
            F.conv2d(maps, weight, padding=1)
            seconds.append(clock.now() - begin)
    return flops / statistics.median(seconds[1:]) / 1e9

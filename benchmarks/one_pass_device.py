"""Seconds of a frame by iterations, by a network and 32 iterations, and by a network alone.

    python -m benchmarks.one_pass_device [--box 200 300 200] [--views 9] [--report PAGE.md]

The colour step on a plume that fills a third of a box, on the processor and, where there is one, on
a CUDA GPU; and a whole frame, both steps with the settings as they are, on a plume of a quarter as
many voxels. The network is trained on other plumes of that kind, on the GPU if there is one. What a
GPU gives is compared with what the processor does.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch

from benchmarks.circumstances import publish, table_page
from benchmarks.shape_cost import make_plume, make_style
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.core.generator.definition import N_ITERATIONS
from usdsmoke.core.generator.network import Generator
from usdsmoke.core.sequence.frame_state import make_context, open_frame
from usdsmoke.core.sequence.stylize import stylize_window
from usdsmoke.core.smoke.schedule import network_iterations
from usdsmoke.core.steps.behind import refine_painted
from usdsmoke.core.steps.colour import run_colour_step
from usdsmoke.core.training.canvas import judge
from usdsmoke.core.training.frames import train_on_frames
from usdsmoke.core.views.scene import Scene, measure_scene

__all__ = ["Way", "main", "measure_device"]

SHARE = 1 / 3  # of the box that holds smoke
AFTER = 32
FRAME = 0.64  # of the box's sides: a quarter of its voxels
TAUGHT = (1, 2, 3)  # plumes of the training, of which the last is held out; 0 is measured
_INTRO = (
    "# A frame on each device",
    "",
    "The colour step on a plume, from noise by the default iterations, and behind a network that",
    "is trained on other plumes, by default in 200 x 300 x 200 voxels with 9 views an iteration;",
    "and a whole frame, both steps with one view, of a quarter as many voxels. Wall",
    "seconds; on a GPU also of a second run, as it records losses when it first uses them. A whole",
    "frame records them anew. The training has loaded the GPU's code. The processor computes with",
    "four threads at most.",
    "The loss is the style loss of four views that nothing was optimised or trained for; that of a",
    "whole frame is of the colour step's last iterations.",
)


Result = TypeVar("Result")


@dataclass(frozen=True)
class Way:
    """What one way takes, and where it ends."""

    name: str
    voxels: int
    seconds: tuple[float, ...]  # of the first and, on a GPU, the second run
    loss: float
    gib: float  # of a GPU's memory, at most


def train(box: Sequence[int], n_iterations: int, device: str) -> tuple[Generator, str]:
    """A network that is trained on plumes, by views as a run takes them; and what it took."""
    config = resolve_config({"optimize": {"device": device, "steps": ["colour"]}})
    frames = [_plume(box, seed) for seed in TAUGHT]
    begin = time.perf_counter()
    found = train_on_frames(
        frames, [make_style()], _scene(frames[-1], config), config, n_iterations, lambda state: None
    ).trained
    spent = time.perf_counter() - begin
    words = (
        f"The network was trained in {spent:.0f} s on {device}, {found.n_iterations} iterations on "
        f"{len(TAUGHT) - 1} plumes: loss {found.loss:.2f} on a held-out one, {found.cold_loss:.2f} "
        f"after {found.n_cold} iterations from noise"
    )
    print(words, file=sys.stderr, flush=True)
    return found.generator, words


def measure_device(
    box: Sequence[int],
    n_views: int,
    generator: Generator,
    device: str,
    iterations: Sequence[int] | None = None,
) -> tuple[list[Way], np.ndarray]:
    """Each way, and the colours [N 3] that the network paints.

    Args:
        iterations: of the colour step from noise; None: the default.
    """
    config = resolve_config(
        {
            "views": {"count": n_views, "pool": max(16, n_views)},
            "optimize": {"device": device, "tolerance": 0.0, "steps": ["colour"]},
        }
    )
    frame = _plume(box)
    scene = _scene(frame, config)
    context = make_context([make_style()], scene, config, None, 24.0, None, 0)
    problem = open_frame(frame, context).colour_problem()
    generator = generator.to(context.device)
    octaves = list(iterations or config.colour.iterations)
    n_voxels = len(problem.smoke.ijk)
    behind = network_iterations([*[0] * (len(octaves) - 1), AFTER], n_voxels)

    def paint() -> torch.Tensor:
        return generator.paint(problem.smoke, scene.gamma_w, 0)

    judging = judge(problem, problem)

    def loss(colours: torch.Tensor) -> float:
        with torch.no_grad():
            return float(judging.loss(colours, 0))

    ways = [
        _measure("network", n_voxels, device, paint, loss),
        _measure(f"network + {AFTER}", n_voxels, device,
                 lambda: refine_painted(problem, behind, paint())[0], loss),
        _measure(f"noise, {sum(octaves)} iterations", n_voxels, device,
                 lambda: run_colour_step(problem, octaves)[0], loss),
        _whole_frame([round(FRAME * n) for n in box], device, iterations),
    ]  # fmt: skip
    return ways, paint().cpu().numpy()


def _whole_frame(box: Sequence[int], device: str, iterations: Sequence[int] | None) -> Way:
    settings = {"colour": {"iterations": list(iterations)}} if iterations else {}
    config = resolve_config({"optimize": {"device": device}}, settings)
    frame = _plume(box)
    scene = _scene(frame, config)

    def stylize() -> float:
        (done,) = stylize_window([frame], [make_style()], scene, config)
        assert done.report.colour is not None
        return done.report.colour.loss[-1]

    n_voxels = int((frame.density.values > 0).sum())
    return _measure("whole frame", n_voxels, device, stylize, float)


def _plume(box: Sequence[int], seed: int = 0) -> VolumeFrame:
    i, j, k = box
    values = make_plume((i, j, k), SHARE, seed)
    return VolumeFrame(1.0 + seed, DenseField("density", values, (0, 0, 0), np.eye(4)), np.eye(4))


def _scene(frame: VolumeFrame, config: Config) -> Scene:
    return measure_scene([frame], config.views, config.optics, "Y", config.grids.parts)


def _measure(
    name: str,
    n_voxels: int,
    device: str,
    run: Callable[[], Result],
    loss: Callable[[Result], float],
) -> Way:
    on_gpu = device != "cpu"
    if on_gpu:
        torch.cuda.empty_cache()  # of what was computed before
        torch.cuda.reset_peak_memory_stats()
    spent = []
    for _ in range(2 if on_gpu else 1):
        begin = time.perf_counter()
        found = run()
        if on_gpu:
            torch.cuda.synchronize()
        spent.append(time.perf_counter() - begin)
        print(f"{device}, {name}: {spent[-1]:.2f} s", file=sys.stderr, flush=True)
    gib = torch.cuda.max_memory_reserved() / 2**30 if on_gpu else 0.0
    return Way(name, n_voxels, tuple(spent), loss(found), gib)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table, and write it with ``--report``."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n", maxsplit=1)[0])
    parser.add_argument("--box", type=int, nargs=3, default=[200, 300, 200], help="voxels")
    parser.add_argument("--views", type=int, default=9, help="of an iteration")
    parser.add_argument("--iterations", type=int, nargs="+", help="from noise, per octave")
    parser.add_argument("--report", type=Path, help="write the page here")
    parser.add_argument(
        "--training", type=int, default=N_ITERATIONS, help="iterations of the network, at most"
    )
    given = parser.parse_args(arguments)
    devices = [*(["cuda"] if torch.cuda.is_available() else []), "cpu"]
    generator, words = train(given.box, given.training, devices[0])
    measured = {
        device: measure_device(given.box, given.views, generator, device, given.iterations)
        for device in devices
    }
    lines = []
    for device, (ways, colours) in measured.items():
        apart = float(np.abs(colours - measured["cpu"][1]).max())
        for way in ways:
            seconds = [*(f"{s:.2f}" for s in way.seconds), ""][:2]
            cells = [
                device, f"{way.voxels:,}", way.name, *seconds,
                f"{way.loss:.3f}", f"{way.gib:.1f}",
                f"{apart:.1e}" if way.name == "network" else "",
            ]  # fmt: skip
            lines.append(f"| {' | '.join(cells)} |")
    if devices == ["cpu"]:
        print("no CUDA device: only the processor was measured", file=sys.stderr)
    columns = [
        "device", "voxels", "way", "first, s", "second, s", "loss", "GPU, GiB",
        "colours, farthest from the processor's",
    ]  # fmt: skip
    own = sys.argv[1:] if arguments is None else arguments
    command = ["python", "-m", "benchmarks.one_pass_device", *own]
    page = table_page(_INTRO, columns, lines, command) + f"- {words}.\n"
    if len(devices) > 1:
        page += f"- GPU: {torch.cuda.get_device_name()}, torch {torch.__version__}.\n"
    publish(page, given.report)
    return 0


if __name__ == "__main__":
    sys.exit(main())

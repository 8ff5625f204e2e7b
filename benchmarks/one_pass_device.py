"""Seconds of a frame by iterations, by a network and 32 iterations, and by a network alone.

    python -m benchmarks.one_pass_device [--box 200 300 200] [--views 9] [--report PAGE.md]

The colour step on a plume that fills a third of a box, on the processor and, where there is one, on
a CUDA GPU. The network is not trained: its time does not depend on its parameters. The colours that
it paints on a GPU are compared with the processor's.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch

from benchmarks.circumstances import publish, table_page
from benchmarks.shape_cost import make_plume, make_style
from usdsmoke.base.resolve import resolve_config
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.generator.network import Generator
from usdsmoke.core.sequence.frame_state import make_context, open_frame
from usdsmoke.core.smoke.schedule import network_iterations
from usdsmoke.core.steps.behind import refine_painted
from usdsmoke.core.steps.colour import run_colour_step
from usdsmoke.core.steps.targets import StepProblem
from usdsmoke.core.views.scene import measure_scene

__all__ = ["main", "measure_device"]

SHARE = 1 / 3  # of the box that holds smoke
AFTER = 32
_INTRO = (
    "# A frame on each device",
    "",
    "The colour step on a plume, from noise by the default iterations, and behind a network. Wall",
    "seconds of the second of two runs: the first one compiles and warms up.",
)


def measure_device(
    box: Sequence[int], n_views: int, device: str, iterations: Sequence[int] | None = None
) -> tuple[dict[str, float], np.ndarray]:
    """Wall seconds by way, and the colours [N 3] that the network paints.

    Args:
        iterations: from noise; None: the default.
    """
    config = resolve_config(
        {
            "views": {"count": n_views, "pool": max(16, n_views)},
            "optimize": {"device": device, "tolerance": 0.0, "steps": ["colour"]},
        }
    )
    i, j, k = box
    field = DenseField("density", make_plume((i, j, k), SHARE), (0, 0, 0), np.eye(4))
    frame = VolumeFrame(1.0, field, np.eye(4))
    scene = measure_scene([frame], config.views, config.optics, "Y", config.grids.refine)
    context = make_context([make_style()], scene, config, None, 24.0, None, 0)
    problem = open_frame(frame, context).colour_problem()
    generator = Generator.new(torch.tensor([0.5, 0.4, 0.6]), 0).to(context.device)
    octaves = list(iterations or config.colour.iterations)
    behind = network_iterations([*[0] * (len(octaves) - 1), AFTER], len(problem.smoke.ijk))

    def paint() -> torch.Tensor:
        return generator.paint(problem.smoke, scene.gamma_w, 0)

    ways: dict[str, Callable[[], object]] = {
        f"noise, {sum(octaves)} iterations": lambda: run_colour_step(problem, octaves),
        f"network + {AFTER}": lambda: refine_painted(problem, behind, paint()),
        "network": paint,
    }
    return {way: _seconds(run, problem) for way, run in ways.items()}, paint().cpu().numpy()


def _seconds(run: Callable[[], object], problem: StepProblem) -> float:
    """Of the second of two runs."""
    spent = 0.0
    for _ in range(2):
        begin = time.perf_counter()
        run()
        if problem.smoke.ijk.is_cuda:
            torch.cuda.synchronize()
        spent = time.perf_counter() - begin
    return spent


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table, and write it with ``--report``."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n", maxsplit=1)[0])
    parser.add_argument("--box", type=int, nargs=3, default=[200, 300, 200], help="voxels")
    parser.add_argument("--views", type=int, default=9, help="of an iteration")
    parser.add_argument("--iterations", type=int, nargs="+", help="from noise, per octave")
    parser.add_argument("--report", type=Path, help="write the page here")
    given = parser.parse_args(arguments)
    devices = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
    lines, first = [], None
    for device in devices:
        seconds, colours = measure_device(given.box, given.views, device, given.iterations)
        first = colours if first is None else first
        apart = float(np.abs(colours - first).max())
        for way, taken in seconds.items():
            lines.append(f"| {device} | {len(colours):,} | {way} | {taken:.2f} | {apart:.1e} |")
            print(lines[-1], file=sys.stderr, flush=True)
    if devices == ["cpu"]:
        print("no CUDA device: only the processor was measured", file=sys.stderr)
    columns = ["device", "voxels", "way", "s", "network's colours, farthest from the processor's"]
    own = sys.argv[1:] if arguments is None else arguments
    command = ["python", "-m", "benchmarks.one_pass_device", *own]
    publish(table_page(_INTRO, columns, lines, command), given.report)
    return 0


if __name__ == "__main__":
    sys.exit(main())

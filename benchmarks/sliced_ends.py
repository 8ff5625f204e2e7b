"""Distributions by counting against sorting: cost of an iteration, and where the colour step ends.

    python -m benchmarks.sliced_ends [--width 32] [--style FILE] [--data FOLDER] [--report FILE]

The colour step runs with the default iterations on small copies of the example plume and the real
plume, with Gram matrices, with distributions as they are compared by default, and with all
directions of a layer sorted. Every end is judged by sorting along all directions of a draw that no
run had, over the pool of views.
"""

import argparse
import math
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np
import torch
from torch import Tensor

from benchmarks.circumstances import publish, table_page
from benchmarks.control_scenes import paint_styles
from benchmarks.equal_judge import find_scenes
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.active import activate
from usdsmoke.core.smoke.srgb import decode_srgb
from usdsmoke.core.steps.colour import run_colour_step
from usdsmoke.core.steps.pictures import prepare_views
from usdsmoke.core.steps.targets import StepProblem, StyleTargets, make_targets
from usdsmoke.core.style import losses, sliced
from usdsmoke.core.views.scene import frame_views, measure_scene

__all__ = ["WAYS", "Row", "main", "measure"]

JUDGE_SEED = 0x1D6E  # of its directions
WAYS = {  # name: statistic, directions, draws, whether every sample is sorted
    "Gram matrices": ("gram", 32, 16, False),
    "32 directions, counted (default)": ("sliced_wasserstein", 32, 16, False),
    "32 directions, counted, 64 draws": ("sliced_wasserstein", 32, 64, False),
    "32 directions, sorted": ("sliced_wasserstein", 32, 16, True),
    "all directions, sorted": ("sliced_wasserstein", 0, 16, True),
}


@dataclass(frozen=True)
class Row:
    """One run of the colour step."""

    scene: str
    way: str
    cpu_s: float
    loss: float  # by sorting along all directions


def measure(frame: VolumeFrame, style: np.ndarray, config: Config, way: str, scene: str) -> Row:
    """Run the step in one of ``WAYS`` and judge its end."""
    statistic, n_axes, n_draws, by_sorting = WAYS[way]
    chosen = config.replace(losses=config.losses.replace(statistic=statistic))
    problem = _problem(frame, style, chosen)
    with _compared(n_axes, n_draws, by_sorting):
        begin = time.process_time()
        colours, _ = run_colour_step(problem, config.colour.iterations)
        seconds = time.process_time() - begin
    judge_config = config.replace(
        losses=config.losses.replace(statistic="sliced_wasserstein"),
        optimize=config.optimize.replace(seed=config.optimize.seed + JUDGE_SEED),
    )
    judge = _problem(frame, style, judge_config)
    with _compared(0, 1, True):
        return Row(scene, way, seconds, _judged(problem, judge.targets, colours))


def _problem(frame: VolumeFrame, style: np.ndarray, config: Config) -> StepProblem:
    device = torch.device("cpu")
    optics = config.optics.replace(thicken=1.0)  # the smoke as it is
    scene = measure_scene([frame], config.views, optics, "Y", 1)
    smoke = activate(frame.density, frame.density_to_stage, device)
    return StepProblem(smoke, make_targets([style], scene, config, device), scene, config)


@contextmanager
def _compared(n_axes: int, n_draws: int, by_sorting: bool) -> Iterator[None]:
    """Distributions are compared so; 0 directions are as many as a layer has channels."""
    real = losses.random_directions
    with ExitStack() as stack:
        if n_axes == 0:

            def all_directions(n_channels: int, _: int, seed: int, like: Tensor) -> Tensor:
                return real(n_channels, n_channels, seed, like)

            stack.enter_context(mock.patch.object(losses, "random_directions", all_directions))
        else:
            stack.enter_context(mock.patch.object(losses, "N_DIRECTIONS", n_axes))
        stack.enter_context(mock.patch.object(losses, "N_DRAWS", n_draws))
        if by_sorting:
            stack.enter_context(mock.patch.object(sliced, "FEWEST_PER_BIN", math.inf))
        yield


def _judged(problem: StepProblem, targets: StyleTargets, colours: Tensor) -> float:
    """Mean over the last octave's pool of views."""
    config, scene = problem.config, problem.scene
    seed = config.optimize.seed + len(config.colour.iterations) - 1
    views = frame_views(problem.smoke, config.views, scene, seed, 1)
    loss, linear = targets.at(1), decode_srgb(colours)
    with torch.no_grad():
        found = [
            float(loss(view.unpremultiplied(linear, targets.background), view.guide))
            for view in prepare_views(problem.smoke, views, scene.gamma_w, scene.exposure)
        ]
    return float(np.mean(found))


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--width", type=int, default=32, help="voxels across the smoke's box")
    parser.add_argument("--scenes", nargs="+", default=["plume", "real_plume"])
    parser.add_argument("--style", default="strokes", help="of the painted ones")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="real volumes")
    parser.add_argument("--report", type=Path, help="Markdown file for the table")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    frames, _ = find_scenes(options.scenes, options.width, options.data)
    style, rows = paint_styles([options.style], 256)[options.style], []
    for scene, frame in frames.items():
        for way in WAYS:
            rows.append(measure(frame, style, Config(), way, scene))
            print(_line(rows[-1]), file=sys.stderr, flush=True)
    text = _report(rows, arguments if arguments is not None else sys.argv[1:])
    publish(text, options.report)
    return 0


def _line(row: Row) -> str:
    return f"| {row.scene} | {row.way} | {row.cpu_s:.1f} | {row.loss:.4f} |"


def _report(rows: Sequence[Row], arguments: Sequence[str]) -> str:
    intro = [
        "# Distributions by counting against sorting",
        "",
        "The colour step with the default iterations; its end is judged by sorting along all",
        "directions.",
    ]
    columns = ["scene", "compared by", "CPU s", "loss"]
    return table_page(
        intro, columns, [*map(_line, rows)], ["python -m benchmarks.sliced_ends", *arguments]
    )


if __name__ == "__main__":
    sys.exit(main())

"""What views of other sides than the camera's gain there, and cost in the camera's picture.

    python -m benchmarks.other_sides [--styles NAME_OR_FILE ...] [--seeds N] [--width 56]
                                     [--data FOLDER] [--report FILE]

The colour step paints a coarse copy of the real plume, or the example plume without the data,
before a camera. Every row has other numbers of views aside in its pools, all else by default. The
losses are of six unseen views of each side, means over the styles' and seeds' runs in parts of the
loss without views aside.
"""

import argparse
import sys
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import torch
from torch import Tensor

from benchmarks.circumstances import publish, table_page
from benchmarks.control_scenes import style_pixels
from benchmarks.equal_judge import find_scenes
from benchmarks.stages import PLUME_FILE
from usdsmoke.base.volume import CameraSource, VolumeFrame
from usdsmoke.config.resolve import resolve_config
from usdsmoke.core.sequence.frame_state import make_context, open_frame
from usdsmoke.core.smoke import schedule
from usdsmoke.core.smoke.voxels import occupied
from usdsmoke.core.steps.colour import colour_pool, pictures_loss, run_colour_step
from usdsmoke.core.steps.targets import StepProblem
from usdsmoke.core.views import cameras
from usdsmoke.core.views.scene import measure_scene
from usdsmoke.pictures import find_style_size

__all__ = ["WAYS", "main", "measure"]

NEVER = 10**6
# One view of so many is aside, in the finest octave and in coarser ones; and degrees left free
WAYS = {
    "none": (NEVER, NEVER, 60.0),
    "1 of 2 in coarse octaves alone": (NEVER, 2, 60.0),
    "1 of 8, coarse 1 of 4": (8, 4, 60.0),
    "1 of 8, coarse 1 of 2": (8, 2, 60.0),
    "1 of 4, coarse 1 of 4": (4, 4, 60.0),
    "1 of 4, coarse 1 of 2 (default)": (4, 2, 60.0),
    "the same, from 30 degrees on": (4, 2, 30.0),
}
NO_CAMERA = "none: all views all round, without a camera"
SIDES = (0, 60, 90, 180, 270)  # degrees around the camera's direction
N_VIEWS, JUDGE_SEED = 6, 777


def measure(problem: StepProblem, way: str) -> tuple[float, list[float]]:
    """CPU seconds of the colour step in one of ``WAYS`` or without a camera, and the losses of
    ``SIDES``.
    """
    fine, coarse, free = WAYS.get(way, WAYS["none"])
    run = problem
    if way == NO_CAMERA:
        views = problem.config.views.replace(camera="")
        run = replace(
            problem, scene=replace(problem.scene, camera=None),
            config=problem.config.replace(views=views),
        )  # fmt: skip
    with ExitStack() as stack:
        for module, name, value in (
            (schedule, "ASIDE", fine),
            (schedule, "COARSE_ASIDE", coarse),
            (cameras, "FREE", free),
        ):
            stack.enter_context(mock.patch.object(module, name, value))
        begin = time.process_time()
        colours, _ = run_colour_step(run, run.config.colour.iterations)
        seconds = time.process_time() - begin
    return seconds, [_loss(problem, colours, side) for side in SIDES]


def _loss(problem: StepProblem, colours: Tensor, side: float) -> float:
    """Mean of views within the ranges around a camera, from a side."""
    azimuth, elevation = schedule.AROUND_CAMERA
    views = problem.config.views.replace(
        azimuth=azimuth, elevation=elevation, centre_azimuth=float(side), pool=N_VIEWS
    )
    judge = replace(problem, config=problem.config.replace(views=views))
    pool, targets = colour_pool(judge, 1, JUDGE_SEED), problem.targets
    loss, background = targets.at(1), targets.background
    with torch.no_grad():
        found = [float(pictures_loss(pool, colours, loss, background, n)) for n in range(N_VIEWS)]
    return sum(found) / N_VIEWS


def problem_of(frame: VolumeFrame, style: np.ndarray, seed: int) -> StepProblem:
    """The smoke with a far camera in front of it, to be painted in the style."""
    smoke = occupied(frame.density, frame.density_to_stage)
    place = np.eye(4)
    place[3, :3] = smoke.positions.mean(0)
    place[3, 2] += 20 * smoke.longest_side
    camera = CameraSource("/camera", place, 360.0, 24.0, 24.0, 0.0, 0.0, (0.1, 1e9), False)
    frame = replace(frame, camera=camera)
    config = resolve_config(
        {"views": {"camera": "/camera"}, "optimize": {"seed": seed, "steps": ["colour"]}}
    )
    scene = measure_scene([frame], config.views, config.optics, "Y", 1)
    scene = replace(scene, style_size=find_style_size([style], scene.voxels, config))
    context = make_context([style], scene, config, None, 24.0, None, 1)
    return open_frame(frame, context).colour_problem()


def main() -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--styles", nargs="+", default=["strokes", "waves", "petals"])
    parser.add_argument("--seeds", type=int, default=2, help="runs of each")
    parser.add_argument("--width", type=int, default=56, help="voxels across")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--report", type=Path, help="file of the table")
    options = parser.parse_args()
    name = "real_plume" if (options.data / PLUME_FILE).is_file() else "plume"
    frame = find_scenes([name], options.width, options.data)[0][name]
    found: dict[str, list[list[float]]] = {way: [] for way in (*WAYS, NO_CAMERA)}
    for style in options.styles:
        for seed in range(options.seeds):
            problem, first = problem_of(frame, style_pixels(style), seed), None
            for way, runs in found.items():
                seconds, losses = measure(problem, way)
                figures = [seconds, *losses]
                first = first or figures
                runs.append([a / b for a, b in zip(figures, first, strict=True)])
                told = " ".join(f"{loss:.3f}" for loss in losses)
                print(
                    f"{Path(style).stem}, seed {seed}, {way}: {seconds:.1f} s, {told}", flush=True
                )
    columns = ["views aside", "CPU time", *(f"{side} degrees" for side in SIDES)]
    rows = [
        f"| {way} | " + " | ".join(f"{x:.3f}" for x in np.mean(runs, axis=0)) + " |"
        for way, runs in found.items()
    ]
    names = ", ".join(Path(style).stem for style in options.styles)
    intro = [
        "# Views of other sides than the camera's",
        "",
        *(__doc__ or "").split("\n\n")[2].strip().splitlines(),
        f"{len(problem.smoke.ijk):,} voxels; styles {names}; {options.seeds} seeds.",
    ]
    command = ["python", "-m", "benchmarks.other_sides", *sys.argv[1:]]
    publish(table_page(intro, columns, rows, command), options.report)
    return 0


if __name__ == "__main__":
    sys.exit(main())

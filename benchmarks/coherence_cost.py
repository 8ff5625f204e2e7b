"""CPU seconds for a frame of a window, style and steadiness, beside another checkout.

    git archive --prefix=be60f8a/ be60f8a | tar x -C /tmp
    python -m benchmarks.coherence_cost --before /tmp/be60f8a [--resolution 32] [--frames 8]

Frames of the example plume are stylized in one window by both versions with their defaults, and by
this one with fewer iterations, each in a new process on one thread. The finished fields of all are
measured by the same code: the unseen loss of colour pictures that a ray marcher draws, and the
temporal error of the colours.
"""

import argparse
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parents[1]
STYLE = "strokes"
RUNS = (  # whether it is the other checkout, and the share of the iterations
    ("before", True, 1.0),
    ("now", False, 1.0),
    ("now, 2/3 of the iterations", False, 2 / 3),
    ("now, half of the iterations", False, 1 / 2),
    ("now, a third of the iterations", False, 1 / 3),
)
SCORED = 3  # every so many frames


def run_child(job_file: Path, result_file: Path) -> None:
    """Stylize by the code of the current folder; job and result are plain values and arrays."""
    from benchmarks.coherence_runs import make_shot, run_windows, simulate_plume

    resolution, n_frames, settings = pickle.loads(job_file.read_bytes())
    shot = make_shot(simulate_plume(resolution, n_frames), STYLE, settings, 256)
    run = run_windows(shot)
    frames = [
        {
            name: (field.values, tuple(map(int, field.ijk_min)))
            for name, field in (("density", outcome.density), ("emission", outcome.emission))
        }
        for outcome in run.outcomes
    ]
    result_file.write_bytes(pickle.dumps((run.seconds, shot.scene.gamma_w, frames)))


def stylize(tree: Path, resolution: int, n_frames: int, settings: Sequence[str]) -> Any:
    """The result of a checkout."""
    with tempfile.TemporaryDirectory() as folder:
        job, result = (Path(folder) / name for name in ("job", "result"))
        job.write_bytes(pickle.dumps((resolution, n_frames, list(settings))))
        environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
        command = [sys.executable, str(Path(__file__).resolve()), "--child", str(job), str(result)]
        subprocess.run(command, check=True, cwd=tree, env=environment)
        return pickle.loads(result.read_bytes())


def measure(found: Any, frames: Sequence[Any], style: Any) -> list[float]:
    """Seconds a frame, unseen losses from the front and all round, errors over 1 and 4 frames."""
    import numpy as np
    import torch

    from benchmarks.held_out import Result, cover_box
    from benchmarks.presets import unseen_loss
    from benchmarks.style_scores import RANGES
    from usdsmoke.base.volume import DenseField
    from usdsmoke.core.sequence.steadiness import Steadiness
    from usdsmoke.core.sequence.transit import Transit
    from usdsmoke.core.smoke.active import activate
    from usdsmoke.core.smoke.srgb import encode_srgb

    seconds, gamma_w, results = found
    steadiness, before = Steadiness(), None
    losses: list[list[float]] = []
    errors: dict[int, list[float]] = {1: [], 4: []}
    for number, (frame, result) in enumerate(zip(frames, results, strict=True)):
        matrix = frame.density.index_to_world
        fields = {name: DenseField(name, *found, matrix) for name, found in result.items()}
        density = fields["density"]
        emission = cover_box(fields["emission"], density)
        smoke = activate(density, np.eye(4), torch.device("cpu"))
        place = tuple((smoke.ijk.numpy() - np.asarray(emission.ijk_min)).T)
        light = torch.from_numpy(np.ascontiguousarray(emission.values[place]))
        colours = encode_srgb(light / (gamma_w * smoke.density)[:, None]).clamp(0, 1)
        transit = None if before is None else Transit(before, 1 / 24)
        for lag, error in steadiness.compare(smoke, colours, transit).items():
            if lag in errors:
                errors[lag].append(error)
        before = frame
        if number % SCORED == 0:
            whole = Result(density, emission, np.eye(4), gamma_w)
            losses.append([unseen_loss(whole, style, RANGES["front"]), unseen_loss(whole, style)])
    return [
        seconds / len(frames), *np.mean(losses, axis=0), *(np.mean(errors[lag]) for lag in (1, 4))
    ]  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    from benchmarks.circumstances import publish, table_page
    from benchmarks.coherence_runs import simulate_plume
    from benchmarks.control_scenes import paint_styles
    from usdsmoke.base.settings import Config

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--before", type=Path, required=True, help="a checkout of be60f8a")
    parser.add_argument("--resolution", type=int, default=32, help="voxels across the plume's box")
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--report", type=Path, help="Markdown file for the table")
    given = parser.parse_args(arguments)
    frames = simulate_plume(given.resolution, given.frames)
    style, config = paint_styles([STYLE], 256)[STYLE], Config()
    rows = []
    for name, is_before, share in RUNS:
        settings = [f"windows.size={given.frames}"]
        for step in ("shape", "colour") if share < 1 else ():
            iterations = [round(share * n) for n in getattr(config, step).iterations]
            settings.append(f"{step}.iterations={iterations}")
        tree = given.before.resolve() if is_before else HERE
        values = measure(stylize(tree, given.resolution, given.frames, settings), frames, style)
        rows.append(f"| {name} | " + " | ".join(f"{value:.3f}" for value in values) + " |")
        print(rows[-1], file=sys.stderr, flush=True)
    intro = [
        "# A window at equal style",
        "",
        f"The example plume, {given.resolution} voxels across, {given.frames} frames in one",
        f"window, style `{STYLE}`. *Before*: the version of `--before` with its defaults.",
    ]
    columns = ["run", "CPU s a frame", "unseen loss, front", "unseen loss, all round"]
    columns += ["temporal error of colour, 1 frame", "4 frames"]
    words = ["python -m benchmarks.coherence_cost", *(arguments or sys.argv[1:])]
    publish(table_page(intro, columns, rows, words), given.report)
    return 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        run_child(*map(Path, sys.argv[2:4]))
        sys.exit(0)
    sys.exit(main())

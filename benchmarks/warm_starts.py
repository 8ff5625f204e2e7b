"""Warm starts against cold ones: iterations and time to reach an equal style distance.

    python -m benchmarks.warm_starts [--resolution 48] [--frames 5] [--style strokes]

Takes consecutive frames of the example plume through the shape step and through the colour step, by
itself each: cold (every frame from rest or noise, all octaves) and warm (from its neighbour's
result, carried along; the finest octave alone), with several numbers of iterations. Nothing is
averaged with the next frame, no coarse step is shared, and no octave stops early.
"""

import argparse
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.circumstances import circumstances
from benchmarks.coherence_measures import style_distances
from benchmarks.coherence_runs import Outcome, Run, Shot, make_shot, simulate_plume
from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.base.frame_report import Progress
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.config.settings import Config
from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.sequence.stylize import StylizedFrame, stylize_window
from usdsmoke.core.smoke.active import activate

__all__ = ["Row", "cheapest_equal", "main", "measure_step", "render_report"]

WARM = {"shape": (2, 4, 8, 16, 24, 40), "colour": (4, 8, 16, 32, 48, 80, 120)}
COLD = (1.0, 0.5, 0.25)  # shares of the configured iterations
KIND = {"shape": "grey", "colour": "colour"}  # the pictures that a step is judged by
BASE = ["optimize.tolerance=0", "shape.smoothing=0", "colour.smoothing=0"]


@dataclass(frozen=True)
class Row:
    """One way of starting, means over all frames but the first."""

    start: str  # "cold" or "warm"
    iterations: tuple[int, ...]  # of every octave, coarse to fine
    cpu_s: float
    distance: float


def measure_step(shot: Shot, step: str, warm: Sequence[int], cold: Sequence[float]) -> list[Row]:
    """The step's rows: cold ones first, the configured number of iterations first of all.

    Args:
        step: "shape" or "colour".
        warm: iterations of the finest octave.
        cold: shares of the configured iterations.
    """
    config = shot.config.replace(optimize=shot.config.optimize.replace(steps=[step]))
    shot = replace(shot, config=config)
    octaves = getattr(config, step).iterations
    rows = []
    for share in cold:
        plan = tuple(max(1, round(share * n)) for n in octaves)
        alone = _with_iterations(config, step, plan)
        rows.append(_measure(shot, step, "cold", plan, alone))
    for n in warm:
        windows = config.windows.replace(warm_iterations=n / octaves[-1])
        rows.append(_measure(shot, step, "warm", (n,), config.replace(windows=windows)))
    return rows


def _with_iterations(config: Config, step: str, plan: Sequence[int]) -> Config:
    section = getattr(config, step).replace(iterations=list(plan))
    return config.replace(**{step: section})


def _measure(shot: Shot, step: str, start: str, plan: tuple[int, ...], config: Config) -> Row:
    chains = [list(shot.frames)] if start == "warm" else [[frame] for frame in shot.frames[1:]]
    outcomes, seconds = [], []
    for frames in chains:
        done, spent = _stylize(shot, frames, config)
        skipped = 1 if start == "warm" else 0  # the first frame of a chain starts cold
        outcomes += [_outcome(*pair) for pair in zip(frames, done, strict=True)][skipped:]
        seconds += spent[skipped:]
    distance = getattr(style_distances(shot, Run(outcomes, 0.0)), KIND[step]).mean()
    print(f"{step} {start} {plan}: {distance:.3f}", file=sys.stderr, flush=True)
    return Row(start, plan, float(np.mean(seconds)), float(distance))


def _stylize(
    shot: Shot, frames: Sequence[VolumeFrame], config: Config
) -> tuple[list[StylizedFrame], list[float]]:
    """The frames, and the CPU seconds from each one's first iteration to its last."""
    begun: dict[float, float] = {}
    ended: dict[float, float] = defaultdict(float)

    def note(state: Progress) -> None:
        now = time.process_time()
        begun.setdefault(state.time_code, now)
        ended[state.time_code] = now

    done = list(stylize_window(frames, [shot.style], shot.scene, config, note))
    return done, [ended[frame.time_code] - begun[frame.time_code] for frame in frames]


def _outcome(frame: VolumeFrame, done: StylizedFrame) -> Outcome:
    """The finished fields; black where there was no colour step. No displacement is looked at."""
    still = activate(frame.density, frame.density_to_stage, torch.device("cpu"))
    lattice = Lattice(np.zeros(3), (1, 1, 1), np.eye(4))
    none = Displacement(torch.zeros(1, 1, 1, 3), lattice)
    density, emission = done.density, done.emission
    if emission is None:
        black = np.zeros((*density.values.shape, 3), np.float32)
        emission = replace(density, name="emission", values=black, background=(0.0, 0.0, 0.0))
    return Outcome(frame, still, none, density, emission)


def cheapest_equal(rows: Sequence[Row]) -> Row | None:
    """The warm row with the fewest iterations that is no farther from the style than the first."""
    equal = [row for row in rows if row.start == "warm" and row.distance <= rows[0].distance]
    return min(equal, key=lambda row: sum(row.iterations), default=None)


def render_report(
    found: dict[str, list[Row]], shot: Shot, style: str, command: Sequence[str]
) -> str:
    """The tables as Markdown."""
    shape = " x ".join(map(str, shot.frames[0].density.values.shape))
    lines = [
        "# Warm starts",
        "",
        f"The example plume, {shape} voxels, style `{style}`, means of {len(shot.frames) - 1}",
        "frames. Cold: from rest (shape) or noise (colour), through all octaves. Warm: from the",
        "neighbour's result, carried along by the velocity; the finest octave alone. CPU seconds",
        "from the first iteration to the last. The style distance is the optimiser's loss of the",
        "finished picture, from views that it never had.",
    ]
    for step, rows in found.items():
        lines += [
            "",
            f"## {step.capitalize()} step",
            "",
            "| start | iterations | CPU s | style distance |",
            "|---|---|---|---|",
            *(
                f"| {row.start} | {' + '.join(map(str, row.iterations))} | {row.cpu_s:.2f} "
                f"| {row.distance:.3f} |"
                for row in rows
            ),
            "",
            _sentence(rows),
        ]
    return "\n".join([*lines, "", *circumstances(command)]) + "\n"


def _sentence(rows: Sequence[Row]) -> str:
    cold, equal = rows[0], cheapest_equal(rows)
    if equal is None:
        best = min((row for row in rows if row.start == "warm"), key=lambda row: row.distance)
        more = best.distance / cold.distance - 1
        return (
            f"No warm start comes as near as the cold one with all of its iterations: the best "
            f"({sum(best.iterations)} iterations) stays {more:.1%} farther away."
        )
    return (
        f"Equal style distance: {sum(equal.iterations)} iterations and {equal.cpu_s:.2f} s warm, "
        f"{sum(cold.iterations)} and {cold.cpu_s:.2f} s cold: {equal.cpu_s / cold.cpu_s:.0%} of "
        "the time."
    )


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--resolution", type=int, default=48, help="voxels across the plume's box")
    parser.add_argument("--frames", type=int, default=5, help="the first of them is not counted")
    parser.add_argument("--style", default="strokes", help="one of the example styles")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings")
    parser.add_argument("--report", type=Path, default=Path("benchmarks/results/warm_starts.md"))
    options = parser.parse_args(arguments)
    words = [
        "python -m benchmarks.warm_starts",
        *(sys.argv[1:] if arguments is None else arguments),
    ]
    try:
        frames = simulate_plume(options.resolution, options.frames)
        shot = make_shot(frames, options.style, [*BASE, *options.settings])
        found = {step: measure_step(shot, step, WARM[step], COLD) for step in WARM}
        report = render_report(found, shot, options.style, words)
        options.report.parent.mkdir(parents=True, exist_ok=True)
        options.report.write_text(report, encoding="utf-8")
    except (OSError, ValueError, UsdSmokeError) as error:
        print(f"benchmarks.warm_starts: {error}", file=sys.stderr)
        return 1
    print(report)
    return 0


if __name__ == "__main__":
    sys.exit(main())

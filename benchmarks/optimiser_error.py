"""The error budget's optimiser rows against runs four times as long.

    python -m benchmarks.optimiser_error [--width 32] [--styles strokes A.jpg] [--data FOLDER]

The shape step and the colour step run on small copies of the example plume and, where its file is
there, of the real plume, with each style: with half of the iterations, with the default iterations,
with twice as many, and stopped early by a large tolerance. Each run is repeated with four times the
iterations that it did in each octave. Both ends are judged over the whole pool of views, each drawn
once: the step is run again from its result with a vanishing rate.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.circumstances import publish, table_page
from benchmarks.control_scenes import style_pixels
from benchmarks.equal_judge import find_scenes
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.config.settings import Config
from usdsmoke.core.sequence.error_estimates import tail_figures
from usdsmoke.core.smoke.active import activate
from usdsmoke.core.steps.colour import run_colour_step
from usdsmoke.core.steps.optimize import Minimum
from usdsmoke.core.steps.shape import run_shape_step
from usdsmoke.core.steps.targets import StepProblem, make_targets
from usdsmoke.core.views.scene import measure_scene

__all__ = ["LIMITS", "Row", "main", "measure_step"]

LONGER = 4
STILL = 1e-12  # a learning rate that moves nothing
LIMITS = {  # name: share of the iterations, tolerance
    "cut short": (0.5, 0.0),
    "default": (1.0, None),
    "twice as many": (2.0, 0.0),
    "stopped early": (4.0, 0.1),
}


@dataclass(frozen=True)
class Row:
    """One run and one four times as long; errors relative to the end of the first."""

    scene: str
    style: str
    step: str
    limit: str  # of ``LIMITS``
    iterations: tuple[int, ...]  # that were done in each octave
    ended: str  # of the last octave
    loss: float
    told: float
    true: float

    @property
    def ratio(self) -> float:
        """Told over true."""
        return self.told / self.true if self.true > 0 else float("inf")


def measure_step(
    frame: VolumeFrame,
    style: np.ndarray,
    config: Config,
    step: str,
    limit: str,
    names: tuple[str, str] = ("", ""),
) -> Row:
    """A step's row.

    Args:
        step: "shape" or "colour".
        limit: of ``LIMITS``.
        names: of the scene and the style.
    """
    share, tolerance = LIMITS[limit]
    planned = [max(1, round(share * n)) for n in getattr(config, step).iterations]
    found, ends = _run(frame, style, _tolerant(config, tolerance), step, planned)
    done = tuple(end.iteration + 1 for end in ends)
    figures = tail_figures(step, ends, config.views.pool, config.views.count)
    longer = [LONGER * n for n in done]
    far, _ = _run(frame, style, _tolerant(config, 0.0), step, longer)
    near_loss, far_loss = (_judge(frame, style, config, step, it) for it in (found, far))
    told = figures.get("remaining", np.nan) / ends[-1].smoothed  # NaN: too few iterations
    true = (near_loss - far_loss) / near_loss
    return Row(*names, step, limit, done, ends[-1].reason, near_loss, told, true)


def _tolerant(config: Config, tolerance: float | None) -> Config:
    if tolerance is None:
        return config
    return config.replace(optimize=config.optimize.replace(tolerance=tolerance))


def _run(
    frame: VolumeFrame,
    style: np.ndarray,
    config: Config,
    step: str,
    iterations: Sequence[int],
    start: Any = None,
) -> tuple[Any, list[Minimum]]:
    """What the step finds, and how its octaves ended."""
    device = torch.device("cpu")
    optics = config.optics.replace(thicken=1.0)  # the smoke as it is
    scene = measure_scene([frame], config.views, optics, "Y", 1)
    smoke = activate(frame.density, frame.density_to_stage, device)
    problem = StepProblem(smoke, make_targets([style], scene, config, device), scene, config)
    if step == "colour":
        return run_colour_step(problem, iterations, start)
    begun = None if start is None else lambda lattice, _: start.on(lattice)
    return run_shape_step(problem, iterations, begun)


def _judge(frame: VolumeFrame, style: np.ndarray, config: Config, step: str, found: Any) -> float:
    """Mean loss of a result over the pool of views that the last octave draws from."""
    still = getattr(config, step).replace(learning_rate=STILL)
    octaves = len(getattr(config, step).iterations)
    config = _tolerant(config.replace(**{step: still}), 0.0)
    passage = -(-config.views.pool // config.views.count)
    iterations = [0] * (octaves - 1) + [passage]
    _, ends = _run(frame, style, config, step, iterations, found)
    return float(np.mean(ends[-1].losses))


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--width", type=int, default=32, help="voxels across the smoke's box")
    parser.add_argument("--styles", nargs="+", default=["strokes", "waves"], help="names or images")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="real volumes")
    parser.add_argument("--report", type=Path, help="Markdown file for the table")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    frames, _ = find_scenes(["plume", "real_plume"], options.width, options.data)
    styles = {Path(name).stem: style_pixels(name, 256) for name in options.styles}
    rows = []
    for scene, frame in frames.items():
        for name, style in styles.items():
            for step in ("shape", "colour"):
                for limit in LIMITS:
                    names = (scene, name)
                    rows.append(measure_step(frame, style, Config(), step, limit, names))
                    print(_line(rows[-1]), file=sys.stderr, flush=True)
    text = _report(rows, arguments if arguments is not None else sys.argv[1:])
    publish(text, options.report)
    return 0


def _line(row: Row) -> str:
    done = "/".join(map(str, row.iterations))
    cells = [row.scene, row.style, row.step, row.limit, done, row.ended, f"{row.loss:.3f}"]
    told, ratio = f"{100 * row.told:.1f} %", f"{row.ratio:.2f}"
    if np.isnan(row.told):
        told, ratio = "left out", ""
    cells += [told, f"{100 * row.true:.1f} %", ratio]
    return "| " + " | ".join(cells) + " |"


def _report(rows: Sequence[Row], arguments: Sequence[str]) -> str:
    told = [row for row in rows if not np.isnan(row.told)]
    within = sum(0.5 <= row.ratio <= 2 for row in told)
    intro = [
        "# The optimiser's rows of the error budget",
        "",
        "*Told* is what the row says: by how much a run four times as long would end lower,",
        "relative to the final loss. *True* is that run, both ends judged over all views of the",
        f"pool. Within a factor of 2: {within} of {len(told)}. The row is left out where the last",
        "octave has too few iterations.",
    ]
    columns = [
        "scene",
        "style",
        "step",
        "iterations",
        "done",
        "ended",
        "loss",
        "told",
        "true",
        "told / true",
    ]
    return table_page(
        intro, columns, [*map(_line, rows)], ["python -m benchmarks.optimiser_error", *arguments]
    )


if __name__ == "__main__":
    sys.exit(main())

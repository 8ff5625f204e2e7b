"""Whether a long shot keeps its style and its memory: many frames, in windows as configured.

    python -m benchmarks.long_shot [--resolution 20] [--frames 96] [--iterations N]

Simulates the example plume and runs ``usdsmoke stylize`` in child processes of one thread: the
first 8 frames, then all of them. Both runs' peak memory is compared. Style distances of the written
frames are those of ``benchmarks.coherence``; a line is fitted to them over the frames, and to their
difference to frames alone, which takes out what the smoke itself changes. Linux only.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from benchmarks.circumstances import circumstances
from benchmarks.coherence_measures import Distances, style_distances
from benchmarks.coherence_runs import Outcome, Run, Shot, run_alone
from benchmarks.control_scenes import EXAMPLES, paint_styles
from benchmarks.style_scores import stylize_in_child
from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.run_sections import WindowsConfig
from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.smoke.active import activate
from usdsmoke.core.views.scene import Scene
from usdsmoke.vdb.read import GridRequest, read_grids

__all__ = ["Line", "fit_line", "main", "window_means"]

SHORT = 8  # frames
STEP = 4  # every so many frames are scored
POOL = 4  # views: most of a tiny frame's time goes into preparing them
MARKS = {"slope": 2.0, "memory": 0.10}


@dataclass(frozen=True)
class Line:
    """A fitted line: its mean, and its change from the first frame to the last."""

    mean: float
    change: float
    error: float  # standard error of the change

    @property
    def is_flat(self) -> bool:
        """Whether the change is within its noise."""
        return abs(self.change) <= MARKS["slope"] * self.error


def fit_line(codes: np.ndarray, values: np.ndarray) -> Line:
    """Least squares over frames; at least three."""
    x = (codes - codes.mean()) / (codes[-1] - codes[0])
    slope = float((x * values).sum() / (x * x).sum())
    rest = values - values.mean() - slope * x
    variance = float((rest * rest).sum()) / (len(codes) - 2)
    return Line(float(values.mean()), slope, float(np.sqrt(variance / (x * x).sum())))


def window_means(codes: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means over the frames of each window, of timeCodes and of values.

    Frames of one window start from each other: as samples they are not independent, and a line's
    standard error would be too small.
    """
    window = (codes - 1) // WindowsConfig().size
    places = [window == number for number in np.unique(window)]
    codes, values = (np.array([x[place].mean() for place in places]) for x in (codes, values))
    return codes, values


@dataclass(frozen=True)
class _Result:
    """The files of a run, scored."""

    codes: np.ndarray
    windows: Distances
    alone: Distances
    peaks: tuple[float, float]  # GiB: of the short run and of the long one
    cpu_s: float  # of the long one


def measure(folder: Path, options: argparse.Namespace) -> _Result:
    """Both runs and the scores, in a folder."""
    command = [sys.executable, "simulate.py", str(folder / "source")]
    command += ["--frames", str(options.frames), "--resolution", str(options.resolution)]
    subprocess.run(command, check=True, cwd=EXAMPLES / "plume", stdout=sys.stderr)
    style = paint_styles(["strokes"], 256)["strokes"]
    Image.fromarray((style * 255).round().astype("uint8")).save(folder / "style.png")
    settings = [
        "optimize.threads=1", "optimize.error_budget=false", "optimize.device=cpu",
        f"views.pool={POOL}", "grids.refine=1",
    ]  # fmt: skip
    if options.iterations is not None:
        settings.append(f"optimize.iterations={options.iterations}")
    peaks = []
    for name, n in (("short", min(SHORT, options.frames)), ("long", options.frames)):
        _, cpu, peak = stylize_in_child(
            folder / "source/plume.usda", folder / "style.png", folder / name,
            [*settings, f"stage.frames=1-{n}"], ["--jobs", "1"],
        )  # fmt: skip
        peaks.append(peak)
    (run_folder,) = (folder / "long/vdb").iterdir()
    scene = Scene(**json.loads((run_folder / "run.json").read_text())["scenes"][0])
    codes = list(range(1, options.frames + 1, STEP))
    outcomes = [_read(folder / "source", run_folder, code) for code in codes]
    frames = [outcome.source for outcome in outcomes]
    shot = Shot(frames, style, resolve_config(settings), scene)
    return _Result(
        np.array(codes, float),
        style_distances(shot, Run(outcomes, 0.0)),
        style_distances(shot, run_alone(shot)),
        (peaks[0], peaks[1]),
        cpu,
    )


def _read(source: Path, result: Path, code: int) -> Outcome:
    """A frame as it was written, with its source."""
    config, (written,) = resolve_config([]).grids, result.glob(f"*.{code:04d}.vdb")
    (before,) = read_grids(source / f"plume.{code:04d}.vdb", [GridRequest("density")], config)
    density, emission = read_grids(
        written, [GridRequest("density"), GridRequest("emission")], config
    )
    frame = VolumeFrame(float(code), before, np.eye(4))
    still = activate(before, np.eye(4), torch.device("cpu"))
    rest = Displacement(torch.zeros(2, 2, 2, 3), Lattice(np.zeros(3), (2, 2, 2), np.eye(4)))
    return Outcome(frame, still, rest, density, emission)


def render_report(found: _Result, options: argparse.Namespace, words: Sequence[str]) -> str:
    """The tables as Markdown."""
    short, long = found.peaks
    rows = []
    for kind in ("colour", "grey"):
        windows, alone = (getattr(d, kind) for d in (found.windows, found.alone))
        for name, values in (
            ("windows", windows), ("alone", alone), ("windows - alone", windows - alone),
        ):  # fmt: skip
            line = fit_line(*window_means(found.codes, values))
            verdict = "flat" if line.is_flat else "not flat"
            rows.append(
                f"| {kind}, {name} | {line.mean:.3f} | {line.change:+.3f} | {line.error:.3f} "
                f"| {verdict} |"
            )
    times = "default" if options.iterations is None else options.iterations
    met = "met" if long / short - 1 <= MARKS["memory"] else "missed"
    lines = [
        "# A long shot",
        "",
        f"The example plume, {options.resolution} voxels across, {options.frames} frames in the",
        f"default windows, {times} iterations a step, {POOL} views, style `strokes`.",
        f"A line is fitted to the style distances of every {STEP}th frame, averaged over those",
        "of each window, as frames of a window are alike. *Change*: of the line, from the first",
        "window to the last; *flat*: no more than two standard errors of it.",
        "*Windows - alone* is without what the smoke itself changes.",
        "",
        "| style distance | mean | change | standard error | |",
        "|---|---|---|---|---|",
        *rows,
        "",
        f"- Peak memory of {min(SHORT, options.frames)} frames {short:.3f} GiB, of"
        f" {options.frames} {long:.3f}: {long / short - 1:+.1%} (mark +10 %: {met}).",
        f"- CPU seconds a frame, everything included: {found.cpu_s / options.frames:.2f}.",
        "",
        *circumstances(words),
    ]
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--resolution", type=int, default=20, help="voxels across the plume's box")
    parser.add_argument("--frames", type=int, default=96)
    parser.add_argument("--iterations", type=int, help="of each step; default: as by default")
    parser.add_argument("--report", type=Path, default=Path("benchmarks/results/long_shot.md"))
    options = parser.parse_args(arguments)
    words = ["python -m benchmarks.long_shot", *(arguments or sys.argv[1:])]
    try:
        with tempfile.TemporaryDirectory() as name:
            report = render_report(measure(Path(name), options), options, words)
    except (OSError, RuntimeError, subprocess.CalledProcessError, UsdSmokeError) as error:
        print(f"benchmarks.long_shot: {error}", file=sys.stderr)
        return 1
    options.report.parent.mkdir(parents=True, exist_ok=True)
    options.report.write_text(report, encoding="utf-8")
    print(report)
    return 0


if __name__ == "__main__":
    sys.exit(main())

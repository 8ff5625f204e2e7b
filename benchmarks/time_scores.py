"""Closeness to the style against time: the default statistic, sorting, Gram matrices, presets.

    python -m benchmarks.time_scores STAGE STYLE [--shares .125 .25 .5 1 2] [--picture FILE]

Runs ``usdsmoke stylize`` with shares of the default iterations, for each way of comparing features,
and with the presets ``draft`` and ``final``. Measures the written files on views that the optimiser
never had: the default style loss, and scores. Only *patches* are near to what is minimised.
Sheets and error estimates are left out.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pxr import Usd

from benchmarks.circumstances import publish, table_page
from benchmarks.held_out import held_out_angles, read_result, read_style, score_result, unseen_loss
from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.schedule import ALL_ROUND, octave_iterations
from usdsmoke.pictures import read_style_image

__all__ = ["WAYS", "Point", "main", "measure"]

# name: whether every sample is sorted, settings
WAYS: dict[str, tuple[bool, list[str]]] = {
    "distributions, counted (default)": (False, []),
    "distributions, sorted": (True, []),
    "Gram matrices": (False, ["losses.statistic=gram"]),
}
LOOKS = {name: look for name, look in zip(WAYS, ("#c03020", "#3060a0", "#408040"), strict=True)}
PRESETS = {"draft": "v", "final": "^"}  # markers; the default settings are ``daily``
MEASURES = {"patch": "patches", "spectrum_root": "spectrum root", "edges": "edges"}
N_VIEWS, IMAGE_SIZE = 6, 192
_RUN = (
    "import sys; from usdsmoke.core.style import sliced\n"
    "sliced.FEWEST_PER_BIN = 10**9 if sys.argv.pop(1) == 'sort' else sliced.FEWEST_PER_BIN\n"
    "from usdsmoke.ui.cli.main import main; sys.exit(main())"
)


@dataclass(frozen=True)
class Point:
    """One run."""

    way: str  # key of WAYS or of PRESETS
    share: float  # of the default iterations; 0 for a preset, which has its own
    cpu_s: float
    loss: float
    scores: dict[str, float]  # closures, and the share of outliers


def measure(stage: Path, style: Path, way: str, share: float) -> Point:
    """Stylize the first frame with one thread, and score it.

    Raises:
        RuntimeError: the run failed; its own message went to stderr.
    """
    sorts, settings = WAYS.get(way, (False, []))
    words = ["optimize.threads=1", "optimize.error_budget=false", "layer.contact_sheet=0"]
    words += settings if way in PRESETS else [*_iterations(share), *settings]
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", _RUN, "sort" if sorts else "count", "stylize", str(stage)]
        command += ["--style", str(style), "-o", folder, "--force"]
        command += ["--preset", way] if way in PRESETS else []
        command += [word for setting in words for word in ("--set", setting)]
        child = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            raise RuntimeError(f"usdsmoke stylize ended with {child.returncode}")
        (root_stage,) = Path(folder).glob("*_look.usda")
        opened = Usd.Stage.Open(str(root_stage))
        result = read_result(opened, time_code=opened.GetStartTimeCode())
        del opened
        angles = held_out_angles(N_VIEWS, *ALL_ROUND)
        found, _ = score_result(result, read_style(style, IMAGE_SIZE), angles, IMAGE_SIZE)
        loss = unseen_loss(result, read_style_image(style).pixels)
    scores = {name: float(found[name]["mean"]) for name in (*MEASURES, "outliers")}
    return Point(way, share, usage.ru_utime + usage.ru_stime, loss, scores)


def _iterations(share: float) -> list[str]:
    """Settings of a share of the default iterations."""
    words, config = [], Config()
    for step, per_octave in (
        ("shape", config.shape.iterations),
        ("colour", config.colour.iterations),
    ):
        counts = octave_iterations(per_octave, round(share * sum(per_octave)))
        words.append(f"{step}.iterations=[{','.join(map(str, counts))}]")
    return words


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("stage", type=Path)
    parser.add_argument("style", type=Path)
    parser.add_argument("--shares", type=float, nargs="+", default=[0.125, 0.25, 0.5, 1.0, 2.0])
    parser.add_argument("--report", type=Path, help="Markdown file for the table")
    parser.add_argument("--picture", type=Path, help="PNG for the curves")
    words = arguments if arguments is not None else sys.argv[1:]
    options = parser.parse_args(words)
    points = []
    # ways in turn: what else the machine does meets all of them
    runs = [(way, share) for share in options.shares for way in WAYS]
    for way, share in [*runs, *((preset, 0.0) for preset in PRESETS)]:
        points.append(measure(options.stage, options.style, way, share))
        print(points[-1], file=sys.stderr, flush=True)
    publish(_page(points, words), options.report)
    if options.picture:
        _draw(points, options.picture)
    return 0


def _page(points: Sequence[Point], arguments: Sequence[str]) -> str:
    intro = [
        "# Closeness to the style against time",
        "",
        "Shares of the default iterations, one thread. The loss is the default one, of colour",
        "pictures from views that the optimiser never had; 0 is the style itself. Scores",
        "(`benchmarks/measures.py`) are near 1 for crops of the style. A run with Gram matrices or",
        "with sorting is judged by the same figures. The preset `daily` is share 1.",
    ]
    columns = ["features compared by", "share", "CPU s", "unseen loss", *MEASURES.values()]
    rows = []
    order = [*WAYS, *PRESETS]
    for point in sorted(points, key=lambda point: (order.index(point.way), point.share)):
        share = f"{point.share:g}" if point.way in WAYS else ""
        cells = [point.way, share, f"{point.cpu_s:.1f}", f"{point.loss:.2f}"]
        cells += [f"{point.scores[name]:.2f}" for name in MEASURES]
        rows.append(f"| {' | '.join([*cells, format(point.scores['outliers'], '.3f')])} |")
    command = ["python -m benchmarks.time_scores", *arguments]
    return table_page(intro, [*columns, "outliers"], rows, command)


def _draw(points: Sequence[Point], file_path: Path) -> None:
    """Loss and scores against CPU seconds."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 3.4), dpi=100, layout="constrained")
    axes = figure.subplots(1, 1 + len(MEASURES))
    for way, colour in LOOKS.items():
        drawn = sorted((p for p in points if p.way == way), key=lambda point: point.cpu_s)
        x = [point.cpu_s for point in drawn]
        values = [[p.loss for p in drawn], *([p.scores[n] for p in drawn] for n in MEASURES)]
        for axis, y in zip(axes, values, strict=True):
            axis.plot(x, y, color=colour, marker="o", markersize=4, linewidth=1.4, label=way)
    for point in (point for point in points if point.way in PRESETS):
        values = [point.loss, *(point.scores[name] for name in MEASURES)]
        for axis, y in zip(axes, values, strict=True):
            mark = PRESETS[point.way]
            axis.plot([point.cpu_s], [y], color="#202020", marker=mark, ls="", label=point.way)
    spent = [point.cpu_s for point in points]
    ticks = [n for n in (3, 5, 10, 20, 40, 80, 160) if min(spent) / 2 < n < 2 * max(spent)]
    for axis, name in zip(axes, ("unseen loss", *MEASURES.values()), strict=True):
        axis.set(xscale="log", xlabel="CPU seconds", title=name)
        axis.set_xticks(ticks, ticks)
        axis.minorticks_off()
        axis.grid(True, color="#e6e6e6", linewidth=0.6)
        axis.set_axisbelow(True)
    lines, names = axes[0].get_legend_handles_labels()
    figure.legend(lines, names, loc="outside upper center", ncols=5, frameon=False)
    figure.savefig(file_path, metadata={"Software": None})


if __name__ == "__main__":
    sys.exit(main())

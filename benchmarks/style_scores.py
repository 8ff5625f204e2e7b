"""How near stylized real smoke comes to its style, on views that the optimiser never had.

    python -m benchmarks.style_scores [--styles A.png B.png] [--set views.count=3] [--quick]

Runs ``usdsmoke stylize`` in a child process twice for every style: with views around the front, as
far as those of a shot's camera go, and with the default views from all sides. Reads each result
through the stage that it wrote, draws held-out views from the same place with a renderer of its
own, and prints the table (also into --report). Without --styles it paints the example styles and
adds those of the data folder.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from pxr import Sdf, Usd

from benchmarks.circumstances import circumstances
from benchmarks.held_out import held_out_angles, read_result, read_style, score_result
from benchmarks.stages import find_stages
from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.core.smoke.schedule import AROUND_CAMERA
from usdsmoke.usd.layer_record import read_record

__all__ = ["Run", "main", "stylize_in_child"]

RANGES = {"front": AROUND_CAMERA, "all round": (180.0, 6.0)}
FRONT = [f"views.azimuth={AROUND_CAMERA[0]:g}", f"views.elevation={AROUND_CAMERA[1]:g}"]
VIEWS: dict[str, list[str]] = {"front": FRONT, "all round": []}  # settings of the optimiser's
N_VIEWS = 12
IMAGE_SIZE = 192  # the default of views.image_size
MEASURES = ("patch", "colour", "spectrum", "spectrum_root", "edges")
PAINTED = ("strokes", "waves")


@dataclass(frozen=True)
class Run:
    """One stylization and what it cost."""

    style: str
    cameras: str  # key of RANGES
    wall_s: float
    cpu_s: float
    peak_gib: float
    scores: dict[str, dict[str, Any]]


def stylize_in_child(
    stage: Path,
    style: Path,
    out_folder: Path,
    settings: Sequence[str],
    options: Sequence[str] = (),
) -> tuple[float, float, float]:
    """Run the installed command and return its wall seconds, CPU seconds and peak memory in GiB.

    Raises:
        RuntimeError: the command failed; its own message went to stderr.
    """
    command = [sys.executable, "-m", "usdsmoke", "stylize", str(stage), "--style", str(style)]
    command += ["-o", str(out_folder), "--force", *options]
    command += [word for setting in settings for word in ("--set", setting)]
    print("$", " ".join(command[1:]), file=sys.stderr, flush=True)
    begin = time.perf_counter()
    child = subprocess.Popen(command, stdout=sys.stderr)
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    wall = time.perf_counter() - begin
    if child.returncode:
        raise RuntimeError(f"usdsmoke stylize ended with {child.returncode}; see its message above")
    return wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**20


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    options = _parse(arguments)
    try:
        stage = find_stages(options.data, options.out)["real_plume"]
        styles = options.styles or _default_styles(options.data, options.out)
        runs: list[Run] = []
        for style in styles:
            for cameras in ["front"] if options.quick else RANGES:
                runs.append(_measure(stage, style, cameras, options))
            words = arguments if arguments is not None else sys.argv[1:]
            report = _report(runs, options.views, words)
            if options.report:  # after every run, for they take minutes
                options.report.parent.mkdir(parents=True, exist_ok=True)
                options.report.write_text(report, encoding="utf-8")
    except (OSError, RuntimeError, ValueError, UsdSmokeError) as error:
        print(f"benchmarks.style_scores: {error}", file=sys.stderr)
        return 1
    print(report)
    return 0


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--styles", type=Path, nargs="+", help="style images")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="real volumes")
    parser.add_argument("--out", type=Path, default=Path("out/bench"), help="folder to write into")
    parser.add_argument("--report", type=Path, help="Markdown file for the table")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings")
    parser.add_argument("--views", type=int, default=N_VIEWS, help="held-out views of each kind")
    parser.add_argument("--quick", action="store_true", help="the runs with front views only")
    parser.add_argument("--reuse", action="store_true", help="score results that are there already")
    return parser.parse_args(arguments)


def _style_size(look_folder: Path) -> float:
    record = read_record(Sdf.Layer.FindOrOpen(str(look_folder / "look.usda")))
    (size,) = record.style_sizes.values()
    return size


def _default_styles(data_folder: Path, out_folder: Path) -> list[Path]:
    painted = out_folder / "styles"
    if not all((painted / f"{name}.png").is_file() for name in PAINTED):
        command = [sys.executable, "examples/styles/paint.py", str(painted), "--only", *PAINTED]
        subprocess.run(command, check=True, stdout=sys.stderr)
    extra = sorted((data_folder / "styles").glob("*.jpg"))
    return [painted / f"{name}.png" for name in PAINTED] + extra


def _measure(stage: Path, style: Path, cameras: str, options: argparse.Namespace) -> Run:
    name = f"{style.stem}_{cameras.replace(' ', '_')}"
    folder, noted = options.out / name, options.out / f"{name}.json"
    if not (options.reuse and noted.is_file()):
        costs = stylize_in_child(stage, style, folder, [*VIEWS[cameras], *options.settings])
        noted.write_text(json.dumps(costs), encoding="utf-8")
    cost = json.loads(noted.read_text(encoding="utf-8"))
    (root_stage,) = folder.glob("*_look.usda")
    result = read_result(Usd.Stage.Open(str(root_stage)))
    picture = read_style(style, IMAGE_SIZE, _style_size(folder))
    angles = held_out_angles(options.views, *RANGES[cameras])
    scores, images = score_result(result, picture, angles, IMAGE_SIZE)
    _write_sheet(options.out / f"{name}.png", picture, images[:4])
    return Run(style.stem, cameras, *cost, scores)


def _write_sheet(image_file: Path, style: np.ndarray, images: Sequence[np.ndarray]) -> None:
    """The style and a few views side by side, to look at."""
    pictures = [style, *images]
    height = max(len(picture) for picture in pictures)
    padded = [np.pad(p, ((0, height - len(p)), (0, 4), (0, 0))) for p in pictures]
    row = np.rint(np.concatenate(padded, axis=1) * 255.0).astype(np.uint8)
    Image.fromarray(row).save(image_file)


def _report(runs: Sequence[Run], n_views: int, arguments: Sequence[str]) -> str:
    lines = [
        "# Closeness of style on the real plume",
        "",
        f"{n_views} held-out views a row, drawn from the written file by",
        "`benchmarks/raymarch.py`. *Front*: the optimiser has views within 12 degrees of azimuth",
        "and 6 of elevation, as with a shot's camera, and so are the held-out ones. *All round*:",
        "the default views; held-out ones all round, within 6 degrees of the horizon.",
        "Closure 0 is the smoke tinted with the style's mean colour, 1",
        "the style pasted through its mask (`benchmarks/measures.py`): mean over the views, in",
        "brackets the worst view; ± is the standard deviation of a single paste, its noise.",
        "Outliers: share of pixels in colours that the style does not have; mean (worst view).",
        "",
        "| style | cameras | " + " | ".join(MEASURES) + " | outliers | wall s | CPU s | peak GiB |",
        "|---|---|" + "---|" * (len(MEASURES) + 4),
        *(_row(run) for run in runs),
        "",
        *circumstances(["python -m benchmarks.style_scores", *arguments]),
    ]
    return "\n".join(lines) + "\n"


def _row(run: Run) -> str:
    cells = [
        f"{run.scores[name]['mean']:.2f} ({run.scores[name]['min']:.2f})"
        f" ± {np.mean(run.scores[name]['noise']):.2f}"
        for name in MEASURES
    ]
    outliers = run.scores["outliers"]
    cells.append(f"{outliers['mean']:.3f} ({outliers['max']:.3f})")
    cost = [f"{run.wall_s:.0f}", f"{run.cpu_s:.0f}", f"{run.peak_gib:.1f}"]
    return "| " + " | ".join([run.style, run.cameras, *cells, *cost]) + " |"


if __name__ == "__main__":
    sys.exit(main())

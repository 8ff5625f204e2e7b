"""What a run costs in this checkout and in another one, in turn: by part, and how good it is.

    python -m benchmarks.speed STAGE STYLE --tree OTHER [--frames 7] [--pairs 1] [--set KEY=VALUE]

Runs ``usdsmoke stylize`` with equal settings in both checkouts and prints wall and CPU seconds,
wall seconds by part, and the unseen loss (``benchmarks.held_out``), the mean of the first and the
last frame, which this checkout measures for both. Ratios are those of the means. CPU seconds depend
little on other work; wall seconds are worth something on a quiet machine alone.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from pxr import Usd

from benchmarks.held_out import read_result, unseen_loss
from benchmarks.style_scores import RANGES
from usdsmoke.base.time_codes import parse_frames
from usdsmoke.pictures import read_style_image

__all__ = ["checkout_parser", "main", "measure"]

HERE = Path(__file__).resolve().parents[1]
PARTS = (
    "preparing", "reading", "coarse step", "shape", "colour", "transport", "estimates", "writing",
    "assembling", "the rest",
)  # fmt: skip


def measure(tree: Path, stage: Path, style: Path, options: list[str]) -> dict[str, float]:
    """Seconds and unseen loss of one run.

    Args:
        tree: the checkout.
        stage: what is stylized.
        style: an image.
        options: of ``usdsmoke stylize``.
    """
    with tempfile.TemporaryDirectory() as folder:
        out, command = Path(folder) / "out", [sys.executable, "-m", "usdsmoke", "stylize"]
        command += [str(stage), "--style", str(style), "-o", str(out), "--json", *options]
        told = Path(folder) / "told.json"
        started = time.perf_counter()
        with told.open("wb") as file:
            environment = {**os.environ, "PYTHONPATH": str(tree)}
            child = subprocess.Popen(command, cwd=tree, env=environment, stdout=file)
            _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            raise RuntimeError(f"usdsmoke stylize ended with {child.returncode} in {tree}")
        found = {"wall": time.perf_counter() - started, "CPU": usage.ru_utime + usage.ru_stime}
        seconds = json.loads(told.read_text())["seconds"]
        found |= {part: seconds.get(part, 0.0) for part in PARTS}
        (root_stage,) = out.glob("*_look.usda")
        opened = Usd.Stage.Open(str(root_stage))
        ends = [read_result(opened, time_code=code) for code in _ends(options, opened)]
        pixels = read_style_image(style).pixels
        for name, ranges in (("", None), (", front", RANGES["front"])):
            losses = [unseen_loss(result, pixels, ranges) for result in ends]
            found[f"unseen loss{name}"] = sum(losses) / len(losses)
        return found


def _ends(options: list[str], stage: Usd.Stage) -> list[float]:
    """The first and the last timeCode that a run with these options has stylized."""
    ranges = parse_frames(options[options.index("--frames") + 1] if "--frames" in options else "")
    codes = [code for part in ranges for code in (part.first, part.last)]
    codes = codes or [stage.GetStartTimeCode(), stage.GetEndTimeCode()]
    return sorted({min(codes), max(codes)})


def checkout_parser(text: str | None) -> argparse.ArgumentParser:
    """Arguments of a comparison with another checkout.

    Args:
        text: the description.
    """
    parser = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("stage", type=Path)
    parser.add_argument("style", type=Path)
    parser.add_argument("--tree", type=Path, required=True, help="the other checkout")
    parser.add_argument("--frames", help="timeCodes; all without it")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = checkout_parser(__doc__)
    parser.add_argument("--pairs", type=int, default=1, help="runs of each")
    given = parser.parse_args(arguments)
    options = [word for setting in given.settings for word in ("--set", setting)]
    options += ["--frames", given.frames] if given.frames else []
    trees = [given.tree.resolve(), HERE]
    runs: dict[Path, list[dict[str, float]]] = {tree: [] for tree in trees}
    for _ in range(given.pairs):
        for tree in trees:
            runs[tree].append(measure(tree, given.stage.resolve(), given.style.resolve(), options))
    before, after = (
        {name: sum(run[name] for run in runs[tree]) / given.pairs for name in runs[tree][0]}
        for tree in trees
    )
    print("| | before | after | ratio |\n| --- | --- | --- | --- |")
    for name, value in before.items():
        ratio = f"{after[name] / value:.2f}" if value > 0.05 else "-"
        print(f"| {name} | {value:.2f} | {after[name]:.2f} | {ratio} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())

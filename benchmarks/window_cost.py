"""What windows cost: CPU time and memory against their size, memory against the shot's length.

    python -m benchmarks.window_cost [--resolution 40] [--quick] [--report FILE]

Simulates the example plume, then runs ``usdsmoke stylize`` in child processes of one thread each:
for every window size on the same 18 frames, without overlap, and for shots of 8, 24 and 72 frames
in windows of 8 with the default overlap. Long shots show the same 8 files again and again, so that
nothing but their length differs. Linux only.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image
from pxr import Usd, UsdVol

from benchmarks.circumstances import circumstances
from benchmarks.control_scenes import EXAMPLES, paint_styles
from benchmarks.style_scores import stylize_in_child
from usdsmoke.base.errors import UsdSmokeError

__all__ = ["Cost", "main", "render_report", "repeat_frames"]

SIZES = (1, 3, 5, 9, 17)
LENGTHS = (8, 24, 72)
WINDOW = 8  # frames, where the length varies
N_FRAMES = 18  # where the size varies: the longest window, and one that follows on it
MARKS = {"cpu": 0.15, "memory": 0.15, "length": 0.10}


@dataclass(frozen=True)
class Cost:
    """One run."""

    frames: int
    window: int
    cpu_s: float  # of all processes
    peak_gib: float  # of the largest process


def repeat_frames(source: Path, n_frames: int, period: int, target: Path) -> None:
    """A stage like the source's whose timeCodes 1 to ``n_frames`` show its first files in turn.

    Args:
        source: a stage with OpenVDBAsset prims whose files are sampled at 1, 2, ...
        period: how many files are used.
        target: file of the new stage, beside the source's.
    """
    stage = Usd.Stage.Open(str(source))
    for prim in stage.Traverse():
        if not prim.IsA(UsdVol.OpenVDBAsset):
            continue
        attribute = UsdVol.OpenVDBAsset(prim).GetFilePathAttr()
        files = [attribute.Get(float(code)) for code in range(1, period + 1)]
        for code in range(1, n_frames + 1):
            attribute.Set(files[(code - 1) % period].path, float(code))
    stage.SetEndTimeCode(n_frames)
    stage.GetRootLayer().Export(str(target))


def measure_sizes(folder: Path, sizes: Sequence[int], settings: Sequence[str]) -> list[Cost]:
    """One run a window size, over all frames of the plume."""
    return [
        _measure(folder / "source/plume.usda", N_FRAMES, size, folder, [*settings, _overlap(0)])
        for size in sizes
    ]


def measure_lengths(folder: Path, lengths: Sequence[int], settings: Sequence[str]) -> list[Cost]:
    """One run a length, in windows of equal size and with the default overlap."""
    costs = []
    for length in lengths:
        stage = folder / f"source/long_{length}.usda"
        repeat_frames(folder / "source/plume.usda", length, WINDOW, stage)
        costs.append(_measure(stage, length, WINDOW, folder, settings))
    return costs


def _overlap(n: int) -> str:
    return f"windows.overlap={n}"


def _measure(
    stage: Path, n_frames: int, size: int, folder: Path, settings: Sequence[str]
) -> Cost:  # fmt: skip
    kept = ["grids.refine=1", f"stage.frames=1-{n_frames}", f"windows.size={size}"]
    target = folder / f"look_{stage.stem}_{size}"
    _, cpu, peak = stylize_in_child(stage, folder / "style.png", target, [*kept, *settings])
    return Cost(n_frames, size, cpu, peak)


def render_report(
    sizes: Sequence[Cost], lengths: Sequence[Cost], resolution: int, command: Sequence[str]
) -> str:
    """Both tables as Markdown, each with what it was measured for."""
    larger = [cost for cost in sizes if cost.window > 3] or list(sizes)
    cpu = _spread([cost.cpu_s / cost.frames for cost in larger])
    memory = _spread([cost.peak_gib for cost in larger])
    length = _spread([cost.peak_gib for cost in lengths])
    lines = [
        "# What windows cost",
        "",
        f"`usdsmoke stylize` on the example plume, {resolution} voxels across, one thread. CPU",
        "time is of all processes and the whole command, coarse step included; the peak is the",
        "largest process's resident memory.",
        "",
        f"Against window size: {sizes[0].frames} frames, no overlap (an overlap of m frames",
        "computes m frames more in every window but the last).",
        "",
        "| window size | CPU s a frame | peak GiB |",
        "|---|---|---|",
        *(f"| {c.window} | {c.cpu_s / c.frames:.2f} | {c.peak_gib:.2f} |" for c in sizes),
        "",
        f"- Beyond 3 frames, greatest over smallest: CPU {_verdict(cpu, MARKS['cpu'])}, memory",
        f"  {_verdict(memory, MARKS['memory'])}.",
        "",
        f"Against the shot's length: windows of {WINDOW}, the default overlap.",
        "",
        "| frames | CPU s a frame | peak GiB |",
        "|---|---|---|",
        *(f"| {c.frames} | {c.cpu_s / c.frames:.2f} | {c.peak_gib:.2f} |" for c in lengths),
        "",
        f"- Greatest over smallest memory: {_verdict(length, MARKS['length'])}.",
        "",
        *circumstances(command),
    ]
    return "\n".join(lines) + "\n"


def _spread(values: Sequence[float]) -> float:
    return max(values) / min(values) - 1


def _verdict(spread: float, limit: float) -> str:
    met = "met" if spread <= limit else "missed"
    return f"+{spread:.1%} (mark +{limit:.0%}: {met})"


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--resolution", type=int, default=40, help="voxels across the plume's box")
    parser.add_argument("--iterations", type=int, default=60, help="of each step, all octaves")
    parser.add_argument("--report", type=Path, default=Path("benchmarks/results/window_cost.md"))
    parser.add_argument("--quick", action="store_true", help="two sizes and two short lengths")
    options = parser.parse_args(arguments)
    shared = [f"optimize.iterations={options.iterations}", "optimize.tolerance=0"]
    shared.append("optimize.threads=1")
    try:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            _prepare(folder, options.resolution)
            sizes = measure_sizes(folder, SIZES[:2] if options.quick else SIZES, shared)
            lengths = measure_lengths(folder, (8, 9) if options.quick else LENGTHS, shared)
    except (OSError, RuntimeError, subprocess.CalledProcessError, UsdSmokeError) as error:
        print(f"benchmarks.window_cost: {error}", file=sys.stderr)
        return 1
    words = [
        "python -m benchmarks.window_cost",
        *(sys.argv[1:] if arguments is None else arguments),
    ]
    report = render_report(sizes, lengths, options.resolution, words)
    options.report.parent.mkdir(parents=True, exist_ok=True)
    options.report.write_text(report, encoding="utf-8")
    print(report)
    return 0


def _prepare(folder: Path, resolution: int) -> None:
    """The plume's stage in ``source`` and a style image."""
    command = [sys.executable, "simulate.py", str(folder / "source")]
    command += ["--frames", str(N_FRAMES), "--resolution", str(resolution)]
    subprocess.run(command, check=True, cwd=EXAMPLES / "plume", stdout=sys.stderr)
    pixels = (paint_styles(["strokes"], 256)["strokes"] * 255).round().astype("uint8")
    Image.fromarray(pixels).save(folder / "style.png")


if __name__ == "__main__":
    sys.exit(main())

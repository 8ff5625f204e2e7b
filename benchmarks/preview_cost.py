"""What a picture costs in this checkout and in another one, and how far their pictures differ.

    python -m benchmarks.preview_cost STAGE ... [--tree OTHER] [--camera PATH] [--repeats 5]

Draws every stage at 512 x 512 with ``usdsmoke preview`` on one thread, from the front and, if it is
named, through a camera of the stage. CPU seconds are those of the command with its worker process,
the least of some repeats; checkouts take turns. Differences are of the OpenEXR pictures, relative
to the brightest value. The second table is where the seconds of this checkout go before the first
pixel: processes that import more and more of what a preview imports, and one that reads a grid.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import OpenEXR

__all__ = ["cpu_seconds", "main"]

HERE = Path(__file__).resolve().parents[1]
SIZE = "512x512"
STEPS = {
    "Python": "pass",
    "NumPy": "import numpy",
    "OpenUSD": "import numpy; from pxr import Usd, UsdGeom, UsdLux, UsdUtils, UsdVol",
    "usdsmoke, with pydantic, yaml and Pillow": "import usdsmoke.ui.cli.arguments, "
    "usdsmoke.ui.cli.main as main, usdsmoke.pictures.preview; main._commands()",
}


def cpu_seconds(command: list[str], tree: Path) -> float:
    """User and system time of a command and the processes that it waits for.

    Args:
        tree: the checkout that it runs in.
    """
    environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
    child = subprocess.Popen(command, cwd=tree, env=environment, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise RuntimeError(f"{command} ended with {child.returncode} in {tree}")
    return usage.ru_utime + usage.ru_stime


def _preview(stage: Path, camera: str, target: Path) -> list[str]:
    words = [sys.executable, "-m", "usdsmoke", "preview", str(stage), "-o", str(target)]
    return [*words, "--size", SIZE, *(["--camera", camera] if camera else [])]


def _pixels(file_path: Path) -> np.ndarray:
    """[H W 4] of a preview's part rgba."""
    with OpenEXR.File(str(file_path), separate_channels=True) as image:
        channels = image.parts[0].channels
        return np.stack([np.array(channels[name].pixels) for name in "RGBA"], axis=-1)


def _compare(stage: Path, camera: str, trees: list[Path], repeats: int) -> list[str]:
    """Seconds in each checkout, and largest and rms difference from the first."""
    least = [np.inf] * len(trees)
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(repeats):
            for number, tree in enumerate(trees):
                found = cpu_seconds(_preview(stage, camera, Path(folder) / "a.png"), tree)
                least[number] = min(least[number], found)
        pictures = []
        for number, tree in enumerate(trees):
            target = Path(folder) / f"{number}.exr"
            cpu_seconds(_preview(stage, camera, target), tree)
            pictures.append(_pixels(target))
    apart = (pictures[-1] - pictures[0]) / pictures[0].max()
    cells = [f"{seconds:.2f}" for seconds in least]
    if len(trees) > 1:
        cells += [f"{np.abs(apart).max():.1e}", f"{np.sqrt((apart**2).mean()):.1e}"]
    return cells


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("stages", type=Path, nargs="+", metavar="STAGE")
    parser.add_argument("--tree", type=Path, help="the other checkout")
    parser.add_argument("--camera", default="", help="prim path of a Camera of all stages")
    parser.add_argument("--repeats", type=int, default=5)
    given = parser.parse_args(arguments)
    trees = [*([given.tree.resolve()] if given.tree else []), HERE]
    names = ["before", "after", "largest difference", "rms"] if given.tree else ["CPU s"]
    print("| ".join(["| picture ", *names]) + " |\n" + "| --- " * (len(names) + 1) + "|")
    for stage in given.stages:
        for camera in dict.fromkeys(["", given.camera]):
            cells = _compare(stage.resolve(), camera, trees, given.repeats)
            print("| " + " | ".join([f"{stage.stem}, {camera or 'front'}", *cells]) + " |")
    print("\n| part | CPU s |\n| --- | --- |")
    before = 0.0
    for name, code in STEPS.items():
        command = [sys.executable, "-c", code]
        least = min(cpu_seconds(command, HERE) for _ in range(given.repeats))
        print(f"| {name} | {least - before:.2f} |")
        before = least
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""A long shot of little smoke: the share of files in its time, and what a second process gains.

    python -m benchmarks.small_shot STYLE [--frames 100] [--resolution 11] [--preset draft]
        [--set KEY=VALUE] [--ways NAME ...] [--report FILE]

Simulates the example plume in so few voxels that reading and writing could take longer than the
rest (11: about 800 a frame), and runs ``usdsmoke stylize`` on all of it in each of ``WAYS``, in
turn. The values of all written grids must have the same bits. Wall seconds are worth something on a
quiet machine alone; CPU seconds, of all processes, depend little on other work.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.circumstances import publish, table_page
from benchmarks.control_scenes import EXAMPLES
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb.read import GridRequest, read_grids

__all__ = ["main", "measure"]

HERE = Path(__file__).resolve().parents[1]
WAYS = {  # options of usdsmoke stylize
    "one process, one thread": ("--jobs", "1", "--set", "optimize.threads=1"),
    "one process, all cores as threads": ("--jobs", "1"),
    "two processes": ("--jobs", "2"),
}
FILES = ("reading", "writing", "assembling")
OTHERS = ("coarse step", "shape", "colour", "transport", "estimates")


def measure(stage: Path, style: Path, options: list[str], folder: Path) -> tuple[dict, str]:
    """Seconds of a run by part, of the clock and of the processor, and the digest of its grids."""
    command = [sys.executable, "-m", "usdsmoke", "stylize", str(stage), "--style", str(style)]
    started = time.perf_counter()
    with (folder / "told.json").open("wb") as told:
        child = subprocess.Popen(
            [*command, "-o", str(folder / "out"), "--json", *options],
            cwd=HERE, stdout=told, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise RuntimeError(f"usdsmoke stylize ended with {child.returncode}")
    seconds = json.loads((folder / "told.json").read_text())["seconds"]
    seconds["wall"] = time.perf_counter() - started
    seconds["CPU"] = usage.ru_utime + usage.ru_stime
    digest = hashlib.sha256()
    for file_path in sorted((folder / "out").rglob("*.vdb")):
        digest.update(file_path.name.encode())
        for grid in read_grids(
            file_path,
            [GridRequest("density"), GridRequest("emission", components=3)],
            GridsConfig(),
        ):
            digest.update(grid.values.tobytes())
    return seconds, digest.hexdigest()


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("style", type=Path, help="an image")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--resolution", type=int, default=11, help="voxels along the box's width")
    parser.add_argument("--preset", default="", help="none: the defaults")
    parser.add_argument("--set", dest="settings", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--ways", nargs="+", default=list(WAYS), help="some of them")
    parser.add_argument("--report", type=Path, help="Markdown file for the table")
    given = parser.parse_args(arguments)
    options = ["--preset", given.preset] if given.preset else []
    options += ["--set", "grids.refine=1"]
    options += [word for setting in given.settings for word in ("--set", setting)]
    lines, digests = [], set()
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "source"
        simulate = [str(EXAMPLES / "plume/simulate.py"), str(source)]
        sizes = ["--frames", str(given.frames), "--resolution", str(given.resolution)]
        subprocess.run([sys.executable, *simulate, *sizes], check=True, capture_output=True)
        for number, way in enumerate(given.ways):
            place = Path(folder) / str(number)
            place.mkdir()
            stage = source / "plume.usda"
            found, digest = measure(stage, given.style.resolve(), [*options, *WAYS[way]], place)
            digests.add(digest)
            lines.append(_line(way, found))
            print(lines[-1], digest[:8], file=sys.stderr, flush=True)
    intro = [
        "# A long shot of little smoke",
        "",
        f"{given.frames} frames of the example plume, {given.resolution} voxels across. *Files*:",
        "reading, writing and assembling. Parts are seconds by the clock.",
        "The grids of all runs have the same bits."
        if len(digests) == 1
        else "THE GRIDS OF THE RUNS DIFFER.",
    ]
    columns = ["run", "wall s", "CPU s", "files s", "share of files", *OTHERS]
    words = arguments if arguments is not None else sys.argv[1:]
    publish(
        table_page(intro, columns, lines, ["python -m benchmarks.small_shot", *words]), given.report
    )
    return 0 if len(digests) == 1 else 1


def _line(way: str, found: dict[str, float]) -> str:
    files = sum(found.get(part, 0.0) for part in FILES)
    cells = [way, f"{found['wall']:.0f}", f"{found['CPU']:.0f}", f"{files:.1f}"]
    cells += [f"{files / found['all']:.0%}" if found.get("all") else ""]
    cells += [f"{found.get(part, 0.0):.0f}" for part in OTHERS]
    return "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    sys.exit(main())

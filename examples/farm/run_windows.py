"""Do what a render queue does: the coarse step, windows in parallel, the assembly.

    python examples/farm/run_windows.py

Each task is a process of its own, as on separate machines that share the output folder.
"""

import argparse
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

DEMO = Path("out/demo")
SETTINGS = (
    "windows.size=2", "windows.overlap=1", "views.image_size=48", "optimize.iterations=10",
    "optimize.threads=1",
)  # fmt: skip
PARALLEL = 2  # tasks at once


def usdsmoke(*arguments: str | Path) -> str:
    """Run the command ``usdsmoke`` and return what it prints; an error ends the script."""
    command = [sys.executable, "-m", "usdsmoke", *map(str, arguments)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode != 0:
        sys.exit(done.returncode)
    return done.stdout


def main() -> None:
    """Read the command line, list the windows, run all tasks."""
    parser = argparse.ArgumentParser(description="Stylize a stage window by window.")
    parser.add_argument("--stage", type=Path, default=DEMO / "source/plume.usda")
    parser.add_argument("--style", type=Path, default=DEMO / "styles/strokes.png")
    parser.add_argument("--output", type=Path, default=Path("out/farm"))
    options = parser.parse_args()
    settings = [text for setting in SETTINGS for text in ("--set", setting)]
    run = ["stylize", options.stage, "--style", options.style, "-o", options.output, *settings]

    n_windows = len(json.loads(usdsmoke(*run, "--dry-run", "--json"))["windows"])
    usdsmoke(*run, "--coarse")
    with ThreadPoolExecutor(PARALLEL) as tasks:
        list(tasks.map(lambda k: usdsmoke(*run, "--window", str(k)), range(n_windows)))
    print(f"{n_windows} windows are done")
    print(usdsmoke("assemble", options.output))


if __name__ == "__main__":
    main()

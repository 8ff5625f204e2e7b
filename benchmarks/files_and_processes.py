"""What reading and writing files costs: processes started, processor time and seconds by part.

    python -m benchmarks.files_and_processes STAGE STYLE [--tree OTHER] [--pairs 3] [--core]

runs the stage in this checkout and, in turn with it, in another one (``--tree``), so that ratios
come from one session. A stand-in takes the place of the core, unless ``--core`` asks for the real
one with one iteration an octave: files cost the same whatever is computed between them. Windows of
eight frames that overlap in four make a third of twelve frames be computed twice and blended.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

__all__ = ["main", "measure"]

HERE = Path(__file__).resolve().parents[1]
SETTINGS = ("windows.size=8", "windows.overlap=4", "views.image_size=112", "views.pool=12")
SHORT = ("optimize.iterations=1", "shape.iterations=1", "colour.iterations=1")
_PARTS = ("preparing", "reading", "transport", "writing", "assembling", "the rest", "all")

# Runs in a process of the checkout that is measured.
_PROGRAM = """
import atexit, json, os, subprocess, sys
stage, style, output, fake, settings = json.loads(sys.argv[1])
started, figures, real = [], {}, subprocess.Popen.__init__

def counted(self, *arguments, **options):
    started.append(arguments)
    real(self, *arguments, **options)

def tell():  # after everything that usdsmoke does at its end
    own, system, theirs, their_system, _ = os.times()
    figures.update(processes=len(started), own=own + system, children=theirs + their_system)
    print("FIGURES" + json.dumps(figures))

subprocess.Popen.__init__ = counted
atexit.register(tell)
if fake:
    from tests.fixtures.pipeline_fixtures import FakeCore
    sys.modules.update(FakeCore().modules())
import usdsmoke
figures["seconds"] = dict(
    usdsmoke.stylize(stage, style=[style], output=output, settings=settings).seconds
)
"""


def measure(tree: Path, stage: Path, style: Path, is_fake: bool) -> dict[str, float]:
    """Processes started, processor seconds of all and of children, seconds by part.

    Args:
        tree: the checkout.
        stage: a stage with a sequence of VDB files.
        style: an image.
        is_fake: whether a stand-in takes the place of the core.
    """
    settings = SETTINGS if is_fake else (*SETTINGS, *SHORT)
    with tempfile.TemporaryDirectory() as output:
        request = [str(stage), str(style), output + "/out", is_fake, settings]
        done = subprocess.run(
            [sys.executable, "-c", _PROGRAM, json.dumps(request)],
            cwd=tree,
            env={**os.environ, "PYTHONPATH": str(tree)},
            capture_output=True,
            text=True,
            check=True,
        )
    found = json.loads(done.stdout.rpartition("FIGURES")[2])
    seconds = {name: found["seconds"].get(name, 0.0) for name in _PARTS}
    whole = found["own"] + found["children"]
    return {"processes": found["processes"], "cpu": whole, "cpu of others": found["children"]} | (
        seconds
    )


def main() -> None:
    """Print the figures of every run, and the ratio of the means."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("stage", type=Path)
    parser.add_argument("style", type=Path)
    parser.add_argument("--tree", type=Path, help="another checkout, to compare with")
    parser.add_argument("--pairs", type=int, default=3, help="runs of each")
    parser.add_argument("--core", action="store_true", help="the real core, one iteration")
    given = parser.parse_args()
    trees = [tree.resolve() for tree in (given.tree, HERE) if tree is not None]
    runs: dict[Path, list[dict[str, float]]] = {tree: [] for tree in trees}
    for _ in range(given.pairs):
        for tree in trees:
            figures = measure(tree, given.stage.resolve(), given.style.resolve(), not given.core)
            runs[tree].append(figures)
            print(tree.name, *(f"{name} {value:.4g}" for name, value in figures.items()), sep=", ")
    means = [
        {name: sum(run[name] for run in found) / len(found) for name in found[0]}
        for found in runs.values()
    ]
    if len(means) == 2:
        shares = {name: means[1][name] / value for name, value in means[0].items() if value > 0}
        print("ratio", *(f"{name} {share:.3f}" for name, share in shares.items()), sep=", ")


if __name__ == "__main__":
    main()

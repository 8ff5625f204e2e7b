"""What it costs in style that displacements do not fold: loss against folded smoke, a curve.

    python -m benchmarks.folding_price [--scenes "plume 32" ...] [--seeds 3] [--report FILE]

The shape step runs with the default settings, once taken at once and without a penalty on folding
(the displacement that is as free as can be), and with other steps of the flow and weights of the
penalty. The written density is judged by the grey style loss of 24 views that no run had, inside
the source's silhouette. *Price* is by how much that is above the free displacement's, mean over
seeds, each against the free run of the same seed.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np
import torch

from benchmarks.circumstances import publish, table_page
from benchmarks.control_scenes import paint_styles
from benchmarks.told_true_scenes import Scene, make_scenes
from benchmarks.true_errors import FOLDED, READ_TWICE, UNREAD, unevenness
from usdsmoke.config.settings import Config
from usdsmoke.core.fields import flow
from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.sequence.frame_loop import run_frames
from usdsmoke.core.sequence.frame_state import PaintedFrame, make_context
from usdsmoke.core.smoke.active import activate
from usdsmoke.core.steps import shape
from usdsmoke.core.steps.pictures import grey_view
from usdsmoke.core.views.project import column_map
from usdsmoke.core.views.scene import frame_views, measure_scene

__all__ = ["FREE", "Run", "main", "measure", "price"]

SCENES = ("plume 32", "real plume 1/4")
FRESH = 24  # views
JUDGE_SEED = 98765
FREE = "at once, no penalty"
WAYS = {  # name: doublings of the flow, weight of the penalty; None: as the code has it
    FREE: (0, 0.0),
    "at once, penalty 10": (0, 10.0),
    "flow in 2 steps, penalty 10": (1, 10.0),
    "flow in 4 steps, no penalty": (2, 0.0),
    "flow in 4 steps, penalty 3": (2, 3.0),
    "the defaults": (None, None),
    "flow in 8 steps, penalty 10": (3, 10.0),
}


@dataclass(frozen=True)
class Run:
    """One run of the shape step."""

    scene: str
    way: str  # of ``WAYS``
    seed: int
    cpu_s: float
    loss: float  # of views that it had not
    folded: float  # of the voxels
    unread: float  # of the mass
    read_twice: float  # of the mass


def measure(name: str, scene: Scene, style: np.ndarray, way: str, seed: int) -> Run:
    """Move a scene's frame, and judge it."""
    config = Config()
    config = config.replace(
        optimize=config.optimize.replace(threads=1, steps=["shape"], seed=seed, error_budget=False)
    )
    optics = config.optics.replace(thicken=1.0)  # the smoke as it is
    measured = measure_scene([scene.frame], config.views, optics, "Y", 1)
    context = make_context([style], measured, config, None, 24.0, None, 1)
    begin = time.process_time()
    with _regular(*WAYS[way]):
        (frame,) = run_frames([scene.frame], context)
    seconds = time.process_time() - begin
    assert frame.displacement is not None
    lattice = frame.displacement.lattice
    u = lattice.from_stage(frame.displacement.values).numpy() / np.asarray(lattice.spacing)
    found = unevenness(u, lattice.fill(frame.source).numpy().astype(float))
    loss = _judged(frame, lattice)
    return Run(name, way, seed, seconds, loss, found[FOLDED], found[UNREAD], found[READ_TWICE])


@contextmanager
def _regular(doublings: int | None, weight: float | None) -> Iterator[None]:
    """Displacements follow a flow of so many steps, and folding has that weight."""
    n = flow.DOUBLINGS if doublings is None else doublings
    w = shape.FOLDING_WEIGHT if weight is None else weight
    with mock.patch.object(flow, "DOUBLINGS", n), mock.patch.object(shape, "FOLDING_WEIGHT", w):
        yield


def _judged(frame: PaintedFrame, lattice: Lattice) -> float:
    """Mean style loss of the moved density's grey pictures over fresh views."""
    after = activate(frame.density, frame.frame.density_to_stage, torch.device("cpu"))
    still, moved = lattice.fill(frame.source), lattice.fill(after)
    where = (still > 0) | (moved > 0)
    positions = lattice.positions(torch.nonzero(where))
    scene, loss = frame.scene, frame.targets.at(1, grey=True)
    views = frame.config.views.replace(pool=FRESH)
    losses = []
    with torch.no_grad():
        for view in frame_views(frame.source, views, scene, JUDGE_SEED):
            image = column_map(positions, frame.source.edges, view)
            seen = grey_view(image, still[where], None, scene.gamma_w_shape, scene.exposure_shape)
            picture = seen.over_grey(seen.picture(moved[where]), scene.grey_mean)
            losses.append(float(loss(picture, seen.guide)))
    return float(np.mean(losses))


def price(run: Run, runs: Sequence[Run]) -> float:
    """By how much a run's loss is above the free one's of its scene and seed; relative."""
    (free,) = [r.loss for r in runs if (r.scene, r.way, r.seed) == (run.scene, FREE, run.seed)]
    return run.loss / free - 1


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=SCENES, help="of told_true")
    parser.add_argument("--ways", nargs="+", default=list(WAYS), help="some of them")
    parser.add_argument("--seeds", type=int, default=3, help="runs of each")
    parser.add_argument("--style", default="strokes", help="of the painted ones")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="real volumes")
    parser.add_argument("--report", type=Path, help="Markdown file for the table")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    style, runs = paint_styles([options.style], 256)[options.style], []
    scenes = {n: s for n, s in make_scenes(options.data).items() if n in options.scenes}
    for name, scene in scenes.items():
        for way in dict.fromkeys([FREE, *options.ways]):
            for seed in range(options.seeds):
                runs.append(measure(name, scene, style, way, seed))
                print(runs[-1], f"price {price(runs[-1], runs):.2%}", file=sys.stderr, flush=True)
    text = _report(runs, arguments if arguments is not None else sys.argv[1:])
    publish(text, options.report)
    return 0


def _report(runs: Sequence[Run], arguments: Sequence[str]) -> str:
    intro = [
        "# The price of displacements that do not fold",
        "",
        "Means over seeds; *price*: the style loss of unseen grey pictures above that of the free",
        "displacement with the same seed, and its standard error over the seeds.",
    ]
    columns = ["scene", "displacement", "loss", "price", "folded", "unread", "read twice", "CPU s"]
    ways = dict.fromkeys((run.scene, run.way) for run in runs)
    rows = [
        _line([run for run in runs if (run.scene, run.way) == (scene, way)], runs)
        for scene, way in ways
    ]
    return table_page(intro, columns, rows, ["python -m benchmarks.folding_price", *arguments])


def _line(same: Sequence[Run], runs: Sequence[Run]) -> str:
    prices = np.array([price(run, runs) for run in same])
    spread = prices.std(ddof=1) / np.sqrt(len(prices)) if len(prices) > 1 else np.nan
    means = np.mean([[r.loss, r.folded, r.unread, r.read_twice, r.cpu_s] for r in same], axis=0)
    loss, *shares, cpu_s = means
    cells = [same[0].scene, same[0].way, f"{loss:.3f}", f"{prices.mean():+.1%} ± {spread:.1%}"]
    return "| " + " | ".join([*cells, *(f"{s:.2%}" for s in shares), f"{cpu_s:.1f}"]) + " |"


if __name__ == "__main__":
    sys.exit(main())

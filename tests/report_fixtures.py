"""Tiny scenes for reports: a puff that moves along, with or without what sweeps need."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.pipeline_fixtures import make_style
from tests.smoke_fixtures import puff
from tests.usd_fixtures import density_prim, sequence, volume_prim, world, write_text
from usdsmoke.base.volume import DenseField
from usdsmoke.vdb.write import write_frame
from usdsmoke.work_precision.case import Case, open_case
from usdsmoke.work_precision.records import Plan, Point, Spread, SweepResult, Task

__all__ = ["QUICK", "TinyScene", "case_of", "make_scene", "point", "result_of"]

QUICK = (
    "views.image_size=16",
    "views.pool=2",
    "features.layers=[oriented1, oriented2]",
    "shape.iterations=[2, 2]",
    "colour.iterations=[2, 2]",
    "optimize.threads=1",
)


@dataclass(frozen=True)
class TinyScene:
    """Where a test's inputs and outputs are."""

    stage: Path
    style: Path
    output: Path


def make_scene(folder: Path, n_frames: int = 3, moving: bool = True, n: int = 10) -> TinyScene:
    """A Volume of ``n`` voxels along each side; ``moving`` has a velocity grid that turns.

    Needs the fixture ``quick_grids``, or a process is started for every file.
    """
    offset = np.stack(np.meshgrid(*[np.arange(n) - (n - 1) / 2] * 3, indexing="ij"), axis=-1)
    velocity = np.stack([-offset[..., 1], offset[..., 0], np.sin(offset[..., 0])], axis=-1)
    for code in range(1, n_frames + 1):
        fields = [DenseField("density", puff(n, seed=code), (0, 0, 0), np.eye(4))]
        if moving:
            values = (8 * velocity).astype(np.float32)
            fields.append(
                DenseField("vel", values, (0, 0, 0), np.eye(4), (0.0, 0.0, 0.0), "unknown")
            )
        target = folder / f"in/cache/smoke.{code:04d}.vdb"
        target.parent.mkdir(parents=True, exist_ok=True)
        write_frame(target, fields, {}, False)
    body = volume_prim(density_prim(sequence(range(1, n_frames + 1))))
    stage = write_text(folder / "in/shot.usda", world(body))
    return TinyScene(stage, make_style(folder / "in/style.png"), folder / "report")


def case_of(scene: TinyScene, *settings: str) -> Case:
    """The scene as sweeps see it."""
    from usdsmoke.planning.job import Request, prepare_job

    request = Request(scene.stage, scene.style, scene.output, [*QUICK, *settings])
    job = prepare_job(request, fits=False)
    return open_case(job, 64, 60.0)


def point(curve: str, label: str, error: float, cost: float, **more: Any) -> Point:
    """A point whose runs all agree."""
    spread = Spread(cost, cost, cost)
    values: Mapping[str, Any] = {"configured": False, **more}
    return Point(
        curve, label, error=Spread(error, error, error), cost=spread, cpu=spread, wall=spread,
        n_runs=3, **values,
    )  # fmt: skip


def result_of(points: Sequence[Point], name: str = "sweep", **plan: Any) -> SweepResult:
    """A sweep of these points."""
    tasks: list[Task] = []
    made = Plan(tasks, "error", "what is done", "what it is compared with", **plan)
    return SweepResult(name, "A sweep", made, tuple(points), ())

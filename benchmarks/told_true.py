"""The rows of the error budget against the errors themselves, on six scenes.

    python -m benchmarks.told_true [--data FOLDER] [--report FILE] [--scenes NAME ...]
    python -m benchmarks.told_true --scenes "plume 32" --presets draft daily final    # error, time

One frame of each scene is stylized with the defaults, or with presets. Each row of its error budget
is compared with the true error: pictures by a ray marcher that shares no code with the optimiser's
projection, density at exact or finer departure points, gradients of the displacement by NumPy,
losses over 48 views that nobody optimised, a second frame that is turned exactly, and runs four
times as long. About ten CPU minutes.
With presets a second table has the CPU seconds of the run and its largest true errors.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.circumstances import publish, table_page
from benchmarks.control_scenes import paint_styles
from benchmarks.moving_truth import RATE, temporal_error, turned_shot
from benchmarks.optimiser_error import measure_step
from benchmarks.told_true_scenes import Scene, make_scenes
from benchmarks.true_errors import (
    difference,
    enlarged,
    filter_errors,
    marched,
    transport_error,
    unevenness,
)
from usdsmoke.base.volume import DenseField
from usdsmoke.config.presets import preset_file
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.sequence.error_estimates import painted_frame
from usdsmoke.core.sequence.frame_loop import run_frames
from usdsmoke.core.sequence.frame_state import PaintedFrame, WindowContext, make_context
from usdsmoke.core.sequence.picture_errors import fit_blocks, quadrature_error, resolution_error
from usdsmoke.core.sequence.stylize import stylized_frame
from usdsmoke.core.smoke.srgb import decode_srgb
from usdsmoke.core.steps.pictures import prepare_views
from usdsmoke.core.views.cameras import View, orbit_view
from usdsmoke.core.views.scene import fit_view, frame_views, measure_scene
from usdsmoke.runs.budget.rows import ROWS

__all__ = ["Row", "main", "measure_scene_rows"]

STYLE = "strokes"
SECONDS = "CPU seconds"
FRESH = 48  # views
TURNING = "the scene turns by 4 degrees"


@dataclass(frozen=True)
class Row:
    """One row of one scene; relative errors. NaN: not known, for the reason."""

    scene: str
    row: str
    told: float
    true: float
    remark: str = ""

    @property
    def within(self) -> bool:
        """Whether told is within a factor of 2, or left out, or both are below a thousandth."""
        if not np.isfinite(self.told):
            return True
        if max(self.told, self.true) < 1e-3:
            return True
        return self.true > 0 and 0.5 <= self.told / self.true <= 2


def measure_scene_rows(
    name: str, scene: Scene, style: np.ndarray, config: Config | None = None
) -> Iterator[Row]:
    """The CPU seconds of a run as the first row, then all rows of a scene.

    Args:
        name: of the scene.
        config: None takes the defaults.
    """
    config = config or Config()
    budget = config.optimize.replace(threads=1, error_budget=True)
    config, begun = config.replace(optimize=budget), time.process_time()
    optics = config.optics.replace(thicken=1.0)  # the smoke as it is
    measured = measure_scene([scene.frame], config.views, optics, "Y", 1)
    context = make_context([style], measured, config, None, 24.0, None, 1)
    (frame,) = run_frames([scene.frame], context)
    done = stylized_frame(frame, context)
    yield Row(name, SECONDS, time.process_time() - begun, np.nan)
    told = {row.name: row.of_frame(done.report) for row in ROWS}
    known = {row: figure.value for row, figure in told.items() if figure is not None}
    assert done.emission is not None
    yield from _pictures(name, frame, done.density, done.emission, known)
    if frame.displacement is not None:
        yield _transport(name, scene, frame, done.density, known["transport"])
        yield from _unevenness(name, frame, known)
    yield from _views(name, frame, known)
    yield from _temporal(name, scene, context)
    for step in config.optimize.steps:
        longer = measure_step(scene.frame, style, config, step, "default")
        yield Row(name, f"optimiser, {step}", longer.told, longer.true)


def _pictures(
    name: str,
    frame: PaintedFrame,
    density: DenseField,
    emission: DenseField,
    told: dict[str, float],
) -> Iterator[Row]:
    view = fit_blocks(frame_views(frame.smoke, frame.config.views, frame.scene, 0)[0])
    painted, gamma_w = painted_frame(frame, view), frame.scene.gamma_w
    size = frame.scene.pixel_size
    turned = fit_blocks(fit_view(orbit_view(45, 10, "Y", np.zeros(3), 1, 1, size), frame.smoke))
    for where, seen in (("", view), (", at 45 degrees", turned)):
        found = painted.picture(seen, gamma_w).numpy()
        exact = marched(density, emission, gamma_w, seen)
        error = quadrature_error(painted, seen, gamma_w)
        yield Row(name, f"quadrature{where}", error, difference(found, exact))
    error = filter_errors(lambda seen: marched(density, emission, gamma_w, seen), view)
    yield Row(name, "pixel filter", told["pixel filter"], error)
    half = painted.halved()
    coarse = fit_blocks(
        replace(view, pixel_size=2 * size, height=view.height // 2, width=view.width // 2)
    )
    finer = replace(coarse, pixel_size=size, height=2 * coarse.height, width=2 * coarse.width)
    rough = half.picture(coarse, gamma_w).numpy()
    exact = painted.picture(finer, gamma_w).numpy()
    yield Row(
        name,
        "resolution",
        resolution_error(half, coarse, gamma_w).value,
        difference(enlarged(rough), exact),
        "at half the resolution; true: against the frame, told: against any finer one",
    )


def _transport(
    name: str, scene: Scene, frame: PaintedFrame, density: DenseField, told: float
) -> Row:
    """One cubic warp against the smoke itself at the places that it comes from."""
    u, lattice = _displacement(frame)
    true = transport_error(scene, u, lattice.low, density)
    return Row(name, "transport", told, true, scene.known_by)


def _unevenness(name: str, frame: PaintedFrame, told: dict[str, float]) -> Iterator[Row]:
    """Where space folds, and what is read how often, by NumPy."""
    u, lattice = _displacement(frame)
    for row, true in unevenness(u, lattice.fill(frame.source).numpy().astype(float)).items():
        yield Row(name, row, told[row], true)


def _displacement(frame: PaintedFrame) -> tuple[np.ndarray, Lattice]:
    """In voxels [I J K 3], and where it is."""
    assert frame.displacement is not None
    lattice = frame.displacement.lattice
    u = lattice.from_stage(frame.displacement.values).numpy()
    return u / np.asarray(lattice.spacing), lattice


def _views(name: str, frame: PaintedFrame, told: dict[str, float]) -> Iterator[Row]:
    """Losses of fresh views against those of the pool."""
    config = frame.config
    octaves = len(config.colour.iterations)
    pool = frame_views(frame.smoke, config.views, frame.scene, config.optimize.seed + octaves - 1)
    fresh = config.views.replace(pool=FRESH)
    ours = _losses(frame, pool)
    theirs = _losses(frame, frame_views(frame.smoke, fresh, frame.scene, 98765))
    sampling = theirs.std(ddof=1) / np.sqrt(len(ours)) / theirs.mean()
    yield Row(name, "view sampling", told["view sampling"], float(sampling))
    unseen = abs(theirs.mean() - ours.mean()) / ours.mean()
    yield Row(
        name,
        "unseen views",
        told["unseen views"],
        float(unseen),
        "told: 8 views of the pool against 2 others",
    )


def _temporal(name: str, scene: Scene, context: WindowContext) -> Iterator[Row]:
    """The scene turns; the next frame's patterns against those of the first."""
    shot = turned_shot(scene)
    optics = context.config.optics.replace(thicken=1.0)  # the smoke as it is
    measured = measure_scene(shot, context.config.views, optics, "Y", 1)
    moving = replace(context, scene=measured, time_codes_per_second=RATE)
    first, second = run_frames(shot, moving)
    told = second.report.temporal
    assert told is not None and first.paint is not None and second.paint is not None
    coloured = [(smoke, colours.numpy()) for smoke, colours in (first.paint, second.paint)]
    patterns = {"colour": (coloured, told.colour)}
    if first.displacement is not None:
        moved = [(frame.source, _moves(frame)) for frame in (first, second)]
        patterns = {"displacement": (moved, told.displacement), **patterns}
    for kind, ((before, after), error) in patterns.items():
        true = temporal_error(scene, before, after)
        yield Row(name, f"temporal, {kind}", np.nan if error is None else error, true, TURNING)


def _moves(frame: PaintedFrame) -> np.ndarray:
    """The displacement at the voxels of the smoke, [N 3]."""
    assert frame.displacement is not None
    return np.asarray(frame.displacement.at(frame.source.positions).numpy())


def _losses(frame: PaintedFrame, views: Sequence[View]) -> np.ndarray:
    assert frame.paint is not None
    loss, linear = frame.targets.at(1), decode_srgb(frame.paint[1])
    scene, behind = frame.scene, frame.targets.background
    with torch.no_grad():
        seen = prepare_views(frame.smoke, views, scene.gamma_w, scene.exposure)
        return np.array([float(loss(v.unpremultiplied(linear, behind), v.guide)) for v in seen])


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="real volumes")
    parser.add_argument("--report", type=Path, help="Markdown file for the table")
    parser.add_argument("--scenes", nargs="*", help="some of the scenes")
    parser.add_argument("--presets", nargs="*", default=[""], help="instead of the defaults")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    style, rows = paint_styles([STYLE], 256)[STYLE], []
    for name, scene in make_scenes(options.data).items():
        for preset in options.presets if not options.scenes or name in options.scenes else ():
            config = resolve_config(preset_file(preset)) if preset else None
            title = f"{name}, {preset}" if preset else name
            for row in measure_scene_rows(title, scene, style, config):
                rows.append(row)
                print(_line(row), file=sys.stderr, flush=True)
    text = _report(rows, arguments if arguments is not None else sys.argv[1:])
    if options.presets != [""]:
        text += "\n".join(["", *_against_time(rows), ""])
    publish(text, options.report)
    return 0


def _against_time(rows: Sequence[Row]) -> list[str]:
    """A table of the CPU seconds and the largest true errors of each scene's run."""
    lines = ["| run | CPU seconds | largest true errors |", "|---|---|---|"]
    for name in dict.fromkeys(row.scene for row in rows):
        (seconds,) = [row.told for row in rows if row.scene == name and row.row == SECONDS]
        known = [row for row in rows if row.scene == name and np.isfinite(row.true)]
        largest = sorted(known, key=lambda row: row.true, reverse=True)[:4]
        cells = ", ".join(f"{row.row} {row.true:.1%}" for row in largest)
        lines.append(f"| {name} | {seconds:.1f} | {cells} |")
    return lines


def _line(row: Row) -> str:
    if not np.isfinite(row.told):
        cells = [row.scene, row.row, "left out", f"{row.true:.2%}", "", row.remark]
    elif not np.isfinite(row.true):
        cells = [row.scene, row.row, f"{row.told:.2%}", "", "", row.remark]
    else:
        ratio = row.told / row.true if row.true > 0 else np.inf
        shown = "" if max(row.told, row.true) < 1e-3 else f"{ratio:.2f}"
        remark = row.remark if row.within else f"{row.remark}; OUTSIDE".lstrip("; ")
        cells = [row.scene, row.row, f"{row.told:.2%}", f"{row.true:.2%}", shown, remark]
    return "| " + " | ".join(cells) + " |"


def _report(rows: Sequence[Row], arguments: Sequence[str]) -> str:
    known = [row for row in rows if np.isfinite([row.told, row.true]).all()]
    intro = [
        "# The error budget, told and true",
        "",
        "*Told* is the row of the run's error budget, *true* the error itself. Both are relative.",
        "Below 0.1 % no ratio is given.",
        f"Within a factor of 2: {sum(row.within for row in known)} of {len(known)}.",
    ]
    columns = ["scene", "row", "told", "true", "told / true", "remark"]
    return table_page(
        intro,
        columns,
        [_line(row) for row in rows if row.row != SECONDS],
        ["python -m benchmarks.told_true", *arguments],
    )


if __name__ == "__main__":
    sys.exit(main())

"""Error against CPU seconds: presets, tolerances and defaults, beside the version be60f8a.

    git archive --prefix=be60f8a/ be60f8a | tar x -C /tmp
    python -m benchmarks.error_against_time --before /tmp/be60f8a [--scenes NAME ...]
        [--report FILE.md] [--curve FILE.png]

One frame is stylized by the core of both versions with each setting, each in a new process on one
thread. Seconds are CPU seconds of the scene's measures, both steps and what estimates and chooses,
without imports and files. Errors are true ones, by the same independent code for both
(``benchmarks.true_errors``): pictures against a ray marcher, the moved density against finer smoke,
gradients of the displacement by NumPy. *Style* is how much of the style loss on views that no run
had would go with the settings of the best run, a ``final`` with four times the iterations.
"""

import argparse
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.circumstances import publish, table_page
from benchmarks.control_scenes import paint_styles
from benchmarks.held_out import Result, cover_box, unseen_loss
from benchmarks.style_scores import RANGES
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
from usdsmoke.core.views.cameras import View

__all__ = ["main"]

HERE = Path(__file__).resolve().parents[1]
STYLE = "strokes"
N_VIEWS = 16  # that no run had
VIEWS = ((8.0, 3.0), (45.0, 10.0))  # azimuth and elevation, degrees
FRONT, ROUND = "style, front", "style, all round"
LARGEST = "largest true error"
BEFORE, PRESETS, TOLERANCES = "be60f8a, --tolerance", "presets", "optimize.tolerance"
LOOKS = {BEFORE: ("#b0413e", "s"), PRESETS: ("#1f5fa8", "o"), TOLERANCES: ("#3a8f5c", "^")}


@dataclass(frozen=True)
class Setting:
    """What is run: settings of this version, or a tolerance of be60f8a."""

    name: str
    curve: str
    settings: tuple[Any, ...] = ()
    tolerance: float | None = None


@dataclass(frozen=True)
class Point:
    """What a setting costs, and its true errors by name; relative."""

    setting: Setting
    seconds: float
    losses: dict[str, float]  # by ``FRONT`` and ``ROUND``
    errors: dict[str, float]

    def style(self, name: str, best: float) -> float:
        """How far the loss is above the best one."""
        return 1 - best / self.losses[name]


def settings() -> Iterator[Setting]:
    """All that is run; the last one is the reference of the style.

    Iterations end earlier with a larger ``optimize.tolerance``; the default of 0.002 ends few.
    """
    yield Setting("defaults", BEFORE)
    for tolerance in (0.5, 0.3, 0.1):
        yield Setting(f"`--tolerance {tolerance:g}`", BEFORE, tolerance=tolerance)
    for name in ("draft", "daily", "final"):
        yield Setting(f"`{name}`", PRESETS, (preset_file(name),))
    for tolerance in (1.0, 0.4, 0.1):
        text = f"optimize.tolerance={tolerance:g}"
        yield Setting(f"`{text}`", TOLERANCES, (text,))
    yield Setting("`grids.refine=2`", "", ("grids.refine=2",))
    for share in (0.1, 0.2):
        shorter = _iterations(resolve_config(), share)
        yield Setting(f"{share:g} of the iterations", "", shorter)
    final = preset_file("final")
    longer = _iterations(resolve_config(final), 4)
    yield Setting("`final`, 4 times the iterations", "", (final, *longer))


def _iterations(config: Config, factor: float) -> tuple[str, ...]:
    """Settings with so many times the iterations of both steps."""
    return tuple(
        f"{step}.iterations={[round(factor * n) for n in getattr(config, step).iterations]}"
        for step in ("shape", "colour")
    )


def measure(scene: Scene, style: np.ndarray, setting: Setting, before: Path) -> Point:
    """Run a setting in its version and measure what it found."""
    tree = before if setting.curve == BEFORE else HERE
    density = scene.frame.density
    job = {
        "density": (density.values, density.ijk_min, density.index_to_world),
        "style": style,
        "settings": setting.settings,
        "tolerance": setting.tolerance,
        "views": VIEWS,
    }
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / name for name in ("job", "result")]
        files[0].write_bytes(pickle.dumps(job))
        environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
        command = [sys.executable, str(HERE / "benchmarks/core_run.py"), *map(str, files)]
        subprocess.run(command, check=True, cwd=tree, env=environment)
        found = pickle.loads(files[1].read_bytes())
    matrix = np.asarray(found["index_to_world"])
    fields = [DenseField(name, *found[name], matrix) for name in ("density", "emission")]
    result = Result(fields[0], cover_box(fields[1], fields[0]), np.eye(4), found["gamma_w"])
    comparable = np.allclose(matrix, density.index_to_world)  # else with voxels of another size
    losses = {FRONT: RANGES["front"], ROUND: None}
    return Point(
        setting,
        found["seconds"],
        {
            name: unseen_loss(result, style, angles, N_VIEWS) if comparable else np.nan
            for name, angles in losses.items()
        },
        _errors(scene if comparable else None, found, result),
    )


def _errors(scene: Scene | None, found: dict[str, Any], result: Result) -> dict[str, float]:
    def marched_from(view: View) -> np.ndarray:
        return marched(result.density, result.emission, result.gamma_w, view)

    views = [View(**view) for view in found["views"]]
    usual, turned = (
        difference(picture, marched_from(view))
        for picture, view in zip(found["pictures"], views, strict=True)
    )
    return {
        "resolution": difference(enlarged(found["half"]), found["pictures"][0]),
        "transport": np.nan
        if scene is None
        else transport_error(scene, found["u"], found["low"], result.density),
        "pixel filter": filter_errors(marched_from, views[0]),
        "quadrature": usual,
        "quadrature, 45 degrees": turned,
        **unevenness(found["u"], found["source"].astype(float)),
    }


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--before", type=Path, required=True, help="a checkout of be60f8a")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="real volumes")
    parser.add_argument("--scenes", nargs="*", default=["plume 32", "real plume 1/4"])
    parser.add_argument("--report", type=Path, help="Markdown file for the tables")
    parser.add_argument("--curve", type=Path, help="PNG file for the curves")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    style, scenes = paint_styles([STYLE], 256)[STYLE], make_scenes(given.data)
    points: dict[str, list[Point]] = {}
    for name in given.scenes:
        points[name] = []
        for setting in settings():
            points[name].append(measure(scenes[name], style, setting, given.before.resolve()))
            print(name, points[name][-1], file=sys.stderr, flush=True)
    publish(_page(points, arguments if arguments is not None else sys.argv[1:]), given.report)
    if given.curve:
        _draw(points, given.curve)
    return 0


def rows_of(points: Sequence[Point]) -> list[tuple[Point, dict[str, float]]]:
    """Each point with all of its errors, the largest one that counts first by ``largest``."""
    best = {name: np.nanmin([point.losses[name] for point in points]) for name in (FRONT, ROUND)}
    return [
        (point, {name: point.style(name, best[name]) for name in best} | point.errors)
        for point in points
    ]


def largest(errors: dict[str, float]) -> tuple[str, float]:
    """The largest error but that of the style all round, for which be60f8a was not made."""
    known = {name: x for name, x in errors.items() if name != ROUND and np.isfinite(x)}
    name = max(known, key=known.__getitem__)
    return name, known[name]


def _page(points: dict[str, list[Point]], arguments: Sequence[str]) -> str:
    intro = [
        "# Error against CPU seconds",
        "",
        "One frame a run, in one go. All errors are true ones, relative, by code that shares none",
        "with the versions that it measures; `python -m benchmarks.error_against_time --help` says",
        "what each is. *Largest* does not count the style all round, as be60f8a was made for views",
        f"from the front alone. Style losses are means over {N_VIEWS} views that no run had.",
    ]
    errors = list(rows_of(next(iter(points.values())))[0][1])
    columns = ["scene", "version", "run", "CPU s", "largest", *errors]
    columns += ["loss, front", "loss, all round"]
    lines = []
    for scene, found in points.items():
        for point, of_point in rows_of(found):
            name, value = largest(of_point)
            version = "before" if point.setting.curve == BEFORE else "now"
            cells = [scene, version, point.setting.name, f"{point.seconds:.1f}"]
            cells += [f"{name}, {value:.1%}", *(f"{of_point[error]:.1%}" for error in errors)]
            cells += [f"{point.losses[name]:.2f}" for name in (FRONT, ROUND)]
            cells = ["" if "nan" in cell else cell for cell in cells]
            lines.append(f"| {' | '.join(cells)} |")
    command = ["python -m benchmarks.error_against_time", *arguments]
    return table_page(intro, columns, lines, command)


def _draw(points: dict[str, list[Point]], file_path: Path) -> None:
    """The largest error, and that of the style, against seconds; a row of diagrams a scene."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 4.2 * len(points)), dpi=100, layout="constrained")
    grid = figure.subplots(len(points), 2, squeeze=False)
    for row, (scene, found) in zip(grid, points.items(), strict=True):
        rows = rows_of(found)
        for axes, name in zip(row, (LARGEST, ROUND), strict=True):
            for curve in LOOKS:
                drawn = [(p, errors) for p, errors in rows if p.setting.curve == curve]
                _draw_curve(axes, curve, sorted(drawn, key=lambda pair: pair[0].seconds), name)
            axes.set(xscale="log", xlabel="CPU seconds of a frame", ylabel="%")
            axes.set(title=f"{scene}: {name}")
            axes.set_ylim(bottom=0)
            axes.set_xticks([3, 5, 7, 10, 15, 20, 30], [3, 5, 7, 10, 15, 20, 30])
            axes.minorticks_off()
            axes.grid(True, which="both", color="#e6e6e6", linewidth=0.6)
            axes.set_axisbelow(True)
    grid[0][0].legend(fontsize=8, frameon=False)
    figure.savefig(file_path, metadata={"Software": None})


def _draw_curve(
    axes: Any, curve: str, drawn: Sequence[tuple[Point, dict[str, float]]], name: str
) -> None:
    colour, marker = LOOKS[curve]
    x = [point.seconds for point, _ in drawn]
    y = [100 * (largest(errors)[1] if name == LARGEST else errors[name]) for _, errors in drawn]
    axes.plot(x, y, color=colour, marker=marker, linewidth=1.4, label=curve)
    for (point, _), *place in zip(drawn, x, y, strict=True):
        words = point.setting.name.strip("`").removeprefix("optimize.tolerance=")
        axes.annotate(
            words.removeprefix("--tolerance "), place, xytext=(4, -11 if marker == "^" else 5),
            textcoords="offset points", fontsize=7, color=colour,
        )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())

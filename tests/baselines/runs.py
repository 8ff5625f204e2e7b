"""The golden runs: small, and together they pass through every part of the product.

``make_results`` makes inputs and results in a folder and returns what is kept of them. It calls
``python -m usdsmoke`` in this process, which loads torch once for all runs.
"""

import contextlib
import io
import json
import os
import runpy
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pxr import Sdf

from tests.baselines.inputs import PROJECT, make_inputs
from tests.baselines.measure import layer_structure, measure_picture, measure_stage

__all__ = ["RUNS", "Run", "command", "make_results", "make_results_in_processes"]

FIRST = ("plume", "mask", "repaired")  # half of the work, for one of two processes

# Bits must not depend on the number of threads or on a GPU that happens to be there.
FIXED = (
    "optimize.device=cpu", "optimize.threads=1", "views.pool=3", "views.image_size=36",
    "shape.iterations=[2, 1]", "colour.iterations=[2, 1]", "grids.refine=1",
)  # fmt: skip
QUICK = "optimize.error_budget=false"
COLOUR, SHAPE = "optimize.steps=[colour]", "optimize.steps=[shape]"
ALONE = ("windows.size=1", "windows.overlap=0")


@dataclass(frozen=True)
class Run:
    """A call of ``usdsmoke stylize`` and what is looked at afterwards.

    ``more`` is called with the inputs' and the result's folder, and adds to what is kept.
    """

    stage: str
    settings: tuple[str, ...] = ()
    options: tuple[str, ...] = ("--style", "style.png")
    more: Callable[[Path, Path], dict[str, Any]] | None = None


def command(*arguments: str | Path) -> str:
    """What ``python -m usdsmoke`` prints on stdout.

    Raises:
        AssertionError: the command fails; with everything that it said.
    """
    out, err, before = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = ["usdsmoke", *(str(part) for part in arguments)]
    code: Any = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            runpy.run_module("usdsmoke", run_name="__main__", alter_sys=False)
    except SystemExit as end:
        code = end.code
    finally:
        sys.argv = before
    assert code in (0, None), f"usdsmoke {' '.join(sys.argv)}: exit code {code}\n{err.getvalue()}"
    return out.getvalue()


def _stylize(inputs: Path, output: Path, run: Run, *more: str) -> str:
    options = [str(inputs / part) if part.endswith(".png") else part for part in run.options]
    settings = [f"--set={text.replace('INPUTS', str(inputs))}" for text in (*FIXED, *run.settings)]
    return command("stylize", inputs / run.stage, "-o", output, *options, *settings, *more)


def _without_seconds(rows: Iterable[dict[str, Any]]) -> list[list[float]]:
    return [[row["mean"], row["largest"], row["n_frames"]] for row in rows]


def _plume_figures(inputs: Path, output: Path) -> dict[str, Any]:
    """The figures of the result, the same window by window, and pictures of it."""
    told = json.loads((output / "told.json").read_text())
    run, apart = RUNS["plume"], output.with_name("apart")
    for step in (["--coarse"], ["--window", "1"], ["--window", "0"]):
        _stylize(inputs, apart, run, *step)
    command("assemble", apart)
    look, names = output / "plume_look.usda", ["sheet.png", "seen.exr", "seen.png"]
    command("preview", look, "-o", output / names[0], "--compare", "--width", "48")
    camera = ["--camera", "/cameras/front", "--frames", "2", "--size", "40x30"]
    command("preview", look, "-o", output / names[1], *camera)
    command("preview", look, "-o", output / names[2], *camera, "--background", "none")
    return {
        "figures": {
            "temporal": sorted(told["temporal_error"].values()),
            "overlap": sorted(told["overlap_difference"].values()),
            "budget": _without_seconds(told["error_budget"]["estimates"]),
        },
        "window by window": _hashes(apart),
        "pictures": {name: measure_picture(output / name) for name in names},
    }


def _once_more(inputs: Path, output: Path) -> dict[str, Any]:
    """The result made again from its own record."""
    again = output.with_name("again")
    command("rerun", output, "-o", again)
    return {"once more": _hashes(again)}


def _second_look(inputs: Path, output: Path) -> dict[str, Any]:
    """Another look beside the first, as a second variant."""
    options = ("--style", "other.png", "--mode", "reference", "--look", "frost")
    _stylize(inputs, output, Run("shot.usda", ("stage.frames=2", COLOUR, QUICK), options))
    return {"both looks": _stages(output)}


def _stylized_again(inputs: Path, output: Path) -> dict[str, Any]:
    """The result as the source of another result."""
    again = output.with_name("restylized")
    run = Run(str(output / "slab_look.usda"), (QUICK,), ("--style", "other.png", "--restylize"))
    _stylize(inputs, again, run)
    return {"restylized": _stages(again)}


def _over_source(inputs: Path, output: Path) -> dict[str, Any]:
    """The look layer, put over the source as a user of such a layer does."""
    stage = Sdf.Layer.CreateNew(str(output / "own_look.usda"))
    stage.subLayerPaths = ["./look.usda", str(inputs / "shot.usda")]
    stage.Save()
    found = _stages(output)
    (output / "own_look.usda").unlink()
    return {"over the source": found}


def _stages(output: Path) -> dict[str, Any]:
    """What every stage of a result shows."""
    stages = sorted([*output.glob("*_look.usda"), *output.glob("*_asset.usda")])
    return {path.name: measure_stage(path) for path in stages}


def _hashes(output: Path) -> dict[str, Any]:
    return {
        name: {file: found["hash"] for file, found in stage["files"].items()}
        for name, stage in _stages(output).items()
    }


RUNS = {
    # shape and colour, two windows with an overlap, the coarse step, errors, pictures
    "plume": Run("plume.usda", ("windows.size=2", "windows.overlap=1"), more=_plume_figures),
    # one voxel thick; and smoke that is stylized once more
    "slab": Run("slab.usda", (QUICK,), more=_stylized_again),
    # VGG-19, content layers, weighted layers, two styles
    "vgg19": Run(
        "shot.usda",
        (
            "stage.frames=1",
            "features.network=vgg19",
            "features.vgg19_file=INPUTS/network.pth",
            "features.layers=[relu1_2, relu2_1]",
            "features.weights=[1, 0.5]",
            "losses.content=0.1",
            "style.weights=[3, 1]",
            "style.size=0.5",
            QUICK,
        ),
        ("--style", "style.png", "--style", "other.png"),
    ),
    # a shot camera that moves and sees a part of the smoke
    "camera": Run(
        "shot.usda",
        ("stage.frames=1,3", "views.camera_width=48", "views.centre_elevation=5", QUICK),
        ("--style", "style.png", "--camera", "/shot/camera"),
    ),
    # a mask with a lattice of its own, and a strength; and the same made again
    "mask": Run(
        "shot.usda",
        ("stage.frames=1", "stage.mask=fade", "optimize.strength=0.8", QUICK),
        more=_once_more,
    ),
    # two looks as variants of an asset, in a binary layer
    "variant": Run(
        "shot.usda",
        ("stage.frames=1-2", COLOUR, "layer.format=usdc", QUICK),
        ("--style", "style.png", "--mode", "reference", "--look", "ember"),
        _second_look,
    ),
    # motion estimated from densities; no velocity in the files
    "estimated": Run("still.usda", ("stage.frames=1-2", "stage.motion=estimate", QUICK)),
    # the prim asks for style, weights, iterations and strength, the last two frame by frame
    "request": Run("request.usda", ("stage.frames=1-2", "windows.pattern_speed=0.5", QUICK), ()),
    # refined lattices, half floats, pruning, and all grids that renderers ask for
    "refined": Run(
        "shot.usda",
        (
            "stage.frames=2",
            "grids.refine=2",
            "grids.prune=0.01",
            "layer.name=fine",
            "layer.scatter_colour=[Cd, color]",
            QUICK,
        ),
        ("--style", "style.png", "--half", "--split-rgb", "--emission-mode", "perDensity"),
    ),
    # frames alone, the other statistic, and every loss
    "alone": Run(
        "shot.usda",
        (
            *ALONE,
            "stage.frames=1,2",
            "losses.statistic=gram",
            "losses.content=0.2",
            "losses.histogram=0.1",
            "losses.laplacian=0.1",
            "losses.photorealism=0.1",
            "losses.total_variation=0.05",
            "views.count=2",
            "views.sampling=uniform",
            "style.tiling=2",
            QUICK,
        ),
    ),
    # two placed Volumes, Z up, centimetres; the other displacements, schemes and start
    "turned": Run(
        "turned.usda",
        (
            "stage.frames=2",
            "shape.displacement=mixed",
            "shape.interpolation=linear",
            "colour.init=density",
            "optics.gamma=0.4",
            "views.sampling=fixed",
            QUICK,
        ),
    ),
    "potential": Run(
        "shot.usda",
        (
            "stage.frames=1",
            SHAPE,
            "shape.displacement=potential",
            "shape.interpolation=linear",
            "shape.mass_correction=false",
            "layer.mode=layer",
            QUICK,
        ),
        more=_over_source,
    ),
    # damaged voxels replaced
    "repaired": Run("damaged.usda", (COLOUR, QUICK), ("--style", "style.png", "--repair", "nan=0")),
    # not what is on record: a slab with another seed; the tests ask that it differs
    "another seed": Run("slab.usda", ("optimize.seed=1", QUICK)),
}


def make_results(folder: Path, names: Iterable[str], inputs: Path) -> dict[str, Any]:
    """Do runs one after another and return what is kept of each, as JSON values.

    Args:
        folder: an empty place for the results.
        names: of ``RUNS``.
        inputs: the folder of ``make_inputs``.
    """
    results = {}
    for name in names:
        started = time.perf_counter()
        run, output = RUNS[name], folder / name.replace(" ", "_") / "out"
        told = _stylize(inputs, output, run, "--json")
        (output / "told.json").write_text(told)
        stages = _stages(output)
        more = run.more(inputs, output) if run.more else {}
        layers = sorted(path for path in output.iterdir() if path.suffix in (".usda", ".usdc"))
        print(f"{name}: {time.perf_counter() - started:.1f} s", file=sys.stderr)
        results[name] = {
            "stages": stages,
            "layers": {path.name: layer_structure(path) for path in layers},
            "sheets": {path.name: measure_picture(path) for path in output.glob("*.png")},
            **more,
        }
    return results


def make_results_in_processes(folder: Path, names: Iterable[str]) -> dict[str, Any]:
    """``make_results`` of all names, by processes side by side with one thread each."""
    inputs, names = folder / "in", list(names)
    inputs.mkdir(parents=True)
    make_inputs(inputs)
    shares = [[n for n in names if n in FIRST], [n for n in names if n not in FIRST]]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    started = []
    for number, share in enumerate(share for share in shares if share):
        place = folder / f"results{number}"
        place.mkdir()
        options = [part for name in share for part in ("--only", name)]
        arguments = ["--inputs", str(inputs), "--results", str(place), *options]
        call = [sys.executable, "-m", "tests.baselines", *arguments]
        with (place / "log.txt").open("w") as log:
            process = subprocess.Popen(call, cwd=PROJECT, env=environment, stderr=log)
        started.append((place, process))
    codes = [process.wait() for _, process in started]
    results: dict[str, Any] = {}
    for (place, _), code in zip(started, codes, strict=True):
        assert code == 0, (place / "log.txt").read_text()
        results |= json.loads((place / "results.json").read_text())
    return {name: results[name] for name in names}

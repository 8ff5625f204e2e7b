"""CPU seconds to the same style loss: a dense baseline of the reference's shape, and usdsmoke.

    python -m benchmarks.equal_loss [--width 48] [--scenes plume real_plume] [--quick]

One frame of the example plume and the real plume (skipped without its file), in turn: a part of the
baseline's iterations (``benchmarks.baselines``), then usdsmoke with more and more iterations, each
time from the start and with everything that a run does, until its style loss is no greater than
the baseline's least so far. Everything runs in one process on one thread; seconds are its CPU
seconds, without what judging takes.

Style losses are judged alike: the finished fields are drawn by ``benchmarks.raymarch``, which
shares no code with either side's renderer, at full size from views that neither had, and compared
with the style by the loss that both minimise. Measures that neither minimises stand beside it.
"""

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.baselines import baseline_colour, baseline_shape, dense_box, with_values
from benchmarks.circumstances import circumstances
from benchmarks.equal_judge import Judge, find_scenes
from benchmarks.equal_report import Comparison, Point, render_report
from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.core.sequence.stylize import stylize_window
from usdsmoke.core.smoke.srgb import decode_srgb
from usdsmoke.core.steps.targets import make_targets
from usdsmoke.core.style.losses import PictureLoss
from usdsmoke.core.views.scene import measure_scene

__all__ = ["compare", "main"]

BASELINE = {"shape": (20, 20), "colour": (60,)}  # iterations of each octave, nine views each
OURS = {  # iterations; of colour in all octaves, of shape in the finest alone: see ``_settings``
    "shape": (6, 12, 18, 24, 36, 48, 96, 150),
    "colour": (6, 12, 24, 48, 96, 180, 360, 720),
}
PARTS = 3  # the baseline's iterations are done in so many parts, with usdsmoke's runs in between


def _settings(step: str, frame: VolumeFrame, iterations: int | None = None) -> Config:
    # an estimate of its own errors is no part of what the baseline does
    optimize = {"steps": [step], "threads": 1, "device": "cpu", "error_budget": False}
    optimize |= {"tolerance": 0.0}
    views = {"image_size": max(16, *frame.density.values.shape)}
    # the reference's kind of unknown for both sides, and its mass as transport leaves it
    shape: dict[str, Any] = {"displacement": "potential", "mass_correction": False}
    if iterations is not None and step == "shape":
        # pictures of under 120 pixels: coarse octaves cost more than they bring
        shape["iterations"] = [0, 0, iterations]
    else:
        optimize |= {"iterations": iterations}
    optics = {"thicken": 1.0}  # both sides see the smoke as it is
    return resolve_config({"views": views, "shape": shape, "optimize": optimize, "optics": optics})


def _run_ours(
    frame: VolumeFrame, style: np.ndarray, step: str, iterations: int
) -> tuple[float, DenseField, DenseField | None]:
    """One whole run from the start: CPU seconds, density, emission."""
    config = _settings(step, frame, iterations)
    begin = time.process_time()
    scene = measure_scene([frame], config.views, config.optics, "Y", config.grids.parts)
    (result,) = stylize_window([frame], [style], scene, config)
    return time.process_time() - begin, result.density, result.emission


def _run_baseline(
    frame: VolumeFrame, style: np.ndarray, step: str, octaves: Sequence[int]
) -> Iterator[tuple[float, Callable[[], tuple[DenseField, DenseField | None]]]]:
    """CPU seconds so far and, when called, density and emission; after every iteration."""
    config = _settings(step, frame)
    spent, begin = 0.0, time.process_time()
    scene, box = measure_scene([frame], config.views, config.optics, "Y"), dense_box(frame.density)
    targets = make_targets([style], scene, config, torch.device("cpu"))

    def shaped(moved: Callable[[], torch.Tensor]) -> tuple[DenseField, None]:
        with torch.no_grad():
            return with_values(frame.density, box, moved()), None

    def painted(colours: torch.Tensor) -> tuple[DenseField, DenseField]:
        light = decode_srgb(colours) * (scene.gamma_w * box.density)
        return with_values(frame.density, box, box.density), with_values(frame.density, box, light)

    states: Iterator[Callable[[], tuple[DenseField, DenseField | None]]]
    if step == "shape":

        def judge_at(factor: float) -> PictureLoss:
            return targets.at(factor, grey=True)  # type: ignore[arg-type]  # any factor works

        found = baseline_shape(box, judge_at, scene, config, octaves)
        states = (partial(shaped, moved) for moved in found)
    else:
        painted_boxes = baseline_colour(
            box, targets.at(1), targets.background, scene, config, sum(octaves)
        )
        states = (partial(painted, colours.clone()) for colours in painted_boxes)
    for state in states:
        spent += time.process_time() - begin
        yield spent, state
        begin = time.process_time()


def compare(
    name: str,
    frame: VolumeFrame,
    style: np.ndarray,
    step: str,
    octaves: Sequence[int],
    ladder: Sequence[int],
) -> Comparison:
    """Both sides on one frame, in turn; ``octaves`` the baseline's iterations, ``ladder`` ours."""
    config = _settings(step, frame)
    judge = Judge(
        frame,
        style,
        measure_scene([frame], config.views, config.optics, "Y", config.grids.parts),
        config,
        step,
    )
    box = dense_box(frame.density)
    found = Comparison(
        name, step, tuple(box.density.shape[::-1]), int((box.density > 0).sum()),
        judge(frame.density, None),
    )  # fmt: skip
    total = sum(octaves)
    stops = {max(1, round(total * part / PARTS)) for part in range(1, PARTS + 1)}
    for number, (cpu, state) in enumerate(_run_baseline(frame, style, step, octaves), 1):
        if number not in stops:
            continue
        found.baseline.append(Point(number, cpu, judge(*state())))
        print(f"{name}, {step}: baseline {found.baseline[-1]}", file=sys.stderr, flush=True)
        _climb(found, frame, style, ladder, judge)
    return found


def _climb(
    found: Comparison, frame: VolumeFrame, style: np.ndarray, ladder: Sequence[int], judge: Judge
) -> None:
    """Ours with more and more iterations, until the baseline's loss so far is reached."""
    for iterations in ladder:
        cpu, density, emission = _run_ours(frame, style, found.step, iterations)
        times = found.repeats.setdefault(iterations, [])
        times.append(cpu)
        known = found.ours.get(iterations)
        verdict = known.verdict if known else judge(density, emission)
        found.ours[iterations] = Point(iterations, statistics.median(times), verdict)
        print(f"  ours {found.ours[iterations]}", file=sys.stderr, flush=True)
        if verdict.loss <= found.best.verdict.loss:
            return


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--width", type=int, default=48, help="voxels across, about")
    parser.add_argument("--scenes", nargs="+", default=["plume", "real_plume"])
    parser.add_argument("--steps", nargs="+", default=["shape", "colour"], choices=BASELINE)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="real volumes")
    parser.add_argument("--report", type=Path, default=Path("benchmarks/results/equal_loss.md"))
    parser.add_argument("--quick", action="store_true", help="small smoke, few iterations")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    found: list[Comparison] = []
    words = ["python -m benchmarks.equal_loss", *(sys.argv[1:] if arguments is None else arguments)]
    try:
        frames, style = find_scenes(
            options.scenes, 16 if options.quick else options.width, options.data
        )
        for name, frame in frames.items():
            for step in options.steps:
                octaves = (1, 1) if options.quick else BASELINE[step]
                ladder = OURS[step][:1] if options.quick else OURS[step]
                found.append(compare(name, frame, style, step, octaves, ladder))
                _write(options.report, found, words)  # after every one, for they take minutes
    except (OSError, ValueError, UsdSmokeError) as error:
        print(f"benchmarks.equal_loss: {error}", file=sys.stderr)
        return 1
    print(options.report.read_text(encoding="utf-8"))
    return 0


def _write(file_path: Path, found: Sequence[Comparison], words: Sequence[str]) -> None:
    file_path.parent.mkdir(parents=True, exist_ok=True)
    about = (__doc__ or "").split("\n\n", 2)[2]
    file_path.write_text(render_report(found, about, words), encoding="utf-8")
    values = {"circumstances": circumstances(words), "comparisons": [asdict(c) for c in found]}
    text = json.dumps(values, indent=1) + "\n"
    file_path.with_suffix(".json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())

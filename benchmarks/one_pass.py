"""A trained network against iterations: style loss of unseen views against CPU seconds.

    python -m benchmarks.one_pass [--resolution 40] [--styles strokes A.jpg] [--data FOLDER]

For each style a network is trained on frames of the example plume, as ``usdsmoke train`` does but
with one more, and paints a frame that it has not seen, and two of other shots: a plume with a wider
source, more heat and other gusts, and the real plume, its voxels merged in blocks, where its file
is there. Beside it stand cold starts of the colour step, a start from the frame before, and the
network with iterations after it. ``--other`` trains on the first of these shots instead, ``--own``
also on the real plume, a shot of one frame. ``--large`` trains only there, at full resolution, on
two frames, the plume and the same turned, and paints it turned further. Density is as it is in the
files. Losses and scores are means over views that no run has, and over the seeds. Everything runs
on one thread.
"""

import argparse
import math
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from benchmarks.circumstances import publish, table_page
from benchmarks.coherence_runs import simulate_plume
from benchmarks.control_scenes import style_pixels
from benchmarks.equal_judge import Judge, read_real_plume, turned_plumes
from benchmarks.long_shot import STEP, fit_line
from benchmarks.one_pass_pictures import Gallery
from benchmarks.stages import PLUME_FILE
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.core.generator.network import Generator
from usdsmoke.core.sequence.frame_state import make_context, open_frame
from usdsmoke.core.sequence.start import start_colours
from usdsmoke.core.sequence.stylize import stylize_window
from usdsmoke.core.sequence.transit import Transit
from usdsmoke.core.smoke.schedule import network_iterations
from usdsmoke.core.smoke.srgb import decode_srgb
from usdsmoke.core.smoke.tasks import share_among
from usdsmoke.core.steps.behind import refine_painted
from usdsmoke.core.steps.colour import initial_colours, run_colour_step
from usdsmoke.core.steps.targets import StepProblem
from usdsmoke.core.training.canvas import Canvas
from usdsmoke.core.training.frames import train_on_frames
from usdsmoke.core.training.train import Trained
from usdsmoke.core.views.scene import Scene, measure_scene

__all__ = ["Row", "Ways", "main", "measure_frame"]

N_FRAMES = 9  # of the plume; the last one is never trained on
HELD_OUT = 4  # number of the frame that training is judged by
N_VIEWS, SEED = 8, 0x0A11  # unseen ones
FULL = (40, 40, 40)  # iterations of a run with the default settings
COLD = ((15, 15, 15), (30, 30, 30), FULL, (150, 150, 160))  # the last: of the preset final
AFTER = (8, 16, 32)
WARM = 40  # iterations behind the neighbour's colours, by default
ALIKE = {"seed": 11, "source_radius": 0.24, "buoyancy": 7.0, "gusts": 2.2}  # another plume
OTHER, REAL = "other plume", "real plume"
MEASURES = ("patch", "colour", "spectrum", "edges")
FRAMES_PER_SECOND = 24.0
LARGEST = 192  # pixels along a picture, as by default
N_SHOWN = 4  # frames whose temporal errors are measured
_INTRO = (
    "# One pass of a trained network against iterations",
    "",
    "A network is trained on seven frames of the example plume, judged by an eighth, and paints",
    "the ninth, which it has not seen, and a frame of each of two other shots. Colours alone, on",
    "density as it is in the files. Losses are the configured style loss, means over eight views",
    "that no run has and over the seeds. Seconds are CPU seconds of one thread, without judging.",
    "Patches, colours, spectrum and edges are closures: 0 the style's mean colour, 1 the style.",
)


@dataclass(frozen=True)
class Row:
    """One way to a frame's colours, means over the seeds."""

    way: str
    loss: float
    cpu_s: float
    scores: tuple[float, ...] = ()  # closures, in the order of MEASURES


@dataclass(frozen=True)
class Ways:
    """The ways to a frame's colours that are compared.

    Attributes:
        cold: iterations per octave.
        after: iterations of the finest octave behind the network.
        neighbour: colours carried from the frame before, None where there is none.
    """

    cold: Sequence[Sequence[int]] = COLD
    after: Sequence[int] = AFTER
    neighbour: torch.Tensor | None = None


def measure_frame(
    problem: StepProblem,
    generator: Generator,
    seeds: Sequence[int],
    ways: Ways = Ways(),
    score: Callable[[str, torch.Tensor], tuple[float, ...]] | None = None,
) -> list[Row]:
    """Noise, cold starts, the neighbour, the network, and the network with iterations.

    Args:
        score: of a way's display-encoded colours [N 3].
    """
    views = problem.config.views.replace(pool=N_VIEWS)
    judged = replace(problem, config=problem.config.replace(views=views))
    judge, smoke = Canvas(judged, SEED, N_VIEWS), problem.smoke
    n_coarse = len(problem.config.colour.iterations) - 1

    def paint(seed: int) -> torch.Tensor:
        return generator.paint(smoke, problem.scene.gamma_w, seed)

    def seeded(seed: int) -> StepProblem:
        optimize = problem.config.optimize.replace(seed=seed)
        return replace(problem, config=problem.config.replace(optimize=optimize))

    def row(way: str, colours: Callable[[int], torch.Tensor]) -> Row:
        losses, spent, scores = [], [], []
        for seed in seeds:
            begin = time.process_time()
            found = colours(seed)
            spent.append(time.process_time() - begin)
            with torch.no_grad():
                losses.append(float(judge.loss(found, 0)))
            scores.append(score(way, found) if score is not None else ())
        means = tuple(map(statistics.mean, zip(*scores, strict=True)))
        return Row(way, statistics.mean(losses), statistics.mean(spent), means)

    def go_on(start: Callable[[int], torch.Tensor], count: int, seed: int) -> torch.Tensor:
        return run_colour_step(seeded(seed), [*[0] * n_coarse, count], start(seed), warm=True)[0]

    def refine(count: int, seed: int) -> torch.Tensor:
        iterations = network_iterations([*[0] * n_coarse, count], len(smoke.ijk))
        return refine_painted(seeded(seed), iterations, paint(seed))[0]

    paint(seeds[0])  # warms up
    rows = [row("noise", lambda seed: initial_colours(smoke, "noise", seed))]
    for octaves in ways.cold:
        way = f"cold, {sum(octaves)} iterations"
        rows.append(row(way, lambda seed, n=octaves: run_colour_step(seeded(seed), n)[0]))  # type: ignore[misc]
    if (carried := ways.neighbour) is not None:
        rows.append(row(f"neighbour + {WARM}", partial(go_on, lambda seed: carried, WARM)))
    rows.append(row("network", paint))
    rows += [row(f"network + {count}", partial(refine, count)) for count in ways.after]
    return rows


def _problem(frame: VolumeFrame, style: np.ndarray, scene: Scene, config: Config) -> StepProblem:
    context = make_context([style], scene, config, None, 24.0, None, 0)
    return open_frame(frame, context).colour_problem()


def _config(longest: int) -> Config:
    return resolve_config(
        {
            "views": {"image_size": min(max(16, longest), LARGEST)},
            "optics": {"thicken": 1.0},  # the smoke as it is, which the judge sees
            "optimize": {"threads": 1, "tolerance": 0.0, "device": "cpu", "steps": ["colour"]},
        }
    )


def _measure(frames: Sequence[VolumeFrame], config: Config) -> Scene:
    chosen = [frames[0], frames[len(frames) // 2], frames[-1]]
    return measure_scene(chosen, config.views, config.optics, "Y", config.grids.parts)


def _train(
    frames: Sequence[VolumeFrame], style: np.ndarray, config: Config, given: argparse.Namespace
) -> tuple[Trained, float]:
    """On all frames but the last, and the CPU seconds that it takes."""
    seen = [frame for n, frame in enumerate(frames[:-1]) if n != HELD_OUT]
    shot = _measure(frames, config), config
    return _fit([*seen, frames[HELD_OUT]], style, shot, given)


def _fit(
    frames: Sequence[VolumeFrame],
    style: np.ndarray,
    shot: tuple[Scene, Config],
    given: argparse.Namespace,
) -> tuple[Trained, float]:
    """On frames of which the last one is held out, and the CPU seconds that it takes."""
    scene, config = shot[0], shot[1].with_values({"optimize.seed": given.training_seed})
    begin, n = time.process_time(), given.iterations
    found = train_on_frames(frames, [style], scene, config, n, lambda state: None)
    return found.trained, time.process_time() - begin


def _curves(
    name: str,
    frames: Sequence[VolumeFrame],
    others: Mapping[str, VolumeFrame],
    gallery: Gallery | None,
    given: argparse.Namespace,
) -> Iterator[str]:
    """The lines of the table for a style: an image file, or the name of an example."""
    style = style_pixels(name)
    name, config = Path(name).stem, _config(max(frames[0].density.values.shape))
    trained, seconds = _train(frames, style, config, given)
    yield _line(name, f"training, {trained.n_iterations} iterations", Row("", 0.0, seconds))
    problem = _problem(frames[-1], style, _measure(frames, config), config)
    work = problem, trained.generator, Ways(neighbour=_carried(frames[-2:], style, problem))
    where = f"{name}, {OTHER if given.other else 'example plume'}"
    yield from _rows(where, (frames[-1], style), work, gallery, given)
    is_first = name == Path(given.styles[0]).stem
    for what, other in others.items():  # drawn with one style
        own = _config(max(other.density.values.shape))
        problem = _problem(other, style, _measure([other], own), own)
        ways, drawn = Ways(COLD[:3], AFTER[1:]), gallery if is_first else None
        work = problem, trained.generator, ways
        yield from _rows(f"{name}, {what}, unseen", (other, style), work, drawn, given)
    if given.own and REAL in others:
        yield from _own(name, style, [others[REAL]], Ways(cold=()), gallery, given)
    if given.shown and is_first:
        yield from _coherence(name, style, frames, trained.generator, config)


def _own(
    name: str,
    style: np.ndarray,
    frames: Sequence[VolumeFrame],
    ways: Ways,
    gallery: Gallery | None,
    given: argparse.Namespace,
) -> Iterator[str]:
    """The real plume with a network of its own: the last frame, by the others if there are any."""
    *seen, frame = frames
    config = _config(max(frame.density.values.shape))
    scene = _measure(frames, config)
    where = f"{name}, real plume, own network"
    fitted, seconds = _fit(seen or frames, style, (scene, config), given)
    yield _line(where, f"training, {fitted.n_iterations} iterations", Row("", 0.0, seconds))
    work = _problem(frame, style, scene, config), fitted.generator, ways
    yield from _rows(where, (frame, style), work, gallery, given)


def _rows(
    where: str,
    pair: tuple[VolumeFrame, np.ndarray],
    work: tuple[StepProblem, Generator, Ways],
    gallery: Gallery | None,
    given: argparse.Namespace,
) -> Iterator[str]:
    (frame, style), (problem, generator, ways) = pair, work
    scene, config, smoke = problem.scene, problem.config, problem.smoke
    judge = Judge(frame, style, scene, config, "colour", MEASURES)
    place = tuple((smoke.ijk.numpy() - np.asarray(frame.density.ijk_min)).T)
    if gallery is not None:
        gallery.add_style(where, style)

    def score(way: str, colours: torch.Tensor) -> tuple[float, ...]:
        light = np.zeros((*frame.density.values.shape, 3), np.float32)
        light[place] = decode_srgb(colours) * (scene.gamma_w * smoke.density)[:, None]
        emission = replace(frame.density, name="emission", values=light, background=(0.0,) * 3)
        if gallery is not None:
            gallery.add(where, way, frame.density, emission, scene)
        closures = judge(frame.density, emission).closures
        return tuple(closures[name] for name in MEASURES if name in closures)  # small ones: none

    rows = measure_frame(problem, generator, range(given.seeds), ways, score)
    full = [row.cpu_s for row in rows if row.way == f"cold, {sum(FULL)} iterations"]
    where = f"{where}, {len(smoke.ijk):,} voxels"
    for row in rows:
        yield _line(where, row.way, row, f"{row.cpu_s / full[0]:.3f}" if full else "")


def _line(where: str, way: str, row: Row, share: str = "") -> str:
    told = row.scores or [math.nan] * len(MEASURES)
    scores = ["" if math.isnan(value) else f"{value:.2f}" for value in told]
    loss = f"{row.loss:.3f}" if row.loss else ""
    return f"| {where} | {way} | {loss} | {row.cpu_s:.2f} | {share} | {' | '.join(scores)} |"


def _carried(
    pair: Sequence[VolumeFrame], style: np.ndarray, problem: StepProblem
) -> torch.Tensor | None:
    """The colours of a frame after a full cold start, carried to the next one."""
    earlier = _problem(pair[0], style, problem.scene, problem.config)
    colours, _ = run_colour_step(earlier, FULL)
    way = Transit(pair[0], (pair[1].time_code - pair[0].time_code) / FRAMES_PER_SECOND)
    return start_colours((earlier.smoke, colours), None, way, problem.smoke, 0)


def _coherence(
    name: str,
    style: np.ndarray,
    frames: Sequence[VolumeFrame],
    generator: Generator,
    config: Config,
) -> Iterator[str]:
    """Temporal errors of the last frames in one window, by how frames start."""
    scene, shown = _measure(frames, config), frames[-N_SHOWN:]
    with tempfile.TemporaryDirectory() as folder:
        file_path = Path(folder) / "network.safetensors"
        file_path.write_bytes(generator.to_bytes({}))
        start = {"optimize.start": str(file_path)}
        for way, values in (
            ("noise, then neighbours", {}),
            ("network + 32, then neighbours", start | {"colour.iterations": [0, 0, 32]}),
        ):
            begin = time.process_time()
            own = config.with_values(values)
            done = list(stylize_window(shown, [style], scene, own))
            spent = (time.process_time() - begin) / len(shown)
            errors = [one.report.temporal.colour for one in done if one.report.temporal is not None]
            error = statistics.mean(error for error in errors if error is not None)
            judge = Judge(shown[-1], style, scene, config, "colour")
            loss = judge(done[-1].density, done[-1].emission).loss
            what = f"{way}: temporal error {error:.2f}; loss of the last"
            yield _line(f"{name}, {N_SHOWN} frames", what, Row("", loss, spent))


def _long_shot(name: str, given: argparse.Namespace) -> Iterator[str]:
    """Whether a network paints the frames of a long shot alike: a line through their losses."""
    style, frames = style_pixels(name), simulate_plume(given.resolution, given.long)
    name = Path(name).stem
    config = _config(max(frames[0].density.values.shape))
    scene = _measure(frames, config)
    places = [round(n * (len(frames) - 1) / 6) for n in range(7)]
    seen = [frames[place] for place in places]
    ordered = [*seen[:3], *seen[4:], seen[3]]
    found, _ = _fit(ordered, style, (scene, config), given)
    codes, losses = [], []
    for number in range(1, len(frames), STEP):
        if number in places:
            continue
        problem = _problem(frames[number], style, scene, config)
        ways = Ways(cold=[COLD[1]], after=())
        rows = {row.way: row.loss for row in measure_frame(problem, found.generator, [0], ways)}
        codes.append(frames[number].time_code)
        losses.append((rows["network"], rows[f"cold, {sum(COLD[1])} iterations"]))
    network, cold = np.array(losses).T
    for what, values in (("network", network), ("network - cold, 90 iterations", network - cold)):
        line = fit_line(np.array(codes), values)
        text = f"{what}: change over the shot {line.change:+.3f} +- {line.error:.3f}; mean"
        yield _line(f"{name}, {len(frames)} frames", text, Row("", line.mean, 0.0))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table, and write it with ``--report``."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n", maxsplit=1)[0])
    parser.add_argument("--resolution", type=int, default=40, help="voxels across, about")
    parser.add_argument("--styles", nargs="+", default=["strokes", "waves"], help="names or images")
    parser.add_argument("--iterations", type=int, default=1200, help="of the training, at most")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--training-seed", type=int, default=0)
    parser.add_argument("--long", type=int, default=0, help="frames of a shot, for drift alone")
    parser.add_argument("--shown", action="store_true", help="temporal errors of the first style")
    parser.add_argument("--other", action="store_true", help="train on the other plume alone")
    parser.add_argument("--own", action="store_true", help="train on the real plume, too")
    parser.add_argument("--large", action="store_true", help="only the real plume, turned")
    parser.add_argument("--picture", type=Path, help="draw the results, with one seed")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="real volumes")
    parser.add_argument("--report", type=Path, help="write the page here")
    given = parser.parse_args(arguments)
    share_among(1)
    file_path, lines = given.data / PLUME_FILE, list[str]()
    gallery = Gallery() if given.picture else None
    if given.large:
        frames = turned_plumes(file_path)
        work = [(Path(name).stem, style_pixels(name), frames) for name in given.styles]
        made = [partial(_own, *one, Ways(), gallery, given) for one in work]
    elif given.long:
        made = [partial(_long_shot, given.styles[0], given)]
    else:
        frames, alike = (simulate_plume(given.resolution, N_FRAMES, **of) for of in ({}, ALIKE))
        frames, others = (alike, {}) if given.other else (frames, {OTHER: alike[-1]})
        if file_path.is_file() and not given.other:
            others[REAL] = read_real_plume(file_path, given.resolution)
        made = [partial(_curves, name, frames, others, gallery, given) for name in given.styles]
    for lines_of in made:
        for line in lines_of():
            print(line, file=sys.stderr, flush=True)
            lines.append(line)
        if gallery is not None and gallery.rows:
            gallery.save(given.picture)
    columns = ["style, smoke", "start", "loss", "CPU s", f"of cold, {sum(FULL)}", *MEASURES]
    own = sys.argv[1:] if arguments is None else arguments
    command = ["python", "-m", "benchmarks.one_pass", *own]
    publish(table_page(_INTRO, columns, lines, command), given.report)
    return 0


if __name__ == "__main__":
    sys.exit(main())

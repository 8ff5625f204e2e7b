"""The example plume stylized frame by frame, alone and in windows, as far as the files' fields."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.control_scenes import FRAMES_PER_SECOND, THINNEST, load_example, paint_styles
from usdsmoke.base.errors import ShapeError
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.sequence.coarse import CoarseStart, coarse_frames
from usdsmoke.core.sequence.frame_loop import run_frames
from usdsmoke.core.sequence.frame_state import PaintedFrame, make_context
from usdsmoke.core.sequence.stylize import stylized_frame
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.views.scene import Scene, measure_scene
from usdsmoke.planning.windows import Window, coarse_runs, split_windows
from usdsmoke.vdb.blend import blend_frames, relative_difference, tail_weights

__all__ = [
    "Outcome",
    "Run",
    "Shot",
    "make_shot",
    "run_alone",
    "run_windows",
    "simulate_plume",
    "some_frames",
]

WARM_UP_STEPS = 40  # of the simulation, as in examples/plume/simulate.py


@dataclass(frozen=True)
class Shot:
    """What is stylized, by what."""

    frames: Sequence[VolumeFrame]  # timeCodes 1, 2, ...
    style: np.ndarray  # display-encoded [H W 3]
    config: Config
    scene: Scene


@dataclass(frozen=True)
class Outcome:
    """One frame as it ends."""

    source: VolumeFrame
    still: ActiveSmoke  # the source's smoke
    displacement: Displacement
    density: DenseField
    emission: DenseField


@dataclass(frozen=True)
class Run:
    """A whole shot, ascending."""

    outcomes: Sequence[Outcome]
    seconds: float  # CPU, coarse step included
    coarse_seconds: float = 0.0
    starts: tuple[int, ...] = ()  # number of the first frame of each window but the first
    touched: tuple[int, ...] = ()  # numbers n of the steps n -> n+1 that blending has a hand in
    differences: tuple[tuple[float, float], ...] = ()  # of both versions: density, emission
    versions: Sequence[Sequence[Outcome]] = ()  # of each window, before blending


def simulate_plume(resolution: int, n_frames: int, **others: float) -> list[VolumeFrame]:
    """The first frames of the example plume, with the velocity that stands in its files.

    Args:
        others: settings of the simulation that are not the example's.
    """
    module = load_example("plume", "solver")
    solver = module.SmokeSolver(resolution, module.PlumeSettings(**others))
    frames: list[VolumeFrame] = []
    for step in range(WARM_UP_STEPS + n_frames):
        solver.step(1.0 / FRAMES_PER_SECOND)
        if step < WARM_UP_STEPS:
            continue
        density = np.asarray(solver.density)
        n_i, _, n_k = density.shape
        index_to_world = np.diag([solver.voxel_size] * 3 + [1.0])
        index_to_world[3, :3] = solver.voxel_size * np.array([0.5 - n_i / 2, 0.5, 0.5 - n_k / 2])
        smoke = np.where(density > THINNEST * density.max(), density, 0).astype(np.float32)
        velocity = np.array(solver.velocity, np.float32)
        frames.append(
            VolumeFrame(
                float(len(frames) + 1),
                DenseField("density", smoke, (0, 0, 0), index_to_world),
                np.eye(4),
                DenseField("vel", velocity, (0, 0, 0), index_to_world, (0.0, 0.0, 0.0)),
                np.eye(4),
            )
        )
    return frames


def make_shot(
    frames: Sequence[VolumeFrame], style: str, settings: Sequence[str], style_size: int = 512
) -> Shot:
    """The frames with an example style; the scene is measured as a whole run measures it."""
    fixed = ["optimize.threads=1", "optimize.device=cpu"]
    config = resolve_config([*fixed, *settings])
    scene = measure_scene(
        [frames[0], frames[len(frames) // 2], frames[-1]],
        config.views,
        config.optics,
        "Y",
        config.grids.parts,
    )
    return Shot(frames, paint_styles([style], style_size)[style], config, scene)


def run_alone(shot: Shot) -> Run:
    """Every frame a window of its own, from noise and rest."""
    started = time.process_time()
    outcomes = [outcome for frame in shot.frames for outcome in _chain(shot, [frame], {})]
    return Run(outcomes, time.process_time() - started)


def some_frames(shot: Shot, codes: Iterable[float]) -> Shot:
    """The shot with some of its frames; extinction and picture size stay."""
    chosen = set(codes)
    return replace(shot, frames=[f for f in shot.frames if f.time_code in chosen])


def run_windows(shot: Shot) -> Run:
    """In windows as configured: a shared coarse step, windows that overlap, blended there.

    Raises:
        ShapeError: the frames leave a gap, or an overlap is longer than the next window.
    """
    started = time.process_time()
    by_code = {frame.time_code: frame for frame in shot.frames}
    windows = split_windows(list(by_code), shot.config.windows)
    starts: dict[float, CoarseStart] = {}
    for codes in coarse_runs(windows):
        chosen = [by_code[code] for code in codes]
        found = coarse_frames(chosen, [shot.style], shot.scene, shot.config, None, _rate())
        starts |= {start.time_code: start for start in found}
    coarse_seconds = time.process_time() - started
    versions = [
        _chain(shot, [by_code[code] for code in (*window.time_codes, *window.overlap)], starts)
        for window in windows
    ]
    run = _joined(windows, versions)
    seconds = time.process_time() - started
    return replace(run, seconds=seconds, coarse_seconds=coarse_seconds, versions=versions)


def _rate() -> float:
    return float(FRAMES_PER_SECOND)


def _chain(
    shot: Shot, frames: Iterable[VolumeFrame], starts: dict[float, CoarseStart]
) -> list[Outcome]:
    frames = list(frames)
    job = make_context(
        [shot.style], shot.scene, shot.config, None, _rate(), starts.get, len(frames)
    )  # fmt: skip
    outcomes = []
    for link in run_frames(frames, job):
        done = stylized_frame(link, job)
        if done.emission is None or link.displacement is None:
            raise ShapeError(f"timeCode {done.time_code:g} was left out: {_why(link)}")
        outcomes.append(
            Outcome(link.frame, link.source, link.displacement, done.density, done.emission)
        )
    return outcomes


def _why(link: PaintedFrame) -> str:
    return link.left_out or "both steps are needed"


def _joined(windows: Sequence[Window], versions: Sequence[Sequence[Outcome]]) -> Run:
    """The windows' own frames in order; those that two windows have are blended."""
    outcomes: list[Outcome] = []
    starts: list[int] = []
    touched: list[int] = []
    differences: list[tuple[float, float]] = []
    tail: Sequence[Outcome] = ()
    for window, found in zip(windows, versions, strict=True):
        own = list(found[: len(window.time_codes)])
        if outcomes:
            starts.append(len(outcomes))
            touched += range(len(outcomes) - 1, len(outcomes) + len(tail))
        for place, (other, weight) in enumerate(zip(tail, tail_weights(len(tail)), strict=True)):
            differences.append(_difference(other, own[place]))
            own[place] = _blend(other, own[place], weight)
        outcomes += own
        tail = found[len(window.time_codes) :]
    last = len(outcomes) - 1  # an overlap may reach the last frame
    return Run(outcomes, 0.0, 0.0, tuple(starts), _below(touched, last), tuple(differences))


def _below(numbers: Iterable[int], limit: int) -> tuple[int, ...]:
    return tuple(sorted({number for number in numbers if number < limit}))


def _blend(tail: Outcome, head: Outcome, weight: float) -> Outcome:
    """The fields as the assembly blends them; the displacement alike, for there is none of it."""
    density, emission = blend_frames(
        [tail.density, tail.emission], [head.density, head.emission], weight
    )
    lattice = head.displacement.lattice
    found = tail.displacement.at(lattice.positions()).view(*lattice.shape, 3)
    values = weight * found + (1 - weight) * head.displacement.values
    return Outcome(head.source, head.still, Displacement(values, lattice), density, emission)


def _difference(tail: Outcome, head: Outcome) -> tuple[float, float]:
    return (
        relative_difference(tail.density, head.density),
        relative_difference(tail.emission, head.emission),
    )

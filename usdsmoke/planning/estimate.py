"""The cost of a run in memory, time and disk, estimated from voxel counts and settings.

N is the number of active voxels and B that of the box (both after refinement), M the voxels of the
mask's box and R those by which the largest box of a velocity or copied grid exceeds the density's
(which are not refined), P the pixels of a picture, L the views in the pool, V those an iteration
draws, S the style images, and s an octave's linear resolution as a share of the full one. J is N
with blocks of voxels counted as one where a pixel holds them. In ``work``, N, B and P are the
visible ones, and such blocks count as one, also those that the shape step moves:

    memory  = BASE + B BOX_BYTES + M MASK_BYTES + R READ_BYTES + N FINE_BYTES +
                  J (VOXEL_BYTES + L VIEW_BYTES) + PIXEL_BYTES P V
    work    = sum over steps and octaves of
                  (min(L, n V) VIEW_TIME N + MAP_TIME N + BOX_TIME B) s^3 +
                  n (ITERATION + V (S PIXEL_TIME P s^2 + VOXEL_TIME N s^3) + MOVE_TIME N s^3)
    seconds = START + sum over frames of
                  (FRAME + FILE_TIME N + (work + FINISH_TIME N s^3 +
                   (NEIGHBOUR s + NEIGHBOUR_TIME N s^3, if warm)) / threads^GAIN)
    training = sum over its parts of
                   n (ITERATION + V' (S PIXEL_TIME P' + VOXEL_TIME C) + LEARN_TIME C) / threads^GAIN
    bytes   = sum over frames of (FILE_BYTES + N bytes per value x values per voxel x TREE)

Where a frame starts from its neighbour, two checkpoints of KEPT_BYTES N + KEPT_BOX_BYTES B (with a
shape step) add to the bytes. Frames in an overlap of windows take twice the time, and two more
files of 32-bit floats. The coarse step, if there is one, costs the work of the octaves up to its
share of the resolution; windows then start above it. A frame that starts from its neighbour (a warm
one) has the finest octave only. Frames that are not optimised, or that a network alone paints, have
FRAME and FILE_TIME and no work; in ``seconds``, s is 1 but in the coarse step.

Training is that of a network in the run (``optimize.start``), in n iterations on frames or crops of
C voxels in V' pictures of P' pixels (``training_parts``); it adds LEARN_BYTES N to the memory. The
network paints a frame that starts from no neighbour in PAINT_TIME N.

MAP_TIME, BOX_TIME, MOVE_TIME and BOX_BYTES_SHAPE apply to the shape step only. Its displacement is
laid out on the whole box, once per octave, and its iterations move the smoke. FINISH_TIME is the
sum of SHEET_TIME, TRANSPORT_TIME with a shape step, and ESTIMATE_TIME with an error budget.

Three frames are in memory at a time, one of them at work. Memory is that of the largest at work, an
upper bound; what the other two hold is part of BOX_BYTES_WARM. The constants of time are fitted to
a server's processor, for plumes of 31 thousand to a million voxels and sequences of four frames:
CPU seconds of one thread were met within a factor of 1.2, wall seconds of two threads within 1.4,
also of twelve frames. Other processors and busy machines differ more.
"""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

from usdsmoke.base.machine import GIB, MOST_THREADS, usable_threads
from usdsmoke.base.naming import COLOUR_CHANNELS
from usdsmoke.config.run_sections import LayerConfig
from usdsmoke.config.settings import Config
from usdsmoke.core.generator.definition import N_ITERATIONS, training_parts
from usdsmoke.core.sequence.controls import (
    are_independent,
    coarse_factor,
    network_alone,
    step_iterations,
)
from usdsmoke.core.smoke.schedule import (
    MANY_VOXELS,
    OCTAVE_SCALE,
    SIDEWAYS,
    network_views,
    pool_size,
    view_ranges,
    warm_iterations,
)
from usdsmoke.vdb.header import GridHeader

BASE = 0.7 * GIB  # the interpreter with USD and torch loaded, and cached frames
BOX_BYTES = 48  # density before and after, RGB, and one temporary array
BOX_BYTES_COLOUR = 8  # of each number beside the emission: written, and read back
BOX_BYTES_SHAPE = 110  # effect, potential and displacement, and the arrays of the transport
BOX_BYTES_WARM = 90  # velocity, also in voxels per second; displacements of the frames beside it
READ_BYTES = 64  # of a larger box beside the density's: as read, checked, hashed and written
MASK_BYTES = 16  # as read, checked, clamped to [0, 1] and on the device
FINE_BYTES = 60  # of a voxel that is written: its place, its colour, the voxels beside it
VOXEL_BYTES = 700  # positions, unknowns with gradients and moments, maps between their levels
VIEW_BYTES = 40  # four pixels and weights
LEARN_BYTES = 1_000  # octaves of a network's frames and of the one that judges, their slopes
PIXEL_BYTES = 12_000  # feature maps, and the values kept for the gradient

START = 3.0  # loading torch, learning the filters
NEIGHBOUR = 2.3  # carrying results from a neighbour, and comparing with it
NEIGHBOUR_TIME = 1.0e-5
FRAME = 0.15  # reading, writing and re-opening the files, however small
FILE_TIME = 1.0e-6
SHEET_TIME = 4.0e-6  # what a frame takes once, and its share of the contact sheet
TRANSPORT_TIME = 3.0e-6  # the last move of the density
ESTIMATE_TIME = 5.0e-6  # of the remaining errors
ITERATION = 0.025
PIXEL_TIME = 8.0e-6
VOXEL_TIME = 1.7e-7
MOVE_TIME = 2.2e-6
BOX_TIME = 1.0e-7
MAP_TIME = 5.0e-7
VIEW_TIME = 4.5e-7
PAINT_TIME = 1.2e-6
LEARN_TIME = 3.2e-6
KEPT_BYTES, KEPT_BOX_BYTES = 65, 12  # of a checkpoint, which a window goes on from
COARSE_BYTES = 44  # of a coarse voxel: displacement and colours, also as the next frame takes them
GAIN = 0.40  # n threads, up to MOST_THREADS, are n ** GAIN times as fast
FILE_BYTES = 60_000  # header and tree of a file with little in it
TREE = 1.3  # masks and nodes beside the values


@dataclass(frozen=True)
class FrameSize:
    """The size of one frame, from its file's header."""

    active_voxels: int
    box: tuple[int, int, int]  # voxels along i, j, k; (0, 0, 0) when empty
    window_start: bool = True  # False: it starts from its neighbour's result
    copied_values: int = 0  # numbers of the velocity and other grids that are copied to the result
    moved_values: int = 0  # of these, those that move with the density
    read_box: int = 0  # voxels of the largest box of these and of the velocity that is followed
    mask_box: tuple[int, int, int] = (0, 0, 0)  # voxels of the mask; (0, 0, 0) without one
    visible: float = 1.0  # share of the box that the shot's camera sees
    computed: bool | None = None  # True if it is optimised; None: as optimize.strength implies
    most_voxels: int = 0  # visible, refined ones of the largest frame that decides; 0: its own
    edges: tuple[float, float, float] = (1.0, 1.0, 1.0)  # of a voxel along i, j, k; any unit

    @property
    def is_thin(self) -> bool:
        """True if the smoke is one voxel thick along one axis."""
        return self.box.count(1) == 1


@dataclass(frozen=True)
class CostEstimate:
    """Costs of a run."""

    memory_gib: float  # peak
    seconds: float
    bytes_written: int  # with the checkpoints of one window at work
    coarse_seconds: float = 0.0  # of these, those of the coarse step that windows share
    bytes_temporary: int = 0  # of decoded source frames; where the disk is short, fewer are kept


def estimate_run(
    frames: Sequence[FrameSize],
    config: Config,
    n_styles: int = 1,
    threads: int | None = None,
    twice: Sequence[FrameSize] = (),
    coarse: Sequence[FrameSize] = (),
    has_starts: bool = False,
) -> CostEstimate:
    """Peak memory, time and bytes written, by the formulae at the top of this file.

    Args:
        frames: of all volumes; empty frames cost their file only.
        threads: None takes the configured number, or what a process takes here.
        twice: the frames that two windows compute.
        coarse: the frames of the shared coarse step; ``window_start`` is that of its chains.
        has_starts: frames start from such a step also where ``coarse`` is empty: it is done.
    """
    again = [replace(frame, window_start=False, copied_values=0) for frame in twice]
    is_shared = has_starts or bool(coarse)
    finest = 1.0 / coarse_factor(config) if is_shared else 1.0
    above = (finest if is_shared else 0.0, 1.0)
    speed = _speed(config, threads)
    below = sum(_frame_seconds(frame, config, n_styles, speed, (0, finest)) for frame in coarse)
    return CostEstimate(
        memory_gib=max((_frame_memory(frame, config) for frame in frames), default=BASE) / GIB,
        seconds=START
        + sum(_frame_seconds(frame, config, n_styles, speed, above) for frame in (*frames, *again))
        + below,
        bytes_written=written_bytes(config, frames, (*twice, *twice), coarse),
        coarse_seconds=below,
    )


def training_seconds(frames: Sequence[FrameSize], config: Config, n_styles: int = 1) -> float:
    """What a run takes to train a network on frames; 0 where it trains none."""
    return training_cost(frames, config, n_styles)[1] if config.optimize.trains else 0.0


def training_cost(
    frames: Sequence[FrameSize], config: Config, n_styles: int, n_iterations: int = N_ITERATIONS
) -> tuple[int, float]:
    """Iterations and seconds of a training on frames; 0 where there is nothing to paint.

    Args:
        n_iterations: at most, as for small frames, see ``training_parts``.
    """
    sizes = [frame for frame in frames if _is_optimized(frame, config)]
    if not sizes:
        return 0, 0.0
    frame = max(sizes, key=lambda size: size.active_voxels)
    active, _ = _refined(frame, config)
    parts = training_parts(active, n_iterations)
    whole, work = n_styles * PIXEL_TIME * _picture_pixels(frame, config), 0.0
    for part in parts:
        pixels = whole * (part.voxels / active) ** (2 / 3)
        drawn = part.views * (pixels + VOXEL_TIME * part.voxels)
        work += part.iterations * (ITERATION + drawn + LEARN_TIME * part.voxels)
    return sum(part.iterations for part in parts), work / _speed(config)


def written_bytes(
    config: Config,
    frames: Sequence[FrameSize] = (),
    parts: Sequence[FrameSize] = (),
    coarse: Sequence[FrameSize] = (),
) -> int:
    """Bytes of the result's frames, parts (a window's versions of frames that two compute), starts
    of the coarse step, and checkpoints."""
    plain = config.replace(grids=config.grids.replace(half=False), layer=LayerConfig())
    finest = 1.0 / coarse_factor(config) if coarse else 1.0
    goes_on = any(not frame.window_start for frame in (*frames, *parts))
    sizes = [_refined(frame, config) for frame in (*frames, *parts) if goes_on]
    versions = [replace(frame, copied_values=frame.moved_values) for frame in parts]
    box_bytes = KEPT_BOX_BYTES if "shape" in config.optimize.steps else 0
    kept = [KEPT_BYTES * active + box_bytes * box for active, box in sizes]
    return (
        sum(_frame_bytes(frame, config) for frame in frames)
        + 2 * max(kept, default=0)
        + sum(_frame_bytes(frame, plain) for frame in versions)
        + sum(round(finest**3 * sum(_refined(f, config)) * COARSE_BYTES) for f in coarse)
    )


def add_estimates(parts: Sequence[CostEstimate]) -> CostEstimate:
    """The costs of several Volumes in one run, one after the other: it starts once."""
    return CostEstimate(
        memory_gib=max((part.memory_gib for part in parts), default=BASE / GIB),
        seconds=sum(part.seconds for part in parts) - (len(parts) - 1) * START,
        bytes_written=sum(part.bytes_written for part in parts),
        coarse_seconds=sum(part.coarse_seconds for part in parts),
        bytes_temporary=sum(part.bytes_temporary for part in parts),
    )


def grid_size(file_path: str, grid: GridHeader) -> tuple[int, tuple[int, int, int]]:
    """Active voxels and their box; without metadata, the file's size is taken as the grid's."""
    active, box = grid.active_voxels, grid.box_shape
    if active is None:
        active = max(1, os.path.getsize(file_path) // 2)  # half floats, nothing compressed
    if box is None and active:
        side = round(active ** (1 / 3)) + 1
        box = (side, side, side)
    return active, box or (0, 0, 0)


def voxel_edges(grid: GridHeader) -> tuple[float, float, float]:
    """The lengths of a voxel's edges in the file's unit; equal ones where it does not tell."""
    if grid.index_to_world is None:
        return 1.0, 1.0, 1.0
    i, j, k = (math.hypot(*row[:3]) or 1.0 for row in grid.index_to_world[:3])
    return i, j, k


def _speed(config: Config, threads: int | None = None) -> float:
    """Times that of one thread."""
    n_threads = threads or config.optimize.threads or usable_threads()
    return float(min(n_threads, MOST_THREADS) ** GAIN)


def _refined(frame: FrameSize, config: Config) -> tuple[int, int]:
    """Active voxels and voxels of the box after subdivision, which leaves thin axes alone."""
    finer: int = config.grids.parts ** sum(n > 1 for n in frame.box)
    return frame.active_voxels * finer, math.prod(frame.box) * finer


def visible_voxels(frame: FrameSize, config: Config) -> int:
    """Active voxels that the shot's camera sees, after subdivision."""
    return round(frame.visible * _refined(frame, config)[0])


def _moves_blocks(frame: FrameSize, config: Config) -> bool:
    """Whether the shape step moves blocks of two voxels: a shot's frames all do, or none."""
    return (frame.most_voxels or visible_voxels(frame, config)) >= MANY_VOXELS


def _voxels_a_pixel(frame: FrameSize, config: Config) -> int:
    """Along its side; without a camera."""
    return max(1, round(max(frame.box) * config.grids.parts / config.views.image_size))


def _joined(frame: FrameSize, config: Config) -> int:
    """The voxels of a block that is optimised as one, because a pixel holds it; rather too few.

    Views from all sides see the longest side of the smoke. Others may see it from its end.
    """
    refine, views = config.grids.parts, config.views
    *_, middle, longest = sorted(n * edge for n, edge in zip(frame.box, frame.edges, strict=True))
    is_seen = not views.camera and view_ranges(views)[0] > SIDEWAYS
    shortest, widest = min(frame.edges) / refine, max(frame.edges) / refine
    n_across = round((longest if is_seen else middle) / views.image_size / shortest)
    side = max(n_across, 1) * shortest / widest
    blocks = OCTAVE_SCALE ** max(int(math.log2(side)), 0)
    return int(blocks ** sum(n > 1 for n in frame.box))


def _picture_pixels(frame: FrameSize, config: Config) -> float:
    """Pixels of a full-size picture: each is a whole number of voxels wide."""
    *_, middle, longest = sorted(frame.box)
    side = longest * config.grids.parts / _voxels_a_pixel(frame, config)
    return side**2 * middle / max(longest, 1)


def _is_optimized(frame: FrameSize, config: Config) -> bool:
    computed = config.optimize.strength > 0 if frame.computed is None else frame.computed
    return frame.active_voxels * frame.visible > 0 and computed and config.losses.style > 0


def _frame_memory(frame: FrameSize, config: Config) -> float:
    active, box = _refined(frame, config)
    per_box_voxel = BOX_BYTES + BOX_BYTES_COLOUR * max(_colour_values(config) - 3, 0)
    if "shape" in config.optimize.steps:
        per_box_voxel += BOX_BYTES_SHAPE
    if not frame.window_start:
        per_box_voxel += BOX_BYTES_WARM
    per_voxel = VOXEL_BYTES + pool_size(config.views) * VIEW_BYTES
    pictures = PIXEL_BYTES * _picture_pixels(frame, config) * config.views.count
    training = LEARN_BYTES * active if config.optimize.trains else 0
    beside = MASK_BYTES * math.prod(frame.mask_box)
    beside += READ_BYTES * max(frame.read_box - math.prod(frame.box), 0)
    fine = active * FINE_BYTES + active / _joined(frame, config) * per_voxel
    return BASE + per_box_voxel * box + beside + fine + pictures + training


def _frame_seconds(
    frame: FrameSize, config: Config, n_styles: int, speed: float, octaves: tuple[float, float]
) -> float:
    """``octaves``: the shares of the full resolution above and up to which they are done."""
    active, _ = _refined(frame, config)
    seconds = FRAME + FILE_TIME * active
    if not _is_optimized(frame, config):
        return seconds
    is_first = frame.window_start and octaves[1] == 1.0
    if network_alone(config) or (config.optimize.paints and is_first):
        seconds += PAINT_TIME * active / speed
    if are_independent(config):
        return seconds
    work = sum(_step_work(step, frame, config, n_styles, octaves) for step in config.optimize.steps)
    work += _finish_time(config) * active * octaves[1] ** 3
    if not frame.window_start:
        work += NEIGHBOUR * octaves[1] + NEIGHBOUR_TIME * active * octaves[1] ** 3
    return seconds + work / speed


def _finish_time(config: Config) -> float:
    """Seconds of one thread for each voxel of a frame, beside its steps."""
    moved = TRANSPORT_TIME if "shape" in config.optimize.steps else 0.0
    return SHEET_TIME + moved + (ESTIMATE_TIME if config.optimize.error_budget else 0.0)


def _step_work(
    step: str, frame: FrameSize, config: Config, n_styles: int, octaves: tuple[float, float]
) -> float:
    """Seconds of one thread."""
    joined = _joined(frame, config)
    active, box = (frame.visible * n / joined for n in _refined(frame, config))
    pixels = n_styles * PIXEL_TIME * _picture_pixels(frame, config) * frame.visible ** (2 / 3)
    above, finest = octaves
    is_warm = not frame.window_start
    iterations = step_iterations(config, step, is_warm and finest == 1.0, round(active))
    scales = [float(OCTAVE_SCALE) ** -n for n in reversed(range(len(iterations)))]
    iterations = [
        n if above < scale <= finest else 0 for n, scale in zip(iterations, scales, strict=True)
    ]
    if is_warm and finest < 1.0:
        iterations = warm_iterations(iterations, config.windows.warm_iterations)
    if step == "shape" and joined == 1 and iterations[-1] and _moves_blocks(frame, config):
        # the last octave is done on the blocks of the one before, which is left out
        iterations[-2:-1] = [0] * len(iterations[-2:-1])
        scales[-1] = 1.0 / OCTAVE_SCALE
    n_pool = pool_size(config.views)
    n_drawn = min(config.views.count, n_pool)
    work = 0.0
    for n_iterations, scale in zip(iterations, scales, strict=True):
        if n_iterations == 0:
            continue
        iteration = n_drawn * (pixels * scale**2 + VOXEL_TIME * active * scale**3)
        drawn = min(n_pool, n_iterations * n_drawn)
        if step == "colour" and config.optimize.paints and not is_warm:
            drawn = network_views(config.views, n_iterations)
        work += n_iterations * (ITERATION + iteration) + drawn * VIEW_TIME * active * scale**3
        if step == "shape":
            work += (MAP_TIME * active + BOX_TIME * box) * scale**3
            work += n_iterations * MOVE_TIME * active * scale**3
    return work


def _frame_bytes(frame: FrameSize, config: Config) -> int:
    # a frame without an effect keeps the voxels of its source
    active = _refined(frame, config)[0] if _is_optimized(frame, config) else frame.active_voxels
    values, per_value = 1 + _colour_values(config), TREE * (2 if config.grids.half else 4)
    return round(FILE_BYTES + (active * values + frame.copied_values) * per_value)


def _colour_values(config: Config) -> int:
    """Numbers that a voxel has in all colour grids of a file."""
    if "colour" not in config.optimize.steps:
        return 0
    names = config.colour_grids
    return sum(1 if name in COLOUR_CHANNELS else 3 for name in names)

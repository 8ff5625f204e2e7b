"""The frames of a window in order: opened, shaped, moved, painted and finished.

Every phase is an iterator that pulls from the one before it, so that only three frames are in
memory, however long the window is. Displacements and colours are carried from frame to frame at
full strength, and each frame takes its own share at the end: of a strength that changes from frame
to frame, only the share of thickening changes what frames are optimised on.
"""

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import starmap
from typing import TypeVar

from torch import Tensor

from usdsmoke.base.frame_report import Estimate, FrameReport, TemporalErrors, TransportReport
from usdsmoke.base.machine import give_back_memory
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.core.sequence.coherence import average_colours, average_displacement
from usdsmoke.core.sequence.controls import network_alone
from usdsmoke.core.sequence.cuts import judge_passage
from usdsmoke.core.sequence.error_estimates import step_report, unseen_views
from usdsmoke.core.sequence.frame_state import (
    NO_STRENGTH,
    MovedFrame,
    OpenedFrame,
    PaintedFrame,
    Phase,
    ShapedFrame,
    WindowContext,
    advance,
    open_frame,
    selected,
)
from usdsmoke.core.sequence.motion import estimate_velocity
from usdsmoke.core.sequence.start import Carried, start_colours, start_displacement
from usdsmoke.core.sequence.steadiness import Steadiness
from usdsmoke.core.sequence.transit import Transit
from usdsmoke.core.smoke.active import ActiveSmoke, activate
from usdsmoke.core.steps.behind import refine_painted
from usdsmoke.core.steps.colour import run_colour_step
from usdsmoke.core.steps.light_share import picture_reports
from usdsmoke.core.steps.move import (
    displacement_of,
    fade_of,
    movable_blocks,
    move_density,
    near_smoke,
)
from usdsmoke.core.steps.pictures import ColourView
from usdsmoke.core.steps.shape import Start, max_displacement, run_shape_step

Result = TypeVar("Result", bound=ShapedFrame)


def run_frames(
    frames: Iterable[VolumeFrame],
    context: WindowContext,
    open_frame: Callable[[VolumeFrame, WindowContext], OpenedFrame] = open_frame,
) -> Iterator[PaintedFrame]:
    """The finished frames of a window, in order.

    Args:
        frames: ascending time_code; pulled one at a time, up to two ahead of what is yielded, three
            where a frame has strength 0.
        context: what they share.
        open_frame: checks a frame and makes its first record.
    """
    steps, motion = context.config.optimize.steps, context.config.stage.motion

    # open: check fields and settings; leave out frames of strength 0
    if motion == "estimate":
        frames = _with_estimated_motion(iter(frames), context)
    opened = _leave_out(open_frame(frame, context) for frame in frames)

    # shape: find each frame's displacement, starting from the frame before
    # move: average it with the next frame's, and move the density
    moved: Iterator[MovedFrame]
    if "shape" in steps and not context.independent:
        shaped = _chain(opened, ShapedFrame, partial(_shape, context))
        averaged = starmap(partial(_average, context), _with_next(shaped))
        moved = map(partial(_move, context), averaged)
    else:
        moved = (advance(frame, MovedFrame) for frame in opened)

    # paint: find each frame's colours, starting from the frame before
    if context.independent:
        return (_paint_alone(context, frame) for frame in moved)
    if "colour" in steps:
        painted = _chain(moved, PaintedFrame, partial(_paint, context))
    else:
        painted = (advance(frame, PaintedFrame) for frame in moved)

    # finish: average the colours with the next frame's, and measure temporal errors
    return _finish(painted, context)


# open


def _with_estimated_motion(
    frames: Iterator[VolumeFrame], context: WindowContext
) -> Iterator[VolumeFrame]:
    """The frames with the velocity that carries each to the next; the last one has none."""
    frame = next(frames, None)
    for later in frames:
        assert frame is not None
        seconds = (later.time_code - frame.time_code) / context.time_codes_per_second
        velocity = estimate_velocity(frame, later, seconds, device=context.device)
        yield replace(frame, velocity=velocity, velocity_to_stage=later.density_to_stage)
        frame = later
    if frame is not None:
        yield replace(frame, velocity=None, velocity_to_stage=None)


def _leave_out(frames: Iterator[OpenedFrame]) -> Iterator[OpenedFrame]:
    """Leaves out frames of strength 0, except those next to one in effect (``is_computed``)."""
    before_in_effect, ahead = False, None
    while (frame := ahead or next(frames, None)) is not None:
        ahead = None
        if not frame.left_out and not frame.in_effect and not before_in_effect:
            ahead = next(frames, None)
            if ahead is None or not ahead.in_effect:
                frame = replace(frame, report=replace(frame.report, left_out=NO_STRENGTH))
        yield frame
        before_in_effect = frame.in_effect


# shape and move


def _shape(context: WindowContext, frame: OpenedFrame, before: ShapedFrame | None) -> ShapedFrame:
    """The frame with its displacement."""
    started, config = time.perf_counter(), frame.config
    before, report, is_cold = _connected(context, frame, before)
    if (known := context.known_of(frame)) is not None:
        unclamped = known.unclamped
    else:
        start: Start | None = None
        if before is not None or frame.has_coarse_displacement:
            carried = before.unclamped if before is not None else None
            transit = None if before is None else context.transit(before, frame)
            limit = max_displacement(frame.source, config.shape.reach)
            start = partial(start_displacement, carried, frame.coarse, transit, limit)
        is_warm = before is not None
        frame.targets.prepare({step: frame.todo(step, is_warm) for step in config.optimize.steps})
        iterations = frame.todo("shape", is_warm)
        watch = context.watch(frame.time_code)("shape", iterations)
        # a window's first frame stays near the coarse step, which pulls at the frames behind it:
        # otherwise they would take the whole overlap to settle
        rate_share = 1.0 if start is None else config.shape.warm_rate
        steadiness = 0.0 if start is None else config.windows.steadiness
        problem = frame.problem(frame.source)
        unclamped, ends = run_shape_step(problem, iterations, start, watch, rate_share, steadiness)
        report = replace(report, shape=step_report("shape", ends, frame, started))
    kept = Carried(frame.time_code, unclamped)
    return advance(
        frame, ShapedFrame, unclamped=unclamped, carried=kept, report=report, is_cold=is_cold
    )


def _average(context: WindowContext, frame: ShapedFrame, later: ShapedFrame | None) -> ShapedFrame:
    """The frame with its displacement averaged with the next frame's."""
    share = context.config.shape.smoothing
    if frame.unclamped is None or later is None or later.unclamped is None or not share:
        return frame
    if later.is_cold:
        return frame
    started, transit = time.perf_counter(), context.transit(frame, later)
    lattice, source = frame.unclamped.lattice, frame.source
    blocks = movable_blocks(source, frame.scene)
    near = near_smoke(lattice.fill(blocks), lattice, fade_of(source))
    averaged = average_displacement(frame.unclamped, later.unclamped, transit, share, near)
    report = frame.report.with_transport_time(time.perf_counter() - started)
    return replace(frame, unclamped=averaged, report=report)


def _move(context: WindowContext, frame: ShapedFrame) -> MovedFrame:
    """The frame with its displacement clamped and its density moved by that."""
    if frame.unclamped is None:
        return advance(frame, MovedFrame)
    started = time.perf_counter()
    give_back_memory()
    source, config = frame.source, frame.config
    limit = max_displacement(source, config.shape.reach)
    displacement = displacement_of(frame.unclamped, source, limit, frame.mask)
    if not frame.in_effect:
        report = replace(frame.report, transport=TransportReport(limit))
        return advance(frame, MovedFrame, displacement=displacement, report=report)
    strength, is_part = config.optimize.strength, frame.visibility is not None
    own = displacement
    if strength < 1:
        own = displacement_of(frame.unclamped, source, limit, frame.mask, strength)
    density, transport = move_density(
        frame.density, source, own, frame.scene, config.shape, frame.mask, is_part
    )
    smoke = activate(density, frame.frame.density_to_stage, context.device)
    if frame.visibility is not None:
        smoke = frame.visibility.visible(smoke)
    report = replace(frame.report, transport=replace(transport, cap=limit))
    estimated = transport.error.seconds if transport.error is not None else 0.0
    report = report.with_transport_time(time.perf_counter() - started - estimated)
    return advance(
        frame, MovedFrame, displacement=displacement, moved_by=own, density=density, smoke=smoke,
        report=report,
    )  # fmt: skip


# paint


def _paint(context: WindowContext, frame: MovedFrame, before: PaintedFrame | None) -> PaintedFrame:
    """The frame with its colours."""
    started = time.perf_counter()
    before, report, is_cold = _connected(context, frame, before)
    painted, n_views = selected(frame.smoke, frame.mask), 0
    unseen: Estimate | None = None
    if (known := context.known_of(frame)) is not None:
        colours = known.colours
    else:
        if network_alone(frame.config):
            before = None
        paint = before.paint if before is not None else None
        transit = None if before is None else context.transit(before, frame)
        start = _colour_start(context, frame, paint, transit, painted)
        iterations = frame.todo("colour", paint is not None)
        frame.targets.prepare({"colour": iterations})
        watch = context.watch(frame.time_code)("colour", iterations)
        problem = frame.colour_problem()

        def compare(views: Sequence[ColourView], colours: Tensor) -> None:
            nonlocal unseen  # here, while the maps of the pool are there
            unseen = None if context.independent else unseen_views(frame, problem, colours, views)

        if context.generator is not None and paint is None and start is not None:
            colours, ends, n_views = refine_painted(problem, iterations, start, watch, compare)
        else:
            is_warm = start is not None  # also from the coarse step, as in the shape step
            colours, ends = run_colour_step(
                problem, iterations, start, watch, is_warm, compare, paint is not None
            )
        light, look = picture_reports(problem, painted, colours)
        started += 0.0 if unseen is None else unseen.seconds
        ended = step_report("colour", ends, frame, started, n_views)
        report = replace(report, light=light, look=look, colour=ended)
    kept = replace(frame.carried or Carried(frame.time_code), colours=colours)
    return advance(
        frame, PaintedFrame, painted=painted, colours=colours, carried=kept, report=report,
        is_cold=is_cold, n_views=n_views, unseen=unseen,
    )  # fmt: skip


def _paint_alone(context: WindowContext, frame: MovedFrame) -> PaintedFrame:
    """The frame with colours that owe nothing to other frames."""
    if frame.left_out:
        return advance(frame, PaintedFrame)
    return replace(_paint(context, frame, None), independent=True)


def _colour_start(
    context: WindowContext,
    frame: MovedFrame,
    before: tuple[ActiveSmoke, Tensor] | None,
    transit: Transit | None,
    painted: ActiveSmoke,
) -> Tensor | None:
    """What a frame's colours start from; None where there is nothing.

    Args:
        before, transit: the neighbour's painted smoke and its colours, and the way from there.
        painted: the frame's painted smoke.
    """
    seed, generator = frame.config.optimize.seed, context.generator
    if generator is None:
        return start_colours(before, frame.coarse, transit, painted, seed)
    if before is None and len(painted.ijk):
        return generator.paint(painted, frame.scene.gamma_w, seed)
    return start_colours(before, None, transit, painted, seed)  # the coarse step starts from noise


# finish


def _finish(frames: Iterator[PaintedFrame], context: WindowContext) -> Iterator[PaintedFrame]:
    share, before = context.config.colour.smoothing, None
    if network_alone(context.config):
        share = 0.0
    seed = context.config.optimize.seed
    moves, colours = Steadiness(seed, is_vector=True), Steadiness(seed)
    for frame, following in _with_next(frames):
        started, paint = time.perf_counter(), frame.paint
        later = following
        if later is not None and (later.left_out or later.is_cold):
            later = None
        if later is not None and paint is not None and later.paint is not None and share:
            averaged = average_colours(*paint, later.paint, context.transit(frame, later), share)
            frame = replace(frame, colours=averaged)
        report, known = frame.report, context.known_of(frame)
        if known is not None and known.clouds:  # they were compared before the cut
            moves.clouds, colours.clouds = known.clouds
        elif not frame.left_out and (before is not None or following is not None):
            temporal = _temporal_errors(moves, colours, before, frame, context)
            if before is not None:
                report = replace(report, temporal=temporal)
        if not frame.left_out and (before is not None or later is not None):
            report = report.with_transport_time(time.perf_counter() - started)
        frame = replace(frame, report=report)
        if (carried := frame.carried) is not None:
            carried = replace(carried, clouds=(moves.clouds, colours.clouds))
        yield replace(frame, carried=carried)
        if not frame.left_out:
            before = replace(frame, carried=None)
        elif frame.ends_chain:
            before = None


def _temporal_errors(
    moves: Steadiness,
    colours: Steadiness,
    before: PaintedFrame | None,
    frame: PaintedFrame,
    context: WindowContext,
) -> TemporalErrors:
    """Of a frame's displacement and colours against the frames before it."""
    transit = None
    if before is not None and not frame.is_cold:
        transit = context.transit(before, frame)
    moved, coloured = dict[int, float](), dict[int, float]()
    if frame.displacement is not None:
        source = selected(frame.source, frame.mask)
        moved = dict(moves.compare(source, frame.displacement.at(source.positions), transit))
    if frame.paint is not None:
        coloured = dict(colours.compare(*frame.paint, transit))
    else:
        colours.restart()
    return TemporalErrors.of(moved, coloured)


# in several phases


def _chain(
    frames: Iterator[Phase], phase: type[Result], step: Callable[[Phase, Result | None], Result]
) -> Iterator[Result]:
    """Each frame after a step that starts from the frame before; those left out pass through."""
    before: Result | None = None
    for frame in frames:
        done = advance(frame, phase) if frame.left_out else step(frame, before)
        if done.is_start:
            before = done
        elif frame.ends_chain:
            before = None
        yield done


def _connected(
    context: WindowContext, frame: OpenedFrame, before: Result | None
) -> tuple[Result | None, FrameReport, bool]:
    """The frame before, unless the smoke jumps; the report, with what is wrong with the velocity,
    and whether the frame starts cold for that."""
    if before is None:
        return None, frame.report, False
    if isinstance(frame, ShapedFrame) and frame.unclamped is not None:  # the shape step has looked
        return (None if frame.is_cold else before), frame.report, frame.is_cold
    rate = context.time_codes_per_second
    way = replace(  # the smoke's, not the pattern's
        context.transit(before, frame), seconds=(frame.time_code - before.time_code) / rate
    )
    passage = judge_passage(
        before.source, frame.source, way, rate, context.config.stage.velocity_unit
    )
    texts = []
    seen = " in the camera's picture" if context.config.views.camera else ""
    if passage.is_cut and passage.is_measured:
        texts.append(
            f"the smoke{seen} jumps: {passage.difference:.0%} of it at timeCode "
            f"{frame.time_code:g} is not that of {before.time_code:g} carried along. The frame "
            f"starts anew, as after a cut{passage.remark}"
        )
    warnings = (*frame.report.warnings, *(t for t in texts if t not in frame.report.warnings))
    report = replace(frame.report, warnings=warnings, velocity_doubt=passage.doubt)
    return (None if passage.is_cut else before), report, passage.is_cut


def _with_next(frames: Iterator[Phase]) -> Iterator[tuple[Phase, Phase | None]]:
    """Every frame with the next one, or None behind the last.

    A frame that was yielded is not kept: only its consumer decides how long it is in memory.
    """
    waiting: deque[Phase] = deque()
    for frame in frames:
        waiting.append(frame)
        del frame
        if len(waiting) == 2:
            yield waiting.popleft(), waiting[0]
    if waiting:
        yield waiting.popleft(), None

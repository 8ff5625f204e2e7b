"""The frames of a window as a chain: shaped one after another, aligned, painted, aligned.

Four generators stand one behind the other, so that only the frames in flight are held, three of
them, however long the window is:

    shape      each frame's displacement, starting from its neighbour's
    settle     averaged with the following frame's; the density is moved
    paint      each frame's colours, starting from its neighbour's
    finish     averaged with the following frame's; temporal errors are measured

All of it is carried along at full strength, and each frame takes its own share at the end. So a
strength that changes from frame to frame changes nothing in how frames follow on each other.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial

from usdsmoke.base.frame_report import StepReport, TemporalErrors, TransportReport
from usdsmoke.base.machine import give_back_memory
from usdsmoke.base.settings import Config
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.core.fields.displacement import clamp_displacement
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.sequence.coherence import (
    average_colours,
    average_displacement,
    colour_error,
    displacement_error,
)
from usdsmoke.core.sequence.error_estimates import tail_figures
from usdsmoke.core.sequence.frame_state import Job, Link
from usdsmoke.core.sequence.motion import estimate_velocity
from usdsmoke.core.sequence.start import Carried, start_colours, start_displacement
from usdsmoke.core.smoke.active import activate
from usdsmoke.core.smoke.schedule import octave_iterations, warm_iterations
from usdsmoke.core.steps.colour import run_colour_step
from usdsmoke.core.steps.move import move_density, shares_on
from usdsmoke.core.steps.optimize import Minimum
from usdsmoke.core.steps.shape import Start, longest_move, run_shape_step

__all__ = ["run_chain"]


def run_chain(
    frames: Iterable[VolumeFrame], job: Job, open_frame: Callable[[VolumeFrame, Job], Link]
) -> Iterator[Link]:
    """The finished links of a window, in the frames' order.

    Args:
        frames: ascending time_code; pulled one at a time, up to two ahead of what is yielded, three
            where a frame has strength 0.
        open_frame: checks a frame and makes its link.
    """
    if job.config.stage.motion == "estimate":
        frames = _with_estimated_motion(iter(frames), job)
    links = _rest(open_frame(frame, job) for frame in frames)
    if "shape" in job.config.optimize.steps:
        links = _settle(_shape(links, job), job)
    if "colour" in job.config.optimize.steps:
        links = _paint(links, job)
    return _finish(links, job)


def _with_estimated_motion(frames: Iterator[VolumeFrame], job: Job) -> Iterator[VolumeFrame]:
    """The frames with the velocity that carries each to the next; the last one has none."""
    held: VolumeFrame | None = None
    for frame in frames:
        if held is not None:
            seconds = (frame.time_code - held.time_code) / job.time_codes_per_second
            velocity = estimate_velocity(held, frame, seconds, device=job.device)
            yield replace(held, velocity=velocity, velocity_to_stage=frame.density_to_stage)
        held = frame
    if held is not None:
        yield replace(held, velocity=None, velocity_to_stage=None)


def _rest(links: Iterator[Link]) -> Iterator[Link]:
    """Leaves out frames of strength 0, except those next to one in effect (``is_computed``)."""
    before, ahead = False, None
    while (link := ahead or next(links, None)) is not None:
        ahead = None
        if not link.left_out and not link.in_effect and not before:
            ahead = next(links, None)
            if ahead is None or not ahead.in_effect:
                link.rests, link.left_out = True, "optimize.strength is 0"
                link.report = replace(link.report, left_out=link.left_out)
        yield link
        before = link.in_effect


def _shape(links: Iterator[Link], job: Job) -> Iterator[Link]:
    before: Link | None = None
    for link in links:
        if not link.left_out:
            _shape_one(link, before, job)
            before = link
        before = None if link.rests else before
        yield link


def _shape_one(link: Link, before: Link | None, job: Job) -> None:
    if job.known is not None and job.known.time_code == link.frame.time_code:
        link.free = job.known.free
    else:
        _optimize_shape(link, before, job)
    if job.keeps_carried:
        link.carried = Carried(link.frame.time_code, link.free)


def _optimize_shape(link: Link, before: Link | None, job: Job) -> None:
    started, config = time.perf_counter(), link.config
    start: Start | None = None
    if before is not None or (link.coarse is not None and link.coarse.displacement is not None):
        carried = before.free if before is not None else None
        seconds = job.seconds(before, link) if before is not None else 0.0
        start = partial(start_displacement, carried, link.coarse, _mover(before, link), seconds)
    plan = _plan(config.shape.iterations, link, before is not None, config)
    link.free, ends = run_shape_step(
        link.source, start, link.targets, link.scene, config, plan,
        job.watch(link.frame.time_code)("shape", plan), link.mask,
        1.0 if before is None else config.shape.warm_rate,
    )  # fmt: skip
    seconds = time.perf_counter() - started
    link.report = replace(link.report, shape=_step_report(ends, link, seconds))


def _settle(links: Iterator[Link], job: Job) -> Iterator[Link]:
    share = job.config.shape.smoothing
    for link, later in _with_next(links):
        free = link.free
        if free is not None:
            if later is not None and later.free is not None and share:
                seconds = job.seconds(link, later)
                free = average_displacement(free, later.free, link.frame, seconds, share)
            link.settled = free
            if later is not None:  # which started from it already
                link.free = None
            _move(link, free, job)
        yield link


def _move(link: Link, free: Displacement, job: Job) -> None:
    """Hold the displacement below the cap and move the density by it; not at all by none."""
    give_back_memory()
    lattice, cap = free.lattice, longest_move(link.source, link.config)
    share = shares_on(lattice, link.mask, link.source.density)
    held = lattice.to_stage(clamp_displacement(lattice.from_stage(free.values), cap, share))
    link.displacement = Displacement(held, lattice)
    if not link.in_effect:
        link.report = replace(link.report, transport=TransportReport(cap))
        return
    link.density, transport = move_density(
        link.density,
        link.source,
        link.displacement,
        link.config,
        share,
        link.visibility is not None,
    )
    moved = activate(link.density, link.frame.density_to_stage, job.device)
    link.smoke = moved if link.visibility is None else link.visibility.visible(moved)
    link.report = replace(link.report, transport=replace(transport, cap=cap))


def _paint(links: Iterator[Link], job: Job) -> Iterator[Link]:
    before: Link | None = None
    for link in links:
        if not link.left_out:
            _paint_one(link, before, job)
            before = link if link.paint is not None else before
        before = None if link.rests else before
        yield link


def _paint_one(link: Link, before: Link | None, job: Job) -> None:
    share = None if link.mask is None else link.mask.at(link.smoke.positions)
    link.painted = link.smoke if share is None else link.smoke.take(share > 0)
    if job.known is not None and job.known.time_code == link.frame.time_code:
        link.colours = job.known.colours
    else:
        _optimize_colours(link, before, job)
    if job.keeps_carried:
        free = link.carried.free if link.carried is not None else None
        link.carried = Carried(link.frame.time_code, free, link.colours)


def _optimize_colours(link: Link, before: Link | None, job: Job) -> None:
    assert link.painted is not None
    started, config = time.perf_counter(), link.config
    paint = before.paint if before is not None else None
    seconds = job.seconds(before, link) if before is not None else 0.0
    start = start_colours(
        paint, link.coarse, _mover(before, link), link.painted, seconds, config.optimize.seed
    )
    plan = _plan(config.colour.iterations, link, paint is not None, config)
    link.colours, ends = run_colour_step(
        link.smoke, start, link.targets, link.scene, config, plan,
        job.watch(link.frame.time_code)("colour", plan), link.mask,
        paint is not None,
    )  # fmt: skip
    seconds = time.perf_counter() - started
    link.report = replace(link.report, colour=_step_report(ends, link, seconds))


def _finish(links: Iterator[Link], job: Job) -> Iterator[Link]:
    share, before = job.config.colour.smoothing, None
    for link, later in _with_next(links):
        paint = link.paint
        if later is not None and paint is not None and later.paint is not None and share:
            seconds = job.seconds(link, later)
            link.colours = average_colours(*paint, later.paint, link.frame, seconds, share)
        if before is not None and not link.left_out:
            temporal = _temporal_errors(before, link, job)
            link.report = replace(link.report, temporal=temporal)
        yield link
        before = None if link.rests else before if link.left_out else link


def _temporal_errors(before: Link, link: Link, job: Job) -> TemporalErrors:
    seconds, displacement, colour = job.seconds(before, link), None, None
    if before.displacement is not None and link.displacement is not None:
        displacement = displacement_error(
            before.displacement, link.displacement, link.source, before.frame, seconds
        )
    if before.paint is not None and link.paint is not None:
        colour = colour_error(before.paint, *link.paint, before.frame, seconds)
    return TemporalErrors(displacement, colour)


def _mover(before: Link | None, link: Link) -> VolumeFrame:
    """Whose velocity brings smoke from one frame to the next: the earlier one's."""
    return link.frame if before is None else before.frame


def _with_next(links: Iterator[Link]) -> Iterator[tuple[Link, Link | None]]:
    """Every link with the next one that is not left out, if that follows at once."""
    held: Link | None = None
    for link in links:
        if held is not None:
            yield held, None if link.left_out else link
        held = link
    if held is not None:
        yield held, None


def _plan(per_octave: Sequence[int], link: Link, warm: bool, config: Config) -> list[int]:
    """Iterations per octave: a share of the finest one's for a frame that has a neighbour.

    A frame that starts from the shared coarse step leaves out the octaves that were done there.
    """
    plan = octave_iterations(per_octave, config.optimize.iterations)
    if warm:
        return warm_iterations(plan, config.windows.warm_iterations)
    n_done = link.coarse.n_octaves(len(plan)) if link.coarse is not None else 0
    return [0 if number < n_done else n for number, n in enumerate(plan)]


def _step_report(ends: Sequence[Minimum], link: Link, seconds: float) -> StepReport:
    """How the octaves of a step ended."""
    views = link.config.views
    pool = views.pool if link.source.thin_axis is None else 1
    return StepReport(
        seconds=seconds,
        loss=tuple(end.smoothed for end in ends),
        iterations=tuple(end.iteration + 1 for end in ends),
        rollbacks=sum(end.rollbacks for end in ends),
        restored=sum(end.restored for end in ends),
        ended=tuple(end.reason for end in ends),
        **tail_figures(ends, pool, views.count),
    )

"""What deserves a look in a frame as soon as it is written, by itself and beside its neighbour."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from usdsmoke.base.frame_report import FrameReport, StepReport
from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.schedule import octave_iterations
from usdsmoke.planning.plan import VolumePlan, named_frames
from usdsmoke.runs.budget.finding import Finding
from usdsmoke.runs.budget.light_findings import (
    DEEPEST,
    find_depth,
    find_light,
    find_scene,
    of_last_step,
)
from usdsmoke.runs.budget.look_findings import (
    colour_remedy,
    find_look,
    has_far_speed,
    has_high_rate,
    is_nearly_black,
    length_of,
)
from usdsmoke.runs.budget.planned import PlannedVolume, neighbours
from usdsmoke.runs.budget.rows import (
    COLOUR_OPTIMISER,
    MASS,
    MOTIONLESS,
    PIXEL_FILTER,
    QUADRATURE,
    RESOLUTION,
    ROWS,
    SHAPE_OPTIMISER,
    TEMPORAL,
    ErrorRow,
)
from usdsmoke.runs.budget.sight_findings import find_sight

UNMOVED = 1e-3  # of the largest allowed displacement: less is not seen
VANISHED = 0.01  # of the voxels
HARDLY_FALLEN = 0.6  # of a cold frame's first losses
UNLIKE = 3.0  # times the neighbour's loss
LEAST_REACH = 1e-3  # of the smoke's longest side: less changes no picture
_OUTWEIGH = (  # settings that can keep the shape step from moving anything
    "shape.reach",
    "optics.gamma_shape",
    "optics.depth_shape",
    "shape.learning_rate",
    "losses.keep",
    "losses.content",
    "losses.style",
    "optimize.strength",
)
_OPTIMISERS = {"shape": SHAPE_OPTIMISER.name, "colour": COLOUR_OPTIMISER.name}


def find_volume(volume: PlannedVolume) -> Iterator[Finding]:
    """The findings of a Volume: of its scene, then frame by frame."""
    yield from find_scene(volume)
    yield from _find_idle(volume)
    before = frames_before(volume.plan)
    reports = {
        frame.file_name: report
        for frame, report in zip(volume.plan.frames, volume.reports, strict=True)
        if report is not None
    }
    measured = names_measured(volume.plan)
    for name in reports:
        before_it, is_measured = before.get(name), name in measured
        yield from find_written(name, reports, before_it, volume.plan.config, is_measured)


def _find_idle(volume: PlannedVolume) -> Iterator[Finding]:
    """A Volume of which nothing is stylized, although no setting asks for that."""
    config = volume.plan.config
    if not volume.idle or config.losses.style == 0 or config.optimize.strength == 0:
        return
    remedy, setting = "Check its densities", ""
    if "mask" in volume.idle:
        remedy, setting = "Check values, place and scale of the mask", "stage.mask"
    elif "clipping" in volume.idle:
        remedy, setting = "Change the camera's clippingRange, or unset views.camera", "views.camera"
    elif "camera" in volume.idle:
        remedy, setting = "Check where the camera looks, or unset views.camera", "views.camera"
    row = _OPTIMISERS["colour" if "colour" in config.optimize.steps else "shape"]
    yield Finding(volume.plan.source.prim_path, row, volume.idle, remedy, setting)


def frames_before(plan: VolumePlan) -> dict[str, str]:
    """By a frame's file name that of the frame before, where there is no cut between them."""
    return {after.file_name: frame.file_name for frame, after in neighbours(plan)}


def names_measured(plan: VolumePlan) -> set[str]:
    """File names of the frames that are known to choose the extinction."""
    named = [plan.frames[0]] if len(plan.frames) == 1 else []
    if plan.config.optics.frames:
        named += named_frames(plan)
    return {frame.file_name for frame in named}


def find_written(
    name: str,
    reports: Mapping[str, FrameReport],
    before: str | None,
    config: Config,
    is_measured: bool = False,
) -> Iterator[Finding]:
    """What a frame tells by itself, and beside the frame before.

    Args:
        name: of its file.
        reports: by file name, its own and that of the frame before, if there is one already.
        before: file name of the frame before; None for none.
        config: of the Volume.
        is_measured: it is known to be one of those that choose the extinction.
    """
    report, optics = reports[name], config.optics
    if report.left_out:
        return
    yield from find_frame(name, report, config)
    yield from find_depth(name, report, optics, is_measured)
    earlier = reports.get(before) if before else None
    if before and earlier is not None and not earlier.left_out:
        yield from _find_pair((before, earlier), (name, report), config)


def find_frame(name: str, report: FrameReport, config: Config) -> Iterator[Finding]:
    """What one frame's report tells by itself.

    Args:
        name: of the frame's file.
        report: of a frame that is stylized.
        config: of its Volume.
    """
    moved = report.transport
    if report.temporal is None:  # a warm frame may be what its neighbour is
        yield from _no_iterations(name, report, config)
    if report.shape and report.shape.loss and moved is not None and moved.folded is not None:
        if moved.largest_displacement <= UNMOVED * moved.cap and not _is_motionless(report):
            yield _unmoved(name, config)
    if report.voxels and report.voxels_written is not None:
        gone = 1 - report.voxels_written / report.voxels
        if gone > VANISHED:
            yield _vanished(name, gone, config)
    if report.temporal is None:  # a warm frame starts where its neighbour ended
        yield from _find_way(name, report, config)
    yield from find_light(name, report, config)
    yield from find_look(name, report, config)
    yield from find_sight(name, report)
    if report.velocity_doubt:
        cause, remedy = report.velocity_doubt.removesuffix(".").split(". ", 1)
        yield Finding(name, TEMPORAL[0].name, cause, remedy)
    for row in ROWS:
        figure = row.of_frame(report)
        if figure is not None and not abs(figure.value) <= row.most:
            yield Finding(
                name,
                row.name,
                f"{row.name} is {abs(figure.value):.1%} of {row.relative_to}, above {row.most:.0%}",
                *_advice(row, config, report),
            )


def _advice(row: ErrorRow, config: Config, report: FrameReport) -> tuple[str, str]:
    """Remedy and setting; of those that cost accuracy in storage, the ones that are set."""
    if row in (QUADRATURE, RESOLUTION) and (report.depth or 0.0) > DEEPEST:
        if not report.gamma_is_set and _changed(config, "optics.percentile"):
            return "Unset optics.percentile", "optics.percentile"
        name = of_last_step("gamma" if report.gamma_is_set else "depth", report)
        remedy = f"Set a smaller optics.{name}: a voxel of this smoke hides all that is behind it"
        return remedy, f"optics.{name}"
    if row in (QUADRATURE, RESOLUTION, PIXEL_FILTER) and (small := _small_pictures(config)):
        return f"Raise {small}", small
    if row in TEMPORAL and config.windows.pattern_speed not in (0, 1):
        return "Use the default of windows.pattern_speed", "windows.pattern_speed"
    if row.setting == "grids.half" and (changed := _changed(config, "grids.prune", "grids.half")):
        return f"Unset {' and '.join(changed)}", changed[0]
    if row is COLOUR_OPTIMISER and is_nearly_black(report):
        return "Brighten the style image: it is nearly black, and its loss is small", ""
    if row is COLOUR_OPTIMISER and has_high_rate(config):
        return "Use the default of colour.learning_rate", "colour.learning_rate"
    if row in (SHAPE_OPTIMISER, COLOUR_OPTIMISER):
        if has_far_speed(config):
            return "Use the default of windows.pattern_speed", "windows.pattern_speed"
        setting = length_of("shape" if row is SHAPE_OPTIMISER else "colour", config)
        return f"Set more {setting}", setting
    return _sentence(row.advice), row.setting


def _small_pictures(config: Config) -> str:
    """The setting that makes pictures smaller than by default; "" for none."""
    names = ("views.camera_width",) * bool(config.views.camera) + ("views.image_size",)
    small = [n for n in _changed(config, *names) if _value(n, config) < _value(n, Config())]
    return small[0] if small else ""


def _vanished(name: str, gone: float, config: Config) -> Finding:
    """A result with fewer voxels."""
    remedy, setting = "Set a smaller shape.reach", "shape.reach"
    if changed := _changed(config, "grids.prune", "grids.half"):
        remedy, setting = f"Unset {' and '.join(changed)}", changed[0]
    remedy += ", or look for voxels far from the rest, or much denser or thinner than it"
    cause = f"the result has {gone:.1%} fewer voxels with smoke than the source"
    return Finding(name, MASS.name, cause, remedy, setting)


def _changed(config: Config, *names: str) -> list[str]:
    """Those of these settings that differ from their defaults: others need not be unset."""
    return [name for name in names if _value(name, config) != _value(name, Config())]


def _value(name: str, config: Config) -> Any:
    section, key = name.split(".")
    return getattr(getattr(config, section), key)


def _no_iterations(name: str, report: FrameReport, config: Config) -> Iterator[Finding]:
    """Steps that end where they start."""
    ends = {"shape": "nothing is moved", "colour": "the colours are the noise that it started from"}
    for step, found in report.steps.items():
        if found.loss or (_is_motionless(report) if step == "shape" else config.optimize.start):
            continue
        asked = octave_iterations(getattr(config, step).iterations, config.optimize.iterations)
        if not any(asked):
            cause, setting = "has no iterations", f"{step}.iterations"
            remedy = f"Set {step}.iterations"
        elif config.views.camera:
            cause, setting = "has no picture to work on", "views.camera"
            remedy = "Check what the camera sees of the smoke, or unset views.camera"
        else:
            cause, setting = "has pictures of too few pixels for this smoke", "views.image_size"
            remedy = "Raise views.image_size"
        yield Finding(
            name,
            _OPTIMISERS[step],
            f"the {step} step {cause}: {ends[step]}",
            f"{remedy}, or leave the step out of optimize.steps",
            setting,
        )


def _is_motionless(report: FrameReport) -> bool:
    """Whether the row of the mass that no potential moves has a finding already."""
    found = MOTIONLESS.of_frame(report)
    return found is not None and found.value > MOTIONLESS.most


def _unmoved(name: str, config: Config) -> Finding:
    cause = "the shape step moved nothing: its pictures hardly depend on the displacement"
    remedy = "Look for smoke in places far apart or far denser than the rest, or leave"
    setting = "optimize.steps"
    if changed := _changed(config, *_OUTWEIGH):
        cause += ", or other settings keep them so"
        remedy, setting = f"Use the default of {', '.join(changed)}, or leave", changed[0]
    if config.stage.mask:
        cause += ", or the mask leaves too little"
    remedy += " the step out with optimize.steps=[colour]"
    return Finding(name, MOTIONLESS.name, cause, remedy, setting)


def _find_way(name: str, report: FrameReport, config: Config) -> Iterator[Finding]:
    """How far a frame that starts from no neighbour has come."""
    for step, found in report.steps.items():
        if found.is_short and _has_low_rate(step, config):
            yield _short_way(name, step, found.way or 0.0)
        elif step == "colour" and found.loss and math.isfinite(found.loss[-1]):
            yield from _hardly_fallen(name, found, config, report)
    if report.shape and report.shape.loss and config.shape.reach < LEAST_REACH:
        yield _small_reach(name, config.shape.reach)


def _has_low_rate(step: str, config: Config) -> bool:
    """Whether the learning rate of a step is below its default."""
    rate: float = getattr(config, step).learning_rate
    usual: float = getattr(Config(), step).learning_rate
    return rate < usual


def _short_way(name: str, step: str, way: float) -> Finding:
    whole = "from black to white" if step == "colour" else "from rest to the largest displacement"
    return Finding(
        name,
        _OPTIMISERS[step],
        f"all steps of the last octave of the {step} step add up to {100 * way:.2g}% of the way "
        f"{whole}: how far it is from its end is not known",
        f"Raise {step}.learning_rate (default {getattr(Config(), step).learning_rate:g})",
        f"{step}.learning_rate",
    )


def _hardly_fallen(
    name: str, found: StepReport, config: Config, report: FrameReport
) -> Iterator[Finding]:
    """A colour step that ends near the loss of the noise that it starts from.

    The shape step's octaves have losses of their own, which tell nothing beside each other.
    """
    asked = octave_iterations(config.colour.iterations, config.optimize.iterations)
    if found.fallen is None or len(found.loss) < sum(map(bool, asked)):  # started further on
        return
    if config.optimize.start and len(found.loss) < max(len(asked), 2):  # behind a network
        return
    end = found.loss[-1]
    if not end > HARDLY_FALLEN * (first := found.fallen + end) or not first > 0:
        return
    setting, remedy = colour_remedy(config, report)
    yield Finding(
        name,
        COLOUR_OPTIMISER.name,
        f"all octaves of the colour step leave {end / first:.0%} of their first losses",
        f"Compare the result with the style; {remedy}",
        setting,
    )


def _small_reach(name: str, reach: float) -> Finding:
    return Finding(
        name,
        SHAPE_OPTIMISER.name,
        f"shape.reach={reach:g} lets smoke move by less than pictures show",
        f"Raise shape.reach (default {Config().shape.reach:g}), or leave the step out with "
        "optimize.steps=[colour]",
        "shape.reach",
    )


def _find_pair(
    before: tuple[str, FrameReport], frame: tuple[str, FrameReport], config: Config
) -> Iterator[Finding]:
    """What two neighbouring frames tell: which of both ends much worse."""
    sides = [before, frame]
    for step in _OPTIMISERS:
        ends = [_end(report, step) for _, report in sides]
        for mine, theirs in ((0, 1), (1, 0)):
            if ends[theirs] > 0 and ends[mine] > UNLIKE * ends[theirs]:
                setting = length_of(step, config)
                yield Finding(
                    sides[mine][0],
                    _OPTIMISERS[step],
                    f"the {step} step ends at {ends[mine] / ends[theirs]:.1f} times the loss of "
                    f"{sides[theirs][0]}",
                    "Look at both frames. If they are unlike, cut the shot between them; else set "
                    f"more {setting}",
                    setting,
                )


def _end(report: FrameReport, step: str) -> float:
    """The final loss of a step; NaN without one."""
    found = report.steps.get(step)
    return found.loss[-1] if found is not None and found.loss else math.nan


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"

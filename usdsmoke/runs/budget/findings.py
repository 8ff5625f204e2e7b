"""What deserves a look: in a scene as soon as it is measured, in a frame as soon as it is written.

A finding names its place, the row of the error budget that it belongs to, the cause and the remedy.
The table, the JSON, the record and the warnings at the end of a run show the same findings.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from usdsmoke.base.frame_report import FrameReport, StepReport
from usdsmoke.base.sections import MOST_STOPS, OpticsConfig
from usdsmoke.base.settings import Config
from usdsmoke.core.smoke.schedule import octave_iterations
from usdsmoke.planning.plan import VolumePlan
from usdsmoke.runs.budget.planned import PlannedVolume, neighbours
from usdsmoke.runs.budget.rows import (
    COLOUR_OPTIMISER,
    MASS,
    MOTIONLESS,
    ROWS,
    SHAPE_OPTIMISER,
    ErrorRow,
)

UNMOVED = 1e-3  # of the largest allowed displacement: less is not seen
VANISHED = 0.01  # of the voxels
HARDLY_FALLEN = 0.5  # of a cold frame's first loss
UNLIKE = 3.0  # times the neighbour's loss
LEAST_REACH = 1e-3  # of the smoke's longest side: less changes no picture
FEW_COLUMNS = 0.02  # share of the columns that is as thick as those that gamma is chosen by
DEEPEST = 50.0  # optical depth of thick columns: a picture of them is their front alone
LIKE_ASKED = 10.0  # times the depth that is asked for: frames of a shot are not alike
FAR_BELOW = 100.0  # likewise
FAINTEST = 1e-12  # likewise: thinner smoke is not brightened any more
DIM = 0.02  # of the pictures' light: less from lamps is not seen
UNSEEN = 1 / 255  # of white
DARK = 0.5  # of the style's white
OUTSHONE = 0.02  # of the pixels with smoke
_OUTWEIGH = (  # settings that can keep the shape step from moving anything
    "optics.gamma_shape",
    "shape.learning_rate",
    "losses.keep",
    "losses.style",
    "optimize.strength",
)
_OPTIMISERS = {"shape": SHAPE_OPTIMISER.name, "colour": COLOUR_OPTIMISER.name}


@dataclass(frozen=True)
class Finding:
    """One thing that deserves a look."""

    place: str  # file of the frame, or path of the Volume
    row: str  # of the error budget; "" for none
    cause: str
    remedy: str
    setting: str = ""  # that the remedy changes; "" where input or result is to be looked at

    @property
    def kind(self) -> tuple[str, str]:
        """Findings of one kind are said once."""
        return self.row, self.remedy


def finding_texts(findings: Iterable[Finding]) -> tuple[str, ...]:
    """The findings as sentences; those of one row and remedy as one, with the first frame's cause.

    >>> finding_texts([Finding("a.vdb", "mass", "mass is 60%", "Look at it")] * 2)
    ('a.vdb and 1 more: mass is 60%. Look at it.',)
    """
    alike: dict[tuple[str, str], list[Finding]] = {}
    for finding in findings:
        alike.setdefault(finding.kind, []).append(finding)
    return tuple(
        f"{first.place}{f' and {len(others)} more' if others else ''}: {first.cause}. "
        f"{first.remedy}."
        for first, *others in alike.values()
    )


def find_volume(volume: PlannedVolume) -> Iterator[Finding]:
    """The findings of a Volume: of its scene, then frame by frame."""
    yield from find_scene(volume)
    before = frames_before(volume.plan)
    reports = {
        frame.file_name: report
        for frame, report in zip(volume.plan.frames, volume.reports, strict=True)
        if report is not None
    }
    for name in reports:
        yield from find_written(name, reports, before.get(name), volume.plan.config)


def frames_before(plan: VolumePlan) -> dict[str, str]:
    """By a frame's file name that of the frame before, where there is no cut between them."""
    return {after.file_name: frame.file_name for frame, after in neighbours(plan)}


def find_written(
    name: str, reports: Mapping[str, FrameReport], before: str | None, config: Config
) -> Iterator[Finding]:
    """What a frame tells by itself, and beside the frame before.

    Args:
        name: of its file.
        reports: by file name, its own and that of the frame before, if there is one already.
        before: file name of the frame before; None for none.
        config: of the Volume.
    """
    report = reports[name]
    if report.left_out:
        return
    yield from find_frame(name, report, config)
    yield from _find_depth(name, report, config.optics)
    earlier = reports.get(before) if before else None
    if before and earlier is not None and not earlier.left_out:
        yield from _find_pair((before, earlier), (name, report))


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
        if moved.largest_displacement <= UNMOVED * moved.cap:
            yield _unmoved(name, moved.motionless or 0.0, config)
    if report.voxels and report.voxels_written is not None:
        gone = 1 - report.voxels_written / report.voxels
        if gone > VANISHED:
            yield _vanished(name, gone, config)
    if report.temporal is None:  # a warm frame starts where its neighbour ended
        for step, found in report.steps.items():
            yield from _hardly_fallen(name, step, found, config)
    yield from _find_light(name, report)
    for row in ROWS:
        figure = row.of_frame(report)
        if figure is not None and not abs(figure.value) <= row.most:
            yield Finding(
                name,
                row.name,
                f"{row.name} is {abs(figure.value):.1%} of {row.relative_to}, above {row.most:.0%}",
                *_advice(row, config),
            )


def _find_depth(name: str, report: FrameReport, optics: OpticsConfig) -> Iterator[Finding]:
    """Whether the extinction that the shot's smoke chose suits a frame's."""
    if report.depth is None:
        return
    asked = "depth_shape" if report.colour is None else "depth"
    wanted = getattr(optics, asked)
    is_deep = report.depth > max(DEEPEST, LIKE_ASKED * wanted)
    if not is_deep and report.depth >= wanted / FAR_BELOW:
        return
    what = "a picture of it is its front alone" if is_deep else "it hardly shows in a picture"
    if optics.percentile != OpticsConfig().percentile:
        remedy, setting = "Unset optics.percentile", "optics.percentile"
    else:
        amount = "dense" if is_deep else "thin"
        remedy, setting = f"Set optics.frames to frames as {amount} as this one", "optics.frames"
        if asked == "depth":
            remedy += ", or give frames their own gamma"
    yield Finding(
        name,
        "",
        f"the thick columns have an optical depth of {report.depth:.2g}, and optics.{asked} is "
        f"{wanted:g}: {what}",
        remedy,
        setting,
    )


def _find_light(name: str, report: FrameReport) -> Iterator[Finding]:
    """Whether lit smoke vanishes or clips."""
    light = report.light
    if light is None:
        return
    advice = "Change the brightness of the lights"
    if light.advised is not None:
        advice = f"Set optics.exposure={light.advised:g} and the shot's exposure with it"
    if light.reach == 0:
        cause = "none of the lights reaches the stylized smoke"
        advice = "Move the lights, or leave them out (colour.target=emission, optics.albedo=0)"
    elif light.share < DIM:
        share = f"{100 * light.share:.2g}%"
        cause = f"the lights give only {share} of the smoke's brightness, which is not visible"
        advice += ", or leave them out (optics.albedo=0)"
    elif light.share > 1 - DIM and light.reach < DARK:
        cause = f"white smoke under the lights is only {light.reach:.0%} as bright as the style"
    elif light.outshone > OUTSHONE:
        cause = (
            f"the lights alone make {light.outshone:.0%} of the smoke brighter than the style's "
            "white, and emission cannot darken it"
        )
        advice += ", or lower optics.albedo"
    else:
        return
    yield Finding(name, "", cause, advice, "optics.exposure")


def _advice(row: ErrorRow, config: Config) -> tuple[str, str]:
    """Remedy and setting; of those that cost accuracy in storage, the ones that are set."""
    if row.setting == "grids.half" and (changed := _changed(config, "grids.prune", "grids.half")):
        return f"Unset {' and '.join(changed)}", changed[0]
    return _sentence(row.advice), row.setting


def _vanished(name: str, gone: float, config: Config) -> Finding:
    """Voxels with smoke that are empty in the result."""
    remedy, setting = "Set a smaller shape.reach", "shape.reach"
    if changed := _changed(config, "grids.prune", "grids.half"):
        remedy, setting = f"Unset {' and '.join(changed)}", changed[0]
    remedy += ", or look for voxels much denser than the rest or far from it"
    cause = f"{gone:.1%} of the voxels with smoke are empty in the result"
    return Finding(name, MASS.name, cause, remedy, setting)


def _changed(config: Config, *names: str) -> list[str]:
    """Those of these settings that differ from their defaults: others need not be unset."""
    default = Config()
    pairs = [(name, name.split(".")) for name in names]
    return [
        name
        for name, (section, key) in pairs
        if getattr(getattr(config, section), key) != getattr(getattr(default, section), key)
    ]


def _no_iterations(name: str, report: FrameReport, config: Config) -> Iterator[Finding]:
    """Steps that end where they start."""
    ends = {"shape": "nothing is moved", "colour": "the colours are the noise that it started from"}
    for step, found in report.steps.items():
        asked = octave_iterations(getattr(config, step).iterations, config.optimize.iterations)
        if not found.loss and config.views.camera and any(asked):
            yield Finding(
                name,
                _OPTIMISERS[step],
                f"the {step} step has no picture to work on: {ends[step]}",
                "Check what the camera sees of the smoke, or unset views.camera",
                "views.camera",
            )
        elif not found.loss and not (step == "colour" and config.optimize.start):
            yield Finding(
                name,
                _OPTIMISERS[step],
                f"the {step} step has no iterations: {ends[step]}",
                f"Set {step}.iterations, or leave the step out of optimize.steps",
                f"{step}.iterations",
            )


def _unmoved(name: str, motionless: float, config: Config) -> Finding:
    if motionless > 1 - VANISHED:
        cause = "the shape step moved nothing: no potential moves smoke of this shape"
        remedy, setting = "Set optimize.steps=[colour], which leaves the step out", "optimize.steps"
    else:
        cause = "the shape step moved nothing: its pictures hardly depend on the displacement"
        remedy, setting = "Look for smoke in places far apart, or leave", "optimize.steps"
        if changed := _changed(config, *_OUTWEIGH):
            cause += ", or other settings outweigh the style"
            remedy, setting = f"Use the default of {', '.join(changed)}, or leave", changed[0]
        if config.stage.mask:
            cause += ", or the mask leaves too little"
        remedy += " the step out with optimize.steps=[colour]"
    return Finding(name, MOTIONLESS.name, cause, remedy, setting)


def _hardly_fallen(name: str, step: str, found: StepReport, config: Config) -> Iterator[Finding]:
    if found.fallen is None or not found.loss or not math.isfinite(found.loss[-1]):
        return
    end = found.loss[-1]
    if not end > HARDLY_FALLEN * (first := found.fallen + end) or not first > 0:
        return
    setting, remedy = f"{step}.iterations", f"raise {step}.iterations, or optimize.iterations"
    if step == "shape" and config.shape.reach < LEAST_REACH:
        setting, remedy = "shape.reach", "raise shape.reach"
    elif config.optimize.iterations is None:
        remedy = f"raise {step}.iterations"
    yield Finding(
        name,
        _OPTIMISERS[step],
        f"the {step} step ends at {end / first:.0%} of its first loss",
        f"Compare the result with the style; {remedy}",
        setting,
    )


def _find_pair(
    before: tuple[str, FrameReport], frame: tuple[str, FrameReport]
) -> Iterator[Finding]:
    """What two neighbouring frames tell: which of both ends much worse."""
    sides = [before, frame]
    for step in _OPTIMISERS:
        ends = [_end(report, step) for _, report in sides]
        for mine, theirs in ((0, 1), (1, 0)):
            if ends[theirs] > 0 and ends[mine] > UNLIKE * ends[theirs]:
                yield Finding(
                    sides[mine][0],
                    _OPTIMISERS[step],
                    f"the {step} step ends at {ends[mine] / ends[theirs]:.1f} times the loss of "
                    f"{sides[theirs][0]}",
                    "Look at both frames. If they are unlike, cut the shot between them; else set "
                    f"more {step}.iterations",
                    f"{step}.iterations",
                )


def _end(report: FrameReport, step: str) -> float:
    """The final loss of a step; NaN without one."""
    found = report.steps.get(step)
    return found.loss[-1] if found is not None and found.loss else math.nan


def find_scene(volume: PlannedVolume) -> Iterator[Finding]:
    """Whether the extinctions suit the smoke, and the light a colour that is split."""
    if volume.plan.config.colour.target == "both":
        yield from _find_split(volume.plan)
    scene, optics, place = volume.scene, volume.plan.config.optics, volume.plan.source.prim_path
    share = scene.get("thick_share")
    chosen = [name for name in ("gamma", "gamma_shape") if getattr(optics, name) is None]
    if share is not None and share < FEW_COLUMNS and chosen:
        yield Finding(
            place,
            "",
            f"optics.{chosen[0]} rests on {share:.1%} of the columns: most smoke is much thinner",
            f"Compare the result with the source; lower optics.percentile or set "
            f"optics.{chosen[0]}",
            f"optics.{chosen[0]}",
        )
    for name, depth in _depths(volume, scene).items():
        if depth > DEEPEST or depth < FAINTEST:
            what = "is saturated" if depth > DEEPEST else "is empty"
            setting, remedy = f"optics.{name}", f"Unset optics.{name}; the smoke then chooses it"
            if name in chosen:  # by the depth that is asked for
                setting = setting.replace("gamma", "depth")
                remedy = f"{'Lower' if depth > DEEPEST else 'Raise'} {setting}"
            yield Finding(
                place,
                "",
                f"the thick columns have an optical depth of {depth:.2g} with {setting}: the "
                f"picture that is optimised {what}",
                remedy,
                setting,
            )


def _find_split(plan: VolumePlan) -> Iterator[Finding]:
    """Whether the light leaves both an albedo and an emission."""
    from usdsmoke.planning.materials import front_brightness  # loads USD

    stops = plan.config.optics.exposure or 0.0
    found = [front_brightness(plan.config, frame.source.lights) for frame in plan.frames]
    brightness = [value * 2.0**stops for value in found if value > 0]
    if not brightness:
        return
    worst = max(brightness, key=lambda value: abs(math.log2(value)))
    if UNSEEN <= worst <= 1 / DIM:
        return
    hardly = "emission, and none of its albedo is bright" if worst > 1 else "colour in the albedo"
    advised = stops - math.log2(worst)
    advice = f"Set optics.exposure={advised:.1f} and the shot's exposure with it"
    if abs(advised) > MOST_STOPS:
        advice = "Change the brightness of the lights"
    yield Finding(
        plan.source.prim_path,
        "",
        f"smoke in the light is {worst:.2g} times as bright as white, so with colour.target=both "
        f"there is hardly any {hardly}",
        advice,
        "optics.exposure",
    )


def _depths(volume: PlannedVolume, scene: Mapping[str, Any]) -> dict[str, float]:
    """Optical depth of the thick columns by the setting that decides it, where one is known."""
    thick, steps = scene.get("thick", 0.0), volume.plan.config.optimize.steps
    names = {"colour": ("gamma", "gamma_w"), "shape": ("gamma_shape", "gamma_w_shape")}
    return {
        setting: scene[key] * thick
        for step, (setting, key) in names.items()
        if step in steps and thick > 0 and key in scene
    }


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"

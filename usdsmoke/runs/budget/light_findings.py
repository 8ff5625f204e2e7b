"""Whether extinction and lamps suit the smoke: in a scene as soon as it is measured, in a frame."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from usdsmoke.base.frame_report import DIM, FrameReport
from usdsmoke.config.look_sections import MOST_STOPS, OpticsConfig
from usdsmoke.config.settings import Config
from usdsmoke.core.views.column_depths import MUCH
from usdsmoke.planning.plan import VolumePlan
from usdsmoke.runs.budget.finding import Finding
from usdsmoke.runs.budget.planned import PlannedVolume
from usdsmoke.runs.budget.rows import RESOLUTION

FEW_COLUMNS = 0.02  # share of the columns that is as thick as those that gamma is chosen by
DEEPEST = 50.0  # optical depth of thick columns: a picture of them is their front alone
LIKE_ASKED = 5.0  # times the depth that is asked for: frames of a shot are not alike
FAR_BELOW = 100.0  # likewise
BY_SIDE = 4.0  # times: a plume or a puff has less than 2
FAINTEST = 1e-12  # likewise: thinner smoke is not brightened any more
UNSEEN = 1 / 255  # of white
DARK = 0.5  # of the style's white
OUTSHONE = 0.02  # of the pixels with smoke
HIDDEN = 0.1  # of the mass
WIDENED = 1.5  # times: strokes are as much coarser


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
    if (hidden := scene.get("hidden", 0.0)) > HIDDEN and chosen:
        yield Finding(
            place,
            "",
            f"{hidden:.0%} of the smoke is in columns more than {MUCH:g} times as thick as those "
            f"that optics.{chosen[0]} rests on: thin smoke around it covers most of the picture",
            "Look at the result: if thin smoke hides the rest, remove it from the source, or set "
            f"a larger optics.percentile or a smaller optics.{chosen[0].replace('gamma', 'depth')}",
            "optics.percentile",
        )
    if (widened := scene.get("widened", 1.0)) > WIDENED:
        yield _far_apart(volume, widened)
    for name, depth in _depths(volume, scene).items():
        if depth > DEEPEST or depth < (UNSEEN / 2 if name == "gamma" else FAINTEST):
            what = "the picture that is optimised is saturated"
            if depth < DEEPEST:
                what = "the picture that is optimised is empty"
                if depth >= FAINTEST:  # it is brightened, but not what is written
                    what = "what is written is too thin to show in a picture"
            setting, remedy = f"optics.{name}", f"Unset optics.{name}; the smoke then chooses it"
            if name in chosen:  # by the depth that is asked for
                setting = setting.replace("gamma", "depth")
                remedy = f"{'Lower' if depth > DEEPEST else 'Raise'} {setting}"
            yield Finding(
                place,
                "",
                f"the thick columns have an optical depth of {depth:.2g} with {setting}: {what}",
                remedy,
                setting,
            )


def _far_apart(volume: PlannedVolume, widened: float) -> Finding:
    """Smoke in several places, or with remains."""
    return Finding(
        volume.plan.source.prim_path,
        RESOLUTION.name,
        f"pictures are {widened:.1f} times as wide as the largest part of the smoke, because other "
        "voxels lie far from it: their pixels are larger than voxels, and smoke is moved farther",
        "Remove those voxels if they are remains, give parts their own Volumes, or set a larger "
        "views.image_size and a smaller shape.reach",
        "views.image_size",
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


def of_last_step(name: str, report: FrameReport) -> str:
    """The setting of optics, depth or gamma, for the last step that a frame has."""
    return name if report.colour is not None else f"{name}_shape"


def find_depth(
    name: str, report: FrameReport, optics: OpticsConfig, is_measured: bool = False
) -> Iterator[Finding]:
    """Whether the extinction that the shot's smoke chose suits a frame's.

    Args:
        name: of the frame's file.
        report: of a frame that is stylized.
        optics: of the Volume.
        is_measured: the frame is known to be one of those that chose the extinction.
    """
    if report.depth is None:
        return
    if report.gamma_is_own:
        yield from _find_animated(name, report.depth)
    if report.gamma_is_set:
        return
    asked = of_last_step("depth", report)
    wanted = getattr(optics, asked)
    if report.depth_by_side is not None and wanted == getattr(OpticsConfig(), asked):
        yield from _find_sides(name, report.depth_by_side, asked, wanted)
    is_deep = report.depth > max(DEEPEST, LIKE_ASKED * wanted)
    if not is_deep and report.depth >= wanted / FAR_BELOW:
        return
    what = "a picture of it is its front alone" if is_deep else "it hardly shows in a picture"
    if optics.percentile != OpticsConfig().percentile:
        remedy, setting = "Unset optics.percentile", "optics.percentile"
    elif is_measured:  # its columns differ: some are much denser, or it was moved
        better = wanted * wanted / report.depth
        remedy, setting = f"Set optics.{asked}={better:.2g} for {wanted:g} there", f"optics.{asked}"
    else:
        amount = "dense" if is_deep else "thin"
        remedy, setting = f"Set optics.frames to frames as {amount} as this one", "optics.frames"
        if optics.frames:
            remedy = f"Unset optics.frames, or name frames as {amount} as this one"
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


def _find_animated(name: str, depth: float) -> Iterator[Finding]:
    """Whether a frame's own gamma suits it; that of all frames has a finding of the scene."""
    if UNSEEN / 2 <= depth <= DEEPEST:
        return
    what, amount = "it shows in no picture", "larger"
    if depth > DEEPEST:
        what, amount = "a picture of it is its front alone", "smaller"
    yield Finding(
        name,
        "",
        f"the thick columns have an optical depth of {depth:.2g} with this frame's gamma: {what}",
        f"Author a {amount} gamma at this timeCode",
        "optics.gamma",
    )


def _find_sides(
    name: str, sides: tuple[float, float], asked: str, wanted: float
) -> Iterator[Finding]:
    """Whether smoke is as opaque from other sides as from the one that extinction is chosen by."""
    least, most = sides
    if most > BY_SIDE * least > 0:
        # for as much above what is wanted as below, but no picture of the front alone
        better = min(wanted * wanted / math.sqrt(least * most), DEEPEST)
        what = "thin sides more" if better > wanted else "thick sides less"
        yield Finding(
            name,
            "",
            f"the thick columns have an optical depth of about {least:.2g} to {most:.2g} by the "
            "side that they are seen from, and the middle view chose the extinction",
            "Look at the result from several sides; set "
            f"optics.{asked}={better:.2g} to make the {what} opaque",
            f"optics.{asked}",
        )


def find_light(name: str, report: FrameReport, config: Config) -> Iterator[Finding]:
    """Whether lit smoke vanishes or clips; light that no setting asks for may be invisible."""
    light, optics = report.light, config.optics
    if light is None:
        return
    is_glowing = config.colour.target == "emission"
    is_asked = optics.albedo is not None or optics.names_lights or not is_glowing
    advice, setting = "Change the brightness of the lights", "optics.exposure"
    if light.advised is not None:
        advice = f"Set optics.exposure={light.advised:g} and the shot's exposure with it"
    if light.reach == 0:
        cause = "none of the lights reaches the stylized smoke"
        advice = "Move the lights, or leave them out (colour.target=emission, optics.albedo=0)"
    elif light.share < DIM and is_asked:
        share = f"{100 * light.share:.2g}%"
        cause = f"the lights give only {share} of the smoke's brightness, which is not visible"
        advice += ", or leave them out (optics.albedo=0)"
    elif light.outshone > OUTSHONE:
        cause = (
            f"the lights alone make {light.outshone:.0%} of the smoke brighter than the style's "
            "white, and emission cannot darken it"
        )
        advice += ", or lower optics.albedo"
    elif light.is_tinted:
        cause = (
            f"the lights' faintest of red, green and blue is {light.faintest:.1%} of the brightest:"
            " smoke that only scatters them cannot show a style that needs it"
        )
        advice = "Use lights of less saturated colours, or colour.target=both or emission"
        setting = "colour.target"
    elif light.share > 1 - DIM and light.reach < DARK:
        cause = f"white smoke under the lights is only {light.reach:.0%} as bright as the style"
    else:
        return
    yield Finding(name, "", cause, advice, setting)

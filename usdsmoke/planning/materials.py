"""A look's material, what hides the look, and the lights that its smoke scatters, in sentences."""

from collections.abc import Iterable, Sequence

from usdsmoke.base.naming import colour_names
from usdsmoke.base.settings import Config
from usdsmoke.base.volume import StageSource
from usdsmoke.planning.plan import FramePlan, Omission, VolumePlan
from usdsmoke.usd.materials import binds_material


def materials_needed(volumes: Iterable[VolumePlan]) -> list[str]:
    """The materials that the layer will hold, a sentence for each Volume."""
    return [
        f"a material of <{volume.source.prim_path}> ({', '.join(targets)})"
        for volume in volumes
        if (targets := volume.config.layer.material_targets) and _binds(volume)
    ]


def hidden_look(volume: VolumePlan) -> list[Omission]:
    """The look, where a bound material does not read it; empty where it is seen."""
    if not _has_colour(volume) or _binds(volume):
        return []
    layer = volume.config.layer
    colours = colour_names(layer.scatter_colour, layer.split_rgb)
    hiding = [material for material in volume.source.materials if material.hides(colours)]
    if not hiding:
        return []
    path, material = volume.source.prim_path, hiding[0]
    if not material.can_replace:
        advice = "its binding is stronger than any on the Volume, so bind another material there"
    else:
        advice = "layer.material=replace binds one that does"
    reason = f"its material <{material.prim_path}> reads no {' or '.join(colours)}; {advice}"
    return [Omission(f"the look of <{path}> in renderers", reason)]


def hidden_look_warnings(volumes: Iterable[VolumePlan]) -> list[str]:
    """The same as warnings at the end of a run."""
    return [
        f"{omission.what} is not seen: {omission.reason}"
        for volume in volumes
        for omission in hidden_look(volume)
    ]


def _binds(volume: VolumePlan) -> bool:
    return binds_material(volume.config.layer, _has_colour(volume), volume.source.materials)


def _has_colour(volume: VolumePlan) -> bool:
    return "colour" in volume.config.optimize.steps


def lights_needed(config: Config, frames: Sequence[FramePlan]) -> list[str]:
    """The lights that light the smoke of frames with the same settings, as a sentence."""
    lights = dict.fromkeys(light.prim_path for frame in frames for light in frame.source.lights)
    if not lights:
        return []
    names = ", ".join(f"<{path}>" for path in lights)
    return [
        f"light of {names}, of which the smoke scatters {config.optics.albedo:.0%} (optics.albedo)"
    ]


def lights_omitted(source: StageSource, volumes: Sequence[VolumePlan]) -> list[Omission]:
    """Lights of the stage that light no smoke, and scattering without a light."""
    frames = [frame for volume in volumes for frame in volume.frames]
    used = any(frame.source.lights for frame in frames)
    if not any(volume.config.scatters for volume in volumes):
        names = ", ".join(f"<{path}>" for path in source.lights)
        reason = "optics.albedo is 0, so the smoke scatters no light"
        return [Omission(f"lights {names}", reason)] if names else []
    omitted = [Omission(f"light <{path}>", why) for path, why in source.unused_lights.items()]
    if not used:
        reason = "the stage has no DistantLight or DomeLight that lights the smoke"
        omitted.append(Omission("scattering (optics.albedo)", reason))
    return omitted

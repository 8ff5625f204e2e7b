"""A look's material, what hides the look, and the lights that its smoke scatters, in sentences."""

import math
from collections.abc import Iterable, Mapping, Sequence

from usdsmoke.base.time_codes import name_time_codes
from usdsmoke.base.volume import LightSource, StageSource
from usdsmoke.config.settings import Config
from usdsmoke.planning.plan import FramePlan, Omission, VolumePlan
from usdsmoke.usd.materials import (
    ALL_RENDERERS,
    binds_material,
    brightness_words,
    hiding_advice,
    hiding_words,
    opacity_words,
)

_SCATTERING = "scattering (optics.albedo)"


def materials_needed(volumes: Iterable[VolumePlan]) -> list[str]:
    """The materials that the layer will hold, a sentence for each Volume."""
    return [
        f"a material of <{volume.source.prim_path}> ({', '.join(targets)})"
        for volume in volumes
        if (targets := volume.config.layer.material_targets) and _binds(volume)
    ]


def material_warnings(volumes: Sequence[VolumePlan]) -> tuple[str, ...]:
    """That bound materials hide looks, or show them too dark or too bright, with the remedy."""
    wrong = [text for volume in volumes for text in _wrong_brightness(volume)]
    return (*_hidden_looks(volumes), *dict.fromkeys(wrong))


def _hidden_looks(volumes: Iterable[VolumePlan]) -> list[str]:
    """A sentence for each kind."""
    kinds: dict[tuple[str, str, bool], list[tuple[str, str]]] = {}
    for volume in volumes:
        colours = volume.config.colour_grids
        hiding = [item for item in volume.source.materials if item.hidden_in(colours)]
        if hiding and _has_colour(volume) and not _binds(volume):
            kind = (*hiding_words(hiding[0], colours), hiding[0].can_replace)
            places = (volume.source.prim_path, hiding[0].prim_path)
            kinds.setdefault(kind, []).append(places)
    return [_hidden(*kind, places) for kind, places in kinds.items()]


def _hidden(what: str, renderers: str, can_replace: bool, places: Sequence[tuple[str, str]]) -> str:
    volumes, materials = (list(dict.fromkeys(paths)) for paths in zip(*places, strict=True))
    where = "" if renderers == ALL_RENDERERS else f" in {renderers}"
    return (
        f"the look of {_first_of(volumes)} is not seen{where}: the material "
        f"{_first_of(materials)} {what}. {hiding_advice(can_replace)}."
    )


def _first_of(paths: Sequence[str]) -> str:
    return f"<{paths[0]}>" + (f" and {len(paths) - 1} more" if paths[1:] else "")


def _wrong_brightness(volume: VolumePlan) -> list[str]:
    if not _has_colour(volume) or _binds(volume):
        return []
    mode = volume.config.layer.emission_mode
    found = [brightness_words(material, mode) for material in volume.source.materials]
    return [f"{text}." for text in found if text]


def opacity_remarks(volume: VolumePlan, extinction: float) -> list[str]:
    """That a bound material shows the look with another opacity than it was made for.

    Args:
        extinction: gamma_w, per stage unit.
    """
    if not _has_colour(volume) or _binds(volume):
        return []
    found = [opacity_words(material, extinction) for material in volume.source.materials]
    return [text for text in found if text]


def _binds(volume: VolumePlan) -> bool:
    return binds_material(volume.config.layer, _has_colour(volume), volume.source.materials)


def _has_colour(volume: VolumePlan) -> bool:
    return "colour" in volume.config.optimize.steps


def lights_needed(config: Config, frames: Sequence[FramePlan]) -> list[str]:
    """The lights that light the smoke of frames with the same settings, as a sentence."""
    names = _light_names(frames)
    if not names:
        return []
    often = ", more than once (optics.bounces)" if config.optics.bounces else ""
    return [
        f"the light of {names}; the smoke scatters {config.albedo:.0%} of it{often} "
        "(optics.albedo; 0 leaves it out)"
    ]


def lights_remark(config: Config, volume: VolumePlan) -> list[str]:
    """That a look is made for its lights, and how bright they make smoke."""
    lights = _lights(volume.frames)
    if not lights:
        return []
    stops = config.optics.exposure or 0.0
    in_light = {
        frame.source.time_code: front_brightness(config, frame.source.lights) * 2.0**stops
        for frame in volume.frames
    }
    code = max(in_light, key=in_light.__getitem__)
    at = f" at {name_time_codes([code])}" if len(set(in_light.values())) > 1 else ""
    at += f" at optics.exposure={stops:g}" if stops else ""
    at += ", and brighter with bounces" if config.optics.bounces else ""
    found = [
        f"the look of <{volume.source.prim_path}> is made for its lights "
        f"(optics.albedo={config.albedo:g}). Stylize again when they change. Thick smoke that "
        f"faces them is about {in_light[code]:.2g} times as bright as white{at}"
    ]
    if config.optics.names_lights:
        to_add = " and ".join(_stage_light(light) for light in volume.frames[0].source.lights)
        found.append(
            f"other renderers do not have {' and '.join(lights)}, and draw the look darker. For "
            f"them add {to_add} to the stage, and no other lights"
        )
    return found


def lights_omitted(source: StageSource, volumes: Sequence[VolumePlan]) -> list[Omission]:
    """Lights of the stage that light no smoke, scattering without a light, and bounces."""
    return [*_unused_lights(source, volumes), *_bounces_omitted(volumes)]


def _unused_lights(source: StageSource, volumes: Sequence[VolumePlan]) -> list[Omission]:
    """Lights of the stage that light no smoke, and scattering without a light."""
    used = {light for volume in volumes for light in _lights(volume.frames)}
    optics = [own for volume in volumes if (own := volume.config.lit_optics) is not None]
    names = _name_all(path for path in source.lights if path not in used)
    if not optics:
        no_colour = not any("colour" in volume.config.optimize.steps for volume in volumes)
        reason = "there is no colour step" if no_colour else "optics.albedo is 0"
        return [Omission(f"lights {names}", f"{reason}, so they have no effect")] if names else []
    if any(own.names_lights for own in optics):
        reason = "optics.sun and optics.sky take their place"
        replaced = [Omission(f"lights {names}", reason)] if names else []
        return replaced if used else [*replaced, Omission(_SCATTERING, "its lights are black")]
    omitted = [Omission(f"light <{path}>", why) for path, why in source.unused_lights.items()]
    if not used and any(own.albedo is not None for own in optics):
        reason = "the stage has no DistantLight or DomeLight that lights the smoke"
        omitted.append(Omission(_SCATTERING, reason))
    return omitted


def _bounces_omitted(volumes: Sequence[VolumePlan]) -> list[Omission]:
    """Light that is scattered more than once, where no Volume with lights is painted for it."""
    asked = [volume for volume in volumes if volume.config.optics.bounces]
    if asked and not any(_lights(volume.frames) for volume in asked):
        return [Omission("bounces of light (optics.bounces)", "the smoke scatters no light")]
    if not asked and any(_lights(volume.frames) for volume in volumes):
        return [Omission("light that is scattered more than once", "optics.bounces is off")]
    return []


def _lights(frames: Iterable[FramePlan]) -> dict[str, dict[float, LightSource]]:
    """By path, or by the name of the setting, and by timeCode."""
    found: dict[str, dict[float, LightSource]] = {}
    for frame in frames:
        for light in frame.source.lights:
            found.setdefault(light.prim_path, {})[frame.source.time_code] = light
    return found


def _light_names(frames: Iterable[FramePlan]) -> str:
    """Lights with where they come from and how bright they are; "" without any."""
    return ", ".join(
        f"{_name_all([path])} ({_describe(light)})" for path, light in _lights(frames).items()
    )


def _describe(light: Mapping[float, LightSource]) -> str:
    """A light by timeCode; one that changes where it is brightest.

    >>> _describe({1: LightSource("/sun", (3, 2, 1.5), (0, 0, 1))})
    'from 0 0 1, colour 3 2 1.5'
    """
    code, brightest = max(light.items(), key=lambda item: max(item[1].colour))
    place = "all around" if brightest.towards is None else f"from {_numbers(brightest.towards)}"
    when = f" at {name_time_codes([code])}, where it is brightest" if _changes(light) else ""
    return f"{place}, colour {_numbers(brightest.colour)}{when}"


def _changes(light: Mapping[float, LightSource]) -> bool:
    return len(set(light.values())) > 1


def _stage_light(light: LightSource) -> str:
    """The UsdLux light that gives the same light below a prim without a transform."""
    colour = f"inputs:intensity = 1 and inputs:color = ({_exact(light.colour)})"
    if light.towards is None:
        return f"a DomeLight with {colour}"
    x, y, z = light.towards
    turn = (-math.degrees(math.atan2(y, math.hypot(x, z))), math.degrees(math.atan2(x, z)), 0.0)
    return (
        f"a DistantLight with {colour}, inputs:normalize = 1 and "
        f"xformOp:rotateXYZ = ({_exact(turn)})"
    )


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{value:.3g}" for value in values)


def _exact(values: Iterable[float]) -> str:
    return ", ".join(f"{value:.6g}" for value in values)


def _name_all(paths: Iterable[str]) -> str:
    return ", ".join(f"<{path}>" if path.startswith("/") else path for path in paths)


def front_brightness(config: Config, lights: Sequence[LightSource]) -> float:
    """Radiance of a thick wall of smoke that faces all of its lights; of the brightest channel.

    At an exposure of 0 stops.

    Scattered once, a sun behind the eye gives E p(180 degrees) albedo / 2, and a dome albedo L
    (1 - ln 2) / 2: the integrals of exp(-2 t), and of exp(-t) E_2(t) / 2.
    """
    back = (1 - config.optics.anisotropy) / (4 * math.pi * (1 + config.optics.anisotropy) ** 2)
    shares = [(1 - math.log(2)) / 2 if light.towards is None else back / 2 for light in lights]
    total = [
        sum(share * light.colour[channel] for share, light in zip(shares, lights, strict=True))
        for channel in range(3)
    ]
    return config.albedo * max(total)

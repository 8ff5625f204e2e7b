"""Lights at one timeCode: a stage's distant ones and its domes without a texture, or settings'."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux

from usdsmoke.base.errors import ConfigError, count_text
from usdsmoke.base.time_codes import name_time_codes
from usdsmoke.base.volume import FrameSource, LightSource, StageSource, VolumeSource
from usdsmoke.config.look_sections import MOST_STOPS, OpticsConfig
from usdsmoke.usd.diagnostics import readable_values
from usdsmoke.usd.values import authored_path

_DISTANT, _DOMES = "DistantLight", ("DomeLight", "DomeLight_1")
_DIRECTION = Gf.Vec3d(0, 0, 1)  # to a distant light, in its own space

_BRIGHTEST = 2.0**MOST_STOPS  # no exposure brings more to white

Colour = tuple[float, float, float]


@readable_values()
def lit_by(
    stage: Usd.Stage, source: StageSource, optics: Sequence[OpticsConfig | None]
) -> StageSource:
    """The same Volumes, with the lights that light them at every selected timeCode.

    Args:
        optics: of each Volume; None for one whose smoke scatters no light, which gets none.

    Raises:
        ConfigError: ``optics.sun`` is no direction, or the light of the settings is no colour, or
            is too bright for any exposure.
    """
    prims = _light_prims(stage)
    known: dict[tuple[str, float], LightSource | str | None] = {}

    def lights(volume: VolumeSource, frame: FrameSource) -> tuple[LightSource, ...]:
        found = []
        for prim in prims:
            key = (str(prim.GetPath()), frame.time_code)
            if key not in known:
                known[key] = _read_light(prim, frame.time_code)
            light = known[key]
            if isinstance(light, LightSource) and _links(prim, volume.prim_path):
                found.append(light)
        return tuple(found)

    volumes = []
    for volume, own in zip(source.volumes, optics, strict=True):
        if own is not None:
            named = named_lights(own)
            frames = tuple(
                replace(f, lights=named if own.names_lights else lights(volume, f))
                for f in volume.frames
            )
            volume = replace(volume, frames=frames)
            volume = replace(volume, notes=(*volume.notes, *_shadow_notes(stage, volume)))
        volumes.append(volume)
    paths = tuple(str(prim.GetPath()) for prim in prims)
    return replace(source, volumes=tuple(volumes), lights=paths, unused_lights=_left_out(known))


def _left_out(known: Mapping[tuple[str, float], LightSource | str | None]) -> dict[str, str]:
    """Why lights are left out, by path; with the timeCodes where they are used at others."""
    reasons: dict[str, dict[float, str]] = {}
    for (path, code), light in known.items():
        if isinstance(light, str):
            reasons.setdefault(path, {})[code] = light
    found = {}
    for path, why in reasons.items():
        codes = [code for name, code in known if name == path]
        at = f" at {name_time_codes(sorted(why))}" if len(why) < len(codes) else ""
        found[path] = f"{next(iter(why.values()))}{at}"
    return found


def _shadow_notes(stage: Usd.Stage, volume: VolumeSource) -> list[str]:
    """That a light's shadows are those of light, whatever UsdLux's ShadowAPI makes of them."""
    changed: dict[str, str] = {}
    for frame in volume.frames:
        for light in frame.lights:
            prim = stage.GetPrimAtPath(light.prim_path) if light.prim_path[0] == "/" else None
            if prim and (name := _changed_shadow(prim, frame.time_code)):
                changed.setdefault(light.prim_path, name)
    return [
        f"<{path}> casts full shadows in <{volume.prim_path}>: its {name} is not read"
        for path, name in changed.items()
    ]


def _changed_shadow(light: Usd.Prim, time_code: float) -> str:
    """The attribute that makes a light's shadows other than they are in the world; "" for none."""
    if not light.HasAPI(UsdLux.ShadowAPI):
        return ""
    shadow = UsdLux.ShadowAPI(light)
    for attribute in (
        shadow.GetShadowEnableAttr(),
        shadow.GetShadowColorAttr(),
        shadow.GetShadowDistanceAttr(),
        shadow.GetShadowFalloffAttr(),
    ):
        plain = light.GetPrimDefinition().GetAttributeFallbackValue(attribute.GetName())
        if attribute.Get(time_code) != plain:
            return str(attribute.GetName())
    return ""


def named_lights(optics: OpticsConfig) -> tuple[LightSource, ...]:
    """The lights that the settings name, by the names of the settings, without black ones.

    Raises:
        ConfigError: see ``lit_by``.
    """
    found = []
    if optics.sun:
        x, y, z = _three("optics.sun", optics.sun)
        length = math.hypot(x, y, z)
        if not 0 < length < math.inf:
            raise ConfigError(
                f"optics.sun={optics.sun} has no direction. Give x, y and z towards the light."
            )
        colour = _colour("optics.sun_colour", optics.sun_colour)
        found.append(LightSource("optics.sun", colour, (x / length, y / length, z / length)))
    if optics.sky:
        found.append(LightSource("optics.sky", _colour("optics.sky", optics.sky)))
    return tuple(light for light in found if max(light.colour) > 0)


def _three(name: str, numbers: Sequence[float]) -> Colour:
    if len(numbers) != 3:
        raise ConfigError(f"{name} has {count_text(len(numbers), 'number')}. Give three.")
    return numbers[0], numbers[1], numbers[2]


def _colour(name: str, numbers: Sequence[float]) -> Colour:
    colour = _three(name, numbers)
    if problem := _out_of_range(colour):
        raise ConfigError(f"{name} is {problem}. Give a colour that is less bright.")
    return colour


def read_lights(stage: Usd.Stage, prim_path: str, time_code: float) -> tuple[LightSource, ...]:
    """The lights that light a Volume at any timeCode; those that cannot be used are passed over."""
    found = [_read_light(p, time_code) for p in _light_prims(stage) if _links(p, prim_path)]
    return tuple(light for light in found if isinstance(light, LightSource))


def _light_prims(stage: Usd.Stage) -> list[Usd.Prim]:
    predicate = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
    return [p for p in Usd.PrimRange.Stage(stage, predicate) if p.HasAPI(UsdLux.LightAPI)]


def _links(light: Usd.Prim, volume_path: str) -> bool:
    """Whether the light's linking lets it light the Volume."""
    collection = UsdLux.LightAPI(light).GetLightLinkCollectionAPI()
    return bool(collection.ComputeMembershipQuery().IsPathIncluded(volume_path))


def _read_light(prim: Usd.Prim, time_code: float) -> LightSource | str | None:
    """The light; why it is left out; or None where it is switched off."""
    if UsdGeom.Imageable(prim).ComputeVisibility(time_code) == UsdGeom.Tokens.invisible:
        return None
    try:
        light = _used_light(prim, time_code)
        if light is not None and (problem := _out_of_range(light.colour)):
            raise _LeftOut(f"it emits {problem}")
        return light
    except _LeftOut as why:
        return str(why)


class _LeftOut(Exception):
    """Why a light is left out."""


def _used_light(prim: Usd.Prim, time_code: float) -> LightSource | None:
    """The light, None where it is black.

    Raises:
        _LeftOut: it cannot be used.
    """
    path, kind = str(prim.GetPath()), prim.GetTypeName()
    if kind != _DISTANT and kind not in _DOMES:
        raise _LeftOut(f"it is of type {kind or 'none'}; DistantLight and DomeLight are used")
    if kind in _DOMES and _has_texture(prim, time_code):
        raise _LeftOut("it has a texture (inputs:texture:file); domes of one colour are used")
    colour = _emission(prim, time_code)
    if max(colour) == 0:
        return None
    if kind in _DOMES:
        return LightSource(path, colour)
    size = _size_factor(prim, time_code)
    red, green, blue = (channel * size for channel in colour)
    place = UsdGeom.XformCache(time_code).GetLocalToWorldTransform(prim)
    towards = np.array(place.TransformDir(_DIRECTION))
    length = float(np.linalg.norm(towards))
    if not (math.isfinite(length) and length > 0):
        raise _LeftOut("its transform is singular or not finite, so it has no direction")
    x, y, z = (towards / length).tolist()
    return LightSource(path, (red, green, blue), (x, y, z))


def _has_texture(dome: Usd.Prim, time_code: float) -> bool:
    texture = UsdLux.DomeLight(dome).GetTextureFileAttr().Get(time_code)
    return bool(authored_path(texture) if isinstance(texture, Sdf.AssetPath) else texture)


def _out_of_range(colour: Colour) -> str:
    """Why smoke cannot scatter the light; "" for nothing."""
    is_light = all(channel >= 0 for channel in colour)  # which NaN is not
    if is_light and max(colour) <= _BRIGHTEST:
        return ""
    red, green, blue = colour
    limit = f"more than {MOST_STOPS:g} stops above white" if is_light else "not 0 or more"
    return f"({red:g}, {green:g}, {blue:g}), {limit}"


def _emission(prim: Usd.Prim, time_code: float) -> Colour:
    """Intensity, exposure, colour and temperature together: radiance before the light's size.

    Raises:
        _LeftOut: one of them is no finite number.
    """
    light = UsdLux.LightAPI(prim)
    (intensity,) = _numbers(light.GetIntensityAttr(), time_code)
    colour = _numbers(light.GetColorAttr(), time_code, 3)
    if intensity == 0 or not colour.any():
        return 0.0, 0.0, 0.0  # at any exposure
    (exposure,) = _numbers(light.GetExposureAttr(), time_code)
    if _numbers(light.GetEnableColorTemperatureAttr(), time_code)[0]:
        (temperature,) = _numbers(light.GetColorTemperatureAttr(), time_code)
        colour = colour * np.array(UsdLux.BlackbodyTemperatureAsRgb(temperature), float)
    with np.errstate(over="ignore", invalid="ignore"):
        red, green, blue = (colour * intensity * np.exp2(exposure)).tolist()
    return red, green, blue


def _size_factor(prim: Usd.Prim, time_code: float) -> float:
    """Irradiance of a surface that faces a distant light, for an emission of 1 [UsdLux].

    Raises:
        _LeftOut: see ``_emission``.
    """
    (angle,) = _numbers(UsdLux.DistantLight(prim).GetAngleAttr(), time_code)
    half = math.radians(min(max(angle, 0.0), 360.0)) / 2
    if half == 0 or _numbers(UsdLux.LightAPI(prim).GetNormalizeAttr(), time_code)[0]:
        return 1.0
    cap = math.pi * math.sin(half) ** 2
    return cap if half <= math.pi / 2 else 2 * math.pi - cap


def _numbers(attribute: Usd.Attribute, time_code: float, count: int = 1) -> np.ndarray:
    """The attribute's value as an array of ``count`` numbers.

    Raises:
        _LeftOut: it has another type, or is not finite.
    """
    value = attribute.Get(time_code)
    try:
        numbers = np.array(value, float).reshape(-1)
    except (TypeError, ValueError):
        numbers = np.array([])
    if isinstance(value, str) or len(numbers) != count or not np.isfinite(numbers).all():
        what = "a finite number" if count == 1 else f"{count} finite numbers"
        raise _LeftOut(f"its {attribute.GetName()} is {value}, not {what}")
    return numbers

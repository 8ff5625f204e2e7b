"""Lights at one timeCode: a stage's distant ones and its domes without a texture, or settings'."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdLux

from usdsmoke.base.errors import ConfigError, count_text
from usdsmoke.base.sections import OpticsConfig
from usdsmoke.base.volume import FrameSource, LightSource, StageSource, VolumeSource
from usdsmoke.usd.diagnostics import readable_values
from usdsmoke.usd.values import authored_path

_DISTANT, _DOMES = "DistantLight", ("DomeLight", "DomeLight_1")
_DIRECTION = Gf.Vec3d(0, 0, 1)  # to a distant light, in its own space


@readable_values()
def lit_by(
    stage: Usd.Stage, source: StageSource, optics: Sequence[OpticsConfig | None]
) -> StageSource:
    """The same Volumes, with the lights that light them at every selected timeCode.

    Args:
        optics: of each Volume; None for one whose smoke scatters no light, which gets none.

    Raises:
        ConfigError: ``optics.sun`` or ``optics.sky`` is no direction and no colour.
    """
    prims = _light_prims(stage)
    known: dict[tuple[str, float], LightSource | str | None] = {}
    left_out: dict[str, str] = {}

    def lights(volume: VolumeSource, frame: FrameSource) -> tuple[LightSource, ...]:
        found = []
        for prim in prims:
            key = (str(prim.GetPath()), frame.time_code)
            if key not in known:
                known[key] = _read_light(prim, frame.time_code)
            light = known[key]
            if isinstance(light, str):
                left_out[key[0]] = light
            elif light is not None and _links(prim, volume.prim_path):
                found.append(light)
        return tuple(found)

    volumes = []
    for volume, own in zip(source.volumes, optics, strict=True):
        if own is not None:
            named = named_lights(own)
            frames = tuple(replace(f, lights=named or lights(volume, f)) for f in volume.frames)
            volume = replace(volume, frames=frames)
        volumes.append(volume)
    paths = tuple(str(prim.GetPath()) for prim in prims)
    return replace(source, volumes=tuple(volumes), lights=paths, unused_lights=left_out)


def named_lights(optics: OpticsConfig) -> tuple[LightSource, ...]:
    """The lights that the settings name, by the names of the settings.

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
        colour = _three("optics.sun_colour", optics.sun_colour)
        found.append(LightSource("optics.sun", colour, (x / length, y / length, z / length)))
    if optics.sky:
        found.append(LightSource("optics.sky", _three("optics.sky", optics.sky)))
    return tuple(light for light in found if max(light.colour) > 0)


def _three(name: str, numbers: Sequence[float]) -> tuple[float, float, float]:
    if len(numbers) != 3:
        raise ConfigError(f"{name} has {count_text(len(numbers), 'number')}. Give three.")
    return numbers[0], numbers[1], numbers[2]


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
    path, kind = str(prim.GetPath()), prim.GetTypeName()
    if UsdGeom.Imageable(prim).ComputeVisibility(time_code) == UsdGeom.Tokens.invisible:
        return None
    if kind != _DISTANT and kind not in _DOMES:
        return f"it is of type {kind or 'none'}; DistantLight and DomeLight are used"
    texture = UsdLux.DomeLight(prim).GetTextureFileAttr().Get(time_code) if kind in _DOMES else None
    if texture and authored_path(texture):
        return "it has a texture (inputs:texture:file); domes of one colour are used"
    colour = _emission(prim, time_code)
    if not (math.isfinite(sum(colour)) and min(colour) >= 0):
        red, green, blue = colour
        return f"it emits ({red:g}, {green:g}, {blue:g}), not finite numbers of 0 or more"
    if not max(colour) > 0:
        return None
    if kind in _DOMES:
        return LightSource(path, colour)
    red, green, blue = (channel * _size_factor(prim, time_code) for channel in colour)
    place = UsdGeom.XformCache(time_code).GetLocalToWorldTransform(prim)
    towards = np.array(place.TransformDir(_DIRECTION))
    length = float(np.linalg.norm(towards))
    if not (math.isfinite(length) and length > 0):
        return "its transform is singular or not finite, so it has no direction"
    x, y, z = (towards / length).tolist()
    return LightSource(path, (red, green, blue), (x, y, z))


def _emission(prim: Usd.Prim, time_code: float) -> tuple[float, float, float]:
    """Intensity, exposure, colour and temperature together: radiance before the light's size."""
    light = UsdLux.LightAPI(prim)
    numbers = [light.GetIntensityAttr().Get(time_code), light.GetExposureAttr().Get(time_code)]
    colour = np.array(light.GetColorAttr().Get(time_code), float)
    if light.GetEnableColorTemperatureAttr().Get(time_code):
        temperature = light.GetColorTemperatureAttr().Get(time_code)
        colour = colour * np.array(UsdLux.BlackbodyTemperatureAsRgb(temperature), float)
    with np.errstate(over="ignore", invalid="ignore"):
        red, green, blue = (colour * numbers[0] * np.exp2(numbers[1])).tolist()
    return red, green, blue


def _size_factor(prim: Usd.Prim, time_code: float) -> float:
    """Irradiance of a surface that faces a distant light, for an emission of 1 [UsdLux]."""
    light = UsdLux.DistantLight(prim)
    half = math.radians(min(max(float(light.GetAngleAttr().Get(time_code)), 0.0), 360.0)) / 2
    if half == 0 or UsdLux.LightAPI(prim).GetNormalizeAttr().Get(time_code):
        return 1.0
    cap = math.pi * math.sin(half) ** 2
    return cap if half <= math.pi / 2 else 2 * math.pi - cap

"""A stage's lights at one timeCode: those that are far away, and domes without a texture."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdLux

from usdsmoke.base.errors import StageError
from usdsmoke.base.time_codes import format_time_code
from usdsmoke.base.volume import FrameSource, LightSource, StageSource, VolumeSource
from usdsmoke.usd.diagnostics import readable_values
from usdsmoke.usd.values import authored_path

_DISTANT, _DOMES = "DistantLight", ("DomeLight", "DomeLight_1")
_DIRECTION = Gf.Vec3d(0, 0, 1)  # to a distant light, in its own space


def list_lights(stage: Usd.Stage) -> tuple[str, ...]:
    """Paths of the prims that emit light, of any type, those inside instances included."""
    return tuple(str(prim.GetPath()) for prim in _light_prims(stage))


@readable_values()
def lit_by(stage: Usd.Stage, source: StageSource, scatters: Sequence[bool]) -> StageSource:
    """The same Volumes, with the lights that light them at every selected timeCode.

    Args:
        scatters: for each Volume whether its smoke scatters light; others get none.

    Raises:
        StageError: a light has a value that is not finite or below 0.
    """
    prims = _light_prims(stage) if any(scatters) else []
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

    volumes = tuple(
        replace(volume, frames=tuple(replace(f, lights=lights(volume, f)) for f in volume.frames))
        if does
        else volume
        for volume, does in zip(source.volumes, scatters, strict=True)
    )
    return replace(source, volumes=volumes, lights=list_lights(stage), unused_lights=left_out)


def read_lights(stage: Usd.Stage, prim_path: str, time_code: float) -> tuple[LightSource, ...]:
    """The lights that light a Volume at any timeCode; those that cannot be used are passed over.

    Raises:
        StageError: see ``lit_by``.
    """
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
    if not max(colour) > 0:
        return None
    if kind in _DOMES:
        return LightSource(path, colour)
    red, green, blue = (channel * _size_factor(prim, time_code) for channel in colour)
    place = UsdGeom.XformCache(time_code).GetLocalToWorldTransform(prim)
    towards = np.array(place.TransformDir(_DIRECTION))
    length = float(np.linalg.norm(towards))
    if not (math.isfinite(length) and length > 0):
        raise StageError(
            f"the light <{path}> at timeCode {format_time_code(time_code)} is placed by a matrix "
            "that is singular or not finite. Correct the transforms of the light and its parents."
        )
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
    if not (math.isfinite(red + green + blue) and min(red, green, blue) >= 0):
        raise StageError(
            f"the light <{prim.GetPath()}> emits ({red:g}, {green:g}, {blue:g}) at timeCode "
            f"{format_time_code(time_code)}. Set intensity, exposure and color so that it emits "
            "finite numbers of 0 or more."
        )
    return red, green, blue


def _size_factor(prim: Usd.Prim, time_code: float) -> float:
    """Irradiance of a surface that faces a distant light, for an emission of 1 [UsdLux]."""
    light = UsdLux.DistantLight(prim)
    half = math.radians(min(max(float(light.GetAngleAttr().Get(time_code)), 0.0), 360.0)) / 2
    if half == 0 or UsdLux.LightAPI(prim).GetNormalizeAttr().Get(time_code):
        return 1.0
    cap = math.pi * math.sin(half) ** 2
    return cap if half <= math.pi / 2 else 2 * math.pi - cap

"""A stage's cameras at one timeCode: place, film and lens."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pxr import Usd, UsdGeom

from usdsmoke.base.errors import StageError
from usdsmoke.base.time_codes import format_time_code
from usdsmoke.base.volume import CameraSource, StageSource
from usdsmoke.usd.diagnostics import readable_values
from usdsmoke.usd.stage.opening import named_prim, type_words

_NUMBERS = {
    "focal_length": "focalLength",
    "horizontal_aperture": "horizontalAperture",
    "vertical_aperture": "verticalAperture",
    "horizontal_offset": "horizontalApertureOffset",
    "vertical_offset": "verticalApertureOffset",
}


def list_cameras(stage: Usd.Stage) -> list[str]:
    """Paths of the stage's Camera prims, those inside instances included."""
    predicate = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
    return [
        str(prim.GetPath())
        for prim in Usd.PrimRange.Stage(stage, predicate)
        if prim.IsA(UsdGeom.Camera)
    ]


@readable_values()
def read_camera(stage: Usd.Stage, prim_path: str, time_code: float) -> CameraSource:
    """A Camera's composed values at a timeCode; what is not authored is the schema's.

    Args:
        time_code: values between time samples are interpolated as USD does it.

    Raises:
        StageError: there is no Camera at the path (the message lists the stage's cameras), or no
            picture can be taken with its values.
    """
    camera = _find_camera(stage, prim_path)
    place = UsdGeom.XformCache(time_code).GetLocalToWorldTransform(camera.GetPrim())
    near, far = camera.GetClippingRangeAttr().Get(time_code)
    numbers = {
        key: float(camera.GetPrim().GetAttribute(name).Get(time_code))
        for key, name in _NUMBERS.items()
    }
    projection = camera.GetProjectionAttr().Get(time_code)
    source = CameraSource(
        prim_path,
        np.array(place, dtype=np.float64),
        clipping_range=(float(near), float(far)),
        is_orthographic=projection == UsdGeom.Tokens.orthographic,
        **numbers,
    )
    _check_camera(source, time_code)
    return source


def seen_through(
    stage: Usd.Stage, source: StageSource, prim_paths: str | Sequence[str]
) -> StageSource:
    """The same Volumes, with a camera at every selected timeCode.

    Where a Volume has none, the stage's cameras are listed, so that the plan can name them.

    Args:
        prim_paths: of a prim of type Camera, for all Volumes or one for each; "" is none.

    Raises:
        StageError: see ``read_camera``.
    """
    if isinstance(prim_paths, str):
        prim_paths = [prim_paths] * len(source.volumes)
    cameras: dict[tuple[str, float], CameraSource] = {}
    volumes = []
    for volume, path in zip(source.volumes, prim_paths, strict=True):
        for code in (frame.time_code for frame in volume.frames) if path else ():
            if (path, code) not in cameras:
                cameras[path, code] = read_camera(stage, path, code)
        frames = tuple(
            replace(frame, camera=cameras.get((path, frame.time_code))) for frame in volume.frames
        )
        volumes.append(replace(volume, frames=frames))
    listed = () if all(prim_paths) else tuple(list_cameras(stage))  # a walk over all prims
    return replace(source, volumes=tuple(volumes), cameras=listed)


def _find_camera(stage: Usd.Stage, path: str) -> UsdGeom.Camera:
    listed = ", ".join(f"<{camera}>" for camera in list_cameras(stage))
    advice = f"Give one of the stage's cameras: {listed}." if listed else "The stage has no camera."
    prim = named_prim(stage, path, "/World/camera", advice, StageError)
    if not prim.IsA(UsdGeom.Camera):
        raise StageError(f"<{path}> {type_words(prim)}, not a Camera. {advice}")
    return UsdGeom.Camera(prim)


def _check_camera(source: CameraSource, time_code: float) -> None:
    """Refuse what gives no picture, by the attribute that is to be corrected."""
    where = f"the camera <{source.prim_path}> at timeCode {format_time_code(time_code)}"
    sizes = [
        ("horizontalAperture", source.horizontal_aperture),
        ("verticalAperture", source.vertical_aperture),
    ]
    if not source.is_orthographic:
        sizes.append(("focalLength", source.focal_length))
    for name, value in sizes:
        if not (math.isfinite(value) and value > 0):
            raise StageError(f"{where} has {name} {value:g}. Set a number above 0.")
    for name, value in (
        ("horizontalApertureOffset", source.horizontal_offset),
        ("verticalApertureOffset", source.vertical_offset),
    ):
        if not math.isfinite(value):
            raise StageError(f"{where} has {name} {value:g}. Set a finite number.")
    near, far = source.clipping_range
    if not (math.isfinite(near) and near < far):
        raise StageError(
            f"{where} has clippingRange ({near:g}, {far:g}). Set two ascending numbers."
        )
    axes = source.camera_to_stage[:3, :3]
    if not (np.isfinite(source.camera_to_stage).all() and abs(np.linalg.det(axes)) > 0):
        raise StageError(
            f"{where} is placed by a matrix that is singular or not finite. Correct the "
            "transforms of the camera and its parents."
        )
    if not np.allclose(source.camera_to_stage[:, 3], (0.0, 0.0, 0.0, 1.0), rtol=0.0, atol=1e-9):
        raise StageError(
            f"{where} is placed by a perspective: the last column of its matrix is not 0, 0, 0, 1. "
            "Correct the transforms of the camera and its parents."
        )

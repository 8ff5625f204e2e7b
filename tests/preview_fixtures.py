"""Looks to be drawn, cameras to draw them through, and readers of what was drawn."""

import importlib
import importlib.util
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image
from pxr import Usd, UsdGeom

from tests.usd_fixtures import make_look, plume_stage


def look_of_four_frames(folder: Path, mode: str = "sublayer") -> Path:
    """The root stage of a look; its extinction per density is 0.5, its emission 1 everywhere."""
    stage = plume_stage(folder / "in", (1, 2, 3, 4))
    (folder / "out").mkdir()
    return Path(make_look(stage, folder / "out", mode=mode).root_stage)


def pixels(file_path: Path) -> np.ndarray:
    with Image.open(file_path) as image:
        return np.asarray(image).astype(np.float32) / 255


def parts(file_path: Path) -> dict[str, tuple[tuple[str, ...], np.ndarray]]:
    """Channel names and values of an OpenEXR file's parts.

    Read by OpenImageIO, which did not write them, where that is installed.
    """
    if importlib.util.find_spec("OpenImageIO") is None:
        return _parts_by_openexr(file_path)
    oiio = importlib.import_module("OpenImageIO")
    image, found = oiio.ImageInput.open(str(file_path)), {}
    assert image is not None, oiio.geterror()
    while image.seek_subimage(len(found), 0):
        spec = image.spec()
        values = np.array(image.read_image(len(found), 0, 0, spec.nchannels, "float"))
        values = values[..., 0] if spec.nchannels == 1 else values
        found[spec.getattribute("name")] = (tuple(spec.channelnames), values)
    image.close()
    return found


def _parts_by_openexr(file_path: Path) -> dict[str, tuple[tuple[str, ...], np.ndarray]]:
    found = {}
    with OpenEXR.File(str(file_path), separate_channels=True) as image:
        for part in image.parts:
            channels = part.channels
            names = tuple(sorted(channels, key="RGBAY".index))
            values = np.stack([np.array(channels[name].pixels) for name in names], axis=-1)
            found[part.name()] = (names, values[..., 0] if len(names) == 1 else values)
    return found


def add_camera(stage_file: Path, path: str, place: tuple[float, float, float], **values: float):
    """A camera that looks along +Y, forwards on a Z-up stage, in a layer over the stage."""
    stage = Usd.Stage.CreateNew(str(stage_file.with_name("with_camera.usda")))
    source = Usd.Stage.Open(str(stage_file))
    stage.GetRootLayer().subLayerPaths.append(f"./{stage_file.name}")
    for key in ("startTimeCode", "endTimeCode", "timeCodesPerSecond", "upAxis"):
        stage.SetMetadata(key, source.GetMetadata(key))
    camera = UsdGeom.Camera.Define(stage, path)
    camera.AddTranslateOp().Set(place)
    camera.AddRotateXOp().Set(90.0)
    for name, value in values.items():
        camera.GetPrim().GetAttribute(name).Set(value)
    camera.GetClippingRangeAttr().Set((0.01, 1000.0))
    stage.GetRootLayer().Save()
    return Path(stage.GetRootLayer().realPath)

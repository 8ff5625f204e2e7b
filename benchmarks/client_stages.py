"""Layers over a result that help to compare clients: without emission, and scaled for Storm."""

from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol

__all__ = ["author_dark_stage", "author_overlay", "author_scaled_stage"]

_METADATA = ("upAxis", "metersPerUnit", "timeCodesPerSecond", "framesPerSecond", "defaultPrim")


def author_dark_stage(stage_file: Path, out_file: Path) -> Path:
    """The stage with no emission on any Volume: what is left is the client's own light."""
    stage = author_overlay(stage_file, out_file)
    for prim in stage.Traverse():
        if prim.IsA(UsdVol.Volume):
            UsdVol.Volume(prim).BlockFieldRelationship("emission")
    stage.GetRootLayer().Save()
    return out_file


def author_scaled_stage(
    stage_file: Path, out_file: Path, camera_path: str, gamma_w: float, time_code: float
) -> Path:
    """The stage with all lengths multiplied by ``gamma_w``, seen by the same camera.

    Storm without a material takes extinction = density per stage unit. Of the result's extinction,
    gamma_w * density per old unit, the new and longer units are what makes it just that. The
    emission stays as it is, so every pixel comes out gamma_w times as bright as it should.
    """
    stage = author_overlay(stage_file, out_file)
    time = Usd.TimeCode(time_code)
    camera = UsdGeom.Camera.Get(stage, camera_path)
    place = camera.ComputeLocalToWorldTransform(time)
    near, far = camera.GetClippingRangeAttr().Get(time)
    for prim in Usd.PrimRange.Stage(stage):
        if prim.IsA(UsdVol.Volume):
            _scale_in_world(UsdGeom.Xformable(prim), gamma_w, time)
    place.SetTranslateOnly(place.ExtractTranslation() * gamma_w)
    camera.MakeMatrixXform().Set(place)
    camera.SetResetXformStack(True)
    camera.GetClippingRangeAttr().Set(Gf.Vec2f(near * gamma_w, far * gamma_w))
    stage.GetRootLayer().Save()
    return out_file


def _scale_in_world(volume: UsdGeom.Xformable, factor: float, time: Usd.TimeCode) -> None:
    """Put the Volume where a scaling of the whole world about its origin would put it."""
    world = np.array(volume.ComputeLocalToWorldTransform(time))
    world[:, :3] *= factor
    volume.MakeMatrixXform().Set(Gf.Matrix4d(*map(float, world.ravel())))
    volume.SetResetXformStack(True)


def author_in_centimetres(stage_file: Path, out_file: Path) -> Path:
    """A stage in centimetres that shows one in metres at the same size, as a pipeline does.

    Every root prim is referenced under a scale of 100; cameras too, whose lens does not change.
    """
    source, stage = Usd.Stage.Open(str(stage_file)), Usd.Stage.CreateNew(str(out_file))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.GetStageUpAxis(source))
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.GetStageMetersPerUnit(source) / 100)
    for key in ("startTimeCode", "endTimeCode", "timeCodesPerSecond", "framesPerSecond"):
        if source.HasAuthoredMetadata(key):
            stage.SetMetadata(key, source.GetMetadata(key))
    for root in source.GetPseudoRoot().GetChildren():
        prim = stage.DefinePrim(root.GetPath(), root.GetTypeName() or "Xform")
        prim.GetReferences().AddReference(str(stage_file.absolute()), root.GetPath())
        UsdGeom.Xformable(prim).AddScaleOp(opSuffix="unit").Set(Gf.Vec3f(100, 100, 100))
        UsdGeom.Xformable(prim).SetXformOpOrder(
            [
                UsdGeom.XformOp(prim.GetAttribute("xformOp:scale:unit")),
                *UsdGeom.Xformable(root).GetOrderedXformOps(),
            ]
        )
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Camera):  # Blender does not scale the clipping range with the camera
            near, far = UsdGeom.Camera(prim).GetClippingRangeAttr().Get(Usd.TimeCode.EarliestTime())
            UsdGeom.Camera(prim).GetClippingRangeAttr().Set(Gf.Vec2f(near, 100 * far))
    stage.SetDefaultPrim(stage.GetPrimAtPath(source.GetDefaultPrim().GetPath()))
    stage.GetRootLayer().Save()
    return out_file


def author_overlay(stage_file: Path, out_file: Path) -> Usd.Stage:
    """A new stage over another one, in a new file; with its metadata, which no sublayer brings."""
    source = Usd.Stage.Open(str(stage_file))
    layer = Sdf.Layer.CreateNew(str(out_file))
    layer.subLayerPaths.append(source.GetRootLayer().realPath)
    stage = Usd.Stage.Open(layer)
    for key in _METADATA:
        if source.HasAuthoredMetadata(key):
            stage.SetMetadata(key, source.GetMetadata(key))
    return stage

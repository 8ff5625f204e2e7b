"""The layers that make clients comparable, and the comparison itself."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol

from benchmarks.client_pictures import compare, main
from benchmarks.client_stages import author_dark_stage, author_scaled_stage
from benchmarks.display import encode_display

CAMERA = "/rig/camera"


@pytest.fixture
def stage_file(tmp_path: Path) -> Path:
    """A Z-up stage with a turned camera under a moved parent, and a moved Volume of two fields."""
    file_path = tmp_path / "shot.usda"
    stage = Usd.Stage.CreateNew(str(file_path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    rig = UsdGeom.Xform.Define(stage, "/rig")
    UsdGeom.XformCommonAPI(rig).SetTranslate(Gf.Vec3d(1, 2, 3))
    camera = UsdGeom.Camera.Define(stage, CAMERA)
    UsdGeom.XformCommonAPI(camera).SetTranslate(Gf.Vec3d(0, 5, 20))
    UsdGeom.XformCommonAPI(camera).SetRotate(Gf.Vec3f(10, 20, 30))
    camera.CreateClippingRangeAttr(Gf.Vec2f(1, 100))
    volume = UsdVol.Volume.Define(stage, "/shot/smoke")
    UsdGeom.XformCommonAPI(volume).SetTranslate(Gf.Vec3d(-1, 0, 2))
    for name in ("density", "emission"):
        asset = UsdVol.OpenVDBAsset.Define(stage, f"/shot/smoke/{name}")
        asset.CreateFilePathAttr(Sdf.AssetPath("./smoke.0001.vdb"))
        volume.CreateFieldRelationship(name, asset.GetPath())
    stage.GetRootLayer().Save()
    return file_path


def screen_place(stage: Usd.Stage, local: Gf.Vec3d) -> Gf.Vec3d:
    """Where the camera sees a point of the density's own space."""
    field = UsdGeom.Imageable(stage.GetPrimAtPath("/shot/smoke/density"))
    world = field.ComputeLocalToWorldTransform(Usd.TimeCode(1)).Transform(local)
    frustum = UsdGeom.Camera.Get(stage, CAMERA).GetCamera(1).frustum
    return (frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()).Transform(world)


def test_the_scaled_stage_has_other_lengths_and_the_same_picture(stage_file: Path, tmp_path: Path):
    scaled_file = author_scaled_stage(stage_file, tmp_path / "scaled.usda", CAMERA, 0.25, 1.0)
    stages = [Usd.Stage.Open(str(file_path)) for file_path in (stage_file, scaled_file)]
    for local in (Gf.Vec3d(0, 0, 0), Gf.Vec3d(2, -1, 3)):
        before, after = (screen_place(stage, local) for stage in stages)
        assert np.allclose(before, after, atol=1e-5)
    lengths = []
    for stage in stages:
        field = UsdGeom.Imageable(stage.GetPrimAtPath("/shot/smoke/density"))
        matrix = field.ComputeLocalToWorldTransform(Usd.TimeCode(1))
        lengths.append(matrix.TransformDir(Gf.Vec3d(0, 0, 1)).GetLength())
    assert lengths[1] == pytest.approx(0.25 * lengths[0])
    assert UsdGeom.GetStageUpAxis(stages[1]) == UsdGeom.Tokens.z


def test_the_dark_stage_lacks_the_emission_and_nothing_else(stage_file: Path, tmp_path: Path):
    before = stage_file.read_bytes()
    stage = Usd.Stage.Open(str(author_dark_stage(stage_file, tmp_path / "dark.usda")))
    volume = UsdVol.Volume(stage.GetPrimAtPath("/shot/smoke"))
    assert list(volume.GetFieldPaths()) == ["density"]
    assert stage_file.read_bytes() == before


def test_the_comparison_finds_a_factor_and_its_difference():
    wanted = np.full((4, 4, 3), 0.2)
    inside = np.ones((4, 4), bool)
    inside[0] = False
    found = np.where(inside[..., None], 0.5 * wanted, 1.0)
    gain, rms = compare(found, wanted, inside)
    assert gain == pytest.approx(0.5)
    assert rms == pytest.approx(
        float(encode_display(np.array(0.2)) - encode_display(np.array(0.1)))
    )


def test_a_stage_without_a_look_ends_in_one_line(stage_file: Path, capsys):
    options = ["--clients", "nowhere", "--python", "nowhere", "--camera", CAMERA]
    assert main([str(stage_file), *options]) == 1
    assert "name the stage that usdsmoke wrote" in capsys.readouterr().err

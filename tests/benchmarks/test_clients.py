"""The stages and measures by which renderers are compared."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol

from benchmarks.client_pictures import difference
from benchmarks.client_runs import GREY, over_black
from benchmarks.client_stages import author_dark_stage, author_in_centimetres, author_scaled_stage
from benchmarks.display import encode_display
from benchmarks.usd_picture_stages import Case, author_stage_without_looks, author_still_stage
from benchmarks.usd_pictures import find_difference
from tests.fixtures.grids_fixtures import openvdb
from tests.fixtures.usd_fixtures import make_look, plume_stage

CAMERA = "/rig/camera"
VOLUME = "/World/smoke"


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


def test_a_stage_in_centimetres_shows_the_same_smoke_a_hundred_times_as_large(
    tmp_path: Path,
) -> None:
    source_file = plume_stage(tmp_path / "in", (1, 2))
    made = author_in_centimetres(source_file, tmp_path / "cm.usda")
    source, stage = Usd.Stage.Open(str(source_file)), Usd.Stage.Open(str(made))
    assert UsdGeom.GetStageMetersPerUnit(stage) == UsdGeom.GetStageMetersPerUnit(source) / 100
    small, large = (
        np.array(UsdGeom.Xformable(each.GetPrimAtPath(VOLUME)).ComputeLocalToWorldTransform(1))
        for each in (source, stage)
    )
    np.testing.assert_allclose(large[:, :3], 100 * small[:, :3])
    field = stage.GetPrimAtPath(f"{VOLUME}/density").GetAttribute("filePath")
    assert Path(field.Get(2).resolvedPath).is_file()


def test_a_difference_is_over_the_whole_picture() -> None:
    wanted = np.zeros((2, 2, 3))
    found = wanted.copy()
    found[0, 0] = 1.0
    assert difference(found, wanted) == pytest.approx(0.5)


def look(folder: Path, mode: str) -> Path:
    """The root layer of a look of the frames 2 and 3 of a shot of the frames 1 to 4."""
    stage_file = plume_stage(folder / "in", (1, 2, 3, 4))
    (folder / "out").mkdir()
    made = make_look(stage_file, folder / "out", frames="2-3", mode=mode, empty=True)
    return Path(made.root_stage)


def composed(stage: Usd.Stage) -> dict[str, object]:
    """All values of the stage by attribute and timeCode, files as they resolve."""
    found: dict[str, object] = {}
    for prim in stage.Traverse():
        for attribute in prim.GetAttributes():
            for code in (1.0, 2.0, 3.0, 4.0):
                value = attribute.Get(code)
                path = value.resolvedPath if isinstance(value, Sdf.AssetPath) else value
                found[f"{attribute.GetPath()} {code}"] = path
        for relationship in prim.GetRelationships():
            found[str(relationship.GetPath())] = relationship.GetTargets()
    return found


def test_a_root_without_its_looks_composes_as_one_with_its_looks_muted(tmp_path: Path):
    root = look(tmp_path, "sublayer")
    without = Usd.Stage.Open(str(author_stage_without_looks(root, tmp_path / "off.usda")))
    muted = Usd.Stage.Open(str(root))
    assert composed(muted) != composed(without)
    muted.MuteLayer(str(root.parent / "look.usda"))
    assert composed(muted) == composed(without)
    assert composed(without) == composed(Usd.Stage.Open(str(tmp_path / "in/shot.usda")))


@pytest.mark.parametrize("frame", [1, 4])
def test_a_still_of_the_source_glows_evenly_in_grey(tmp_path: Path, frame: int):
    case = Case("", look(tmp_path, "sublayer"), frame)
    stage = Usd.Stage.Open(str(author_still_stage(case, tmp_path / "still.usda", 0.25)))
    volume = UsdVol.Volume.Get(stage, VOLUME)
    files = [
        UsdVol.OpenVDBAsset.Get(stage, volume.GetFieldPath(name)).GetFilePathAttr().Get()
        for name in ("density", "emission")
    ]
    assert files[0].resolvedPath == files[1].resolvedPath
    grids = {grid.name: grid for grid in openvdb().readAll(files[0].resolvedPath)[0]}
    density = grids["density"].getConstAccessor().getValue((1, 1, 1))
    light = grids["emission"].getConstAccessor().getValue((1, 1, 1))
    assert density > 0
    assert light == pytest.approx((0.5 * 0.25 * density,) * 3)


def test_the_difference_of_flat_pictures_is_that_of_their_display_values():
    alpha = np.ones((4, 4))
    alpha[:2] = 0.0
    wanted = np.where(alpha[..., None] > 0, 0.4, 0.0) * np.ones(3)
    apart = float(encode_display(np.array(0.4)) - encode_display(np.array(0.2)))
    found = find_difference(0.5 * wanted, wanted, alpha)
    assert found.gain == pytest.approx(0.5)
    assert found.largest == pytest.approx(apart)
    assert found.inside == pytest.approx(apart)
    assert found.rms == pytest.approx(apart / np.sqrt(2.0))
    same = find_difference(wanted, wanted, alpha)
    assert (same.gain, same.rms, same.largest, same.inside) == (1.0, 0.0, 0.0, 0.0)


def test_storms_grey_background_comes_off_again():
    light, alpha = np.full((2, 2, 3), 0.3), np.array([[0.0, 0.5], [0.9, 1.0]])
    light[0, 0] = 0.0
    picture = encode_display(light) + (1.0 - alpha[..., None]) * GREY
    np.testing.assert_allclose(over_black(picture, alpha), light, atol=1e-6)

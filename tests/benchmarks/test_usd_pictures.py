"""The stages that `benchmarks.usd_pictures` draws, the measure, and the sheet."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdVol

from benchmarks.client_runs import GREY, over_black
from benchmarks.display import encode_display
from benchmarks.usd_picture_stages import (
    Case,
    author_original_stage,
    author_shot_stage,
    author_stage_without_looks,
    author_still_stage,
    files_shown,
)
from benchmarks.usd_pictures import ROWS, compose_sheet, find_difference, main
from tests.grids_fixtures import openvdb
from tests.usd_fixtures import make_look, plume_stage

VOLUME = "/World/smoke"


def look(folder: Path, mode: str) -> Path:
    """The root stage of a look of the frames 2 and 3 of a shot of the frames 1 to 4."""
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


def test_the_original_of_an_asset_shows_the_source_and_leaves_the_asset_alone(tmp_path: Path):
    asset = look(tmp_path, "reference")
    before = asset.read_bytes()
    original = Usd.Stage.Open(str(author_original_stage(asset, tmp_path / "off.usda")))
    assert composed(original) == composed(Usd.Stage.Open(str(tmp_path / "in/shot.usda")))
    assert asset.read_bytes() == before


def test_a_still_of_the_look_names_the_files_of_the_result(tmp_path: Path):
    root = look(tmp_path, "sublayer")
    case = Case("", root, 3)
    stage = Usd.Stage.Open(str(author_still_stage(case, tmp_path / "still.usda", 0.5)))
    for name in ("density", "emission"):
        attribute = UsdVol.OpenVDBAsset.Get(stage, f"{VOLUME}/{name}").GetFilePathAttr()
        (wanted,) = {Path(attribute.Get(code).resolvedPath) for code in (1, 3, 4)}
        assert wanted.parent == root.parent / "vdb"
        assert files_shown(case) == [wanted.name]
    assert not list(tmp_path.glob("*.vdb"))


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


def test_the_shot_moves_the_camera_and_not_the_sources(tmp_path: Path):
    source_file = tmp_path / "plume.usda"
    stage = Usd.Stage.CreateNew(str(source_file))
    UsdGeom.XformCommonAPI(UsdGeom.Camera.Define(stage, "/cameras/front")).SetTranslate((0, 1, 5))
    stage.GetRootLayer().Save()
    before = source_file.read_bytes()
    shot_file = author_shot_stage(source_file, tmp_path / "shot.usda", "/cameras/front")
    assert source_file.read_bytes() == before
    assert Sdf.Layer.FindOrOpen(str(shot_file)).subLayerPaths == ["./plume.usda"]
    shot = Usd.Stage.Open(str(shot_file))
    camera = UsdGeom.Camera.Get(shot, "/cameras/front")
    assert camera.ComputeLocalToWorldTransform(1).ExtractTranslation()[2] == 5.0
    assert camera.GetFocalLengthAttr().Get() == 68.0


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


def test_every_picture_stands_below_its_case_and_beside_its_program():
    columns = {
        name: [np.full((16, 16, 3), (10 * x + y) / 255.0) for y in range(len(ROWS))]
        for x, name in enumerate(("a", "b"))
    }
    sheet = np.asarray(compose_sheet(columns))
    assert sheet.shape == (14 + len(ROWS) * 30, 32, 3)
    for x in range(2):
        for y in range(len(ROWS)):
            cell = sheet[28 + 30 * y : 44 + 30 * y, 16 * x : 16 * x + 16]
            assert (cell == 10 * x + y).all()


def test_clients_that_are_missing_end_in_one_line(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.setattr("benchmarks.usd_pictures._python", lambda *_: None)
    monkeypatch.setattr("benchmarks.usd_pictures.author_shot_stage", lambda *_: None)
    words = ["--clients", "nowhere", "--python", "nowhere", "--out", str(tmp_path)]
    assert main(words) == 1
    assert capsys.readouterr().err.startswith("benchmarks.usd_pictures: ")

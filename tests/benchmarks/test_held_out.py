"""Held-out views of a result, and the stage that the benchmark makes over a real file."""

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol

from benchmarks.display import decode_display
from benchmarks.held_out import (
    RENDERERS,
    Result,
    cover_box,
    fit_view,
    read_result,
    score_result,
)
from benchmarks.stages import author_plume_stage
from usdsmoke.base.volume import DenseField
from usdsmoke.vdb.write import write_frame

VOXEL = 0.25


def make_field(name: str, values: np.ndarray, ijk_min: tuple[int, int, int]) -> DenseField:
    matrix = np.diag([VOXEL, VOXEL, VOXEL, 1.0])
    matrix[3, :3] = (3.0, -2.0, 1.0)
    return DenseField(name, values.astype(np.float32), ijk_min, matrix)


def make_result(colour: tuple[float, float, float] = (0.5, 0.2, 0.1)) -> Result:
    """Thick smoke of one colour in a box of 16 x 24 x 12 voxels."""
    density = np.full((16, 24, 12), 3.0)
    emission = density[..., None] * 0.8 * np.array(colour)
    return Result(
        make_field("density", density, (-5, 2, 7)),
        make_field("emission", emission, (-5, 2, 7)),
        np.eye(4),
        0.8,
    )


def test_a_smaller_and_shifted_grid_lands_on_its_own_voxels():
    box = make_field("density", np.zeros((4, 5, 6)), (10, 20, 30))
    values = np.arange(2 * 2 * 3 * 3).reshape(2, 2, 3, 3)
    covered = cover_box(make_field("emission", values, (12, 19, 31)), box)
    assert covered.values.shape == (4, 5, 6, 3)
    assert np.array_equal(covered.values[2:4, 0:1, 1:4], values[:, 1:])
    assert covered.values.sum() == values[:, 1:].sum()


@pytest.mark.parametrize("renderer", sorted(RENDERERS))
def test_smoke_of_one_colour_is_drawn_in_that_colour_in_the_middle(renderer: str):
    result = make_result()
    view = fit_view(result, 0.0, 0.0, 48)
    picture, alpha = RENDERERS[renderer](result, view)
    centre = (view.height // 2, view.width // 2)
    wanted = 1.0 - np.exp(-0.8 * 3.0 * 12 * VOXEL)
    assert alpha[centre] == pytest.approx(wanted, rel=1e-3)
    assert picture[centre] / alpha[centre] == pytest.approx([0.5, 0.2, 0.1], rel=1e-3)
    assert alpha[0].max() < 0.02 and alpha[:, -1].max() < 0.02  # all of the smoke is in the picture


def test_smoke_painted_straight_through_scores_near_one_from_the_front():
    rng = np.random.default_rng(2)
    style = np.kron(rng.uniform(0.1, 0.9, (12, 12, 3)), np.ones((4, 4, 1))).astype(np.float32)
    density = np.full((48, 48, 8), 10.0)
    colour = decode_display(style)[::-1].transpose(1, 0, 2)[:, :, None]
    result = Result(
        make_field("density", density, (0, 0, 0)),
        make_field("emission", density[..., None] * colour, (0, 0, 0)),
        np.eye(4),
        1.0,
    )
    scores, images = score_result(result, style, [(0.0, 0.0)], 48)
    assert len(images) == 1
    assert all(scores[name]["mean"] > 0.9 for name in ("patch", "colour", "spectrum"))


def test_a_result_is_read_through_its_stage_with_the_extinction_that_it_names(tmp_path):
    made = make_result()
    write_frame(tmp_path / "result.0001.vdb", [made.density, made.emission], {}, False)
    stage = Usd.Stage.CreateNew(str(tmp_path / "look.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    volume = UsdVol.Volume.Define(stage, "/smoke")
    UsdGeom.XformCommonAPI(volume).SetTranslate(Gf.Vec3d(1, 2, 3))
    for name in ("density", "emission"):
        asset = UsdVol.OpenVDBAsset.Define(stage, f"/smoke/{name}")
        asset.CreateFilePathAttr(Sdf.AssetPath("./result.0001.vdb"))
        asset.CreateFieldNameAttr(name)
        volume.CreateFieldRelationship(name, asset.GetPath())
    stage.GetRootLayer().Save()
    with pytest.raises(ValueError, match="usdsmoke wrote"):
        read_result(stage)
    extinction = "usdSmoke:extinctionPerDensity"
    volume.GetPrim().CreateAttribute(extinction, Sdf.ValueTypeNames.Float).Set(0.8)
    result = read_result(stage, "/smoke")
    assert result.gamma_w == pytest.approx(0.8)
    assert result.up_axis == "Z"
    assert np.array_equal(result.to_stage[3], [1, 2, 3, 1])
    assert np.array_equal(result.emission.values, made.emission.values)


def test_the_plume_stage_finds_its_file_by_a_relative_path_and_frames_the_smoke(tmp_path):
    vdb_file = tmp_path / "data" / "smoke.vdb"
    vdb_file.parent.mkdir()
    write_frame(vdb_file, [make_result().density], {}, False)
    stage_file = author_plume_stage(vdb_file, tmp_path / "out" / "plume.usda")
    assert "../data/smoke.vdb" in stage_file.read_text()
    stage = Usd.Stage.Open(str(stage_file))
    volume = UsdVol.Volume(stage.GetPrimAtPath("/plume/smoke"))
    extent = np.array(volume.GetExtentAttr().Get())
    wanted = VOXEL * np.array([[-5.5, 1.5, 6.5], [10.5, 25.5, 18.5]]) + [3.0, -2.0, 1.0]
    assert np.allclose(extent, wanted)
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/cameras/front")).GetCamera(1.0)
    corners = np.array(np.meshgrid(*extent.T)).reshape(3, -1).T
    seen = np.array(
        [camera.transform.GetInverse().Transform(Gf.Vec3d(*map(float, c))) for c in corners]
    )
    on_screen = seen[:, :2] / -seen[:, 2:] * camera.focalLength / (0.5 * camera.horizontalAperture)
    assert 0.8 < np.abs(on_screen).max() < 1.0

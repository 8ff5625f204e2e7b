"""Previews of stages: what is drawn, from where, how dense, and into which files."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdVol

from tests.fixtures.preview_fixtures import (
    add_camera,
    look_of_four_frames,
    parts,
    pixels,
    referenced,
)
from tests.fixtures.usd_fixtures import (
    density_prim,
    file_hashes,
    make_look,
    plume_stage,
    volume_prim,
    world,
    write_text,
    write_vdb,
)
from usdsmoke.base.errors import DamagedFile, StageError, WriteFailed
from usdsmoke.pictures import encode_srgb
from usdsmoke.pictures.drawing import GREY
from usdsmoke.pictures.preview import preview

pytestmark = pytest.mark.usefixtures("quick_grids")

# write_vdb's box is 3 voxels of 0.5 deep along Y, which the front view of a Z-up stage looks along;
# make_look's extinction per density is 0.5, its density and emission are 1.
LENGTH = 1.5
ALPHA = 1 - np.exp(-0.5 * LENGTH)
LIGHT = 1.0 / 0.5 * ALPHA


@pytest.fixture
def look(tmp_path: Path) -> Path:
    """The root layer of a look of four frames."""
    return look_of_four_frames(tmp_path)


def test_other_stages_are_drawn_beside_the_first(look: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.usda"
    Usd.Stage.Open(str(look)).Export(str(other))  # flattened: it shows the same
    stage = Usd.Stage.Open(str(other))
    stage.GetAttributeAtPath("/World/smoke.usdSmoke:extinctionPerDensity").Set(1.0)
    stage.Save()
    result = preview(look, tmp_path / "a.exr", frames="2", beside=[other, stage], size=(61, 41))
    names = ["a.exr", "a.other_1.exr", "a.other_2.exr"]
    assert [file.name for file in result.files][:1] == names[:1] and len(result.files) == 3
    depths = [parts(file)["density"][1][20, 30] for file in result.files]
    assert depths == pytest.approx([0.5 * LENGTH, LENGTH, LENGTH], rel=1e-5)


@pytest.mark.parametrize(
    ("frames", "columns", "n_rows"), [("2", 3, 1), ("2-3", 3, 2), ("1-4", 4, 3)]
)
def test_a_sheet_has_a_column_or_a_row_for_each_stage(
    look: Path, tmp_path: Path, frames: str, columns: int, n_rows: int
) -> None:
    """A column, where there are fewer frames than stages."""
    preview(look, tmp_path / "a.png", frames=frames, beside=[look] * 2, size=(300, 200))
    height, width = pixels(tmp_path / "a.png").shape[:2]
    assert width // 300 == columns and height // 200 == n_rows


# What is drawn


def test_a_look_is_drawn_with_its_extinction_and_emission(look: Path, tmp_path: Path) -> None:
    result = preview(look, tmp_path / "a.exr", frames="2", size=(61, 41))
    assert result.files == (tmp_path / "a.exr",) and result.extinctions == {"/World/smoke": 0.5}
    found = parts(tmp_path / "a.exr")
    middle = {name: values[20, 30] for name, (_, values) in found.items()}
    assert middle["density"] == pytest.approx(0.5 * LENGTH, rel=1e-5)
    assert middle["alpha"] == pytest.approx(ALPHA, rel=1e-5)
    assert middle["emission"] == pytest.approx([LIGHT] * 3, rel=1e-5)
    assert middle["rgba"] == pytest.approx([LIGHT] * 3 + [ALPHA], rel=1e-5)
    assert found["rgba"][1][0, 0] == pytest.approx([0.0] * 4)


@pytest.mark.parametrize("units", [(100, 0.01), (100, 1), (1, 0.01)], ids=str)
def test_a_look_under_another_scale_or_unit_has_the_same_picture(
    look: Path, tmp_path: Path, units: tuple[float, float]
) -> None:
    pictures = []
    for stage in (look, referenced(look, *units)):
        (file_path,) = preview(stage, tmp_path / "a.exr", frames="2", size=(61, 41)).files
        pictures.append(parts(file_path)["rgba"][1])
    assert pictures[0].max() > 0.5
    assert pictures[1] == pytest.approx(pictures[0], abs=1e-4)


def test_exr_parts_and_channels_are_what_the_document_says(look: Path, tmp_path: Path) -> None:
    preview(look, tmp_path / "a.exr", frames="2", width=32)
    channels = {name: names for name, (names, _) in parts(tmp_path / "a.exr").items()}
    assert channels == {
        "rgba": ("R", "G", "B", "A"),
        "emission": ("R", "G", "B"),
        "alpha": ("A",),
        "density": ("Y",),
    }
    assert next(iter(channels)) == "rgba"  # what readers of one part show


def test_a_png_is_the_linear_picture_over_its_background_display_encoded(
    look: Path, tmp_path: Path
) -> None:
    for background, behind in (("black", 0.0), ("grey", 0.03)):
        preview(look, tmp_path / "a.png", frames="2", size=(61, 41), background=background)
        found = pixels(tmp_path / "a.png")
        assert found.shape == (41, 61, 3)
        wanted = encode_srgb(np.clip(LIGHT + (1 - ALPHA) * behind, 0, 1))
        assert found[20, 30] == pytest.approx([float(wanted)] * 3, abs=0.6 / 255)
        assert found[0, 0] == pytest.approx([float(encode_srgb(np.float64(behind)))] * 3, abs=0.01)


def test_a_transparent_png_has_straight_alpha(tmp_path: Path) -> None:
    preview(plume_stage(tmp_path), tmp_path / "a.png", frames="2", size=(61, 41), background="none")
    found = pixels(tmp_path / "a.png")
    assert found.shape == (41, 61, 4) and found[0, 0, 3] == 0
    seen = found[..., 3] > 0.1
    assert np.allclose(found[seen][:, :3], float(encode_srgb(np.float64(GREY))), atol=0.6 / 255)


def test_smoke_without_a_look_is_grey_and_as_dense_as_a_run_would_take_it(tmp_path: Path) -> None:
    result = preview(plume_stage(tmp_path), tmp_path / "a.exr", frames="2", size=(61, 41))
    found = parts(tmp_path / "a.exr")
    assert result.extinctions["/World/smoke"] == pytest.approx(1.3 / LENGTH, rel=0.05)
    assert found["density"][1][20, 30] == pytest.approx(1.3, rel=0.05)  # optics.depth_shape
    alpha = found["alpha"][1]
    assert np.allclose(found["rgba"][1][..., :3], GREY * alpha[..., None], atol=1e-6)
    assert not found["emission"][1].any()


def test_an_emission_that_is_no_colour_is_left_out_and_said(tmp_path: Path) -> None:
    write_vdb(tmp_path / "smoke.vdb", ("density", "flame"))
    files = "asset filePath = @./smoke.vdb@"
    body = density_prim(files) + density_prim(files, "flame", grid='token fieldName = "flame"')
    relations = (
        "rel field:density = </World/smoke/density>\nrel field:emission = </World/smoke/flame>"
    )
    stage = write_text(tmp_path / "shot.usda", world(volume_prim(body, relations=relations)))
    result = preview(stage, tmp_path / "a.png", width=16)
    assert "float values and no colours" in result.notes[0]


def test_an_emission_per_density_is_drawn_as_its_product_with_it(tmp_path: Path) -> None:
    write_vdb(tmp_path / "smoke.vdb", ("density", "emission"), value=3.0)
    files = "asset filePath = @./smoke.vdb@"
    body = density_prim(files) + density_prim(
        files, "emission", grid='token fieldName = "emission"'
    )
    relations = """rel field:density = </World/smoke/density>
        rel field:emission = </World/smoke/emission>
        float usdSmoke:extinctionPerDensity = 0.25
        token usdSmoke:emissionMode = """
    light = {}
    for mode in ("absolute", "perDensity"):
        text = world(volume_prim(body, relations=f'{relations}"{mode}"'))
        stage = write_text(tmp_path / f"{mode}.usda", text)
        preview(stage, tmp_path / "a.exr", size=(61, 41))
        light[mode] = parts(tmp_path / "a.exr")["emission"][1][20, 30]
    alpha = 1 - np.exp(-0.25 * 3.0 * LENGTH)
    assert light["absolute"] == pytest.approx([3.0 / 0.75 * alpha] * 3, rel=1e-5)
    assert light["perDensity"] == pytest.approx([9.0 / 0.75 * alpha] * 3, rel=1e-5)


def two_volumes(folder: Path) -> Path:
    """Two equal boxes, the second 20 units to the right and hidden at timeCode 3."""
    stage_file = plume_stage(folder, (1, 2, 3))
    write_vdb(folder / "box.vdb")
    other = volume_prim(density_prim("asset filePath = @./box.vdb@"), "other")
    text = stage_file.read_text().rstrip().removesuffix("}") + other + "}\n"
    write_text(stage_file, text)
    stage = Usd.Stage.Open(str(stage_file))
    prim = UsdVol.Volume(stage.GetPrimAtPath("/World/other"))
    prim.AddTranslateOp().Set((20, 0, 0))
    prim.CreateVisibilityAttr().Set("inherited", 1)
    prim.CreateVisibilityAttr().Set("invisible", 3)
    stage.GetRootLayer().Save()
    return stage_file


def test_all_volumes_are_in_one_picture_hidden_ones_are_not(tmp_path: Path) -> None:
    stage = two_volumes(tmp_path)
    preview(stage, tmp_path / "a.exr", frames="2-3", width=200)
    both, one = (parts(tmp_path / f"a.000{n}.exr")["alpha"][1].max(axis=0) for n in (2, 3))
    assert both[:40].max() > 0.5 and both[-40:].max() > 0.5 and both[60:140].max() == 0
    assert one[:40].max() > 0.5 and one[-40:].max() == 0
    preview(stage, tmp_path / "b.exr", prims=["/World/smoke"], frames="2", width=60)
    assert parts(tmp_path / "b.exr")["alpha"][1].any(axis=0).mean() > 0.9  # fitted to it alone


# An open stage


def test_volumes_too_far_apart_to_be_seen_are_told(tmp_path: Path) -> None:
    def drawn(shift: float) -> tuple[str, ...]:
        stage = two_volumes(tmp_path)
        text = stage.read_text().replace("(20, 0, 0)", f"({shift}, 0, 0)")
        return preview(write_text(stage, text), tmp_path / "a.png", width=64).notes

    assert not any("--prim" in note for note in drawn(20))
    assert any("--prim" in note for note in drawn(800))


def test_an_open_stage_is_drawn_with_its_unsaved_edits(look: Path, tmp_path: Path) -> None:
    stage = Usd.Stage.Open(str(look))
    extinction = stage.GetPrimAtPath("/World/smoke").GetAttribute("usdSmoke:extinctionPerDensity")
    extinction.Set(0.25)
    result = preview(stage, tmp_path / "open.exr", frames="2", width=20)
    assert result.extinctions == {"/World/smoke": 0.25}


def test_comparing_an_open_stage_mutes_nothing_on_it(look: Path, tmp_path: Path) -> None:
    stage = Usd.Stage.Open(str(look))
    result = preview(stage, tmp_path / "open.exr", frames="2", width=20, compare=True)
    assert [path.name for path in result.files] == ["open.original.exr", "open.exr"]
    assert stage.GetMutedLayers() == []
    first, second = (parts(path)["emission"][1] for path in result.files)
    assert not first.any() and second.any()


# From where


def test_a_camera_of_the_stage_puts_smoke_on_the_pixels_it_should(
    look: Path, tmp_path: Path
) -> None:
    film = {"focalLength": 50.0, "horizontalAperture": 20.0, "verticalAperture": 10.0}
    stage = add_camera(look, "/cameras/side", (0.25, -50.0, 1.25), **film)
    result = preview(stage, tmp_path / "a.exr", camera="/cameras/side", frames="2", width=400)
    assert (result.width, result.height) == (400, 200)  # the film's shape
    alpha = parts(tmp_path / "a.exr")["alpha"][1]
    y, x = (np.average(grid, weights=alpha) for grid in np.mgrid[:200, :400])
    # The box's middle is (0.75, 0.5, 0.25).
    scale = 50.0 / 20.0 * 400 / 50.5
    assert x == pytest.approx(199.5 + scale * (0.75 - 0.25), abs=0.1)
    assert y == pytest.approx(99.5 - scale * (0.25 - 1.25), abs=0.1)


def test_the_front_view_does_not_depend_on_which_frames_are_drawn(tmp_path: Path) -> None:
    for code, size in ((1, 0.5), (2, 0.5), (3, 5.0)):
        write_vdb(tmp_path / f"cache/smoke.{code:04d}.vdb", voxel_size=size)
    files = ", ".join(f"{code}: @./cache/smoke.{code:04d}.vdb@" for code in (1, 2, 3))
    body = density_prim(f"asset filePath.timeSamples = {{ {files} }}")
    stage = write_text(tmp_path / "shot.usda", world(volume_prim(body)))
    preview(stage, tmp_path / "all.exr", frames="1-3", width=100)
    preview(stage, tmp_path / "one.exr", frames="1", width=100)
    alone, among = (parts(tmp_path / name)["density"][1] for name in ("one.exr", "all.0001.exr"))
    assert np.array_equal(alone, among)
    large = parts(tmp_path / "all.0003.exr")["alpha"][1] > 0
    assert large[:, 2:-2].any(axis=0).all()  # all of the largest frame, and it fills the picture
    assert not large[:, 0].any() and not large[0].any()
    assert 0.05 < (alone > 0).any(axis=0).mean() < 0.2


def test_missing_or_damaged_files_of_other_frames_do_not_matter(tmp_path: Path) -> None:
    stage = plume_stage(tmp_path)
    (tmp_path / "cache/smoke.0003.vdb").unlink()
    preview(stage, tmp_path / "a.png", frames="2", width=16)
    (tmp_path / "cache/smoke.0004.vdb").write_bytes(b"no VDB at all")
    preview(stage, tmp_path / "a.png", frames="2", width=16)
    with pytest.raises(StageError, match=r"timeCode 3|smoke\.0003\.vdb"):
        preview(stage, tmp_path / "b.png", frames="3", width=16)
    with pytest.raises(DamagedFile, match=r"smoke\.0004\.vdb"):
        preview(stage, tmp_path / "b.png", frames="2,4", width=16)
    assert not (tmp_path / "b.png").exists()


# Into which files


def test_several_frames_are_a_contact_sheet_first_middle_and_last_by_default(
    look: Path, tmp_path: Path
) -> None:
    result = preview(look, tmp_path / "a.png", size=(60, 40))
    assert result.time_codes == (1, 3, 4) and result.files == (tmp_path / "a.png",)
    sheet = pixels(tmp_path / "a.png")
    preview(look, tmp_path / "one.png", frames="1", size=(60, 40))
    one = pixels(tmp_path / "one.png")
    found = [
        (row, column)
        for row in range(sheet.shape[0] - 40)
        for column in range(sheet.shape[1] - 60)
        if np.array_equal(sheet[row, column], one[0, 0])
        and np.array_equal(sheet[row : row + 40, column : column + 60], one)
    ]
    assert len(found) == 3 and len({row for row, _ in found}) == 1  # side by side, pixel for pixel


@pytest.mark.parametrize("mode", ["sublayer", "reference"])
def test_comparing_puts_the_original_beside_the_look(mode: str, tmp_path: Path) -> None:
    look = look_of_four_frames(tmp_path, mode)
    result = preview(look, tmp_path / "a.exr", frames="2-3", compare=True, width=32)
    names = ["a.original.0002.exr", "a.original.0003.exr", "a.0002.exr", "a.0003.exr"]
    assert [file_path.name for file_path in result.files] == names
    before, after = (parts(result.files[n])["rgba"][1] for n in (0, 2))
    assert before.shape == after.shape
    assert np.allclose(before[..., 0], GREY * before[..., 3], atol=1e-6)  # grey: its look is muted
    assert after[..., 0].max() == pytest.approx(LIGHT, rel=1e-4)
    single = preview(look, tmp_path / "a.png", frames="2", size=(40, 30))
    one = pixels(single.files[0]).shape
    preview(look, tmp_path / "a.png", frames="2", compare=True, size=(40, 30))
    assert pixels(tmp_path / "a.png").shape[0] > 2 * one[0]


def test_the_stage_and_its_files_stay_as_they_are(look: Path, tmp_path: Path) -> None:
    before = file_hashes(tmp_path)
    preview(look, tmp_path / "a.png", compare=True, width=16)
    after = file_hashes(tmp_path)
    assert after.pop("a.png") and after == before


@pytest.mark.parametrize("name", ["a.png", "a.exr"])
def test_an_old_picture_is_replaced_as_a_whole_or_stays(
    name: str, look: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = write_text(tmp_path / name, "something older")

    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("usdsmoke.base.publish.os.replace", refuse)
    with pytest.raises(WriteFailed, match="some space"):
        preview(look, target, frames="2", width=16)
    assert target.read_text() == "something older"
    monkeypatch.undo()


@pytest.mark.parametrize(
    "request_text",
    ["asset[] @@styleImages = [@./gone.png@]", "double @@strenght = 1", "rel @@mask = </none>"],
)
def test_a_request_that_cannot_be_fulfilled_hides_no_smoke(
    request_text: str, tmp_path: Path
) -> None:
    stage = plume_stage(tmp_path / "in", (1,))
    asked = request_text.replace("@@", "usdSmoke:request:")
    text = stage.read_text(encoding="utf-8").replace(
        'def Volume "smoke"\n    {',
        f'def Volume "smoke" (prepend apiSchemas = ["UsdSmokeStyleAPI"])\n    {{\n{asked}',
    )
    write_text(stage, text)
    assert asked in text
    assert preview(stage, tmp_path / "a.png", width=16).files == (tmp_path / "a.png",)


# Which look of an asset is drawn


def test_a_look_of_an_asset_is_drawn_by_its_name(tmp_path: Path) -> None:
    output = tmp_path / "out"
    files = make_look(plume_stage(tmp_path, [1]), output, mode="reference", look="ember")
    asset, before = files.root_stage, file_hashes(output)
    ember = preview(asset, tmp_path / "a.exr", size=(61, 41), look="ember")
    source = preview(asset, tmp_path / "b.exr", size=(61, 41), look="original")
    assert ember.extinctions == {"/World/smoke": 0.5} != source.extinctions
    assert file_hashes(output) == before
    assert preview(asset, tmp_path / "c.exr", size=(61, 41)).extinctions == ember.extinctions
    with pytest.raises(StageError, match=r"frost.*found: ember, original"):
        preview(asset, tmp_path / "d.exr", look="frost")

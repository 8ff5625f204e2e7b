"""What a plan remarks on, and what a run of a part of a shot says at its end."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.fixtures.grids_fixtures import raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, make_shot
from tests.fixtures.usd_fixtures import (
    density_prim,
    sequence,
    volume_prim,
    world,
    write_text,
    write_vdb,
)
from usdsmoke.config.settings import Config
from usdsmoke.pipeline import Request, plan_request, stylize
from usdsmoke.planning.plan import Plan
from usdsmoke.runs import coarse


@pytest.fixture
def shot(tmp_path: Path) -> Shot:
    return make_shot(tmp_path)


def plan_of(shot: Shot, *settings: str) -> Plan:
    return plan_request(Request(shot.stage, shot.style, shot.output, list(settings)))


def test_ordinary_settings_are_not_remarked_on(shot: Shot) -> None:
    assert plan_of(shot).notes == ()


def test_a_learning_rate_far_above_the_default_is_remarked_on(shot: Shot) -> None:
    (note,) = plan_of(shot, "colour.learning_rate=50").notes
    assert "colour.learning_rate=50" in note
    assert plan_of(shot, "colour.learning_rate=0.1").notes == ()
    assert plan_of(shot, "colour.learning_rate=50", "optimize.steps=[shape]").notes == ()


def test_a_loss_that_outweighs_the_style_is_remarked_on(shot: Shot) -> None:
    (note,) = plan_of(shot, "losses.nearest=1e6").notes
    assert "losses.nearest=1e+06 outweighs the style" in note
    assert plan_of(shot, "losses.nearest=10").notes == ()
    (note,) = plan_of(shot, "losses.keep=1e9").notes
    assert "losses.keep" in note
    assert plan_of(shot, "losses.keep=1e9", "optimize.steps=[colour]").notes == ()


@pytest.mark.parametrize("setting", ["style.size=0.001", "style.tiling=16"])
def test_a_style_of_a_few_pixels_is_remarked_on(setting: str, shot: Shot) -> None:
    (note,) = plan_of(shot, setting).notes
    assert setting in note and "strokes are lost" in note


def test_a_part_of_a_shot_is_measured_on_that_part_and_the_plan_says_so(shot: Shot) -> None:
    (note,) = plan_of(shot, "stage.frames=1-2").notes
    assert "on 2 of 3" in note and "optics.gamma" in note
    known = (
        "optics.gamma=1", "optics.gamma_shape=1", "optics.thicken=1", "style.size=1",
        "grids.refine=1",
    )  # fmt: skip
    assert plan_of(shot, "stage.frames=1-2", *known).notes == ()
    assert plan_of(shot, "stage.frames=1-2", known[0]).notes


def test_frames_that_are_to_be_measured_but_not_stylized_are_named(shot: Shot) -> None:
    measured = "optics.frames=1-3"
    (note,) = (n for n in plan_of(shot, "stage.frames=2", measured).notes if "optics.frames" in n)
    assert "timeCodes 1,3" in note
    assert plan_of(shot, measured).notes == ()


def test_empty_frames_that_are_to_be_measured_are_named_and_need_no_velocity(shot: Shot) -> None:
    write_vdb(shot.stage.parent / "cache/smoke.0001.vdb", value=0.0)
    assert plan_of(shot).notes == ()
    (note,) = plan_of(shot, "optics.frames=1").notes
    assert "optics.frames names empty frames" in note
    assert plan_of(shot, "optics.frames=1-2").notes == ()


def test_a_frame_without_a_velocity_among_others_is_named(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, n_frames=4, names=("density", "vel"))
    assert plan_of(shot).notes == ()
    for last in (4, 2):  # nothing goes on from the last frame
        write_vdb(shot.stage.parent / f"cache/smoke.{last:04d}.vdb")
        notes = plan_of(shot).notes
        assert len(notes) == (last == 2)
    assert "no velocity at timeCode 2:" in notes[0] and "stays in place" in notes[0]
    assert plan_of(shot, "stage.motion=estimate").notes == ()
    assert plan_of(shot, "windows.size=1").notes == ()


@pytest.mark.parametrize(
    ("codes", "hole"), [((0, 1, 3), "1 and 3"), ((1, 2, 3, 4, 6, 7, 8), "4 and 6")]
)
def test_a_missing_file_of_a_sequence_is_named(
    tmp_path: Path, codes: tuple[int, ...], hole: str
) -> None:
    shot = make_shot(tmp_path, n_frames=1)
    for code in codes:
        write_vdb(shot.stage.parent / f"cache/smoke.{code:04d}.vdb")
    write_text(shot.stage, world(volume_prim(density_prim(sequence(codes)))))
    (note,) = plan_of(shot).notes
    assert f"timeCodes {hole}," in note
    (note,) = (item for item in plan_of(shot, f"stage.frames={codes[0]}").notes)
    assert hole not in note


def test_a_choice_among_grids_of_one_name_is_told_until_the_stage_makes_it(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, n_frames=1)
    here, there = (raw_grid(np.ones((4, 4, 4)), ijk=(i, 0, 0)) for i in (0, 50))
    write_raw(shot.stage.parent / "cache/smoke.0001.vdb", here, there)
    (note,) = plan_of(shot).notes
    assert '"density"' in note and "fieldIndex" in note
    prim = density_prim(sequence([1]), extra="int fieldIndex = 0")
    write_text(shot.stage, world(volume_prim(prim)))
    assert plan_of(shot).notes == ()


@pytest.mark.parametrize(("size", "is_told"), [(1e-3, False), (1e6, False), (1e18, True)])
def test_voxels_beyond_single_precision_are_told(
    tmp_path: Path, size: float, is_told: bool
) -> None:
    shot = make_shot(tmp_path, n_frames=1)
    grid = raw_grid(np.ones((4, 4, 4)), matrix=np.diag([size, size, size, 1.0]))
    write_raw(shot.stage.parent / "cache/smoke.0001.vdb", grid)
    assert ["32-bit" in note for note in plan_of(shot).notes] == [True] * is_told


@pytest.mark.parametrize(
    ("shear", "scale", "is_told"), [(0.001, 1, False), (0.5, 1, True), (0, 0.2, True)]
)
def test_a_sheared_or_stretched_camera_is_told(
    tmp_path: Path, shear: float, scale: float, is_told: bool
) -> None:
    shot = make_shot(tmp_path, n_frames=1)
    place = f"((1, 0, 0, 0), ({shear}, 1, 0, 0), (0, 0, {scale}, 0), (1, 1, 50, 1))"
    camera = (
        f'\ndef Camera "cam"\n{{\nmatrix4d xformOp:transform = {place}\n'
        'uniform token[] xformOpOrder = ["xformOp:transform"]\n}\n'
    )
    write_text(shot.stage, world(volume_prim(density_prim(sequence([1]))) + camera))
    notes = plan_of(shot, "views.camera=/World/cam").notes
    assert any("sheared" in note for note in notes) == is_told


@pytest.mark.parametrize(("away", "is_told"), [(1e6, False), (1e9, False), (1e13, True)])
def test_a_place_that_doubles_cannot_hold_is_told(
    tmp_path: Path, away: float, is_told: bool
) -> None:
    """A voxel has an edge of 1; doubles have 53 bits."""
    shot = make_shot(tmp_path, n_frames=1)
    matrix = np.eye(4)
    matrix[3, 0] = away
    grid = raw_grid(np.ones((4, 4, 4)), matrix=matrix)
    write_raw(shot.stage.parent / "cache/smoke.0001.vdb", grid)
    notes = plan_of(shot).notes
    assert ["far from the origin" in note for note in notes] == [True] * is_told


def test_a_velocity_without_a_relationship_is_not_copied_and_the_plan_says_so(
    tmp_path: Path,
) -> None:
    shot = make_shot(tmp_path, n_frames=2, names=("density", "vel"))

    def copies(*settings: str) -> list[str]:
        omitted = plan_of(shot, *settings).omitted
        return [item.reason for item in omitted if item.what == "the copy of vel of </World/smoke>"]

    (reason,) = copies()
    assert "layer.copy_velocity=true" in reason
    assert copies("layer.copy_velocity=true") == copies("layer.copy_velocity=false") == []
    assert copies("layer.copy_fields=[all]") == []


def test_pictures_of_few_pixels_are_remarked_on(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, n_frames=1)
    large = raw_grid(np.ones((222, 6, 6), np.float32))
    write_raw(shot.stage.parent / "cache/smoke.0001.vdb", large)
    assert any("only 16 pixels" in note for note in plan_of(shot, "views.image_size=16").notes)
    assert not any("pixels:" in note for note in plan_of(shot, "views.image_size=64").notes)


@pytest.mark.parametrize(("scale", "is_told"), [(2.0, False), (10.0, True), (0.1, True)])
def test_a_frame_with_voxels_of_another_unit_is_named(
    tmp_path: Path, scale: float, is_told: bool
) -> None:
    shot = make_shot(tmp_path)
    for code, size in ((1, 1.0), (2, scale), (3, 1.0)):
        grid = raw_grid(np.ones((6, 6, 6), np.float32), matrix=np.diag([size, size, size, 1.0]))
        write_raw(shot.stage.parent / f"cache/smoke.{code:04d}.vdb", grid)
    told = [note for note in plan_of(shot).notes if "as large as usual" in note]
    assert len(told) == is_told
    assert all(f"timeCode 2 are {scale:g} times" in note for note in told)


def test_timecodes_at_which_a_volume_is_invisible_are_named(shot: Shot) -> None:
    body = 'token visibility.timeSamples = {1: "inherited", 3: "invisible"}\n'
    write_text(shot.stage, world(volume_prim(body + density_prim(sequence((1, 2, 3))))))
    (note,) = (note for note in plan_of(shot).notes if "invisible" in note)
    assert "timeCode 3 " in note and "--frames" in note


@pytest.mark.usefixtures("core")
def test_at_the_end_the_extinctions_are_told_that_keep_the_look(shot: Shot, core: FakeCore) -> None:
    told = stylize(shot.stage, shot.style, shot.output, "stage.frames=1-2").warnings
    scene = core.measure_scene([], None, None, "Y", 1)
    gamma = scene.gamma_w * scene.reference_voxel_size
    assert any(f"optics.gamma={gamma:g}" in text for text in told)
    whole = stylize(shot.stage, shot.style, shot.folder / "whole").warnings
    assert not any("optics.gamma" in text for text in whole)


@pytest.mark.usefixtures("core")
@pytest.mark.parametrize(
    ("sizes", "setting", "words"),
    [
        ((2, 2, 1.41, 1), "grids.refine=1", ["2 times", "grids.refine=3", "into 27"]),
        ((2, 2, 1.41, 1), "grids.refine=2", ["2 times", "grids.refine=3"]),
        ((2, 2, 2, 2), "grids.refine=1", ["2 times"]),
        ((2, 2, 2, 1), "grids.refine=4", None),
        ((1, 1, 1, 1), "grids.refine=1", None),
        ((2, 2, 1.41, 1), "style.size=2", None),
    ],
)
def test_at_the_end_an_enlarged_style_is_told_with_the_voxels_that_it_needs(
    sizes: tuple[float, ...],
    setting: str,
    words: list[str] | None,
    shot: Shot,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def find(_styles: Any, _voxels: float, config: Config) -> float:
        return sizes[config.grids.parts - 1]

    def refine(_styles: Any, _voxels: float, config: Config, size: float, most: int) -> int:
        finer = range(config.grids.parts + 1, most + 1)
        return next((parts for parts in finer if sizes[parts - 1] < size), 0)

    monkeypatch.setattr(coarse, "find_style_size", find)
    monkeypatch.setattr(coarse, "refine_for_less", refine)
    told = stylize(shot.stage, shot.style, shot.output, setting).warnings
    found = [text for text in told if "times as large" in text]
    assert len(found) == (words is not None)
    for text in found:
        assert all(word in text for word in words or ())
        assert ("grids.refine" in text) == (len(words or ()) > 1)


def fine_style(folder: Path, wavelength: float) -> Path:
    """An image with stripes that are so many voxels wide on smoke of 96 voxels."""
    light = 0.5 + 0.4 * np.sin(2 * np.pi / (4 * wavelength) * np.arange(384))
    pixels = np.rint(255 * np.broadcast_to(light[None, :, None], (384, 384, 3)))
    Image.fromarray(pixels.astype(np.uint8)).save(folder / "stripes.png")
    return folder / "stripes.png"


@pytest.mark.parametrize(
    ("n_voxels", "wavelength", "setting", "words"),
    [
        (96, 2.6, "grids.refine=1", ["style.size", "grids.refine=2", "96 voxels"]),
        (192, 2.6, "grids.refine=1", None),  # marks are twice as wide there
        (96, 9.0, "grids.refine=1", None),
        (96, 2.6, "grids.refine=2", None),
        (96, 2.6, "style.size=1", None),
        (12, 2.6, "grids.refine=1", None),
    ],
)
def test_the_plan_tells_that_a_fine_style_will_be_enlarged(
    tmp_path: Path, n_voxels: int, wavelength: float, setting: str, words: list[str] | None
) -> None:
    shot = make_shot(tmp_path, n_frames=1)
    smoke = raw_grid(np.ones((n_voxels, 6, 6), np.float32))
    write_raw(shot.stage.parent / "cache/smoke.0001.vdb", smoke)
    style = fine_style(tmp_path, wavelength)
    notes = plan_request(Request(shot.stage, style, shot.output, [setting])).notes
    found = [text for text in notes if "style.size" in text]
    assert len(found) == (words is not None)
    assert all(word in text for text in found for word in words or ())


def test_an_overlap_that_no_window_can_have_is_told(shot: Shot) -> None:
    (note,) = plan_of(shot, "windows.size=2", "windows.overlap=3").notes
    assert "windows.overlap=3" in note and "windows.overlap=2" in note and "windows.size" in note
    for words in (["windows.size=2"], ["windows.size=2", "windows.overlap=2"]):
        assert plan_of(shot, *words).notes == ()
    assert plan_of(shot, "windows.size=8", "windows.overlap=9").notes == ()


@pytest.mark.parametrize(("start", "named"), [(0, True), (4, True), (11, False)])
def test_volumes_in_the_same_place_are_named(tmp_path: Path, start: int, named: bool) -> None:
    folder = tmp_path / "shot"
    folder.mkdir()
    write_raw(folder / "large.vdb", raw_grid(np.ones((12, 12, 12), np.float32)))
    small = raw_grid(np.ones((4, 4, 4), np.float32), ijk=(start, start, start))
    write_raw(folder / "small.vdb", small)
    bodies = [
        volume_prim(density_prim(f"asset filePath = @./{name}.vdb@"), name)
        for name in ("large", "small")
    ]
    stage = write_text(folder / "shot.usda", world("".join(bodies)))
    style = make_shot(tmp_path / "other").style
    notes = plan_request(Request(stage, style, tmp_path / "look", [])).notes
    found = ["</World/small>" in note for note in notes if "same place" in note]
    assert found == [True] * named


@pytest.mark.parametrize(
    ("n_cameras", "setting", "told"),
    [(0, "", False), (1, "", True), (2, "", True), (1, "views.azimuth=12", False),
     (1, "views.centre_azimuth=30", False), (1, "views.camera=/World/cam0", False)],
)  # fmt: skip
def test_a_camera_that_no_view_is_taken_from_is_told(
    shot: Shot, n_cameras: int, setting: str, told: bool
) -> None:
    cameras = "".join(
        f'\ndef Camera "cam{number}"\n{{\ndouble3 xformOp:translate = (1, 1, 50)\n'
        'uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
        for number in range(n_cameras)
    )
    write_text(shot.stage, world(volume_prim(density_prim(sequence([1]))) + cameras))
    notes = plan_of(shot, *([setting] if setting else [])).notes
    tips = [note for note in notes if "--camera" in note]
    assert len(tips) == told
    assert all(("/World/cam0" in tip) == (n_cameras == 1) for tip in tips)


def test_what_of_a_style_is_left_out_is_told(shot: Shot) -> None:
    pixels = np.random.default_rng(0).integers(100, 256, (48, 48, 3), np.uint8)
    pixels[:, :12] //= 8
    Image.fromarray(pixels).save(shot.style)
    (note,) = plan_of(shot).notes
    assert Path(shot.style).name in note and "style.areas=all" in note and "%" in note
    assert plan_of(shot, "style.areas=all").notes == ()

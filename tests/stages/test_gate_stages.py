"""Mends, and USD's own validators over every kind of stage that is written."""

from functools import partial
from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdVol

from tests.fixtures.pipeline_fixtures import Shot, make_shot, make_style, run
from tests.fixtures.usd_fixtures import (
    density_prim,
    needs_usd,
    sampled,
    sequence,
    volume_prim,
    world,
    write_sequence,
    write_text,
    write_vdb,
)
from usdsmoke.base.errors import OutputExists, StageError
from usdsmoke.ui.cli.main import main
from usdsmoke.usd.gate import validate_look, write_mends
from usdsmoke.usd.rules import Severity, validate

KINDS = {
    "sublayer": (),
    "usdc": ("layer.format=usdc",),
    "reference": ("layer.mode=reference",),
    "layer": ("layer.mode=layer",),
    "part": ("stage.frames=2", "layer.scatter_colour=[Cd,color]", "layer.split_rgb=true"),
    "all materials": (
        "layer.material_targets=[glslfx,mtlx,arnold,karma,renderman]", "layer.material=replace",
    ),
    "copied": ("layer.copy_fields=[all]", "layer.emission_mode=perDensity"),
    "lit": ("optics.sun=[0,0,1]", "optics.sky=[0.5,0.4,0.3]", "optics.bounces=true"),
    "own paths": ("layer.files={prim}/{look}/{name}.{frame:04d}.vdb", "stage.frames=1-2"),
    "second look": ("layer.mode=reference", "layer.look=ember"),
}  # fmt: skip


def errors_of(stage: Path) -> list[str]:
    return [f"{item.rule} {item.message}" for item in validate(stage) if item.severity == "error"]


@needs_usd(26, 5)
@pytest.mark.usefixtures("core")
@pytest.mark.parametrize("kind", KINDS)
def test_no_validator_finds_an_error_of_a_look(tmp_path: Path, kind: str) -> None:
    """All validators of OpenUSD and of usdsmoke; the source has no error."""
    shot = make_shot(tmp_path / "shot", names=("density", "vel", "heat"))
    assert errors_of(shot.stage) == []
    if kind == "second look":
        run(shot, "layer.mode=reference", "layer.contact_sheet=0")
    result = run(shot, *KINDS[kind], "layer.contact_sheet=0")
    mine = f"#usda 1.0\n(\nsubLayers = [@{result.look_layer}@, @{shot.stage}@]\n"
    mine += 'defaultPrim = "World"\nupAxis = "Z"\nmetersPerUnit = 0.5\n)\n'
    root = result.root_stage or write_text(tmp_path / "mine.usda", mine)
    for stage in (root, result.look_layer):
        assert errors_of(stage) == []
    own, _ = validate_look(root)
    assert [item for item in own if item.severity == Severity.ERROR] == []
    result.frames[-1].unlink()  # which each of them finds
    assert errors_of(root) and errors_of(result.look_layer)
    own, _ = validate_look(root)
    assert [item for item in own if item.severity == Severity.ERROR]


@pytest.mark.usefixtures("core")
def test_a_root_layer_without_its_look_names_what_is_missing(shot: Shot) -> None:
    result = run(shot, "layer.contact_sheet=0")
    for make in (result.look_layer.unlink, partial(result.look_layer.write_text, "#usda 1.0\n }")):
        make()
        with pytest.raises(StageError, match=r"look\.usda"):
            validate_look(result.root_stage)


@needs_usd(26, 5)
def test_no_validator_finds_an_error_in_a_stage_made_of_files(tmp_path: Path) -> None:
    write_sequence(tmp_path, (1, 2, 3))
    target = tmp_path / "made.usda"
    files = str(tmp_path / "cache/smoke.####.vdb")
    assert main(["stage", files, "-o", str(target), "--meters-per-unit", "1"]) == 0
    assert [item for item in validate(target) if item.severity == Severity.ERROR] == []


def faulty(folder: Path) -> Path:
    write_sequence(folder, (1, 2))
    paths = {code: f"@{folder}/cache/smoke.{code:04d}.vdb@" for code in (1, 2)}
    field = density_prim(sampled("asset filePath", paths)).replace('"float"', '"float3"')
    return write_text(folder / "shot.usda", world(volume_prim(field)))


@needs_usd(26, 11)
def test_mends_are_a_layer_above_the_stage(tmp_path: Path) -> None:
    stage_file, target = faulty(tmp_path), tmp_path / "publish/mended.usda"
    target.parent.mkdir()
    before = stage_file.read_bytes()
    rules = {"VolumeExtentMissing", "FieldTypeMismatch", "AbsolutePath"}
    assert rules <= {item.rule for item in validate(stage_file)}
    assert {item.rule for item in write_mends(stage_file, target)} == rules
    assert stage_file.read_bytes() == before
    assert not rules & {item.rule for item in validate(target)}
    stage = Usd.Stage.Open(str(target))
    volume, field = (stage.GetPrimAtPath(f"/World/{name}") for name in ("smoke", "smoke/density"))
    assert [tuple(point) for point in volume.GetAttribute("extent").Get(2)] == [
        (-0.25, -0.25, -0.25), (1.75, 1.25, 0.75),
    ]  # fmt: skip
    asset = field.GetAttribute("filePath").Get(2)
    assert asset.path == "../cache/smoke.0002.vdb" and Path(asset.resolvedPath).is_file()
    assert stage.GetTimeCodesPerSecond() == 25
    with pytest.raises(OutputExists):
        write_mends(stage_file, target)


@needs_usd(26, 11)
@pytest.mark.usefixtures("core")
def test_a_grid_of_another_name_gets_a_relationship_of_its_own_and_is_stylized(
    tmp_path: Path,
) -> None:
    write_vdb(tmp_path / "cache/aero.vdb", ("voxel_fog_density",))
    files, grid = "asset filePath = @./cache/aero.vdb@", 'token fieldName = "voxel_fog_density"'
    text = world(volume_prim(density_prim(files, grid=grid)))
    stage_file, target = write_text(tmp_path / "shot.usda", text), tmp_path / "mended.usda"
    assert "FieldNameMismatch" in {item.rule for item in write_mends(stage_file, target)}
    stage = Usd.Stage.Open(str(target))
    volume = UsdVol.Volume(stage.GetPrimAtPath("/World/smoke"))
    paths = volume.GetFieldPaths()
    assert paths["voxel_fog_density"] == paths["density"] == Sdf.Path("/World/smoke/density")
    assert "FieldNameMismatch" not in {item.rule for item in validate(target)}
    mended = Shot(tmp_path, target, make_style(tmp_path / "style.png"), tmp_path / "out")
    own, _ = validate_look(run(mended).root_stage)
    assert own == []


@needs_usd(26, 11)
@needs_usd(26, 11)
def test_a_mended_extent_holds_what_a_static_field_shows(tmp_path: Path) -> None:
    """And what is held between two files."""
    write_vdb(tmp_path / "still.vdb")
    for code in (100, 200):
        write_vdb(tmp_path / f"cache/smoke.{code:04d}.vdb")
    moving = density_prim(sequence([100, 200]), "temp")
    moving = moving.replace("{", "{\n double3 xformOp:translate.timeSamples = "
        "{100: (50, 0, 0), 200: (90, 0, 0)}\n uniform token[] xformOpOrder = "
        '["xformOp:translate"]', 1)  # fmt: skip
    body = density_prim("asset filePath = @./still.vdb@") + moving
    relations = "\n".join(
        f"rel field:{name} = </World/smoke/{name}>" for name in ("density", "temp")
    )
    stage_file = write_text(tmp_path / "s.usda", world(volume_prim(body, relations=relations)))
    write_mends(stage_file, tmp_path / "mended.usda")
    stage = Usd.Stage.Open(str(tmp_path / "mended.usda"))
    extent = stage.GetAttributeAtPath("/World/smoke.extent")
    for code in (0, 100, 150, 199, 200, 300):
        low, high = extent.Get(code)
        assert low[0] <= 0 and high[0] >= (50 if code < 200 else 90)


def test_where_nothing_can_be_mended_no_layer_is_written(shot: Shot, tmp_path: Path) -> None:
    clean = faulty(tmp_path)
    write_mends(clean, tmp_path / "first.usda")
    assert (
        main(["validate", str(tmp_path / "first.usda"), "--mend", str(tmp_path / "two.usda")]) == 0
    )
    assert not (tmp_path / "two.usda").exists()


@needs_usd(26, 11)
def test_a_stage_with_a_value_that_cannot_be_read_is_refused_and_no_layer_stays(
    tmp_path: Path,
) -> None:
    stage_file, target = faulty(tmp_path), tmp_path / "mended.usda"
    moved = 'token xformOp:translate = "far"\nuniform token[] xformOpOrder = ["xformOp:translate"]'
    text = stage_file.read_text()
    place = text.index("{", text.index("def Volume")) + 1
    stage_file.write_text(text[:place] + moved + text[place:])
    with pytest.raises(StageError, match="be read"):
        write_mends(stage_file, target)
    assert not target.exists()

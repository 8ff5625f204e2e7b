"""Where frames go: paths of the studio's own (``layer.files``)."""

import re
from pathlib import Path

import pytest

from tests.fixtures.farm_fixtures import WINDOWS
from tests.fixtures.pipeline_fixtures import (
    FakeCore,
    Shot,
    contents,
    copied,
    make_shot,
    run,
    shown_files,
)
from tests.fixtures.usd_fixtures import density_prim, sequence, volume_prim, world
from usdsmoke.audit.record import find_records
from usdsmoke.audit.repetition import rerun
from usdsmoke.audit.verification import verify
from usdsmoke.base.errors import ConfigError, LayerError, UsdSmokeError
from usdsmoke.base.naming import frame_places
from usdsmoke.pipeline import Request, assemble, run_window
from usdsmoke.usd.rules import validate

pytestmark = pytest.mark.usefixtures("core")

TEMPLATE = "layer.files={prim}/{look}/{name}.{frame:04d}.vdb"
EMBER = ("layer.look=ember", "optimize.seed=1")


def files_below(folder: Path) -> list[str]:
    """All VDB files outside the folders of runs."""
    found = (path.relative_to(folder).as_posix() for path in folder.rglob("*.vdb"))
    return sorted(name for name in found if not name.startswith("vdb/"))


def broken(stage: Path) -> list[str]:
    return [finding.rule for finding in validate(stage) if finding.severity == "error"]


def test_frames_go_where_the_template_says_and_layers_name_them(shot: Shot) -> None:
    plain = contents(run(copied(shot, "plain")).root_stage)
    result = run(shot, TEMPLATE, "layer.name=plume")
    names = [f"smoke/stylized/plume.{code:04d}.vdb" for code in (1, 2, 3)]
    assert files_below(shot.output) == names
    assert [path.relative_to(shot.output).as_posix() for path in result.frames] == names
    assert list(shown_files(result.root_stage).values()) == [str(path) for path in result.frames]
    assert contents(result.root_stage) == plain
    assert "@./smoke/stylized/plume.0001.vdb@" in result.look_layer.read_text()
    assert broken(result.root_stage) == []


def test_looks_and_volumes_have_folders_of_their_own_and_the_rest_shows_the_source(
    tmp_path: Path,
) -> None:
    shot = make_shot(tmp_path / "shot")
    prims = density_prim(sequence(range(1, 4)))
    shot.stage.write_text(world(volume_prim(prims) + volume_prim(prims, "fog")))
    run(shot, TEMPLATE, "stage.frames=2")
    run(shot, TEMPLATE, *EMBER, "stage.frames=2")
    # beside each frame the file without a voxel, which the emission of other frames shows
    assert files_below(shot.output) == [
        f"{prim}/{look}/{prim}.{code:04d}.vdb"
        for prim in ("fog", "smoke")
        for look in ("ember", "stylized")
        for code in (1, 2)
    ]
    assert broken(shot.output / "shot_look.usda") == []
    assert broken(shot.output / "shot_look_ember.usda") == []


@pytest.mark.parametrize("template", [(), (TEMPLATE,)])
def test_no_file_without_a_voxel_passes_for_a_frame_of_the_source(
    shot: Shot, template: tuple[str, ...]
) -> None:
    """But for the first timeCode, which Blender counts from."""
    result = run(shot, *template, "stage.frames=1-2", "layer.contact_sheet=0")
    (folder,) = {path.parent for path in result.frames}
    names = ["smoke.0001.vdb", "smoke.0002.vdb", "smoke.empty.vdb"]
    assert sorted(path.name for path in folder.glob("*.vdb")) == names
    assert shown_files(result.root_stage, "emission")[3.0] == str(folder / names[2])
    assert broken(result.root_stage) == [] and verify(result.look_layer) == []
    grown = run(shot, *template, "layer.contact_sheet=0")  # all of them: none is needed
    (folder,) = {path.parent for path in grown.frames}
    assert [path.name for path in folder.glob("*empty*")] == []


def test_a_record_is_found_verified_and_run_again_from_such_a_file(shot: Shot) -> None:
    result = run(shot, TEMPLATE)
    (found,) = find_records(result.frames[0])
    assert found.file == result.look_layer
    assert found.record.frames[0].file == "./smoke/stylized/smoke.0001.vdb"
    assert verify(shot.output) == []
    again = rerun(result.frames[1], shot.folder / "again")
    assert again.differences == ()
    assert files_below(shot.folder / "again") == files_below(shot.output)
    result.look_layer.unlink()
    assert find_records(result.frames[0])[0].record.run == found.record.run


def test_a_replaced_result_takes_its_paths_and_leaves_nothing_behind(shot: Shot) -> None:
    before = contents(run(shot, TEMPLATE).root_stage)
    after = run(shot, TEMPLATE, "optimize.seed=1", force=True)
    assert contents(after.root_stage) != before
    assert files_below(shot.output) == [f"smoke/stylized/smoke.000{n}.vdb" for n in (1, 2, 3)]
    run(shot, "layer.files=v2/{name}.{frame}.vdb", "optimize.seed=1", force=True)
    assert files_below(shot.output) == [f"v2/smoke.{n}.vdb" for n in (1, 2, 3)]
    assert not (shot.output / "smoke").exists()


def test_a_look_grows_and_frames_are_done_again_under_their_paths(shot: Shot) -> None:
    run(shot, TEMPLATE, "stage.frames=1-2")
    result = run(shot, TEMPLATE, "stage.frames=1-3")
    before = contents(result.root_stage)
    (shot.output / "smoke/stylized/smoke.0002.vdb").write_bytes(b"damaged")
    run(shot, TEMPLATE, "stage.frames=2")
    assert contents(result.root_stage) == before
    (shot.output / "smoke/stylized/smoke.0003.vdb").unlink()
    assemble(shot.output)
    assert contents(result.root_stage) == before


def test_windows_on_a_farm_are_delivered_by_the_assembly(farm: Shot) -> None:
    settings = [*WINDOWS, TEMPLATE]
    for window in (2, 0, 1):
        run_window(Request(farm.stage, farm.style, farm.output, settings), window)
        assert files_below(farm.output) == []
    contents(assemble(farm.output).root_stage)
    assert len(files_below(farm.output)) == 8


@pytest.mark.parametrize(
    ("template", "found"),
    [
        ("{shot}/{name}.{frame:04d}.vdb", r"\{shot\}.*\{prim\}, \{look\}, \{name\}, \{frame\}"),
        ("{name}.vdb", r"no \{frame\}"),
        ("{name}.{frame:04d}.usd", r"no suffix \.vdb"),
        ("{name}.{frame:4}.vdb", r"format '4' of \{frame\}"),
        ("{name:>9}.{frame}.vdb", r"format '>9' of \{name\}"),
        ("../{name}.{frame}.vdb", r"part '\.\.'"),
        ("/tmp/{name}.{frame}.vdb", "absolute path"),
        ("C:\\{name}.{frame}.vdb", "':"),
        ("{name}.{frame.vdb", "'{'"),
        ("VDB/{name}.{frame}.vdb", "holds the runs"),
        ("{name}.{frame:4d}.vdb", r"format '4d' of \{frame\}"),  # Python pads it with spaces
    ],
)
def test_a_template_that_is_no_path_of_frames_is_refused(
    shot: Shot, core: FakeCore, template: str, found: str
) -> None:
    with pytest.raises(ConfigError, match=r"layer\.files is .*" + found):
        run(shot, f"layer.files={template}")
    assert not shot.output.exists()


def test_two_volumes_in_one_file_are_refused_by_name(tmp_path: Path) -> None:
    shot = make_shot(tmp_path / "shot")
    prims = density_prim(sequence(range(1, 4)))
    shot.stage.write_text(world(volume_prim(prims) + volume_prim(prims, "fog")))
    with pytest.raises(ConfigError, match=r"</World/smoke> and </World/fog>"):
        run(shot, "layer.files={look}.{frame:04d}.vdb")


def test_files_of_other_looks_programs_and_of_the_source_are_not_overwritten(shot: Shot) -> None:
    plain = "layer.files={name}.{frame:04d}.vdb"
    run(shot, plain)
    before = contents(shot.output / "shot_look.usda")
    with pytest.raises(LayerError, match=r"stylized.*\{look\}"):
        run(shot, plain, *EMBER)
    assert contents(shot.output / "shot_look.usda") == before
    foreign = shot.output / "smoke/ember/smoke.0002.vdb"
    foreign.parent.mkdir(parents=True)
    foreign.write_text("mine")
    with pytest.raises(LayerError, match=re.escape(str(foreign))):
        run(shot, TEMPLATE, *EMBER, force=True)
    assert foreign.read_text() == "mine"
    with pytest.raises(UsdSmokeError, match="an input"):
        run(
            Shot(shot.folder, shot.stage, shot.style, shot.stage.parent),
            "layer.files=cache/{name}.{frame:04d}.vdb",
        )


def test_numbers_are_wide_enough_for_every_frame_and_keep_fractions() -> None:
    names = {"name": "fog"}
    assert list(frame_places("{name}.{frame:02d}.vdb", names, [-2, 7, 101]).values()) == [
        "fog.-002.vdb", "fog.007.vdb", "fog.101.vdb",
    ]  # fmt: skip
    assert list(frame_places("{frame}/{name}.{frame}.vdb", names, [1, 1.5]).values()) == [
        "1.0/fog.1.0.vdb", "1.5/fog.1.5.vdb",
    ]  # fmt: skip


def test_a_picture_in_the_place_of_a_sheet_stays_unless_a_run_has_put_it_there(shot: Shot) -> None:
    sheet = shot.output / "contact_sheet.png"
    sheet.parent.mkdir(parents=True)
    sheet.write_text("mine")
    with pytest.raises(LayerError):
        run(shot, "layer.contact_sheet=64", force=True)
    run(shot, "layer.contact_sheet=0")
    with pytest.raises(LayerError):
        run(shot, "layer.contact_sheet=64", force=True)
    assert sheet.read_text() == "mine"
    sheet.unlink()
    run(shot, "layer.contact_sheet=64", force=True)
    run(shot, "layer.contact_sheet=64", force=True)
    assert sheet.read_bytes().startswith(b"\x89PNG")

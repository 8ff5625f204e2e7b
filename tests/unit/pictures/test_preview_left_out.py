"""Previews of stages of which a part cannot be read: the rest is drawn, the part is named."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.fixtures.usd_fixtures import (
    density_prim,
    plume_stage,
    sequence,
    volume_prim,
    world,
    write_sequence,
    write_text,
)
from usdsmoke.base.errors import AssetNotResolved, DamagedFile, FieldNotFound, StageError
from usdsmoke.pictures.preview import preview

pytestmark = pytest.mark.usefixtures("quick_grids")

ONE, TWO, BAD = "/World/fx/one", "/World/fx/two", "/World/fx/bad"


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    """Two Volumes of three frames, of which the second lacks the file of frame 2; and a bad one."""
    write_sequence(tmp_path, (1, 2, 3))
    write_sequence(tmp_path / "b", (1, 3))
    body = volume_prim(density_prim(sequence((1, 2, 3))), "one")
    body += volume_prim(density_prim(sequence((1, 2, 3), "./b/cache/smoke.{:04d}.vdb")), "two")
    body += volume_prim("", "bad", "")
    group = f'def Xform "fx" {{ {body.replace("/World/", "/World/fx/")} }}'
    return write_text(tmp_path / "shot.usda", world(group))


@pytest.mark.parametrize("allow_missing", [False, True])
@pytest.mark.parametrize("prims", [(), ("/World/fx",), (ONE, TWO)], ids=len)
def test_a_volume_without_one_file_and_one_without_density_hide_no_others(
    pair: Path, prims: Sequence[str], allow_missing: bool
) -> None:
    target = pair.with_name("a.png")
    if prims == (ONE, TWO) and not allow_missing:  # what is named must be there
        with pytest.raises(AssetNotResolved, match=r"0002.*--allow-missing"):
            preview(pair, target, prims=prims, width=16)
        return
    drawn = preview(pair, target, prims=prims, allow_missing=allow_missing, width=16)
    assert drawn.time_codes == (1, 2, 3) and set(drawn.extinctions) == {ONE, TWO}
    (note,) = [note for note in drawn.notes if f"<{TWO}" in note]
    assert "timeCode 2" in note
    assert any(f"<{BAD}>" in note for note in drawn.notes) == (BAD not in prims and len(prims) < 2)


def test_frames_that_are_named_have_their_files_unless_they_may_be_missing(pair: Path) -> None:
    target = pair.with_name("a.png")
    with pytest.raises(AssetNotResolved, match="0002"):
        preview(pair, target, prims=[ONE, TWO], frames="1-2", width=16)
    preview(pair, target, prims=[ONE, TWO], frames="1-2", allow_missing=True, width=16)
    with pytest.raises(FieldNotFound, match=BAD):
        preview(pair, target, prims=[ONE, BAD, "/World/fx"], width=16)


@pytest.mark.parametrize("frames", ["2", "1-2"])
@pytest.mark.parametrize("allow_missing", [False, True])
def test_a_missing_file_at_a_named_frame_hides_no_other_volume(
    pair: Path, frames: str, allow_missing: bool
) -> None:
    target = pair.with_name("a.png")
    for prims in ((), ("/World/fx",)):
        drawn = preview(
            pair, target, prims=prims, frames=frames, allow_missing=allow_missing, width=16
        )
        assert drawn.time_codes[-1] == 2 and ONE in drawn.extinctions
        for path in (TWO, BAD):
            assert len([note for note in drawn.notes if f"<{path}>" in note]) == 1
    with pytest.raises(AssetNotResolved, match="0002"):
        preview(pair, target, prims=[TWO], frames="1-2", width=16)
    with pytest.raises(StageError, match="timeCode 9"):
        preview(pair, target, frames="1-9", width=16)


def test_a_named_frame_without_any_file_is_refused(pair: Path) -> None:
    (pair.parent / "cache/smoke.0002.vdb").unlink()
    target = pair.with_name("a.png")
    for frames in ("2", "1-2"):
        with pytest.raises(StageError, match="0002"):
            preview(pair, target, frames=frames, width=16)
    assert preview(pair, target, frames="1-2", allow_missing=True, width=16).time_codes == (1,)


def test_a_still_volume_is_drawn_at_a_frame_at_which_the_others_have_no_file(
    tmp_path: Path,
) -> None:
    write_sequence(tmp_path, (1, 3))
    still = volume_prim(density_prim("asset filePath = @./cache/smoke.0001.vdb@"), "still")
    moving = volume_prim(density_prim(sequence((1, 2, 3))), "moving")
    stage = write_text(tmp_path / "shot.usda", world(still + moving))
    drawn = preview(stage, tmp_path / "a.png", frames="2", width=16)
    assert drawn.time_codes == (2,) and set(drawn.extinctions) == {"/World/still"}
    assert len([note for note in drawn.notes if "/World/moving" in note]) == 1


def test_a_damaged_volume_hides_no_others_in_named_frames(pair: Path) -> None:
    source = pair.parent / "cache/smoke.0001.vdb"
    (pair.parent / "cache/bad.vdb").write_bytes(b"")
    stage = pair.with_name("three.usda")
    bad = volume_prim(density_prim("asset filePath = @./cache/bad.vdb@"), "bad")
    stage.write_text(world(volume_prim(density_prim(f"asset filePath = @{source}@")) + bad))
    drawn = preview(stage, pair.with_name("a.png"), frames="1", width=16)
    assert any("/World/bad" in note and "0 bytes" in note for note in drawn.notes)
    with pytest.raises(DamagedFile):
        preview(stage, pair.with_name("a.png"), prims=["/World/bad"], frames="1", width=16)


def test_a_damaged_file_leaves_out_its_frame(tmp_path: Path) -> None:
    stage = plume_stage(tmp_path, (1, 2, 3))
    damaged = tmp_path / "cache/smoke.0002.vdb"
    damaged.write_bytes(damaged.read_bytes()[:300])
    drawn = preview(stage, tmp_path / "a.png", width=16)
    assert drawn.time_codes == (1, 3)
    (note,) = drawn.notes
    assert "</World/smoke> at timeCode 2" in note and "smoke.0002.vdb" in note
    for code in (1, 3):
        (tmp_path / f"cache/smoke.{code:04d}.vdb").write_bytes(b"none")
    with pytest.raises(DamagedFile):
        preview(stage, tmp_path / "a.png", width=16)


def test_pictures_that_would_be_blank_because_of_damage_are_refused(tmp_path: Path) -> None:
    """The header is intact: that the voxels are not is found when they are read."""
    stage = plume_stage(tmp_path, (1,))
    file = tmp_path / "cache/smoke.0001.vdb"
    data = file.read_bytes()
    half = len(data) // 2
    file.write_bytes(data[:half] + 24 * b"\xff" + data[half + 24 :])
    for name, turn in (("a.png", None), ("a.webp", 4), ("a.exr", None)):
        with pytest.raises(DamagedFile):
            preview(stage, tmp_path / name, width=16, turntable=turn)
        assert not (tmp_path / name).exists()


def test_volumes_inside_instances_are_drawn(tmp_path: Path) -> None:
    write_sequence(tmp_path, (1,))
    asset = world(volume_prim(density_prim(sequence((1,)))))
    write_text(tmp_path / "asset.usda", asset)
    place = "prepend references = @./asset.usda@</World>\n instanceable = {}"
    drawn = {}
    for is_instance in ("true", "false"):
        arcs = place.format(is_instance)
        stage = f'#usda 1.0\ndef Xform "A" ({arcs})\n{{\n}}\ndef Xform "B" ({arcs})\n{{\n}}\n'
        target = tmp_path / f"{is_instance}.png"
        found = preview(write_text(tmp_path / f"{is_instance}.usda", stage), target, width=16)
        drawn[is_instance] = (set(found.extinctions), target.read_bytes())
    assert drawn["true"] == drawn["false"]
    assert drawn["true"][0] == {"/A/smoke", "/B/smoke"}

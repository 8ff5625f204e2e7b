"""Looks that are older than their source, and flattened stages."""

import dataclasses
import os
from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdUtils

from tests.fixtures.pipeline_fixtures import Shot, contents, make_shot, make_style, run
from tests.fixtures.usd_fixtures import (
    density_prim,
    needs_usd,
    sequence,
    volume_prim,
    world,
    write_text,
    write_vdb,
)
from usdsmoke import provenance, verify
from usdsmoke.pipeline import plan
from usdsmoke.ui.cli.main import main
from usdsmoke.usd.gate import short_looks, validate_look
from usdsmoke.usd.rules import Severity, validate

pytestmark = pytest.mark.usefixtures("core")


def takes(folder: Path, selected: str) -> Shot:
    """A Volume below a prim whose variant set ``sim`` has take A and take B."""
    variants = ""
    for take, value in (("takeA", 0.5), ("takeB", 0.75)):
        for code in (1, 2):
            file_path = folder / f"in/{take}/smoke.{code:04d}.vdb"
            if not file_path.exists():
                write_vdb(file_path, value=value)
        variants += f"""
        "{take}" {{
            over "smoke" {{
                over "density" {{
                    {sequence((1, 2)).replace("./cache", f"./{take}")}
                }}
            }}
        }}"""
    stage = write_text(
        folder / "in/shot.usda",
        f"""#usda 1.0
        (defaultPrim = "World")
        def Xform "World" (
            prepend variantSets = "sim"
            variants = {{ string sim = "{selected}" }}
        )
        {{
            def Volume "smoke"
            {{
                rel field:density = </World/smoke/density>
                def OpenVDBAsset "density"
                {{
                    token fieldName = "density"
                }}
            }}
            variantSet "sim" = {{
                {variants}
            }}
        }}""",
    )
    return Shot(folder, stage, make_style(folder / "in/style.png"), folder / "out")


def stale(stage: Path) -> list[str]:
    return [item.message for item in validate(stage) if item.rule == "LookStale"]


def test_a_switched_variant_is_named_by_validate_and_verify(tmp_path: Path) -> None:
    result = run(takes(tmp_path, "takeB"))
    assert stale(result.root_stage) == []
    own, _ = validate_look(result.root_stage)
    assert "LookStale" not in {finding.rule for finding in own}
    takes(tmp_path, "takeA")
    (message,) = stale(result.root_stage)
    assert message.startswith("the variant </World>{sim} was takeB when the look was made, and is ")
    own, _ = validate_look(result.root_stage)
    words = [finding.message for finding in own if finding.rule == "LookStale"]
    assert any("takeA/smoke.0001.vdb" in text and "takeB/smoke.0001.vdb" in text for text in words)
    kinds = {change.kind: change for change in verify(result.look_layer)}
    assert kinds["stage-variant"].expected == "the variant </World>{sim} takeB"
    assert kinds["stage-variant"].found == "takeA"
    assert "timeCodes 1,2" in kinds["stage-files"].found
    for options in ([], ["--look-only"]):
        assert main(["validate", *options, str(result.root_stage)]) == 1


def test_a_republished_cache_is_named_with_its_date(tmp_path: Path) -> None:
    result = run(takes(tmp_path, "takeB"))
    cache = tmp_path / "in/takeB/smoke.0002.vdb"
    later = 2_000_000_000
    os.utime(cache, (later, later))
    assert stale(result.root_stage) == []  # copied again, the same bytes
    write_vdb(cache, value=0.25)
    os.utime(cache, (later + 60, later + 60))
    (message,) = stale(result.root_stage)
    assert message.startswith("takeB/smoke.0002.vdb has other content, written 2033-05-1")
    (change,) = [item for item in verify(result.look_layer) if item.kind == "input-edited"]
    assert "written 2033-05-1" in change.found


@pytest.mark.parametrize("unit", ["second", "frame"])
def test_a_source_written_again_with_the_same_grids_is_a_note(tmp_path: Path, unit: str) -> None:
    shot = make_shot(tmp_path, names=("density", "vel"))
    result = run(shot, "stage.motion=velocity", f"stage.velocity_unit={unit}")
    cache = shot.stage.parent / "cache/smoke.0001.vdb"
    for value, severity in ((0.625, Severity.INFO), (0.5, Severity.ERROR)):
        before = cache.read_bytes()
        write_vdb(cache, ("density", "vel"), value=value)
        assert cache.read_bytes() != before
        os.utime(cache, (2_000_000_000, 2_000_000_000 + value))
        found = [item for item in validate(result.root_stage) if item.rule == "LookStale"]
        assert [item.severity for item in found] == [severity]
    assert "has other content" in found[0].message


def test_a_cache_published_again_with_the_same_grids_is_the_same_to_every_command(
    tmp_path: Path,
) -> None:
    """Programs give each file that they write another name of its own (a UUID)."""
    shot = make_shot(tmp_path, names=("density", "vel"))
    settings = ("layer.copy_velocity=true", "windows.size=2")
    result = run(shot, *settings)
    files = sorted((shot.stage.parent / "cache").glob("*.vdb"))
    for code, cache in enumerate(files, start=1):
        before = cache.read_bytes()
        write_vdb(cache, ("density", "vel"), value=0.5 + code / 8)
        os.utime(cache, (2_000_000_000, 2_000_000_000))
        assert cache.read_bytes() != before
    found = [item for item in validate(result.root_stage) if item.rule == "LookStale"]
    assert {item.severity for item in found} == {Severity.INFO}
    assert {change.severity for change in verify(result.look_layer)} == {"note"}
    notes = " ".join(plan(shot.stage, shot.style, shot.output, settings).notes)
    assert "already holds this result" in notes and "other content" not in notes
    again = run(shot, *settings, "stage.frames=3")  # a window of it once more
    assert contents(again.root_stage) == contents(result.root_stage)
    write_vdb(files[2], ("density", "vel"), value=0.5)
    assert "smoke.0003.vdb has other content" in " ".join(
        plan(shot.stage, shot.style, shot.output, settings).notes
    )


@pytest.mark.parametrize("rate", [24, 25])
def test_a_look_at_other_times_of_another_shot_is_not_stale(tmp_path: Path, rate: int) -> None:
    result = run(make_shot(tmp_path, n_frames=3))
    text = "#usda 1.0\n(\nsubLayers = [@out/shot_look.usda@ (offset = 100)]\n"
    shot = write_text(tmp_path / "shot.usda", f"{text}timeCodesPerSecond = {rate}\n)\n")
    own, _ = validate_look(shot)
    assert "LookStale" not in {finding.rule for finding in own}
    source = tmp_path / "in/shot.usda"
    source.write_text(source.read_text().replace("smoke.0002.vdb", "smoke.0003.vdb"))
    own, _ = validate_look(shot)
    assert any("smoke.0003.vdb" in item.message for item in own if item.rule == "LookStale")
    assert result.root_stage is not None


def test_a_look_in_another_place_of_another_shot_is_compared_with_its_own_prims(
    tmp_path: Path,
) -> None:
    result = run(takes(tmp_path, "takeB"))
    assert result.root_stage is not None
    shot = write_text(
        tmp_path / "seq/shot.usda",
        """#usda 1.0
        def "set"
        {
            def "fx" (
                references = @../out/shot_look.usda@
            ) {}
        }""",
    )
    assert stale(shot) == []
    variants = 'usda@\nvariants = { string sim = "takeA" }'
    switched = shot.read_text().replace("usda@", variants)
    (message,) = stale(write_text(tmp_path / "seq/other.usda", switched))
    assert "{sim} was takeB" in message


def test_a_flattened_stage_leads_to_the_record(tmp_path: Path) -> None:
    result = run(takes(tmp_path, "takeB"))
    flat = tmp_path / "out/flat.usda"
    Usd.Stage.Open(str(result.root_stage)).Export(str(flat))
    (found,) = provenance(flat)
    (own,) = provenance(result.look_layer)
    assert found.record == own.record


def test_a_flattened_stage_without_its_files_tells_what_it_holds(tmp_path: Path) -> None:
    result = run(takes(tmp_path, "takeB"))
    flat = tmp_path / "elsewhere/flat.usdc"
    flat.parent.mkdir()
    Usd.Stage.Open(str(result.root_stage)).Export(str(flat))
    (own,) = provenance(result.look_layer)
    for file_path in result.frames:
        file_path.unlink()
    (found,) = provenance(flat)
    record = found.record
    assert (record.run, record.version, record.created) == (
        own.record.run, own.record.version, own.record.created,
    )  # fmt: skip
    assert [style.name for style in record.styles] == ["style.png"]


def test_a_package_fails_and_is_said_to_be_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = run(takes(tmp_path, "takeB"))
    package = tmp_path / "p.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(result.root_stage), str(package))
    texts = {finding.rule: finding.message for finding in validate(package)}
    assert "p.usdz" in texts["ResultChanged"]
    assert "Unpack it" in texts["FieldFileMissing"]
    for only in ((), ("--look-only",)):  # a package that shows nothing does not pass the gate
        assert main(["validate", str(package), *only]) == 1
        first = capsys.readouterr().out.splitlines()[0]
        assert "ResultChanged" in first and "inside the package p.usdz" in first
    own, of_source = validate_look(package)
    assert "FieldFileMissing" in {finding.rule for finding in of_source}  # in the source too
    assert {"ResultChanged"} <= {finding.rule for finding in own}
    assert main(["inspect", str(package)]) == 1
    assert "package" in capsys.readouterr().err
    assert main(["verify", str(package)]) == 1
    referencing = write_text(tmp_path / "r.usda", "#usda 1.0\n(subLayers = [@./p.usdz@])\n")
    assert main(["verify", str(referencing)]) == 1
    assert "ResultChanged" in {finding.rule for finding in validate_look(referencing)[0]}
    out, err = capsys.readouterr()
    assert "p.usdz is a package" in err and "result-missing" in out
    (found,) = provenance(package)
    assert found.record.run == provenance(result.look_layer)[0].record.run


@needs_usd(26, 5)
def test_frames_that_the_source_gets_later_make_a_look_stale(tmp_path: Path) -> None:
    shot = make_shot(tmp_path, n_frames=3)
    whole = shot.stage.read_text()
    shot.stage.write_text(world(volume_prim(density_prim(sequence((1, 2))))))
    result = run(shot, "layer.contact_sheet=0")
    assert not [item for item in validate_look(result.root_stage)[0] if item.rule == "LookStale"]
    shot.stage.write_text(whole)
    Sdf.Layer.FindOrOpen(str(shot.stage)).Reload(True)
    (found,) = [item for item in validate_look(result.root_stage)[0] if item.rule == "LookStale"]
    assert found.severity == "error" and "timeCode 3" in found.message
    assert [item for item in short_looks(result.root_stage) if item.rule == "LookStale"] == [found]


@needs_usd(26, 5)
def test_an_edited_look_layer_is_a_warning_of_the_gate(tmp_path: Path) -> None:
    result = run(make_shot(tmp_path, n_frames=1), "layer.contact_sheet=0")
    layer = Sdf.Layer.FindOrOpen(str(result.look_layer))
    attribute = layer.GetAttributeAtPath("/World/smoke.usdSmoke:extinctionPerDensity")
    attribute.default = 10 * attribute.default
    layer.Save()
    own, _ = validate_look(result.root_stage)
    (found,) = [item for item in own if item.rule == "ResultChanged"]
    assert found.severity == "warn" and "edited" in found.message


def test_versions_of_a_look_stand_beside_one_another_by_folder_and_by_name(tmp_path: Path) -> None:
    shot = takes(tmp_path, "takeB")
    layers = []
    for folder, look in (("look_v001", "v001"), ("look_v002", "v001"), ("look_v002", "v002")):
        own = dataclasses.replace(shot, output=tmp_path / folder)
        seed = f"optimize.seed={len(layers)}"
        layers.append(run(own, f"layer.look={look}", seed).look_layer)
    assert [path.relative_to(tmp_path).as_posix() for path in layers] == [
        "look_v001/look_v001.usda", "look_v002/look_v001.usda", "look_v002/look_v002.usda",
    ]  # fmt: skip
    assert [verify(path) for path in layers] == [[], [], []]
    # the next version starts from the source, whichever version the shot shows
    shown = dataclasses.replace(
        shot, stage=tmp_path / "look_v002/shot_look_v002.usda", output=tmp_path / "look_v003"
    )
    result = run(shown, "layer.look=v003", "optimize.seed=2")
    assert contents(result.root_stage) == contents(tmp_path / "look_v002/shot_look_v002.usda")

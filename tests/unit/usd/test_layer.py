"""What the look says about a Volume and its run, and what it refuses to write."""

import dataclasses
import os

import pytest
from pxr import Sdf, Usd, UsdMedia

from tests.fixtures.usd_fixtures import (
    HEADER,
    finish_frame,
    make_look,
    needs_usd,
    plume_stage,
    volume_prim,
    world,
    write_sequence,
    write_text,
)
from usdsmoke.base.errors import LayerError, WriteFailed
from usdsmoke.base.naming import relative_asset_path
from usdsmoke.base.record_format import RECORD_FORMAT, RunRecord
from usdsmoke.base.volume import WrittenFrame
from usdsmoke.config.run_sections import LayerConfig, StageConfig
from usdsmoke.usd.layer_record import read_record
from usdsmoke.usd.look import StylizedVolume, author_look, look_files
from usdsmoke.usd.stage import find_volumes, open_stage
from usdsmoke.usd.values import anchored_asset

RECORD = RunRecord(RECORD_FORMAT, "3f2b8c1e-0a4d-4c57-9d0e-5b7a1f6c2d34", "1")


def read(stage_file, **settings):
    stage = open_stage(stage_file)
    return stage, find_volumes(stage, StageConfig(**settings))


def author(stage, source, volumes, folder, **config):
    return author_look(stage, source, volumes, folder, LayerConfig(**config), RECORD)


def test_the_volume_carries_the_look_schema_with_every_value_authored(tmp_path):
    stage = open_stage(make_look(plume_stage(tmp_path), tmp_path / "out").root_stage)
    prim = stage.GetPrimAtPath("/World/smoke")
    assert prim.HasAPI("UsdSmokeLookAPI")
    values = {
        "extinctionPerDensity": 0.5,
        "stageUnitsPerUnit": 1.0,
        "emissionMode": "absolute",
        "colorSpace": "lin_rec709",
        "run": "3f2b8c1e-0a4d-4c57-9d0e-5b7a1f6c2d34",
        "style": ["x.png ff"],
        "seed": 7,
    }
    for name, value in values.items():
        attribute = prim.GetAttribute(f"usdSmoke:{name}")
        assert attribute.HasAuthoredValue()
        found = attribute.Get()
        assert (list(found) if isinstance(value, list) else found) == value
    ours = {name for name in prim.GetPropertyNames() if name.startswith("usdSmoke:")}
    of_lights = {"albedo", "anisotropy", "bounces", "lights", "exposure", "scatterField"}
    assert ours == {f"usdSmoke:{name}" for name in (*values, *of_lights)}
    assert not any(prim.GetAttribute(f"usdSmoke:{name}").HasAuthoredValue() for name in of_lights)


def test_the_extinction_has_time_samples_where_it_changes_and_only_there(tmp_path):
    stage, source = read(plume_stage(tmp_path), frames="1-3")
    frames = [
        finish_frame(tmp_path / f"out/smoke.{n:04d}.vdb", float(n), False, ["density"])
        for n in (1, 2, 3)
    ]
    grids = {"density": "density"}
    plain = StylizedVolume(source.volumes[0], frames, 0.5, grids)
    found = {}
    for name, changing in (("still", {}), ("moving", {1.0: 0.5, 2.0: 0.25, 3.0: 2.0})):
        result = dataclasses.replace(plain, extinction_samples=changing)
        folder = tmp_path / "out" / name
        folder.mkdir()
        root = author(stage, source, [result], folder).root_stage
        look = open_stage(root)
        prim = look.GetPrimAtPath("/World/smoke")
        attribute = prim.GetAttribute("usdSmoke:extinctionPerDensity")
        values = [attribute.Get(code) for code in (1.0, 2.0, 3.0)]
        found[name] = (attribute.Get(), attribute.GetTimeSamples(), values)
    assert found["still"] == (0.5, [], [0.5, 0.5, 0.5])
    assert found["moving"] == (0.5, [1.0, 2.0, 3.0], [0.5, 0.25, 2.0])


@needs_usd(26, 11)
def test_the_authorship_record_is_usds_own(tmp_path):
    stage = open_stage(make_look(plume_stage(tmp_path), tmp_path / "out").root_stage)
    (record,) = UsdMedia.AuthorshipAPI.GetAllOnStage(stage)
    assert record.GetName() == "usdsmoke_3f2b8c1e"
    assert record.GetPrim().GetPath() == "/World/smoke"
    assert record.GetSoftwarePackageAttr().Get() == "org.usdsmoke.usdsmoke"
    assert record.GetSoftwareVersionAttr().Get() == "1.2.3"
    assert record.GetDigitalSourceTypeAttr().Get() == (
        "http://cv.iptc.org/newscodes/digitalsourcetype/algorithmicallyEnhanced"
    )
    assert record.GetInstanceIDAttr().Get() == "3f2b8c1e-0a4d-4c57-9d0e-5b7a1f6c2d34"
    inputs = list(record.GetInputsAttr().Get())
    pairs = dict(zip(inputs[::2], inputs[1::2], strict=True))
    assert pairs["seed"] == "7"
    assert pairs["style"] == "x.png ff"
    for name in UsdMedia.AuthorshipAPI.GetSchemaAttributeNames(False, "usdsmoke_3f2b8c1e"):
        attribute = record.GetPrim().GetAttribute(name)
        if attribute.HasAuthoredValue():
            assert attribute.GetVariability() == Sdf.VariabilityUniform


def test_the_layer_holds_the_record_and_the_hash_of_every_file(tmp_path):
    files = make_look(plume_stage(tmp_path), tmp_path / "out", frames="2,3", ours=True)
    layer = Sdf.Layer.FindOrOpen(str(files.look_layer))
    assert layer.customLayerData["creator"] == "usdsmoke 1.2.3"
    values = layer.customLayerData["usdsmoke"]
    assert all(isinstance(value, str) for value in values.values())
    assert (values["tool"], values["version"]) == ("usdsmoke", "1.2.3")
    record = read_record(layer)
    assert record.format == 1 and record.run == values["run"]
    assert list(record.results) == ["./vdb/smoke.0002.vdb", "./vdb/smoke.0003.vdb"]
    assert all(len(digest) == 64 for digest in record.results.values())
    assert "</World/smoke>" in layer.documentation


def test_emission_and_density_say_what_they_are(tmp_path):
    write_sequence(tmp_path, [1])
    files = "asset filePath = @./cache/smoke.0001.vdb@"
    untyped = f'def OpenVDBAsset "density" {{\ntoken fieldName = "density"\n{files}\n}}'
    stage_file = write_text(tmp_path / "shot.usda", world(volume_prim(untyped)))
    stage = open_stage(make_look(stage_file, tmp_path / "out").root_stage)
    expected = {
        "density": ("density", "float", "fogVolume"),
        "emission": ("emission", "float3", "unknown"),
    }
    for name, tokens in expected.items():
        prim = stage.GetPrimAtPath(f"/World/smoke/{name}")
        names = ("fieldName", "fieldDataType", "fieldClass")
        assert tuple(prim.GetAttribute(item).Get() for item in names) == tokens
    emission = stage.GetPrimAtPath("/World/smoke/emission")
    assert emission.GetTypeName() == "OpenVDBAsset"
    assert emission.GetAttribute("vectorDataRoleHint").Get() == "Color"


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"frames": []}, "no frames.* 1-4"),
        (
            {"grids": {"emission": "emission"}},
            'no grid for its density "density".*: emission',
        ),
    ],
)
def test_a_result_that_does_not_fit_its_source_is_refused(tmp_path, change, reason):
    stage, source = read(plume_stage(tmp_path))
    frame = WrittenFrame(1.0, str(tmp_path / "a.vdb"), "0", None, None)
    volume = StylizedVolume(source.volumes[0], [frame], 1.0)
    with pytest.raises(LayerError, match=reason):
        author(stage, source, [dataclasses.replace(volume, **change)], tmp_path)
    strange = dataclasses.replace(volume, frames=[dataclasses.replace(frame, time_code=9.0)])
    with pytest.raises(LayerError, match=r"timeCode 9\b.* 1-4"):
        author(stage, source, [strange], tmp_path)
    with pytest.raises(LayerError, match="stylized Volume"):
        author(stage, source, [], tmp_path)
    assert not list(tmp_path.glob("look*"))


def test_the_sources_own_layers_are_never_written_over(tmp_path):
    stage_file = plume_stage(tmp_path)
    write_text(tmp_path / "look.usda", HEADER)
    text = stage_file.read_text().replace("(\n", "(\n    subLayers = [@./look.usda@]\n", 1)
    stage, source = read(write_text(tmp_path / "shot.usda", text))
    frame = finish_frame(tmp_path / "vdb/a.0001.vdb", 1.0, False, ["density", "emission"])
    volume = StylizedVolume(source.volumes[0], [frame], 1.0)
    with pytest.raises(LayerError, match=r"look\.usda"):
        author(stage, source, [volume], tmp_path)
    assert (tmp_path / "look.usda").read_text() == HEADER


def test_a_stage_that_was_never_saved_is_refused(tmp_path):
    stage, source = read(plume_stage(tmp_path))
    frame = finish_frame(tmp_path / "vdb/a.0001.vdb", 1.0, False, ["density", "emission"])
    volume = StylizedVolume(source.volumes[0], [frame], 1.0)
    memory = Usd.Stage.CreateInMemory()
    memory.GetRootLayer().TransferContent(stage.GetRootLayer())
    with pytest.raises(LayerError, match="no file"):
        author(memory, source, [volume], tmp_path)


def test_a_folder_that_cannot_be_written_to_leaves_nothing(tmp_path, capfd):
    stage, source = read(plume_stage(tmp_path))
    frame = finish_frame(tmp_path / "vdb/a.0001.vdb", 1.0, False, ["density", "emission"])
    volume = StylizedVolume(source.volumes[0], [frame], 1.0)
    not_a_folder = write_text(tmp_path / "file", "")
    with pytest.raises(WriteFailed, match="write look"):
        author(stage, source, [volume], not_a_folder)
    assert os.listdir(tmp_path / "vdb") == ["a.0001.vdb"]
    assert capfd.readouterr().err == ""


def test_writing_again_replaces_the_old_result_also_for_stages_that_are_open(tmp_path):
    stage_file = plume_stage(tmp_path)
    files = make_look(stage_file, tmp_path / "out", frames="1")
    stage = open_stage(files.root_stage)
    again = make_look(
        stage_file, tmp_path / "out", frames="1-2", run_id="bbbbbbbb-0000-4000-8000-0"
    )
    assert again == files
    prim = stage.GetPrimAtPath("/World/smoke")
    assert prim.GetAttribute("usdSmoke:run").Get() == "bbbbbbbb-0000-4000-8000-0"
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "look.glslfx",
        "look.usda",
        "shot_look.usda",
        "vdb",
    ]


def test_the_files_are_known_before_anything_is_written(tmp_path):
    _, source = read(plume_stage(tmp_path))
    files = look_files(source.file_path, tmp_path / "out", LayerConfig(format="usdc"))
    assert files.look_layer == tmp_path / "out/look.usdc"
    assert files.root_stage == tmp_path / "out/shot_look.usda"


@pytest.mark.parametrize(
    ("file_path", "expected"),
    [
        ("/a/b/vdb/x.vdb", "./vdb/x.vdb"),
        ("/a/x.vdb", "../x.vdb"),
        ("/c/d/x.vdb", "../../c/d/x.vdb"),
        ("/a/b/..x/y.vdb", "./..x/y.vdb"),
    ],
)
def test_paths_are_relative_and_say_so_with_a_dot(tmp_path, file_path, expected):
    root = str(tmp_path)
    assert relative_asset_path(root + file_path, tmp_path / "a/b") == expected


def test_a_resolvers_address_and_a_missing_file_keep_their_meaning(tmp_path):
    layer = Sdf.Layer.CreateNew(str(tmp_path / "in/shot.usda"))
    address = Sdf.AssetPath("asset:smoke?version=3", "/resolved/elsewhere.vdb")
    assert anchored_asset(address, layer, tmp_path).path == "asset:smoke?version=3"
    missing = anchored_asset(Sdf.AssetPath("./gone.vdb"), layer, tmp_path / "out")
    assert missing.path == "../in/gone.vdb"
    assert anchored_asset(Sdf.AssetPath(""), layer, tmp_path).path == ""

"""Files of a result that were lost, replaced or changed are found, with and without their layer."""

from pxr import Sdf, Usd

from tests.fixtures.usd_fixtures import (
    dense_field,
    make_look,
    needs_usd,
    plume_stage,
    write_text,
    write_vdb,
)
from usdsmoke.usd.rules import Severity, validate
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.write import write_frame

pytestmark = needs_usd(26, 5)


def ours(stage_file):
    return [item for item in validate(stage_file) if ":" not in item.rule]


def test_a_changed_file_of_a_result_is_found(tmp_path):
    files = make_look(plume_stage(tmp_path), tmp_path / "out", frames="1-2", ours=True)
    first, second = (tmp_path / f"out/vdb/smoke.000{n}.vdb" for n in (1, 2))
    assert validate(files.root_stage) == []
    write_frame(first, [dense_field("density", 0.5), dense_field("emission")], {}, False)
    second.unlink()
    messages = {item.message for item in ours(files.root_stage) if item.rule == "ResultChanged"}
    assert len(messages) == 2
    assert any(
        text.startswith("smoke.0001.vdb is ") and "not that of this" in text for text in messages
    )
    assert any(text.startswith("smoke.0002.vdb is missing") for text in messages)
    assert {item.rule for item in ours(files.look_layer)} == {"ResultChanged"}


def test_values_that_no_longer_fit_the_stored_hash_are_found_with_and_without_the_layer(tmp_path):
    files = make_look(plume_stage(tmp_path, [1]), tmp_path / "out", ours=True)
    vdb_file = tmp_path / "out/vdb/smoke.0001.vdb"
    promised = {
        key: value
        for key, value in read_header(vdb_file).metadata.items()
        if key.startswith("usdsmoke:")
    }
    write_vdb(vdb_file, ["density", "emission"], value=0.75, metadata=promised)
    (found,) = ours(files.root_stage)
    assert found.rule == "ResultChanged"
    assert found.severity == Severity.ERROR
    assert "was changed after it was written" in found.message
    flat = tmp_path / "out/flat.usda"
    assert Usd.Stage.Open(str(files.root_stage)).Flatten().Export(str(flat))
    bare = flat.read_text().replace("usdsmoke = {", "other = {")
    write_text(flat, bare)
    assert "GridHashMismatch" in {item.rule for item in ours(flat)}


def test_a_layer_over_the_look_that_shows_other_files_is_found(tmp_path):
    stage_file = plume_stage(tmp_path)
    files = make_look(stage_file, tmp_path / "out", frames="1-2", ours=True)
    root = Sdf.Layer.FindOrOpen(str(files.root_stage))
    look, source = root.subLayerPaths
    root.subLayerPaths = [source, look]
    assert root.Save()
    (found,) = (item for item in ours(files.root_stage) if item.rule == "LookOverridden")
    assert (found.severity, found.prim_path) == (Severity.ERROR, "/World/smoke/density")
    assert stage_file.name in found.message and files.look_layer.name in found.message


def test_a_layer_over_the_look_may_name_its_files_at_another_place(tmp_path):
    files = make_look(plume_stage(tmp_path, [1]), tmp_path / "out", ours=True)
    published = tmp_path / "published"
    (tmp_path / "out/vdb").rename(published)
    stage = Usd.Stage.Open(str(files.root_stage))
    for name in ("density", "emission"):
        attribute = stage.GetPrimAtPath(f"/World/smoke/{name}").GetAttribute("filePath")
        attribute.Set(str(published / "smoke.0001.vdb"), 1)
    assert "LookOverridden" not in {item.rule for item in ours(files.root_stage)}
    stage.GetRootLayer().Save()
    assert "LookOverridden" not in {item.rule for item in ours(files.root_stage)}


def test_a_look_whose_volume_has_gone_is_found(tmp_path):
    stage_file = plume_stage(tmp_path)
    files = make_look(stage_file, tmp_path / "out", frames="1-2", ours=True)
    source = Usd.Stage.Open(str(stage_file))
    source.GetPrimAtPath("/World/smoke").SetActive(False)
    source.GetRootLayer().Save()
    (found,) = (item for item in ours(files.root_stage) if item.rule == "LookWithoutVolume")
    assert (found.severity, found.prim_path) == (Severity.WARN, "/World/smoke")
    source.RemovePrim("/World")
    source.DefinePrim("/Other")
    source.GetRootLayer().Save()
    assert "LookWithoutVolume" in [item.rule for item in ours(files.root_stage)]
    assert not [item for item in ours(files.look_layer) if item.rule == "LookWithoutVolume"]


def test_a_shader_of_a_renderer_that_is_not_installed_is_a_warning(tmp_path):
    stage_file = plume_stage(tmp_path)
    shader = """
def Material "look"
{
    def Shader "volume"
    {
        uniform token info:id = "someone:standard_volume"
    }
}
"""
    write_text(stage_file, stage_file.read_text() + shader)
    (found,) = validate(stage_file)
    assert found.rule.endswith("ShaderSdrCompliance.MissingShaderIdInRegistry")
    assert (found.severity, found.prim_path) == (Severity.WARN, "/look/volume.info:id")

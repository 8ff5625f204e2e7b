"""What a stage says about its volumes: timeCodes, files, grids, places, and which of them count."""

import json

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom

from tests.fixtures.usd_fixtures import (
    HEADER,
    density_prim,
    file_hashes,
    make_look,
    plume_stage,
    sampled,
    sequence,
    volume_prim,
    world,
    write_sequence,
    write_text,
    write_vdb,
)
from usdsmoke.base.errors import FieldNotFound
from usdsmoke.config.run_sections import StageConfig
from usdsmoke.ui.cli.main import main
from usdsmoke.usd.stage import find_volumes, open_stage

DEFAULT = "asset filePath = @./cache/smoke.0001.vdb@"


def read_one(folder, body, header=HEADER, **settings):
    """The only Volume of a stage with ``body`` below /World."""
    stage_file = write_text(folder / "shot.usda", world(body, header))
    (volume,) = find_volumes(open_stage(stage_file), StageConfig(**settings)).volumes
    return volume


def codes_of(volume):
    return [frame.time_code for frame in volume.frames]


def files_of(volume):
    return [frame.fields["density"].file_path.rsplit("/", 1)[-1] for frame in volume.frames]


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd"])
def test_stage_metadata_and_fields_are_read_from_every_format(tmp_path, suffix):
    text_file = plume_stage(tmp_path)
    stage_file = text_file.with_suffix(suffix)
    if suffix != ".usda":
        assert open_stage(text_file).GetRootLayer().Export(str(stage_file))
    source = find_volumes(open_stage(stage_file), StageConfig())
    assert source.file_path == str(stage_file)
    assert (source.up_axis, source.meters_per_unit, source.default_prim) == ("Z", 0.5, "World")
    assert (source.time_codes_per_second, source.frames_per_second) == (25.0, 25.0)
    assert (source.start_time_code, source.end_time_code) == (1.0, 4.0)
    (volume,) = source.volumes
    assert volume.prim_path == "/World/smoke"
    assert volume.animated
    assert volume.time_codes == (1.0, 2.0, 3.0, 4.0)
    density = volume.frames[2].fields["density"]
    assert density.prim_path == "/World/smoke/density"
    assert density.time_code == 3.0
    assert density.file_path == str(tmp_path / "cache/smoke.0003.vdb")
    assert density.authored_path == "./cache/smoke.0003.vdb"
    assert (density.grid_name, density.grid_index) == ("density", None)
    assert (density.data_type, density.field_class) == ("float", "fogVolume")


def test_reading_leaves_every_file_as_it_was(tmp_path):
    stage_file = plume_stage(tmp_path)
    before = file_hashes(tmp_path)
    find_volumes(open_stage(stage_file), StageConfig())
    assert file_hashes(tmp_path) == before


def test_a_default_alone_is_one_frame_at_the_start_of_the_stage(tmp_path):
    write_sequence(tmp_path, [1])
    volume = read_one(tmp_path, volume_prim(density_prim(DEFAULT)))
    assert not volume.animated
    assert codes_of(volume) == [1.0]
    without_range = HEADER.replace("    startTimeCode = 1\n", "").replace(" endTimeCode = 4", "")
    assert codes_of(read_one(tmp_path, volume_prim(density_prim(DEFAULT)), without_range)) == [1.0]
    at_zero = HEADER.replace("startTimeCode = 1", "startTimeCode = 0")
    assert codes_of(read_one(tmp_path, volume_prim(density_prim(DEFAULT)), at_zero)) == [0.0]


def test_sparse_samples_with_arbitrary_names_are_taken_as_they_are(tmp_path):
    for name in ("b.vdb", "a-17.vdb"):
        write_vdb(tmp_path / name)
    files = sampled("asset filePath", {-2: "@./b.vdb@", 3.5: "@./a-17.vdb@", 40: "@./b.vdb@"})
    body = volume_prim(density_prim(files))
    volume = read_one(tmp_path, body)
    assert codes_of(volume) == [-2.0, 3.5, 40.0]
    assert files_of(volume) == ["b.vdb", "a-17.vdb", "b.vdb"]


def test_a_blocked_sample_is_a_gap(tmp_path):
    write_sequence(tmp_path, [1, 4])
    values = {1: "@./cache/smoke.0001.vdb@", 2: "None", 4: "@./cache/smoke.0004.vdb@"}
    volume = read_one(tmp_path, volume_prim(density_prim(sampled("asset filePath", values))))
    assert codes_of(volume) == [1.0, 4.0]
    assert volume.time_codes == (1.0, 2.0, 4.0)


def test_a_gap_in_another_field_is_a_gap_in_every_version_of_usd(tmp_path, monkeypatch):
    """OpenUSD before 26.03 returns the block itself between two blocked samples."""
    get = Usd.Attribute.Get

    def get_as_before(attribute, time_code=None):
        value = get(attribute) if time_code is None else get(attribute, time_code)
        blocked = value is None and time_code is not None and attribute.GetNumTimeSamples()
        return Sdf.ValueBlock() if blocked else value

    monkeypatch.setattr(Usd.Attribute, "Get", get_as_before)
    for name in ("a.vdb", "b.vdb"):
        write_vdb(tmp_path / name)
    files = sampled("asset filePath", {1: "@./a.vdb@", 2.5: "@./b.vdb@", 4: "@./a.vdb@"})
    others = sampled("asset filePath", {1: "@./a.vdb@", 2: "None", 3: "None", 4: "@./a.vdb@"})
    names = sampled("token fieldName", {1: '"density"', 2: "None", 3: "None", 4: '"density"'})
    relations = "rel field:density = </World/smoke/density>\nrel field:vel = </World/smoke/vel>"
    body = volume_prim(
        density_prim(files) + density_prim(others, "vel", grid=names), relations=relations
    )
    volume = read_one(tmp_path, body)
    assert [sorted(frame.fields) for frame in volume.frames] == [
        ["density", "vel"],
        ["density"],
        ["density", "vel"],
    ]
    made = make_look(tmp_path / "shot.usda", tmp_path / "out")
    assert open_stage(made.root_stage).GetPrimAtPath("/World/smoke/vel")


@pytest.mark.parametrize(
    ("frames", "expected"),
    [("", [1, 2, 3, 4]), ("2-4", [2, 3, 4]), ("1-4x2", [1, 3]), ("4,1", [1, 4])],
)
def test_frames_select_among_the_existing_time_codes(tmp_path, frames, expected):
    source = find_volumes(open_stage(plume_stage(tmp_path)), StageConfig(frames=frames))
    assert codes_of(source.volumes[0]) == expected
    assert source.volumes[0].time_codes == (1.0, 2.0, 3.0, 4.0)


def test_missing_time_codes_are_left_out_by_name_where_that_is_allowed(tmp_path):
    stage_file = plume_stage(tmp_path)
    (tmp_path / "cache/smoke.0003.vdb").unlink()
    config = StageConfig(frames="2-9", allow_missing=True)
    source = find_volumes(open_stage(stage_file), config)
    assert codes_of(source.volumes[0]) == [2, 4]
    assert len(source.missing) == 2
    assert "2-9 " in source.missing[0] and "</World/smoke> has 1-4" in source.missing[0]
    assert "smoke" in source.missing[1] and "timeCode 3" in source.missing[1]


def test_files_outside_the_selection_may_be_missing(tmp_path):
    stage_file = plume_stage(tmp_path)
    (tmp_path / "cache/smoke.0001.vdb").unlink()
    source = find_volumes(open_stage(stage_file), StageConfig(frames="2-4"))
    assert codes_of(source.volumes[0]) == [2, 3, 4]


def test_field_name_and_index_are_read_at_every_sample(tmp_path):
    write_sequence(tmp_path, [1, 2])
    body = volume_prim(
        density_prim(
            sequence([1, 2]),
            grid=sampled("token fieldName", {1: '"smoke"', 2: '"density"'}),
            extra=sampled("int fieldIndex", {1: "2", 2: "0"}),
        )
    )
    fields = [frame.fields["density"] for frame in read_one(tmp_path, body).frames]
    assert [(item.grid_name, item.grid_index) for item in fields] == [("smoke", 2), ("density", 0)]


def test_the_grids_of_one_file_can_be_the_frames(tmp_path):
    write_sequence(tmp_path, [1])
    index = sampled("int fieldIndex", {1: "0", 2: "1", 3: "1", 5: "2"})
    volume = read_one(tmp_path, volume_prim(density_prim(DEFAULT, extra=index)))
    assert volume.animated
    assert [(f.time_code, f.fields["density"].grid_index) for f in volume.frames] == [
        (1.0, 0),
        (2.0, 1),
        (5.0, 2),
    ]


def test_samples_of_field_name_that_never_change_make_no_frames(tmp_path):
    write_sequence(tmp_path, [1, 4])
    names = sampled("token fieldName", {1: '"density"', 2: '"density"'})
    body = density_prim(sequence([1, 4]), grid=names)
    assert codes_of(read_one(tmp_path, volume_prim(body))) == [1.0, 4.0]
    static = density_prim(DEFAULT, grid=names)
    assert not read_one(tmp_path, volume_prim(static)).animated


def test_field_to_stage_is_the_field_prims_own_place_at_each_time(tmp_path):
    write_sequence(tmp_path, [1, 2])
    turned = """
            double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 2: (10, 0, 0) }
            float3 xformOp:scale = (2, 3, 4)
            uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]"""
    body = volume_prim(
        density_prim(sequence([1, 2]), extra=turned)
        + "double3 xformOp:translate = (0, 0, 7)\n"
        + 'uniform token[] xformOpOrder = ["xformOp:translate"]'
    )
    frames = read_one(tmp_path, body).frames
    expected = np.diag([2.0, 3.0, 4.0, 1.0])
    expected[3] = (10, 0, 7, 1)
    np.testing.assert_allclose(frames[1].fields["density"].field_to_stage, expected, atol=1e-12)
    corner = np.array([1.0, 1.0, 1.0, 1.0]) @ frames[1].fields["density"].field_to_stage
    np.testing.assert_allclose(corner, [12, 3, 11, 1], atol=1e-12)
    assert frames[0].fields["density"].field_to_stage[3, 0] == 0.0


def test_fields_outside_the_volume_and_shared_ones_are_followed(tmp_path):
    write_sequence(tmp_path, [1, 2])
    relation = "rel field:density = </World/fields/d>"
    body = (
        f'def Xform "fields"\n{{{density_prim(sequence([1, 2]), name="d")}}}\n'
        + volume_prim("", name="one", relations=relation)
        + volume_prim("", name="two", relations=relation)
    )
    stage_file = write_text(tmp_path / "shot.usda", world(body))
    volumes = find_volumes(open_stage(stage_file), StageConfig()).volumes
    assert [item.prim_path for item in volumes] == ["/World/one", "/World/two"]
    assert {item.frames[1].fields["density"].prim_path for item in volumes} == {"/World/fields/d"}


def test_only_the_named_prims_are_taken_in_the_order_they_are_named(tmp_path):
    write_sequence(tmp_path, [1])
    body = "".join(volume_prim(density_prim(DEFAULT), name=name) for name in ("a", "b", "c"))
    stage = open_stage(write_text(tmp_path / "shot.usda", world(body)))
    source = find_volumes(stage, StageConfig(prims=["/World/c", "/World/a"]))
    assert [item.prim_path for item in source.volumes] == ["/World/c", "/World/a"]


@pytest.mark.parametrize(
    ("names", "wanted", "velocity"),
    [
        (["density"], "", ()),
        (["density", "vel"], "", ("vel",)),
        (["v", "velocity"], "", ("v",)),
        (
            ["velocity_x", "velocity_y", "velocity_z"],
            "",
            ("velocity_x", "velocity_y", "velocity_z"),
        ),
        (["vel_x", "vel_y"], "", ()),
        (["vel", "wind"], "wind", ("wind",)),
        (["vel"], "wind", ()),
    ],
)
def test_the_velocity_is_found_by_the_usual_names_or_the_one_given(
    tmp_path, names, wanted, velocity
):
    write_sequence(tmp_path, [1])
    names = ["density", *[name for name in names if name != "density"]]
    relations = "\n".join(f"rel field:{name} = </World/smoke/{name}>" for name in names)
    prims = "".join(density_prim(DEFAULT, name=name) for name in names)
    volume = read_one(tmp_path, volume_prim(prims, relations=relations), velocity=wanted)
    assert volume.velocity == velocity
    assert set(volume.frames[0].fields) == {"density", *velocity}
    assert volume.other_fields == tuple(sorted(set(names) - {"density", *velocity}))


def test_a_velocity_with_other_samples_is_held(tmp_path):
    write_sequence(tmp_path, [1, 2, 3, 4])
    relations = "rel field:density = </World/smoke/density>\nrel field:vel = </World/smoke/vel>"
    body = density_prim(sequence([1, 2, 3, 4])) + density_prim(sequence([1, 3]), name="vel")
    volume = read_one(tmp_path, volume_prim(body, relations=relations))
    frames = volume.frames
    held = [f.fields["vel"].file_path[-8:-4] for f in frames]
    assert held == ["0001", "0001", "0003", "0003"]
    (note,) = volume.notes
    assert "/vel> has no time sample at timeCodes 2,4" in note and "timeCode 3." in note
    assert [f.fields["vel"].time_code for f in frames] == [1, 2, 3, 4]


def test_a_velocity_that_leads_nowhere_is_left_with_the_others(tmp_path):
    write_sequence(tmp_path, [1])
    relations = "rel field:density = </World/smoke/density>\nrel field:vel = </World/none>"
    volume = read_one(tmp_path, volume_prim(density_prim(DEFAULT), relations=relations))
    assert (volume.velocity, volume.other_fields) == ((), ("vel",))


def test_volumes_without_a_selected_time_code_are_left_out_with_a_reason(tmp_path):
    write_sequence(tmp_path, [1, 2, 3, 4])
    body = volume_prim(density_prim(sequence([1, 2])), name="early") + volume_prim(
        density_prim(sequence([3, 4])), name="late"
    )
    stage = open_stage(write_text(tmp_path / "shot.usda", world(body)))
    source = find_volumes(stage, StageConfig(frames="3-4"))
    assert [item.prim_path for item in source.volumes] == ["/World/late"]
    assert source.omitted == {"/World/early": "none of its timeCodes 1,2 is in '3-4'"}
    assert len(find_volumes(stage, StageConfig(frames="2,3")).volumes) == 2


def test_volumes_that_nobody_sees_are_left_out_unless_they_are_named(tmp_path):
    write_sequence(tmp_path, [1])
    hidden = 'token visibility = "invisible"\n'
    blinking = 'token visibility.timeSamples = { 1: "invisible", 2: "inherited" }\n'
    guide = 'uniform token purpose = "guide"\n'
    parts = {"seen": "", "hidden": hidden, "blinking": blinking, "guide": guide}
    prims = [volume_prim(text + density_prim(DEFAULT), name) for name, text in parts.items()]
    group = f'def Xform "off" {{ {hidden} {volume_prim(density_prim(DEFAULT), "inside")} }}'
    group = group.replace("/World/inside", "/World/off/inside")
    stage = open_stage(write_text(tmp_path / "shot.usda", world("".join([*prims, group]))))
    source = find_volumes(stage, StageConfig())
    assert [item.prim_path for item in source.volumes] == ["/World/seen", "/World/blinking"]
    assert "invisible" in source.omitted["/World/hidden"]
    assert "guide" in source.omitted["/World/guide"]
    assert "</World/off>" in source.omitted["/World/off/inside"]
    named = find_volumes(stage, StageConfig(prims=["/World/hidden", "/World/guide"]))
    assert len(named.volumes) == 2 and not named.omitted


def stage_with_faults(folder):
    """One good Volume with a missing file, one without fields, one whose files are all missing."""
    write_sequence(folder, [1, 2, 3, 4])
    (folder / "cache/smoke.0003.vdb").unlink()
    gone = density_prim("asset filePath = @./cache/gone.vdb@")
    body = volume_prim(density_prim(sequence([1, 2, 3, 4]))) + volume_prim(gone, name="gone")
    return write_text(
        folder / "shot.usda", world(body + volume_prim("", name="bare", relations="int a"))
    )


def test_what_cannot_be_used_is_noted_and_the_rest_is_found(tmp_path):
    stage, problems = open_stage(stage_with_faults(tmp_path)), []
    source = find_volumes(stage, StageConfig(), problems=problems)
    (volume,) = source.volumes
    assert volume.prim_path == "/World/smoke" and codes_of(volume) == [1, 2, 4]
    told = "; ".join(problems)
    assert "</World/smoke>" in told and "timeCode 3" in told
    assert "/World/bare" in told and "</World/gone>" in told


def test_one_bad_volume_among_several_names_the_way_out(tmp_path):
    with pytest.raises(FieldNotFound, match=r"/World/bare.*--prim /World/smoke\."):
        find_volumes(open_stage(stage_with_faults(tmp_path)), StageConfig(allow_missing=True))


def test_inspect_and_preview_show_the_rest(tmp_path, capsys):
    stage_file = stage_with_faults(tmp_path)
    assert main(["inspect", str(stage_file), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    (only,) = found["volumes"]
    assert only["prim_path"] == "/World/smoke" and len(found["problems"]) == 3
    draw = ["preview", str(stage_file), "-o", str(tmp_path / "a.png"), "--width", "16"]
    assert main(draw) == 0 and main([*draw, "--frames", "2"]) == 0
    told = capsys.readouterr().err
    assert "timeCode 3" in told and told.count("/World/bare") == 2
    assert [main([*draw, "--frames", beyond]) for beyond in ("9", "2-9", "3")] == [1, 1, 1]
    assert "smoke.0003.vdb" in capsys.readouterr().err


def test_volumes_inside_instances_are_left_out_with_a_reason(tmp_path):
    write_sequence(tmp_path, [1])
    body = f"""
    def Xform "source"
    {{
        def Volume "v" {{ rel field:density = <../v/density>\n{density_prim(DEFAULT)} }}
    }}
    def "copy" (instanceable = true
                references = </World/source>) {{}}
"""
    stage = open_stage(write_text(tmp_path / "shot.usda", world(body)))
    source = find_volumes(stage, StageConfig())
    assert [item.prim_path for item in source.volumes] == ["/World/source/v"]
    assert list(source.omitted) == ["/World/copy/v"]
    assert "</World/copy>" in source.omitted["/World/copy/v"]
    assert "</World/source/v>" in source.omitted["/World/copy/v"]


def test_an_axis_and_unit_that_are_not_authored_are_usds_own(tmp_path):
    write_sequence(tmp_path, [1])
    text = world(volume_prim(density_prim(DEFAULT)), '#usda 1.0\n(defaultPrim = "World")\n')
    source = find_volumes(open_stage(write_text(tmp_path / "s.usda", text)), StageConfig())
    assert source.up_axis == UsdGeom.GetFallbackUpAxis()
    assert source.meters_per_unit == 0.01
    assert (source.start_time_code, source.end_time_code) == (None, None)
    assert source.time_codes_per_second == 24.0

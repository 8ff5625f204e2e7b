"""The Volume's extent: in its own space, around what is shown at every moment, never too small."""

import dataclasses

import numpy as np
from pxr import Usd, UsdGeom

from tests.fixtures.usd_fixtures import (
    density_prim,
    finish_frame,
    make_look,
    plume_stage,
    sequence,
    volume_prim,
    world,
    write_sequence,
    write_text,
)
from usdsmoke.base.record_format import RECORD_FORMAT, RunRecord
from usdsmoke.config.run_sections import LayerConfig, StageConfig
from usdsmoke.usd.look import StylizedVolume, author_look
from usdsmoke.usd.stage import find_volumes, open_stage

RECORD = RunRecord(RECORD_FORMAT, "3f2b8c1e-0a4d-4c57-9d0e-5b7a1f6c2d34", "1")


def look_with_boxes(tmp_path, stage_file, boxes, **settings):
    """The stage with the look of files whose boxes, (low, high) or None, are given by timeCode."""
    stage = open_stage(stage_file)
    source = find_volumes(stage, StageConfig(**settings))
    frames = []
    for frame in source.volumes[0].frames:
        file_path = tmp_path / f"out/vdb/s.{int(frame.time_code):04d}.vdb"
        written = finish_frame(file_path, frame.time_code, False, ["density", "emission"])
        low, high = boxes[frame.time_code] or (None, None)
        frames.append(dataclasses.replace(written, extent_min=low, extent_max=high))
    volume = StylizedVolume(source.volumes[0], frames, 0.5)
    files = author_look(stage, source, [volume], tmp_path / "out", LayerConfig(), RECORD)
    return open_stage(files.root_stage)


def extent_at(stage, code, path="/World/smoke"):
    value = stage.GetPrimAtPath(path).GetAttribute("extent").Get(code)
    return None if value is None else np.array(value, dtype=np.float64)


def test_the_extent_is_the_files_box_in_the_volumes_own_space(tmp_path):
    write_sequence(tmp_path, [1])
    place = """
            double3 xformOp:translate = (10, 0, 0)
            float3 xformOp:scale = (2, -2, 1)
            uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]"""
    body = density_prim("asset filePath = @./cache/smoke.0001.vdb@", extra=place)
    body += "double3 xformOp:translate = (0, 500, 0)\n"
    body += 'uniform token[] xformOpOrder = ["xformOp:translate"]'
    stage_file = write_text(tmp_path / "shot.usda", world(volume_prim(body)))
    stage = look_with_boxes(tmp_path, stage_file, {1.0: ((-1, -1, -1), (3, 2, 1))})
    np.testing.assert_array_equal(extent_at(stage, 1), [[8, -4, -1], [16, 2, 1]])
    assert stage.GetPrimAtPath("/World/smoke").GetAttribute("extent").GetTimeSamples() == []
    cache = UsdGeom.BBoxCache(1, [UsdGeom.Tokens.default_])
    bound = cache.ComputeWorldBound(stage.GetPrimAtPath("/World/smoke")).ComputeAlignedRange()
    assert tuple(bound.GetMin()) == (8, 496, -1)


def test_what_is_shown_lies_inside_the_extent_between_samples_too(tmp_path):
    stage_file = plume_stage(tmp_path, [1, 2, 3])
    boxes = {
        1.0: ((0, 0, 0), (1, 1, 1)),
        2.0: ((5, 5, 5), (6, 6, 6)),
        3.0: ((5.1, 5.1, 5.1), (5.9, 5.9, 5.9)),
    }
    stage = look_with_boxes(tmp_path, stage_file, boxes)
    for code in np.arange(1, 4, 0.125):
        low, high = boxes[float(int(code))]
        extent = extent_at(stage, code)
        assert (extent[0] <= low).all() and (extent[1] >= high).all(), code
    np.testing.assert_array_equal(extent_at(stage, 1), [[0, 0, 0], [1, 1, 1]])
    np.testing.assert_array_equal(extent_at(stage, Usd.TimeCode.Default()), [[0, 0, 0], [6, 6, 6]])


def test_empty_frames_have_the_bounds_of_their_neighbours_and_all_empty_ones_none(tmp_path):
    write_sequence(tmp_path, [1, 2, 3])
    stage_file = write_text(
        tmp_path / "shot.usda", world(volume_prim(density_prim(sequence([1, 2, 3]))))
    )
    box = ((0, 0, 0), (1, 1, 1))
    stage = look_with_boxes(tmp_path, stage_file, {1.0: None, 2.0: box, 3.0: None})
    for code in (1, 2, 3):
        np.testing.assert_array_equal(extent_at(stage, code), box)
    nothing = look_with_boxes(tmp_path, stage_file, {1.0: None, 2.0: None, 3.0: None})
    assert extent_at(nothing, 2) is None


def test_outside_the_range_the_extent_is_the_sources_its_files_or_all_that_is_known(tmp_path):
    stage_file = plume_stage(tmp_path)
    stage = look_with_boxes(tmp_path, stage_file, {2.0: ((0, 0, 0), (1, 1, 1))}, frames="2")
    np.testing.assert_array_equal(extent_at(stage, 4), [[-9] * 3, [9] * 3])
    without = stage_file.read_text().replace("float3[] extent", "custom float3[] other")
    bare_file = write_text(tmp_path / "bare.usda", without)
    bare = look_with_boxes(tmp_path, bare_file, {2.0: ((0, 0, 0), (1, 1, 1))}, frames="2")
    np.testing.assert_array_equal(extent_at(bare, 4), [[-0.25] * 3, [1.75, 1.25, 0.75]])
    for code in (3, 4):
        (tmp_path / f"cache/smoke.{code:04d}.vdb").write_bytes(b"no VDB file")
    bare = look_with_boxes(tmp_path, bare_file, {2.0: ((0, 0, 0), (3, 3, 3))}, frames="2")
    np.testing.assert_array_equal(extent_at(bare, 4), [[-0.25] * 3, [3] * 3])


def test_fields_that_are_left_alone_stay_inside_the_extent(tmp_path):
    write_sequence(tmp_path, [1])
    files = "asset filePath = @./cache/smoke.0001.vdb@"
    relations = "rel field:density = </World/smoke/density>\nrel field:temp = </World/smoke/temp>"
    body = "float3[] extent = [(-9, 0, 0), (0.5, 9, 0.5)]\n"
    body += density_prim(files) + density_prim(files, name="temp")
    text = world(volume_prim(body, relations=relations))
    stage = open_stage(
        make_look(write_text(tmp_path / "s.usda", text), tmp_path / "out").root_stage
    )
    np.testing.assert_array_equal(extent_at(stage, 1), [[-9, -0.25, -0.25], [1.75, 9, 0.75]])


def test_extents_are_rounded_outwards(tmp_path):
    third = 1.0 / 3.0
    stage_file = plume_stage(tmp_path, [1])
    stage = look_with_boxes(tmp_path, stage_file, {1.0: ((-third,) * 3, (0.1,) * 3)})
    extent = extent_at(stage, 1)
    assert (extent[0] <= -third).all() and (extent[1] >= 0.1).all()
    np.testing.assert_allclose(extent, [[-third] * 3, [0.1] * 3], rtol=2e-7)

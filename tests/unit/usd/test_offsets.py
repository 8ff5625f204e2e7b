"""Layers that are shown at other timeCodes, or more slowly."""

import pytest

from tests.fixtures.usd_fixtures import (
    HEADER,
    density_prim,
    sequence,
    volume_prim,
    world,
    write_sequence,
    write_text,
)
from usdsmoke.config.run_sections import StageConfig
from usdsmoke.usd.stage import find_volumes, open_stage


def test_references_payloads_and_offset_sublayers_are_read_composed(tmp_path):
    write_sequence(tmp_path / "asset", [1, 2])
    asset = world(volume_prim(density_prim(sequence([1, 2]))))
    write_text(tmp_path / "asset/smoke.usda", asset)
    inner = f'{HEADER}\ndef "World" (payload = @./asset/smoke.usda@</World>) {{}}\n'
    write_text(tmp_path / "inner.usda", inner)
    offset = HEADER.replace("(\n", "(\n    subLayers = [@./inner.usda@ (offset = 100)]\n", 1)
    stage = open_stage(write_text(tmp_path / "shot.usda", offset))
    (volume,) = find_volumes(stage, StageConfig()).volumes
    assert [frame.time_code for frame in volume.frames] == [101.0, 102.0]
    assert volume.frames[0].fields["density"].file_path == str(
        tmp_path / "asset/cache/smoke.0001.vdb"
    )


@pytest.mark.parametrize("animated", ["filePath", "fieldName"])
def test_a_slower_sublayer_slows_the_velocity_whatever_is_animated(tmp_path, animated):
    write_sequence(tmp_path, [1, 2])
    files, grid = "asset filePath = @./cache/smoke.0001.vdb@", 'token fieldName = "density"'
    if animated == "filePath":
        files = sequence([1, 2])
    else:
        grid = 'token fieldName.timeSamples = { 1: "density", 2: "density2" }'
    write_text(tmp_path / "inner.usda", world(volume_prim(density_prim(files, grid=grid))))
    slow = HEADER.replace("(\n", "(\n    subLayers = [@./inner.usda@ (scale = 2)]\n", 1)
    stage = open_stage(write_text(tmp_path / "shot.usda", slow))
    (volume,) = find_volumes(stage, StageConfig()).volumes
    assert [frame.time_code for frame in volume.frames] == [2.0, 4.0]
    assert [frame.fields["density"].code_stretch for frame in volume.frames] == [2.0, 2.0]


def test_time_samples_of_one_value_slow_nothing(tmp_path):
    write_sequence(tmp_path, [1])
    files = "asset filePath = @./cache/smoke.0001.vdb@"
    grid = 'token fieldName.timeSamples = { 1: "density", 2: "density" }'
    write_text(tmp_path / "inner.usda", world(volume_prim(density_prim(files, grid=grid))))
    slow = HEADER.replace("(\n", "(\n    subLayers = [@./inner.usda@ (scale = 2)]\n", 1)
    stage = open_stage(write_text(tmp_path / "shot.usda", slow))
    (volume,) = find_volumes(stage, StageConfig()).volumes
    assert [frame.fields["density"].code_stretch for frame in volume.frames] == [1.0]

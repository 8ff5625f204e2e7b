"""Transforms that leave no smoke to be seen, or show it in perspective."""

import pytest

from tests.fixtures.usd_fixtures import (
    density_prim,
    sampled,
    sequence,
    volume_prim,
    world,
    write_sequence,
    write_text,
)
from tests.unit.usd.test_stage_refusals import refuse
from usdsmoke.base.errors import StageError
from usdsmoke.config.run_sections import StageConfig
from usdsmoke.usd.rules import validate
from usdsmoke.usd.stage import find_volumes, open_stage


@pytest.mark.parametrize("scale", ["(0, 1, 1)", "(1, inf, 1)", "(1, nan, 1)"])
def test_a_place_without_size_is_refused_at_its_time_code_and_found_by_validate(tmp_path, scale):
    write_sequence(tmp_path, (1, 2))
    scales = sampled("float3 xformOp:scale", {1: "(1, 1, 1)", 2: scale})
    body = scales + '\nuniform token[] xformOpOrder = ["xformOp:scale"]\n'
    body = volume_prim(body + density_prim(sequence((1, 2))))
    reason = "</World/smoke/density> at timeCode 2 has a scale of 0, NaN or infinity.*--frames"
    refuse(tmp_path, body, StageError, reason)
    stage = open_stage(tmp_path / "shot.usda")
    assert len(find_volumes(stage, StageConfig(frames="1")).volumes[0].frames) == 1
    found = [item for item in validate(stage) if item.rule == "FieldPlaceDiffers"]
    assert [item.time_code for item in found] == ([] if "0" in scale else [2.0])


def test_a_perspective_is_refused_and_a_shear_is_not(tmp_path):
    write_sequence(tmp_path, (1, 2))
    matrix = "( (1, 8, 0, {}), (0, 1, 0, 0), (0, 0, 1, 0), (3, 0, 0, {}) )"

    def body(*last: float) -> str:
        place = f"matrix4d xformOp:transform = {matrix.format(*last)}"
        order = '\nuniform token[] xformOpOrder = ["xformOp:transform"]\n'
        return volume_prim(place + order + density_prim(sequence((1, 2))))

    refuse(tmp_path, body(0.5, 1), StageError, "</World/smoke/density> at timeCode 1.*perspective")
    refuse(tmp_path, body(0, 2), StageError, "</World/smoke/density> at timeCode 1.*perspective")
    write_text(tmp_path / "shot.usda", world(body(0, 1)))
    assert find_volumes(open_stage(tmp_path / "shot.usda"), StageConfig()).volumes

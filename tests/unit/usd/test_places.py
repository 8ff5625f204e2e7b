"""Transforms that leave no smoke to be seen, or show it in perspective; what is not shown."""

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
from usdsmoke.base.errors import FieldNotFound, StageError
from usdsmoke.config.run_sections import StageConfig
from usdsmoke.usd.inspect import grids_beside
from usdsmoke.usd.rules import Severity, validate
from usdsmoke.usd.stage import find_volumes, open_stage
from usdsmoke.vdb.header import read_header


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


def test_an_inactive_field_is_not_used(tmp_path):
    write_sequence(tmp_path, (1, 2), names=("density", "vel"))
    both = "rel field:density = </World/smoke/density>\nrel field:vel = </World/smoke/vel>"
    velocity = density_prim(sequence((1, 2)), "vel", grid='token fieldName = "vel"')
    body = volume_prim(density_prim(sequence((1, 2))) + velocity, "smoke", both)
    stage = open_stage(write_text(tmp_path / "shot.usda", world(body)))
    for name, severity in {"vel": Severity.WARN, "density": Severity.ERROR}.items():
        stage.GetPrimAtPath(f"/World/smoke/{name}").SetActive(False)
        if name == "vel":
            (volume,) = find_volumes(stage, StageConfig()).volumes
            assert set(volume.frames[0].fields) == {"density"}
        else:
            with pytest.raises(FieldNotFound, match="inactive"):
                find_volumes(stage, StageConfig())
        found = {item.prim_path: item for item in validate(stage)}
        assert found[f"/World/smoke.field:{name}"].severity == severity


def test_what_is_invisible_at_all_of_its_time_codes_is_left_out_unless_it_is_named(tmp_path):
    """Whatever is selected: a look that grows keeps its Volumes."""
    write_sequence(tmp_path, (1, 2, 3))
    late = sampled("token visibility", {1: '"invisible"', 3: '"inherited"'})
    ended = sampled("token visibility", {0: '"inherited"', 1: '"invisible"'})
    other = density_prim(sequence((1, 2, 3)))
    body = volume_prim(other) + volume_prim(late + other, "late")
    stage = open_stage(
        write_text(tmp_path / "shot.usda", world(body + volume_prim(ended + other, "ended")))
    )
    for frames in ("1-2", "1-3"):
        found = find_volumes(stage, StageConfig(frames=frames))
        seen = {volume.prim_path: volume for volume in found.volumes}
        assert list(seen) == ["/World/smoke", "/World/late"]
        assert list(found.omitted) == ["/World/ended"]
        assert any("invisible" in note for note in seen["/World/late"].notes)
    named = find_volumes(stage, StageConfig(frames="1-2", prims=["/World/ended"]))
    assert [volume.prim_path for volume in named.volumes] == ["/World/ended"]


@pytest.mark.parametrize(("names", "beside"), [(("soot",), []), (("density", "heat"), ["heat"])])
def test_the_one_grid_of_a_file_needs_no_name(tmp_path, names, beside):
    write_sequence(tmp_path, (1,), names=names)
    grid = "" if len(names) == 1 else 'token fieldName = "density"'
    body = volume_prim(density_prim(sequence((1,)), grid=grid))
    stage = open_stage(write_text(tmp_path / "shot.usda", world(body)))
    (volume,) = find_volumes(stage, StageConfig()).volumes
    assert grids_beside(volume, read_header(tmp_path / "cache/smoke.0001.vdb")) == beside

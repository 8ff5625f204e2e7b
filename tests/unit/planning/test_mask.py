"""The mask: where it is found, what is refused, how it arrives."""

from pathlib import Path

import numpy as np
import pytest

from tests.fixtures.grids_fixtures import openvdb, raw_grid, uniform, write_raw
from tests.fixtures.mask_fixtures import PLACED, frames_of, make_stage, plan_of, write_mask
from tests.fixtures.usd_fixtures import (
    density_prim,
    sampled,
    volume_prim,
    world,
    write_text,
    write_vdb,
)
from usdsmoke.base.errors import (
    AssetNotResolved,
    FieldNotFound,
    GridNotFound,
    NonFiniteError,
    StageError,
    UnsupportedGrid,
)


@pytest.mark.usefixtures("quick_grids")
def test_a_mask_arrives_with_its_own_values_voxels_and_place(tmp_path: Path) -> None:
    values = write_mask(tmp_path / "fade.vdb", value=3.0)  # nothing is clamped here
    frames = frames_of(make_stage(tmp_path))
    for code, frame in enumerate(frames, 1):
        assert frame.mask is not None and frame.mask_to_stage is not None
        np.testing.assert_array_equal(frame.mask.values, values)
        assert frame.mask.ijk_min == (-4, 0, 1)
        np.testing.assert_array_equal(frame.mask.index_to_world, uniform(2.0))
        first = np.array([-4, 0, 1, 1]) @ frame.mask.index_to_world @ frame.mask_to_stage
        np.testing.assert_allclose(first, [-11, 0, 4, 1])
        np.testing.assert_array_equal(frame.density.values, code)
        np.testing.assert_array_equal(frame.density_to_stage, np.eye(4))


@pytest.mark.usefixtures("quick_grids")
def test_a_grid_of_the_densitys_file_is_a_mask_where_the_density_lies(tmp_path: Path) -> None:
    write_vdb(tmp_path / "smoke.vdb", ("density", "fade"), value=0.75)
    body = volume_prim(density_prim("asset filePath = @./smoke.vdb@", extra=PLACED))
    (frame,) = frames_of(write_text(tmp_path / "s.usda", world(body)))
    assert frame.mask is not None and frame.mask_to_stage is not None
    assert frame.mask.name == "fade"
    np.testing.assert_array_equal(frame.mask.values, np.full((4, 3, 2), 0.75))
    np.testing.assert_array_equal(frame.mask_to_stage, frame.density_to_stage)
    assert frame.mask_to_stage[3, 0] == 5.0


@pytest.mark.usefixtures("quick_grids")
def test_a_mask_field_of_the_volume_comes_before_a_grid_of_that_name(tmp_path: Path) -> None:
    values = write_mask(tmp_path / "fade.vdb")
    stage = make_stage(tmp_path, time_codes=[1])
    write_vdb(tmp_path / "cache/smoke.0001.vdb", ("density", "fade"), value=9.0)
    (frame,) = frames_of(stage)
    assert frame.mask is not None
    np.testing.assert_array_equal(frame.mask.values, values)


@pytest.mark.usefixtures("quick_grids")
def test_a_masks_fieldindex_tells_grids_of_one_name_apart(tmp_path: Path) -> None:
    grids = [raw_grid(np.full((1, 1, 1), value), "weight") for value in (0.25, 0.5)]
    write_raw(tmp_path / "fade.vdb", *grids)
    stage = make_stage(tmp_path, grid='token fieldName = "weight"\nint fieldIndex = 1')
    frame = frames_of(stage)[0]
    assert frame.mask is not None and frame.mask.values.item() == 0.5
    assert plan_of(stage).to_dict()["frames"][0]["mask"] == "weight[1]"


@pytest.mark.usefixtures("quick_grids")
@pytest.mark.parametrize(
    ("codes", "expected"), [((1, 2, 3), [0.1, 0.2, 0.3]), ((1, 3), [0.1, 0.1, 0.3])]
)
def test_an_animated_mask_is_held_between_its_own_time_samples(
    tmp_path: Path, codes: tuple[int, ...], expected: list[float]
) -> None:
    for code in codes:
        write_mask(tmp_path / f"fade.{code}.vdb", code / 10)
    files = sampled("asset filePath", {code: f"@./fade.{code}.vdb@" for code in codes})
    frames = frames_of(make_stage(tmp_path, files))
    found = [frame.mask.values.max() for frame in frames if frame.mask is not None]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_a_mask_in_neither_place_is_refused_with_what_there_is(tmp_path: Path) -> None:
    write_vdb(tmp_path / "smoke.vdb", ("density", "heat"))
    relations = "\n".join(f"rel field:{n} = </World/smoke/density>" for n in ("density", "dust"))
    body = density_prim("asset filePath = @./smoke.vdb@")
    stage = write_text(tmp_path / "s.usda", world(volume_prim(body, relations=relations)))
    message = (
        r'mask "fade".*</World/smoke>.*density, dust\).*smoke\.vdb.*density, heat\).*stage\.mask'
    )
    for settings in ([], ["optimize.strength=0"]):  # a wrong name is wrong even when not needed
        with pytest.raises(GridNotFound, match=message):
            plan_of(stage, *settings)


def test_a_mask_whose_file_has_no_such_grid_is_refused(tmp_path: Path) -> None:
    write_mask(tmp_path / "fade.vdb", name="other")
    message = r'fade\.vdb \(mask, field </World/smoke/fade>, timeCode 1\).*grid "weight".*other'
    with pytest.raises(GridNotFound, match=message):
        plan_of(make_stage(tmp_path))


def test_a_mask_relationship_that_leads_nowhere_is_refused(tmp_path: Path) -> None:
    stage = make_stage(tmp_path)
    write_text(stage, stage.read_text().replace("</World/smoke/fade>", "</World/none>"))
    message = r'relationship "field:fade" of Volume </World/smoke> leads to </World/none>'
    with pytest.raises(FieldNotFound, match=message):
        plan_of(stage)


def test_a_missing_mask_file_and_a_gap_are_refused_with_their_timecode(tmp_path: Path) -> None:
    stage = make_stage(tmp_path)
    with pytest.raises(AssetNotResolved, match=r"</World/smoke/fade> at timeCode 1 is @./fade.vdb"):
        plan_of(stage)
    write_mask(tmp_path / "fade.vdb")
    files = sampled("asset filePath", {1: "@./fade.vdb@", 2: "None", 3: "@./fade.vdb@"})
    stage = make_stage(tmp_path, files)
    with pytest.raises(
        AssetNotResolved, match=r"mask </World/smoke/fade> .*no filePath at timeCode 2"
    ):
        plan_of(stage)
    assert len(plan_of(stage, "stage.frames=3").volumes[0].frames) == 1


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("vector", "3 components per voxel.* 1"),
        ("level set", "is a level set"),
        ("bool", "holds bool values.*float"),
    ],
)
def test_a_grid_that_is_no_field_of_numbers_is_no_mask(
    tmp_path: Path, kind: str, reason: str
) -> None:
    grid = openvdb().BoolGrid() if kind == "bool" else raw_grid(
        np.ones((2, 2, 2, 3) if kind == "vector" else (2, 2, 2)), "weight",
        grid_class="level set" if kind == "level set" else "unknown",
    )  # fmt: skip
    grid.name = "weight"
    write_raw(tmp_path / "fade.vdb", grid)
    with pytest.raises(UnsupportedGrid, match=rf"mask, field </World/smoke/fade>.*{reason}"):
        plan_of(make_stage(tmp_path))


def test_a_mask_that_is_scaled_to_nothing_is_refused(tmp_path: Path) -> None:
    write_mask(tmp_path / "fade.vdb")
    stage = make_stage(tmp_path)
    write_text(stage, stage.read_text().replace("(2, 2, 2)", "(2, 0, 2)"))
    message = r"the transform of </World/smoke/fade> at timeCode 1 has a scale of 0"
    with pytest.raises(StageError, match=message):
        plan_of(stage)


@pytest.mark.usefixtures("quick_grids")
def test_nan_in_a_mask_is_refused_or_repaired_as_in_a_density(tmp_path: Path) -> None:
    write_raw(tmp_path / "fade.vdb", raw_grid(np.full((1, 1, 2), np.nan), "weight"))
    stage = make_stage(tmp_path, time_codes=[1])
    with pytest.raises(NonFiniteError, match=r"mask, field </World/smoke/fade>.*has 2 NaN"):
        frames_of(stage)
    (frame,) = frames_of(stage, "grids.repair_nan=1")
    assert frame.mask is not None
    np.testing.assert_array_equal(frame.mask.values, 1.0)

"""An output folder, or all of a shot, that is reached through a link."""

import dataclasses
from pathlib import Path

import pytest
from pxr import Usd

from tests.fixtures.farm_fixtures import WINDOWS, outcome, windows_in
from tests.fixtures.pipeline_fixtures import Shot, contents, run
from usdsmoke.base.naming import relative_asset_path
from usdsmoke.pipeline import assemble, plan


@pytest.fixture
def linked(farm: Shot) -> Shot:
    """The same shot with an output folder that lies deeper than the link that leads to it."""
    (farm.folder / "far/away").mkdir(parents=True)
    link = farm.folder / "link"
    link.symlink_to(farm.folder / "far/away", target_is_directory=True)
    return dataclasses.replace(farm, output=link / "out")


def real(shot: Shot) -> Shot:
    return dataclasses.replace(shot, output=shot.folder / "far/away/out")


def test_a_result_made_through_a_link_opens_in_its_real_folder(linked: Shot) -> None:
    result = run(linked, *WINDOWS)
    assert result.root_stage == real(linked).output / "shot_look.usda"
    assert len(contents(result.root_stage)) == 8


def test_the_plan_says_where_a_result_opens_that_a_link_leads_to(linked: Shot) -> None:
    (linked.folder / "near").symlink_to(linked.folder / "far", target_is_directory=True)
    for output, is_told in ((linked.output, True), (linked.folder / "near/away/out", False)):
        notes = plan(linked.stage, linked.style, output).notes
        told = [note for note in notes if str(real(linked).output) in note]
        assert bool(told) == is_told


def test_parts_made_through_a_link_and_without_it_are_one_run_and_one_stage(linked: Shot) -> None:
    windows_in(linked, [0, 2])
    windows_in(real(linked), [1])
    first = assemble(linked.output)
    assert len(list(linked.output.glob("vdb/*"))) == 1
    made, root = outcome(first.root_stage), first.root_stage.read_bytes()
    again = run(real(linked), *WINDOWS, "stage.frames=2")
    assert (outcome(again.root_stage), again.root_stage.read_bytes()) == (made, root)


def test_a_whole_tree_behind_a_link_opens_by_either_name(farm: Shot, tmp_path: Path) -> None:
    tree = tmp_path / "projects"
    tree.symlink_to(farm.folder, target_is_directory=True)
    run(dataclasses.replace(farm, stage=tree / "in/shot.usda", output=tree / "out"), *WINDOWS)
    for folder in (farm.folder, tree):
        stage = Usd.Stage.Open(str(folder / "out/shot_look.usda"))
        assert stage.GetPrimAtPath("/World/smoke/density").IsValid()
        assert len(contents(folder / "out/shot_look.usda")) == 8


def test_a_link_to_an_inputs_folder_is_kept_where_it_is_no_detour(tmp_path: Path) -> None:
    (tmp_path / "v12").mkdir()
    (tmp_path / "latest").symlink_to(tmp_path / "v12", target_is_directory=True)
    file_path = tmp_path / "latest/shot.usda"
    assert relative_asset_path(file_path, tmp_path / "out") == "../latest/shot.usda"

"""Whether extinction and lamps suit the smoke: found in reports, with cause and remedy."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.fixtures.budget_fixtures import GOOD, SCENE, budget_of
from usdsmoke.base.frame_report import (
    Estimate,
    FrameErrors,
    LightReport,
    SightReport,
)
from usdsmoke.config.settings import Config
from usdsmoke.runs.budget.findings import find_frame


@pytest.mark.parametrize(
    ("change", "settings", "wanted"),
    [
        ({"thick_share": 0.003}, [], "optics.gamma"),
        ({"thick_share": 0.003}, ["optics.gamma=1"], "optics.gamma_shape"),
        ({"hidden": 0.4}, [], "optics.percentile"),
        ({"gamma_w": 1e4}, ["optics.gamma=1000"], "optics.gamma"),
        ({"gamma_w": 1e-4}, ["optics.gamma=1e-6"], "optics.gamma"),
        ({"gamma_w": 1e-4}, ["optics.depth=1e-4"], "optics.depth"),
        ({"gamma_w_shape": 1e-30}, ["optics.gamma_shape=1e-30"], "optics.gamma_shape"),
    ],
)
def test_an_extinction_that_does_not_suit_the_smoke_is_named(
    change: dict[str, float], settings: list[str], wanted: str, tmp_path: Path
) -> None:
    (finding,) = budget_of(tmp_path, [GOOD], SCENE | change, settings).findings
    assert finding.setting == wanted and finding.place.startswith("/")


@pytest.mark.parametrize(
    ("sight", "wanted"),
    [
        (None, []),
        (SightReport(0.0, 0.0), []),
        (SightReport(0.05, 0.005), []),
        (SightReport(0.3, 0.0), ["inside"]),
        (SightReport(0.0, 0.2), ["clipping"]),
    ],
)
def test_smoke_right_before_a_camera_or_its_clipping_planes_is_named(
    sight: SightReport | None, wanted: list[str], tmp_path: Path
) -> None:
    found = budget_of(tmp_path, [replace(GOOD, sight=sight)]).findings
    assert len(found) == len(wanted)
    assert all(word in finding.cause for word, finding in zip(wanted, found, strict=True))


@pytest.mark.parametrize(("widened", "named"), [(1.0, 0), (1.2, 0), (4.2, 1)])
def test_voxels_far_away_that_make_pictures_coarse_are_named(
    widened: float, named: int, tmp_path: Path
) -> None:
    budget = budget_of(tmp_path, [GOOD], SCENE | {"widened": widened})
    assert [finding.setting for finding in budget.findings] == ["views.image_size"] * named


@pytest.mark.parametrize(
    ("depth", "settings", "wanted"),
    [
        (3e4, [], ["optics.frames"]),
        (0.03, [], ["optics.frames"]),
        (6000.0, ["optics.percentile=0.001"], ["optics.percentile"]),
        (60.0, [], []),
        (3e4, ["optics.depth=1e4"], []),
        (0.03, ["optics.depth=1"], []),
    ],
)
def test_a_frame_far_from_the_depth_that_is_asked_for_is_named(
    depth: float, settings: list[str], wanted: list[str], tmp_path: Path
) -> None:
    found = budget_of(tmp_path, [GOOD, replace(GOOD, depth=depth)], settings=settings).findings
    assert [finding.setting for finding in found] == wanted
    assert all(finding.place.endswith(".0002.vdb") for finding in found)


@pytest.mark.parametrize("settings", [[], ["optics.frames=1"]])
def test_a_frame_that_chose_the_extinction_itself_is_given_another_depth(
    settings: list[str], tmp_path: Path
) -> None:
    reports = [replace(GOOD, depth=600.0)] * (1 + len(settings))
    finding, *_ = budget_of(tmp_path, reports, settings=settings).findings
    assert finding.setting == "optics.depth" and "optics.depth=1.5 " in finding.remedy
    set_by_hand = replace(GOOD, depth=600.0, gamma_is_set=True)
    assert budget_of(tmp_path / "set", [set_by_hand], settings=settings).findings == ()


def test_a_frame_beside_the_measured_ones_has_the_choice_of_frames_to_blame(
    tmp_path: Path,
) -> None:
    reports = [GOOD, replace(GOOD, depth=3e4)]
    (finding,) = budget_of(tmp_path, reports, settings=["optics.frames=1"]).findings
    assert finding.setting == "optics.frames" and "Unset optics.frames" in finding.remedy


@pytest.mark.parametrize(("depth", "wanted"), [(30.0, "grids.refine"), (600.0, "optics.gamma")])
def test_pictures_of_smoke_that_is_too_opaque_are_not_mended_by_finer_voxels(
    depth: float, wanted: str
) -> None:
    report = replace(
        GOOD, depth=depth, gamma_is_set=True, errors=FrameErrors(resolution=Estimate(0.8))
    )
    (finding,) = find_frame("a.vdb", report, Config())
    assert finding.setting == wanted and wanted in finding.remedy
    low = Config(optics=Config().optics.replace(percentile=5.0))
    (finding,) = find_frame("a.vdb", replace(report, gamma_is_set=False), low)
    assert finding.setting == ("grids.refine" if depth < 50 else "optics.percentile")


@pytest.mark.parametrize(("light", "named"), [(1.0, 0), (1e6, 1), (1e-6, 1)])
def test_light_that_leaves_no_albedo_or_no_emission_is_named(
    light: float, named: int, tmp_path: Path
) -> None:
    sky = f"optics.sky=[{light},{light},{light}]"
    found = budget_of(tmp_path, [GOOD], settings=[sky, "colour.target=both"]).findings
    assert [finding.setting for finding in found] == ["optics.exposure"] * named
    assert budget_of(tmp_path / "glow", [GOOD], settings=[sky]).findings == ()


@pytest.mark.parametrize(
    ("outshone", "setting"), [(0.9, "optics.exposure"), (0.0, "colour.target")]
)
def test_a_red_light_that_outshines_the_style_is_too_bright_before_it_is_too_red(
    outshone: float, setting: str
) -> None:
    red = LightReport(share=1.0, outshone=outshone, reach=1.0, advised=-13.0, faintest=0.0)
    (finding,) = find_frame("a.vdb", replace(GOOD, light=red), Config())
    assert finding.setting == setting


def test_an_extinction_of_a_step_that_is_not_run_does_not_matter(tmp_path: Path) -> None:
    scene = SCENE | {"gamma_w_shape": 1e-30}
    assert budget_of(tmp_path, [GOOD], scene, ["optimize.steps=[colour]"]).findings == ()


@pytest.mark.parametrize(("depth", "named"), [(6e-6, True), (4.0, False), (1e3, True)])
def test_an_animated_gamma_that_does_not_suit_a_frame_is_named(
    depth: float, named: bool, tmp_path: Path
) -> None:
    own = replace(GOOD, depth=depth, gamma_is_set=True, gamma_is_own=True)
    found = budget_of(tmp_path, [GOOD, own]).findings
    assert [finding.setting for finding in found] == ["optics.gamma"] * named

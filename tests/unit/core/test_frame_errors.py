"""Which errors of a finished frame are estimated, and from how many views."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from tests.fixtures.smoke_fixtures import frame_of, puff, random_style
from tests.fixtures.stylize_fixtures import quick_config, run_core, scene_of
from usdsmoke.base.frame_report import FrameErrors, FrameReport
from usdsmoke.core.sequence.error_estimates import unseen_views
from usdsmoke.core.sequence.frame_loop import run_frames
from usdsmoke.core.sequence.frame_state import make_context
from usdsmoke.runs.budget.light_findings import find_depth

ALL_ROUND: Mapping[str, Any] = {"pool": 4, "image_size": 16}


def report_of(views: Mapping[str, Any] = ALL_ROUND, budget: bool = True) -> FrameReport:
    config = quick_config(views=views, optimize={"error_budget": budget})
    return run_core([frame_of(puff(10))], config)[0].report


def test_equal_views_are_not_compared_with_each_other() -> None:
    front = {**ALL_ROUND, "azimuth": 0.0, "elevation": 0.0}
    one, many = report_of(front), report_of()
    for step in one.steps.values():
        assert step.view_spread is None
    assert many.errors.unseen_views is not None and many.last_step.view_spread is not None
    assert one.errors.unseen_views is None
    assert one.errors.resolution is not None and one.errors.quadrature is not None


@pytest.mark.parametrize("angles", [{"azimuth": 0.0}, {"elevation": 0.0}])
def test_views_on_a_line_are_compared(angles: Mapping[str, float]) -> None:
    report = report_of({**ALL_ROUND, **angles})
    assert report.errors.unseen_views is not None and report.last_step.view_spread is not None


@pytest.mark.parametrize("colour", [{"iterations": [2, 8]}, {"iterations": [2, 0]}])
def test_maps_of_the_pool_tell_the_same_as_maps_made_anew(colour: Mapping[str, Any]) -> None:
    """Without iterations of the finest octave there are none of the pool."""
    painted = {**colour, "occlusion": 0.0}  # colours are compared as they are painted
    config = quick_config(views=ALL_ROUND, optimize={"error_budget": True}, colour=painted)
    frames = [frame_of(puff(10))]
    context = make_context([random_style()], scene_of(frames, config), config, None, 24.0, None, 1)
    (frame,) = run_frames(frames, context)
    (report,) = (done.report for done in run_core(frames, config))
    again = unseen_views(frame, frame.colour_problem(), frame.colours)
    assert (frame.unseen is None) == (colour["iterations"][-1] == 0)
    assert again is not None and again.value > 0 and report.errors.unseen_views is not None
    assert report.errors.unseen_views.value == pytest.approx(again.value, rel=1e-3)


def test_the_opacity_of_a_frame_is_known_without_a_budget_too() -> None:
    report = report_of(budget=False)
    assert report.errors == FrameErrors()
    assert report.depth == pytest.approx(30, rel=0.2)  # the default of optics.depth


@pytest.mark.parametrize("axis", [0, 2])
def test_smoke_that_is_long_in_one_direction_has_other_depths_from_its_sides(axis: int) -> None:
    """The middle view looks along z, so a cylinder along z is thin from all others."""
    cylinder = np.ones((4, 4, 4), np.float32).repeat(10, axis)
    config = quick_config(views=ALL_ROUND, optimize={"steps": ["colour"]})
    (frame,) = run_core([frame_of(cylinder)], config)
    least, most = frame.report.depth_by_side
    assert most / least == pytest.approx(10, rel=0.1)
    assert (least if axis == 0 else most) == pytest.approx(frame.report.depth, rel=0.01)
    (finding,) = find_depth("a.vdb", frame.report, config.optics)
    assert finding.setting == "optics.depth"
    puff_report = report_of(budget=False)
    assert puff_report.depth_by_side[1] < 1.3 * puff_report.depth_by_side[0]
    assert not list(find_depth("a.vdb", puff_report, config.optics))

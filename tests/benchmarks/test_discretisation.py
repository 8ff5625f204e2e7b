"""The sweeps of benchmarks.discretisation run, and exact cases are exact."""

from pathlib import Path

import pytest
import torch

from benchmarks.discretisation.__main__ import SWEEPS
from benchmarks.discretisation.quadrature_rules import integrate
from tests.fixtures.report_fixtures import case_of, make_scene


@pytest.mark.usefixtures("quick_grids")
@pytest.mark.parametrize("sweep", SWEEPS, ids=lambda sweep: sweep.name)
def test_the_configured_point_of_each_sweep_has_a_small_error(sweep, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    case = case_of(make_scene(tmp_path))
    assert sweep.applies(case) == ""
    plan = sweep.plan(case)
    (task,) = [task for task in plan.tasks if task.configured]
    assert 0 < task.error(task.work(0)) < 0.5


def test_exponential_segments_are_exact_in_a_slab_of_one_colour() -> None:
    sigma = torch.full((4, 1), 30.0, dtype=torch.float64)
    found = float(integrate("segments", 0.25 * sigma, sigma, 0.25))
    assert found == pytest.approx(0.25 * (1 - 2.718281828459045**-30), rel=1e-14)

"""Benchmarks of iterations run on a few voxels, and a cost that grows is said to."""

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks import equal_loss, scaling, scaling_cases, shape_cost


@pytest.fixture(autouse=True)
def same_threads() -> Iterator[None]:
    """As many threads after a test as before it."""
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def test_peers_measures_finite_costs_and_the_network_has_its_part() -> None:
    whole, bare = (
        shape_cost.measure_case(shape_cost.Case("embedded", 2, 1, network, 4, (10, 14, 10)))
        for network in (True, False)
    )
    assert all(math.isfinite(value) for value in vars(whole).values() if isinstance(value, float))
    assert whole.cpu_s > bare.cpu_s > 0 and whole.peak_gib <= whole.whole_peak_gib


@pytest.mark.parametrize(("power", "met"), [(0.0, True), (1.0, False)])
def test_a_cost_that_grows_with_the_box_misses_the_mark(
    power: float, met: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cost = scaling_cases.Cost(1000, 0.5, 0.4, 1.0, 0.2, 2.0)

    def measured(case: scaling_cases.Case) -> scaling_cases.Cost:
        volume = 1e-3 * (case.side / 32) ** (3 * power)
        return replace(cost, network_s=0.001, seconds=0.001 + volume)

    monkeypatch.setattr(scaling, "measure_in_child", measured)
    monkeypatch.setattr(scaling, "measure_peak", lambda: 50.0)
    file_path = tmp_path / "scaling.md"
    assert scaling.main(["--series", "padded", "--report", str(file_path)]) == 0
    report = file_path.read_text(encoding="utf-8")
    assert f"box^{power:.2f}" in report
    assert (": met)" in report, ": missed)" in report) == (met, not met)


@pytest.mark.parametrize("step", ["shape", "colour"])
def test_the_quick_comparison_runs_and_judges_both_sides(step: str, tmp_path: Path) -> None:
    report = tmp_path / "equal.md"
    options = ["--quick", "--scenes", "plume", "real_plume", "--data", str(tmp_path)]
    assert equal_loss.main([*options, "--steps", step, "--report", str(report)]) == 0
    (found,) = json.loads(report.with_suffix(".json").read_text(encoding="utf-8"))["comparisons"]
    assert len(found["baseline"]) == 2 and found["ours"]
    losses = [point["verdict"]["loss"] for point in [*found["baseline"], *found["ours"].values()]]
    assert np.isfinite(losses).all()

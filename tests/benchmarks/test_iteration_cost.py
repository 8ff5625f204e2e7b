"""Benchmarks of iterations: costs of `peers` and `scaling`, time to an equal loss."""

import json
import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks import equal_loss, equal_report, peers, scaling, scaling_cases, shape_cost
from benchmarks.equal_judge import Verdict
from benchmarks.equal_report import Comparison, Point
from usdsmoke.core.style.vgg19 import Vgg19Features

TINY = (10, 14, 10)


@pytest.fixture(autouse=True)
def same_threads() -> Iterator[None]:
    """As many threads after a test as before it."""
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


@pytest.mark.parametrize("scattered", [False, True])
def test_the_share_of_voxels_asked_for_holds_smoke(scattered: bool) -> None:
    density = shape_cost.make_plume((24, 36, 24), shape_cost.SHARE, scattered=scattered)
    assert density.max() == 1 and density.min() == 0
    assert (density > 0).mean() == pytest.approx(shape_cost.SHARE, rel=0.01)


@pytest.mark.parametrize("features", ["embedded", "vgg19"])
def test_peers_measures_finite_costs_and_network_and_voxels_have_their_part(features: str) -> None:
    whole, bare = (
        shape_cost.measure_case(shape_cost.Case(features, 2, 1, network, 4, TINY))
        for network in (True, False)
    )
    assert all(math.isfinite(value) for value in vars(whole).values() if isinstance(value, float))
    assert whole.cpu_s > bare.cpu_s > 0 and whole.peak_gib <= whole.whole_peak_gib
    assert whole.voxels == np.count_nonzero(shape_cost.make_plume(TINY))


def test_the_random_parameter_file_is_taken_for_vgg19(tmp_path: Path) -> None:
    shape_cost.write_vgg19(tmp_path / "random.pth")
    network = Vgg19Features.from_file(str(tmp_path / "random.pth"))
    maps = network(torch.rand(8, 8, 3), frozenset({"relu3_1"}))["relu3_1"]
    assert maps.shape == (1, 256, 2, 2) and maps.std() > 0.1


def test_a_cost_above_the_mark_is_reported_as_missed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cost = shape_cost.Cost(0.5, 0.4, 1.0, 0.1, 0.3, 0.2, 0.25, 76972, (40, 130, 40))
    for seconds, missed in ((1.0, False), (1.5, True)):

        def measured(case: shape_cost.Case, whole: float = seconds) -> shape_cost.Cost:
            return replace(cost, cpu_s=whole if case.network else 0.4)

        monkeypatch.setattr(peers, "measure_in_child", measured)
        assert peers.main(["--iterations", "3", "--report", str(tmp_path / "peers.md")]) == 0
        assert ("missed" in capsys.readouterr().out) is missed
    rows = (tmp_path / "peers.md").read_text(encoding="utf-8").splitlines()
    n_cases = sum(case.network for case in peers.list_cases(3))
    assert len([row for row in rows if row.startswith(("| plume", "| scattered"))]) == n_cases


def test_a_case_runs_in_a_process_of_its_own_and_a_failing_one_is_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = scaling_cases.Case("colour", 16, 0.3, image_size=16, iterations=3)
    assert scaling.measure_in_child(case).seconds > 0
    monkeypatch.setattr(sys, "executable", "false")
    with pytest.raises(RuntimeError, match="1"):
        scaling.measure_in_child(case)


def test_the_networks_part_grows_with_the_pictures_and_is_below_the_whole() -> None:
    small, large = (
        scaling_cases.measure_case(
            scaling_cases.Case("colour", side, 0.3, image_size=side, iterations=2)
        )
        for side in (16, 32)
    )
    assert 0 < small.network_s < small.seconds and 0 < small.share < 1
    assert 3 < large.network_gflop / small.network_gflop < 5  # four times the pixels
    assert small.voxels == pytest.approx(0.3 * 16**3, rel=0.01)


def test_exponents_of_powers_are_found_and_padding_adds_empty_space_alone() -> None:
    assert scaling.fit_exponent([1, 10, 100], [3, 30, 300]) == pytest.approx(1)
    assert scaling.fit_exponent([8, 64, 512], [2, 2, 2]) == pytest.approx(0)
    small, large = (
        scaling_cases.make_smoke(scaling_cases.Case("shape", side, layout="padded"))
        for side in (32, 40)
    )
    assert np.array_equal(large[4:36, 4:36, 4:36], small) and large.sum() == small.sum()


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


def test_the_ratio_is_of_the_baselines_end_and_the_quickest_of_ours_as_good() -> None:
    def points(*values: tuple[int, float, float]) -> list[Point]:
        return [Point(n, seconds, Verdict(loss)) for n, seconds, loss in values]

    def comparison(ours: list[Point]) -> Comparison:
        baseline = points((10, 20.0, 3.0), (20, 40.0, 2.0), (30, 60.0, 2.5))
        found = Comparison("plume", "colour", (4, 5, 6), 60, Verdict(9.0), baseline)
        found.ours = {point.iterations: point for point in ours}
        return found

    good = comparison(points((5, 1.0, 2.6), (10, 2.0, 2.0), (20, 4.0, 1.5)))
    assert good.ratio(good.end) == pytest.approx(30.0)
    assert good.ratio(good.best) == pytest.approx(20.0)
    assert "| met |" in equal_report.render_report([good], "", ["x"])
    for bad in (points((5, 30.0, 1.0)), points((5, 1.0, 2.6))):  # slow; never as good
        assert "| missed |" in equal_report.render_report([comparison(bad)], "", ["x"])


@pytest.mark.parametrize("step", ["shape", "colour"])
def test_the_quick_comparison_runs_and_judges_both_sides(step: str, tmp_path: Path) -> None:
    report = tmp_path / "equal.md"
    options = ["--quick", "--scenes", "plume", "real_plume", "--data", str(tmp_path)]
    assert equal_loss.main([*options, "--steps", step, "--report", str(report)]) == 0
    (found,) = json.loads(report.with_suffix(".json").read_text(encoding="utf-8"))["comparisons"]
    assert len(found["baseline"]) == 2 and found["ours"]
    seconds = [point["cpu_s"] for point in found["baseline"]]
    assert seconds == sorted(seconds) and seconds[0] > 0
    losses = [point["verdict"]["loss"] for point in [*found["baseline"], *found["ours"].values()]]
    assert np.isfinite(losses).all()

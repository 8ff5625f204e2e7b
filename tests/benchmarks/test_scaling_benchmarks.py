"""Time to equal loss, and cost against size: the commands run, and say what they measured."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks import equal_loss, equal_report, scaling
from benchmarks.equal_judge import Verdict
from benchmarks.equal_report import Comparison, Point
from benchmarks.scaling import fit_exponent, list_cases, render_report
from benchmarks.scaling_cases import Case, Cost, make_smoke, measure_case, measure_peak
from usdsmoke.core.style.losses import StyleTarget

COST = Cost(1000, 0.5, 0.4, 1.0, 0.2, 2.0)


def points(*values: tuple[int, float, float]) -> list[Point]:
    return [Point(n, seconds, Verdict(loss)) for n, seconds, loss in values]


def comparison(ours: list[Point], baseline: list[Point]) -> Comparison:
    found = Comparison("plume", "colour", (4, 5, 6), 60, Verdict(9.0), baseline)
    found.ours = {point.iterations: point for point in ours}
    return found


def test_the_ratio_is_of_the_baseline_s_end_and_the_quickest_of_ours_as_good() -> None:
    baseline = points((10, 20.0, 3.0), (20, 40.0, 2.0), (30, 60.0, 2.5))
    found = comparison(points((5, 1.0, 2.6), (10, 2.0, 2.0), (20, 4.0, 1.5)), baseline)
    assert found.end.iterations == 30 and found.best.iterations == 20
    assert found.ratio(found.end) == pytest.approx(30.0)
    assert found.ratio(found.best) == pytest.approx(20.0)
    report = equal_report.render_report([found], "", ["x"])
    assert "| 30.0 | met |" in report and "30.0 times shorter (mark 10: met)" in report
    assert "| 20.0 | (its least loss) |" in report
    still_falling = comparison(points((5, 1.0, 0.1)), baseline[:2])
    assert still_falling.targets == [still_falling.best] == baseline[1:2]
    assert "| 2.0 | missed |" in equal_report.render_report(
        [comparison(points((5, 30.0, 1.0)), baseline)], "", ["x"]
    )
    assert "| not reached | missed |" in equal_report.render_report(
        [comparison(points((5, 1.0, 2.6)), baseline)], "", ["x"]
    )


@pytest.mark.parametrize("step", ["shape", "colour"])
def test_the_quick_comparison_runs_and_judges_both_sides(step: str, tmp_path: Path) -> None:
    threads = torch.get_num_threads()
    report = tmp_path / "equal.md"
    options = ["--quick", "--scenes", "plume", "real_plume", "--data", str(tmp_path)]
    try:
        code = equal_loss.main([*options, "--steps", step, "--report", str(report)])
    finally:
        torch.set_num_threads(threads)
    assert code == 0 and f"| {step} |" in report.read_text(encoding="utf-8")
    (found,) = json.loads(report.with_suffix(".json").read_text(encoding="utf-8"))["comparisons"]
    assert len(found["baseline"]) == 2 and found["ours"]
    seconds = [point["cpu_s"] for point in found["baseline"]]
    assert seconds == sorted(seconds) and seconds[0] > 0
    losses = [point["verdict"]["loss"] for point in [*found["baseline"], *found["ours"].values()]]
    assert np.isfinite(losses).all()


def test_an_unknown_scene_is_one_line_and_exit_code_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert equal_loss.main(["--scenes", "sea", "--report", str(tmp_path / "x.md")]) == 1
    assert "no scene 'sea'" in capsys.readouterr().err


@pytest.mark.parametrize("step", ["shape", "colour"])
def test_the_network_s_seconds_are_a_part_of_the_iteration_s(step: str) -> None:
    real = StyleTarget.loss
    threads = torch.get_num_threads()
    try:
        cost = measure_case(Case(step, 16, 0.3, image_size=16, views=2, iterations=4))
    finally:
        torch.set_num_threads(threads)
    assert StyleTarget.loss is real
    assert 0 < cost.network_s < cost.seconds and 0 < cost.share < 1
    assert cost.network_gflop > 0.01 and cost.voxels == pytest.approx(0.3 * 16**3, rel=0.01)


def test_convolutions_are_counted_by_their_size_and_the_peak_is_a_speed() -> None:
    small, large = (
        measure_case(Case("colour", side, 0.3, image_size=side, iterations=2)).network_gflop
        for side in (16, 32)
    )
    assert 3 < large / small < 5  # four times the pixels
    assert 0.1 < measure_peak(repeats=2) < 1e4


def test_padding_adds_empty_space_alone() -> None:
    small, large = (make_smoke(Case("shape", side, layout="padded")) for side in (32, 40))
    assert large.shape == (40, 40, 40) and np.array_equal(large[4:36, 4:36, 4:36], small)
    assert large.sum() == small.sum() and (small > 0).mean() == pytest.approx(0.6, abs=0.01)


def test_exponents_of_powers_are_found() -> None:
    assert fit_exponent([1, 10, 100], [3, 30, 300]) == pytest.approx(1)
    assert fit_exponent([8, 64, 512], [2, 2, 2]) == pytest.approx(0)


def test_every_series_has_both_steps_and_the_asked_for_range() -> None:
    cases = list_cases()
    assert {case.share for case in cases["active"]} == {0.01, 0.03, 0.1, 0.3, 1.0}
    assert {case.side for case in cases["volume"]} == {32, 64, 128, 256}
    assert {(c.side, c.share, c.image_size) for c in cases["network"]} == {(128, 0.1, 128)}
    assert all({case.step for case in found} == {"shape", "colour"} for found in cases.values())
    assert Counter(case.device for found in list_cases(device="cuda").values() for case in found)[
        "cuda"
    ] == sum(map(len, cases.values()))


def test_the_command_writes_tables_exponents_and_marks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def measured(case: Case) -> Cost:
        voxels = max(1, int(case.side**3 * case.share)) if case.layout != "padded" else 1000
        network = 0.4 if case.views == 9 else 0.001
        return replace(COST, voxels=voxels, network_s=network, seconds=network + 1e-6 * voxels)

    monkeypatch.setattr(scaling, "measure_in_child", measured)
    monkeypatch.setattr(scaling, "measure_peak", lambda: 50.0)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    file_path = tmp_path / "scaling.md"
    assert scaling.main(["--report", str(file_path)]) == 0
    report = file_path.read_text(encoding="utf-8")
    assert "- colour: volume part ~ voxels^1.00; over the last three sizes ^1.00" in report
    assert "- colour: volume part ~ box^0.00 (mark -0.1 to 0.1: met)" in report
    assert "- plume, 9 views an iteration: 66% of 40 iterations of shape and 120" in report
    assert "- plume, 1 view an iteration: 0% of 40 iterations of shape and 120" in report
    values: dict[str, Any] = json.loads(file_path.with_suffix(".json").read_text(encoding="utf-8"))
    rows = values["active"]["rows"]
    assert len(rows) == 10 and rows[0][0]["step"] == "shape" and rows[0][1]["peak_gib"] == 0.2
    assert values["active"]["circumstances"] and values["active"]["peak_gflops"] == 50.0
    monkeypatch.setattr(scaling, "measure_peak", lambda: 70.0)
    assert scaling.main(["--series", "padded", "--report", str(file_path)]) == 0
    report = file_path.read_text(encoding="utf-8")  # one series anew, the others as they were
    assert "50 (active), 70 (padded)" in report and report.count("Made (") == 2


def test_a_case_runs_in_a_process_of_its_own_and_a_failing_one_is_told() -> None:
    case = Case("colour", 16, 0.3, image_size=16, iterations=3)
    assert scaling.measure_in_child(case).seconds > 0
    with pytest.raises(RuntimeError, match="ended with 1"):
        scaling.measure_in_child(replace(case, device="none"))


def test_a_report_with_some_series_only_is_whole() -> None:
    costs = {"padded": [(Case("shape", n, layout="padded"), COST) for n in (32, 64)]}
    report = render_report(costs, {"padded": scaling.Made(["- x"], 10.0)})
    assert "## The same smoke in larger boxes" in report and "## More smoke" not in report

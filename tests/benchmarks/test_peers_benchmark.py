"""The comparison with the reference code, on a few voxels: it measures what it says."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks import peers
from benchmarks.peers import list_cases, main, measure_in_child, render_report
from benchmarks.shape_cost import (
    SHAPE,
    SHARE,
    Case,
    Cost,
    make_plume,
    measure_case,
    write_vgg19,
)
from usdsmoke.core.style.losses import StyleTarget
from usdsmoke.core.style.vgg19 import Vgg19Features

TINY = (10, 14, 10)
COST = Cost(0.5, 0.4, 1.0, 0.1, 0.3, 0.2, 0.25, 76972, (40, 130, 40))


@pytest.fixture(autouse=True)
def same_threads() -> Iterator[None]:
    """As many threads after a test as before it."""
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


@pytest.mark.parametrize("scattered", [False, True])
def test_the_share_of_voxels_asked_for_holds_smoke(scattered: bool) -> None:
    density = make_plume((24, 36, 24), SHARE, scattered=scattered)
    assert density.dtype == np.float32 and density.max() == 1 and density.min() == 0
    assert (density > 0).mean() == pytest.approx(SHARE, rel=0.01)
    assert np.array_equal(density, make_plume((24, 36, 24), SHARE, scattered=scattered))


def test_scattered_smoke_fills_the_box_and_a_plume_does_not() -> None:
    boxes = [
        np.ptp(np.argwhere(make_plume((48, 72, 48), scattered=s) > 0), axis=0) + 1
        for s in (False, True)
    ]
    assert boxes[0][0] < 30 and boxes[0][1] > 60
    assert (boxes[1] >= [44, 66, 44]).all()


@pytest.mark.parametrize("features", ["embedded", "vgg19"])
def test_a_case_is_measured_an_iteration_at_a_time(features: str) -> None:
    cost = measure_case(Case(features, 2, 1, True, 4, TINY))
    numbers = [value for value in vars(cost).values() if isinstance(value, float)]
    assert all(map(math.isfinite, numbers))
    assert 0 < cost.cpu_s < 5 and cost.wall_s > 0 and cost.base_gib > 0.05
    assert cost.peak_gib <= cost.whole_peak_gib
    assert cost.voxels == np.count_nonzero(make_plume(TINY))


def test_without_the_network_no_picture_is_judged_and_the_loss_comes_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    judged: list[int] = []
    real = StyleTarget.loss

    def noted(self: StyleTarget, picture: torch.Tensor, *more: object) -> torch.Tensor:
        judged.append(len(picture))
        return real(self, picture, *more)  # type: ignore[arg-type]

    monkeypatch.setattr(StyleTarget, "loss", noted)
    measure_case(Case("embedded", 2, 1, False, 3, TINY))
    warm_up = len(judged)
    measure_case(Case("embedded", 2, 1, True, 3, TINY))
    assert warm_up >= 1 and StyleTarget.loss is noted
    assert len(judged) >= 2 * warm_up + 3 * 2  # its own warm-up, and each view of each iteration


def test_the_parameter_file_is_taken_for_vgg19(tmp_path: Path) -> None:
    write_vgg19(tmp_path / "random.pth")
    network = Vgg19Features.from_file(str(tmp_path / "random.pth"))
    maps = network(torch.rand(8, 8, 3), frozenset({"relu3_1"}))["relu3_1"]
    assert maps.shape == (1, 256, 2, 2) and maps.std() > 0.1


def test_a_case_runs_in_a_process_of_its_own_and_a_failing_one_is_told() -> None:
    cost = measure_in_child(Case("embedded", 1, 1, True, 3, TINY))
    assert cost.cpu_s > 0 and cost.box == tuple(
        np.ptp(np.argwhere(make_plume(TINY) > 0), axis=0) + 1
    )
    with pytest.raises(RuntimeError, match="ended with 1"):
        measure_in_child(Case("no network", 1, 1, True, 3, TINY))


def test_the_table_has_a_row_for_each_case_with_its_ratios_and_misses_are_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def measured(case: Case) -> Cost:
        return Cost(**{**vars(COST), "cpu_s": 1.5 if case.network else 0.6})

    monkeypatch.setattr(peers, "measure_in_child", measured)
    assert main(["--iterations", "3", "--report", str(tmp_path / "peers.md")]) == 0
    report = (tmp_path / "peers.md").read_text(encoding="utf-8")
    rows = [line for line in report.splitlines() if line.startswith(("| plume", "| scattered"))]
    assert len(rows) == sum(case.network for case in list_cases(3))
    assert (
        "| 1.500 | 12.98 | 0.116 |" in rows[0] and "| 60% | 0.25 (0.20) | 0.66 | 0.38 |" in rows[0]
    )
    assert "missed: embedded: 1.500 CPU s, wanted at most 1.298" in capsys.readouterr().out
    assert f"{' x '.join(map(str, SHAPE))} voxels" in report


def test_the_quick_cases_are_among_all_and_rows_of_one_thread_know_the_network_s_share() -> None:
    cases = list_cases(8)
    assert set(list_cases(8, quick=True)) <= set(cases)
    report = render_report(dict.fromkeys(cases, COST), [])
    rows = [row.split("|")[1:-1] for row in report.splitlines() if row.startswith("| ")]
    assert {len(row) for row in rows} == {15}
    assert [bool(row[8].strip()) for row in rows] == [row[3].strip() != "all" for row in rows]

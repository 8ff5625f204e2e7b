"""Benchmarks of cameras, fades, windows and warm starts, on a few voxels."""

import numpy as np
import pytest

from benchmarks import fades
from benchmarks.camera_cost import half_out, near_eye
from benchmarks.coherence_runs import make_shot
from benchmarks.warm_starts import measure_step
from benchmarks.window_cost import Cost, render_report
from tests.fixtures.smoke_fixtures import frame_of, puff, random_style

PLAIN = ["features.layers=[oriented1]", "optimize.error_budget=false"]
QUICK = [
    "colour.iterations=[2]", "shape.iterations=[1]", "views.pool=2", "views.image_size=24",
    "features.layers=[oriented1]",
]  # fmt: skip


def test_half_of_the_smoke_is_half_of_the_work_and_each_camera_has_its_result(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("benchmarks.camera_cost.painted_waves", random_style)
    found = half_out(24, QUICK, 1)
    voxels = [found[name][1] for name in ("no camera", "whole", "half")]
    assert voxels[0] == voxels[1] and voxels[2] / voxels[0] == pytest.approx(0.5, abs=0.01)
    errors = [error for _, _, error in found.values()]
    assert min(errors) > 0 and len(set(errors)) == 3
    near = near_eye(16, [1.0], QUICK)[1.0]
    parallel, perspective = near["parallel"][1], near["perspective"][1]
    assert min(parallel, perspective) > 0 and parallel != pytest.approx(perspective, rel=1e-6)


def test_fades_compute_no_frame_without_a_visible_neighbour(
    capsys: pytest.CaptureFixture[str],
) -> None:
    settings = ("optimize.iterations=1", "views.pool=1", "views.image_size=16", *PLAIN)
    options = [word for setting in settings for word in ("--set", setting)]
    fades.main(["--resolution", "12", "--frames", "8", *options])
    rows = capsys.readouterr().out.splitlines()[2:]
    assert len(rows) == len(fades.STRENGTHS)
    cells = {row.split(" | ")[0].strip("| "): row.strip("| ").split(" | ")[1:] for row in rows}
    n_steps = {name: int(values[0]) for name, values in cells.items()}
    assert n_steps["1 throughout"] == n_steps["1, but 0 at frame 5"] == 7
    assert n_steps["1, but 0 at frames 4 to 6"] < 7
    assert all(0 < float(values[1]) <= float(values[2]) for values in cells.values())


def test_windows_whose_cost_grows_miss_the_mark() -> None:
    sizes = [Cost(10, 1, 90.0, 5.0), Cost(10, 5, 20.0, 1.0), Cost(10, 9, 22.0, 1.2)]
    report = render_report(sizes, [Cost(8, 8, 9, 1.0), Cost(72, 8, 90, 1.05)], 40, ["x"])
    assert "CPU +10.0% (mark +15%: met)" in report
    assert "+20.0% (mark +15%: missed)" in report


def test_warm_starts_do_the_finest_octave_alone_and_cold_ones_all() -> None:
    frames = [frame_of(puff(8, seed), float(seed), np.zeros(3)) for seed in (1, 2)]
    settings = [*QUICK, "views.pool=1", "views.image_size=16", "colour.iterations=[2,2,4]"]
    shot = make_shot(frames, "strokes", [*settings, "optimize.tolerance=0"], 64)
    rows = measure_step(shot, "colour", warm=(1, 4), cold=(1.0, 0.5))
    assert [(row.start, row.iterations) for row in rows] == [
        ("cold", (2, 2, 4)), ("cold", (1, 1, 2)), ("warm", (1,)), ("warm", (4,)),
    ]  # fmt: skip
    assert all(np.isfinite(row.distance) for row in rows)

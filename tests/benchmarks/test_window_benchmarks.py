"""The benchmarks of windows and warm starts: what they repeat, choose and say."""

from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdVol

from benchmarks.coherence_runs import make_shot
from benchmarks.warm_starts import Row, cheapest_equal, measure_step
from benchmarks.window_cost import Cost, render_report, repeat_frames
from tests.smoke_fixtures import frame_of, puff


def test_a_long_stage_shows_the_first_files_in_turn(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "short.usda"))
    asset = UsdVol.OpenVDBAsset.Define(stage, "/smoke/density")
    for code in range(1, 5):
        asset.CreateFilePathAttr().Set(Sdf.AssetPath(f"./a.{code}.vdb"), float(code))
    stage.GetRootLayer().Save()
    repeat_frames(tmp_path / "short.usda", 7, 3, tmp_path / "long.usda")
    long = Usd.Stage.Open(str(tmp_path / "long.usda"))
    files = UsdVol.OpenVDBAsset.Get(long, "/smoke/density").GetFilePathAttr()
    shown = [files.Get(float(code)).path for code in range(1, 8)]
    assert shown == [f"./a.{code}.vdb" for code in (1, 2, 3, 1, 2, 3, 1)]
    assert long.GetEndTimeCode() == 7


def test_only_windows_beyond_three_frames_are_held_to_the_mark() -> None:
    sizes = [Cost(10, 1, 90.0, 5.0), Cost(10, 5, 20.0, 1.0), Cost(10, 9, 22.0, 1.2)]
    report = render_report(sizes, [Cost(8, 8, 9, 1.0), Cost(72, 8, 90, 1.05)], 40, ["x"])
    assert "CPU +10.0% (mark +15%: met)" in report
    assert "+20.0% (mark +15%: missed)" in report
    assert "+5.0% (mark +10%: met)" in report


def test_the_cheapest_warm_start_is_the_first_that_is_as_near_as_the_full_cold_one() -> None:
    cold = [Row("cold", (60, 50, 40), 3.0, 1.0), Row("cold", (30, 25, 20), 1.5, 1.3)]
    warm = [Row("warm", (n,), n / 10, 1.4 - n / 40) for n in (8, 16, 32)]
    assert cheapest_equal([*cold, *warm]) is warm[1]
    assert cheapest_equal([*cold, warm[0]]) is None


def test_warm_starts_do_the_finest_octave_alone_and_cold_ones_all() -> None:
    frames = [frame_of(puff(8, seed), float(seed), np.zeros(3)) for seed in (1, 2)]
    settings = ["views.pool=1", "views.image_size=16", "colour.iterations=[2,2,4]"]
    shot = make_shot(frames, "strokes", [*settings, "optimize.tolerance=0"], 64)
    rows = measure_step(shot, "colour", warm=(1, 4), cold=(1.0, 0.5))
    assert [(row.start, row.iterations) for row in rows] == [
        ("cold", (2, 2, 4)), ("cold", (1, 1, 2)), ("warm", (1,)), ("warm", (4,)),
    ]  # fmt: skip
    assert all(np.isfinite(row.distance) and row.cpu_s >= 0 for row in rows)

"""Stages at the ends of what USD allows, through the pipeline."""

import re
from dataclasses import replace

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from tests.fixtures.grids_fixtures import raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, run, shown_files, values_of
from tests.fixtures.smoke_fixtures import puff
from tests.fixtures.usd_fixtures import density_prim, samples, volume_prim, world, write_vdb
from usdsmoke.base.errors import ConfigError
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.run_sections import WindowsConfig
from usdsmoke.planning.windows import split_windows

QUICK = (
    "views.pool=1", "views.image_size=16", "features.layers=[oriented1]", "shape.iterations=[2]",
    "colour.iterations=[2]", "optimize.threads=1",
)  # fmt: skip


@pytest.mark.usefixtures("quick_grids")
def test_the_stage_s_unit_is_kept_and_changes_no_bit_of_the_smoke(shot: Shot) -> None:
    text = shot.stage.read_text()
    found = []
    for metres in (0.01, 1000.0):
        stage_file = shot.stage.with_name(f"unit{metres}.usda")
        own = replace(shot, stage=stage_file, output=shot.folder / f"out{metres}")
        changed, n = re.subn(r"metersPerUnit = [\d.]+", f"metersPerUnit = {metres}", text)
        assert n == 1
        stage_file.write_text(changed)
        result = run(own, *QUICK, "stage.frames='1'")
        stage = Usd.Stage.Open(str(result.root_stage))
        assert UsdGeom.GetStageMetersPerUnit(stage) == metres
        found.append([values_of(result.frames[0], name) for name in ("density", "emission")])
    for one, other in zip(*found, strict=True):
        assert np.isfinite(one).all() and one.any()
        assert np.array_equal(one, other)


@pytest.mark.usefixtures("quick_grids")
def test_the_pattern_rides_on_one_file_in_a_volume_that_travels_and_turns(shot: Shot) -> None:
    """Later frames keep what they start from: all show the file's voxels with the same colours."""
    write_raw(shot.stage.parent / "cache/one.vdb", raw_grid(puff(12)))
    files = samples(dict.fromkeys((1, 2, 3), "@./cache/one.vdb@"))
    ride = f"""
        double3 xformOp:translate.timeSamples = {samples({1: "(0, 0, 0)", 3: "(40, -8, 3)"})}
        float xformOp:rotateZ.timeSamples = {samples({1: "0", 3: "50"})}
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]"""
    shot.stage.write_text(
        world(volume_prim(density_prim(f"asset filePath.timeSamples = {files}") + ride))
    )
    still = [
        f"{step}.{end}" for step in ("shape", "colour") for end in ("warm_rate=1e-9", "smoothing=0")
    ]
    found = [values_of(file, "emission") for file in run(shot, *QUICK, *still).frames]
    assert len(found) == 3 and found[0].std() > 0.05 * found[0].max()
    for other in found[1:]:
        assert np.abs(other - found[0]).max() < 0.05 * found[0].max()


@pytest.mark.usefixtures("core")
def test_negative_fractional_and_distant_timecodes_show_files_of_their_own(shot: Shot) -> None:
    codes = (-3.0, -2.5, 0.0, 1.0, 400.0)
    for n, _ in enumerate(codes):
        write_vdb(shot.stage.parent / f"cache/odd{n}.vdb", value=1.0 + n)
    named = {code: f"@./cache/odd{n}.vdb@" for n, code in enumerate(codes)}
    files = f"asset filePath.timeSamples = {samples(named)}"
    shot.stage.write_text(world(volume_prim(density_prim(files))))
    shown = shown_files(run(shot).root_stage)
    assert tuple(shown) == codes
    assert [values_of(shown[code]).max() for code in codes] == [0.5, 1.0, 1.5, 2.0, 2.5]


def test_a_window_longer_than_the_shot_holds_all_of_it(shot: Shot, core: FakeCore) -> None:
    result = run(shot, "windows.size=12")
    assert core.stylized == [1.0, 2.0, 3.0]
    assert len(result.frames) == 3
    (window,) = split_windows([1.0, 2.0, 3.0], WindowsConfig(size=12))
    assert window.time_codes == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("name", ["gamma", "gamma_shape"])
def test_no_extinction_is_refused_as_a_setting(name: str) -> None:
    with pytest.raises(ConfigError, match=rf"optics\.{name} is 0\.0.*above 0"):
        resolve_config({"optics": {name: 0.0}})

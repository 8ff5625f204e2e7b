"""What particular renderers want, in the files; OpenVDB itself reads the grids."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf

from tests.fixtures.client_fixtures import (
    ALL,
    CD,
    COLOR,
    PARTS,
    PER_DENSITY,
    SPLIT,
    VECTORS,
    WINDOWS,
    dense,
    expected,
    make_plume,
)
from tests.fixtures.grids_fixtures import check_content, openvdb, raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, copied, make_shot, run, stand_in
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.pipeline import Request, assemble, run_window
from usdsmoke.ui.cli.main import main
from usdsmoke.vdb.content_hash import hash_vdb_file


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, np.ndarray]]:
    """The grids of each frame without any option."""
    with pytest.MonkeyPatch.context() as patch:
        stand_in(patch)
        result = run(make_plume(tmp_path_factory.mktemp("plain")), *WINDOWS)
    return {file_path.name: dense(file_path) for file_path in result.frames}


@pytest.mark.parametrize(
    "settings",
    [(CD,), (COLOR,), (SPLIT,), (PER_DENSITY,), ALL],
    ids=["Cd", "color", "rgb", "per density", "all"],
)
def test_each_option_writes_what_follows_from_density_and_emission(
    plume: Shot, plain: dict[str, dict[str, np.ndarray]], settings: tuple[str, ...]
) -> None:
    result = run(plume, *WINDOWS, *settings)  # 4, 5, 7 and 8 are blended
    assert [frame.name for frame in result.frames] == list(plain)
    for without, file_path in zip(plain.values(), result.frames, strict=True):
        wanted, found = expected(without, settings), dense(file_path)
        assert set(found) == set(wanted)
        assert (wanted["density"] > 0).any() and (wanted["density"] == 0).any()
        for name, values in wanted.items():
            np.testing.assert_array_equal(found[name], values, err_msg=name)
        check_content(file_path)


@pytest.mark.usefixtures("core")
def test_options_that_are_off_leave_files_and_layer_as_they_are(plume: Shot) -> None:
    plain = run(copied(plume, "plain"))
    off = ("layer.scatter_colour=[]", "layer.split_rgb=false", "layer.emission_mode=absolute")
    same = run(plume, *off)
    for one, other in zip(plain.frames, same.frames, strict=True):
        assert set(dense(one)) == {"density", "emission"}
        assert hash_vdb_file(one, GridsConfig()) == hash_vdb_file(other, GridsConfig())
    layers = [Sdf.Layer.FindOrOpen(str(item.look_layer)) for item in (plain, same)]
    for layer in layers:
        children = layer.GetPrimAtPath("/World/smoke").nameChildren
        assert [child.name for child in children] == ["density", "emission", "look_material"]
        mode = layer.GetAttributeAtPath("/World/smoke.usdSmoke:emissionMode")
        assert mode.default == "absolute"


def test_all_options_in_16_bits_are_within_half_a_step(plume: Shot) -> None:
    plain = run(copied(plume, "plain"))
    result = run(plume, *ALL, "grids.half=true")
    for without, file_path in zip(plain.frames, result.frames, strict=True):
        wanted, found = expected(dense(without), ALL), dense(file_path)
        grids, _ = openvdb().readAll(str(file_path))
        assert all(grid.saveFloatAsHalf for grid in grids)
        for name, values in wanted.items():
            # Half a unit in the last of 11 bits, or of the smallest half there is.
            bound = np.maximum(np.abs(values) * 2.0**-11, 2.0**-25)
            assert (np.abs(found[name].astype(float) - values) <= bound).all(), name
        again = found["emission"].astype(float) * found["density"][..., None]
        error = np.abs(again - dense(without)["emission"])
        assert (error <= 2.01 * 2.0**-11 * np.abs(dense(without)["emission"]) + 1e-6).all()
        check_content(file_path)


def test_a_frame_without_smoke_has_all_grids_and_no_voxel(plume: Shot) -> None:
    empty = raw_grid(np.zeros((0, 0, 0), np.float32))
    write_raw(plume.folder / "in/cache/smoke.0002.vdb", empty)
    grids, _ = openvdb().readAll(str(run(plume, *ALL).frames[1]))
    assert {grid.name for grid in grids} == {"density", *VECTORS, *PARTS}
    assert [grid.activeVoxelCount() for grid in grids] == [0] * len(grids)


def test_pruned_voxels_have_no_colour(plume: Shot) -> None:
    whole = dense(run(copied(plume, "whole"), *ALL).frames[0])
    found = dense(run(plume, *ALL, "grids.prune=0.5").frames[0])
    gone = found["density"] == 0
    assert gone.sum() > (whole["density"] == 0).sum()
    assert not any(values[gone].any() for values in found.values())


def test_a_velocity_is_copied_beside_them(tmp_path: Path, core: FakeCore) -> None:
    shot = make_shot(tmp_path, n_frames=1, names=("density", "vel"))
    found = {grid.name: grid for grid in openvdb().readAll(
        str(run(shot, *ALL, "layer.copy_velocity=true").frames[0]))[0]}  # fmt: skip
    assert set(found) == {"density", *VECTORS, *PARTS, "vel"}
    assert found["vel"].getConstAccessor().getValue((0, 0, 0)) == (0.625, 0.625, 0.625)


def test_windows_one_by_one_and_frames_done_again_give_the_same_bits(plume: Shot) -> None:
    settings = (*WINDOWS, *ALL)
    whole = [hash_vdb_file(item, GridsConfig()) for item in run(plume, *settings).frames]
    apart = copied(plume, "apart")
    for path in apart.output.rglob("*"):
        path.unlink() if path.is_file() else None
    for window in (2, 0, 1):
        run_window(Request(apart.stage, apart.style, apart.output, list(settings)), window)
    frames = assemble(apart.output).frames
    assert [hash_vdb_file(item, GridsConfig()) for item in frames] == whole
    again = run(plume, *settings, "stage.frames=4")
    assert [hash_vdb_file(item, GridsConfig()) for item in again.frames] == whole


def test_the_contact_sheet_shows_the_same_light_per_density(
    plume: Shot, core: FakeCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[np.ndarray] = []

    march = core.march

    def look(media: Any, view: Any) -> Any:
        light = media[0].emission
        if light is not None and light.any():
            seen.append(light)
        return march(media, view)

    monkeypatch.setattr(sys.modules["usdsmoke.core.rays.march"], "march", look)
    run(copied(plume, "plain"))
    run(plume, PER_DENSITY)
    half = len(seen) // 2
    assert half >= 3
    for absolute, again in zip(seen[:half], seen[half:], strict=True):
        np.testing.assert_allclose(again, absolute, rtol=2.0**-22)


def test_the_command_line_names_them_and_the_plan_tells(
    shot: Shot, core: FakeCore, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--alias-cd", "--split-rgb", "--emission-mode", "perDensity"]
    assert main([*shot.arguments(*options, "--dry-run", "--json")]) == 0
    needed = json.loads(capsys.readouterr().out)["needed"]
    assert any(
        "density, emission per density, emission_r, emission_g, emission_b, Cd, Cd_r, Cd_g and Cd_b"
        in sentence for sentence in needed
    )  # fmt: skip
    assert main(shot.arguments(*options)) == 0
    with_them = {path.name: path for path in shot.output.rglob("smoke.*.vdb")}
    assert set(dense(with_them["smoke.0001.vdb"])) >= {"Cd", "emission_r", "Cd_b"}


def test_without_a_colour_step_the_plan_says_that_they_are_left_out(
    shot: Shot, core: FakeCore
) -> None:
    result = run(shot, *ALL, "optimize.steps=shape")
    assert set(dense(result.frames[0])) == {"density"}
    assert any("layer.scatter_colour" in omission.what for omission in result.plan.omitted)

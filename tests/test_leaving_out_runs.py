"""What a scene does not need is neither read nor written, and plan and result name it, with why.

Counted like in test_leaving_out.py, by whole runs.
"""

from pathlib import Path

import numpy as np
import pytest

from tests.counters import Reads, count_calls
from tests.pipeline_fixtures import Shot, make_shot, make_style, run
from tests.smoke_fixtures import puff
from tests.usd_fixtures import density_prim, sequence, volume_prim, world, write_text
from usdsmoke.audit import provenance
from usdsmoke.vdb.binding import find_binding

QUICK = (
    "views.pool=2", "views.image_size=16", "features.layers=[oriented1]", "shape.iterations=[1]",
    "colour.iterations=[1]", "optimize.threads=1",
)  # fmt: skip
CORE = "usdsmoke.core"
COLOURS = (
    f"{CORE}.sequence.frame_loop:run_colour_step",
    f"{CORE}.steps.colour:white_noise", f"{CORE}.steps.pictures:colour_map",
    f"{CORE}.sequence.stylize:_empty_emission", f"{CORE}.sequence.stylize:_emit",
    f"{CORE}.sequence.frame_loop:start_colours",
)  # fmt: skip
FEATURES = (f"{CORE}.steps.targets:build_network", f"{CORE}.style.losses:StyleTarget.loss")


def reasons(shot: Shot, *settings: str) -> dict[str, str]:
    """What a finished run's record says that it left out; the plan says the same."""
    result = run(shot, *QUICK, *settings, force=True)
    planned = [f"{item.what}: {item.reason}" for item in result.plan.omitted]
    (found,) = provenance(result.look_layer)
    assert list(found.record.omitted) == planned
    return {item.what: item.reason for item in result.plan.omitted}


def test_without_a_colour_step_no_colour_is_made_or_written(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls, reads = count_calls(monkeypatch, *COLOURS), Reads(monkeypatch)
    said = reasons(shot, "optimize.steps=[shape]")
    assert not calls and set(reads.written) == {"density"}
    assert "no colour step" in said["RGB emission"]
    n_density = reads.written["density"]
    said = reasons(shot)
    assert set(calls) == {name.partition(":")[2] for name in COLOURS}
    assert reads.written["emission"] >= 3 * n_density and "RGB emission" not in said


def test_a_style_of_weight_0_loads_no_network_and_judges_no_picture(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    Reads(monkeypatch)
    calls = count_calls(monkeypatch, *FEATURES, f"{CORE}.views.scene:sample_angles")
    said = reasons(shot, "losses.style=0")
    assert not calls and said["style loss and features"] == "losses.style is 0"
    reasons(shot)
    assert len(calls) == 3


def test_one_frame_reads_its_own_density_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shot, reads = make_shot(tmp_path, names=("density", "vel")), Reads(monkeypatch)
    said = reasons(shot, "stage.frames=2")
    assert of_sources(reads) == {("cache/smoke.0002.vdb", "density")}
    assert said["velocity grids"] == "there is one frame only"
    reads.grids.clear()
    said = reasons(shot, "windows.size=1")
    assert {grid for _, grid in of_sources(reads)} == {"density"}
    assert "windows.size is 1" in said["velocity grids"]
    reads.grids.clear()
    assert "velocity grids" not in reasons(shot)
    assert {grid for _, grid in of_sources(reads)} == {"density", "vel"}


def write_sparse(file_path: Path, density: np.ndarray, *names: str) -> None:
    """A file with the same smoke in every grid; voxels without any are not active."""
    openvdb, grids = find_binding(), []
    for name in names or ("density",):
        grid = openvdb.FloatGrid()
        grid.copyFromArray(np.ascontiguousarray(density))  # strides would be misread
        grid.name, grid.gridClass = name, "fog volume"
        grids.append(grid)
    file_path.parent.mkdir(parents=True, exist_ok=True)
    openvdb.write(str(file_path), grids=grids)


def of_sources(reads: Reads) -> set[tuple[str, str]]:
    """File and grid of what was read of the stage's own files; results are read once more too."""
    return {(name, grid) for name, grid in reads.grids if name.startswith("cache/")}


def test_fields_that_are_not_asked_for_are_not_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file of the other field is damaged: who opens it fails."""
    write_sparse(tmp_path / "in/cache/smoke.0001.vdb", puff(6), "density", "spare")
    (tmp_path / "in/cache/heat.vdb").write_bytes(b"no VDB")
    names = ("density", "heat", "temperature")
    relations = "\n".join(f"rel field:{n} = </World/smoke/{n}>" for n in names)
    body = density_prim(sequence((1,)))
    for name in names[1:]:
        body += density_prim("asset filePath = @./cache/heat.vdb@", name)
    stage = write_text(tmp_path / "in/shot.usda", world(volume_prim(body, relations=relations)))
    shot = Shot(tmp_path, stage, make_style(tmp_path / "style.png"), tmp_path / "out")
    reads = Reads(monkeypatch)
    said = reasons(shot)
    assert of_sources(reads) == {("cache/smoke.0001.vdb", "density")}
    assert "they stay as they are" in said["fields heat, temperature of </World/smoke>"]


def test_the_plan_of_one_view_leaves_the_others_out(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    Reads(monkeypatch)
    said = reasons(shot, "views.azimuth=0", "views.elevation=0")
    assert "one view is asked for" in said["further views"]


def test_empty_space_and_thin_volumes_are_told_in_the_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Reads(monkeypatch)
    for number, (density, what) in enumerate(
        [(puff(8), "% of the boxes of"), (puff(8)[:, :, 4:5], "everything three-dimensional of")]
    ):
        folder = tmp_path / str(number)
        write_sparse(folder / "in/cache/smoke.0001.vdb", density)
        stage = write_text(
            folder / "in/shot.usda", world(volume_prim(density_prim(sequence((1,)))))
        )
        shot = Shot(folder, stage, make_style(folder / "style.png"), folder / "out")
        said = reasons(shot)
        assert any(what in name for name in said), said


def test_convergence_and_unneeded_layers_are_told_in_the_result(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    Reads(monkeypatch)
    said = reasons(shot)
    assert "optimize.tolerance" in said["iterations after convergence"]
    assert "iterations after convergence" not in reasons(shot, "optimize.tolerance=0")
    assert said["network layers oriented2, oriented3, oriented4, learned0, learned1, learned2, "
                "learned3, learned4"]  # fmt: skip

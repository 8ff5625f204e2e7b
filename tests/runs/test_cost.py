"""What a scene does not need is not done: counted in elements of tensors, in files and in bytes.

Each test counts the same work twice, left out and not left out. A broken counter fails it.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest

from tests.fixtures.counters import Elements, Reads, unnamed_files
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, make_shot, make_style, run
from tests.fixtures.smoke_fixtures import frame_of, puff
from tests.fixtures.stylize_fixtures import quick_config, run_core, scene_of
from tests.fixtures.usd_fixtures import density_prim, sequence, volume_prim, world, write_text
from usdsmoke.base.volume import CameraSource, LightSource, VolumeFrame
from usdsmoke.core.style.hues import Hues
from usdsmoke.runs.progress import RunProgress
from usdsmoke.vdb.binding import find_binding

QUICK = ("views.pool=2", "views.image_size=16", "optimize.threads=1")
ONE_OCTAVE = {"shape": {"iterations": [2]}, "colour": {"iterations": [2]}}
ONE_VIEW = {"azimuth": 0.0, "elevation": 0.0, "centre_azimuth": 90.0}  # along the i axis


def work(frames: Sequence[VolumeFrame], **sections: Any) -> Elements:
    """The work of a window, counted the second time: some tensors are kept for the process.

    Without the table of the style's hues, which costs the same in every run, and more than small
    ones do.
    """
    config = quick_config(**(ONE_OCTAVE | sections))
    with mock.patch.object(Hues, "bring", lambda self, *colours: None):
        run_core(frames, config)
        with Elements(views=False) as elements:
            run_core(frames, config)
    return elements


def test_work_grows_with_the_smoke_and_not_with_the_box_around_it() -> None:
    def padded(n: int, room: int) -> VolumeFrame:
        return frame_of(np.pad(puff(n), room), ijk_min=(-room, -room, -room))

    assert work([padded(10, 24)]).made == work([padded(10, 0)]).made < work([padded(14, 0)]).made


def test_an_iteration_of_the_shape_step_costs_the_same_in_any_box() -> None:
    """Two lumps one behind the other: the pictures are equal, the box between them is not.

    But for the velocity's look-ups, which write it into the box twice (decision 018): 52 numbers a
    voxel, forward and backward.
    """

    def iterations(length: int, number: int) -> int:
        density = np.zeros((length, 12, 12), np.float32)
        density[:12] = density[-12:] = puff(12)
        # smoke that leaves the box takes more steps: it moves a little only
        shape = {"iterations": [number], "learning_rate": 1e-3}
        views = {"pool": 1, "count": 1, "image_size": 16, **ONE_VIEW}
        return work(
            [frame_of(density)], shape=shape, views=views, optimize={"steps": ["shape"]}
        ).made

    short, long = (iterations(length, 8) - iterations(length, 4) for length in (160, 640))
    more_voxels = (640 - 160) * 18 * 18
    assert 0 < short <= long <= short + 4 * 56 * more_voxels


def test_an_empty_frame_calls_neither_renderer_nor_network() -> None:
    scene = scene_of([frame_of(puff(8))], quick_config(), "Y")
    counts = []
    for density in (np.zeros((8, 8, 8)), puff(8)):
        with Elements() as elements:
            run_core([frame_of(density)] * 2, scene=scene)
        counts.append(elements)
    empty, full = counts
    assert empty.convolved == 0 < full.convolved
    assert empty.made < 1e-3 * full.made


@pytest.fixture(scope="module")
def plain() -> int:
    """Elements that a puff takes without further losses."""
    return work([frame_of(puff(8))]).made


@pytest.mark.parametrize(
    "loss", ["total_variation", "histogram", "content", "laplacian", "photorealism"]
)
def test_a_loss_of_weight_0_is_not_evaluated(loss: str, plain: int) -> None:
    frames = [frame_of(puff(8))]
    assert work(frames, losses={loss: 0.0}).made == plain < work(frames, losses={loss: 0.1}).made


def test_a_layer_of_weight_0_and_those_below_the_deepest_are_not_evaluated() -> None:
    def layers(names: list[str], weights: list[float]) -> Elements:
        return work([frame_of(puff(8))], features={"layers": names, "weights": weights})

    one = layers(["oriented1"], [1.0])
    left_out = layers(["oriented1", "learned2"], [1.0, 0.0])
    both = layers(["oriented1", "learned2"], [1.0, 1.0])
    assert (left_out.made, left_out.convolved) == (one.made, one.convolved)
    assert both.convolved > 1.5 * one.convolved


def test_one_view_is_projected_once_and_a_view_that_is_not_drawn_never() -> None:
    def views(pool: int, count: int, **angles: float) -> int:
        found = {"pool": pool, "count": count, "image_size": 16, **angles}
        short = {"iterations": [3]}
        return work([frame_of(puff(10))], views=found, shape=short, colour=short).made

    assert views(3, 3, **ONE_VIEW) == views(1, 1, **ONE_VIEW) < 0.9 * views(3, 3)
    assert views(64, 1) == pytest.approx(views(8, 1), rel=0.05)


def test_lights_cost_nothing_where_smoke_scatters_none_and_little_where_it_does() -> None:
    sun = LightSource("/sun", (1.0, 0.9, 0.8), (0.6, 0.0, 0.8))
    dark = frame_of(puff(12))
    lit = replace(dark, lights=(sun,))
    plain = work([dark]).made
    assert plain == work([lit], optics={"albedo": 0.0}).made
    assert plain == work([dark], optics={"albedo": 0.9}).made
    once = work([lit]).made
    assert 0.99 * plain < once < 1.1 * plain  # colours decide a little of what is faint
    dome = replace(dark, lights=(LightSource("/sky", (1.0, 1.0, 1.0)),))
    assert once < work([dome]).made < 1.1 * plain
    assert work([replace(dark, lights=(*lit.lights, *dome.lights))]).made < 1.1 * plain
    assert plain == work([dark], optics={"bounces": True}).made
    assert once < work([lit], optics={"bounces": True}).made < 1.2 * plain


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_slab_is_seen_from_one_side_only(axis: int) -> None:
    slab = np.moveaxis(puff(12)[:, :, 5:6], 2, axis)

    def views(density: np.ndarray, pool: int) -> int:
        found = {"pool": pool, "count": pool, "image_size": 16}
        return work([frame_of(density)], views=found).made

    assert views(slab, 3) == views(slab, 1)
    thick = np.repeat(slab, 4, axis)  # blocks of two voxels would be a slab too
    assert views(thick, 3) > 1.1 * views(thick, 1)


def test_no_detail_is_optimised_that_a_small_picture_cannot_show() -> None:
    place = np.eye(4)
    place[3, :3] = [19.5, 19.5, 120.0]  # looks along -Z
    camera = CameraSource("/cam", place, 36.0, 24.0, 24.0, 0.0, 0.0, (0.1, 1e4), False)
    frames = [replace(frame_of(puff(40)), camera=camera)]

    def width(pixels: int) -> int:
        views = {"image_size": 64, "camera": "/cam", "camera_width": pixels, "pool": 2}
        steps = {"steps": ["colour"]}
        return work(frames, views=views, colour={"iterations": [4]}, optimize=steps).convolved

    assert 0 < width(6) < 0.5 * width(640)


def test_a_converged_octave_does_no_more_iterations() -> None:
    frames, counts = [frame_of(puff(8))], []
    for tolerance in (0.0, 10.0):
        config = quick_config(
            colour={"iterations": [80]}, optimize={"steps": ["colour"], "tolerance": tolerance}
        )
        with Elements() as elements:
            (result,) = run_core(frames, config)
        counts.append(elements.convolved)
        report = result.report.colour
        assert report.ended == ("converged" if tolerance else "iterations",)
        assert (report.iterations == (80,)) is (tolerance == 0)
    assert 0 < counts[1] < 0.7 * counts[0]


def reasons(shot: Shot, *settings: str) -> dict[str, str]:
    """What a finished run left out, and why."""
    result = run(shot, *settings, force=True)
    return {item.what: item.reason for item in result.plan.omitted}


@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("settings", [(), ("windows.size=2", "windows.overlap=1")])
def test_each_grid_of_a_source_file_is_read_once(
    settings: tuple[str, ...],
    named: bool,
    tmp_path: Path,
    core: FakeCore,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also the velocity, which is read as vectors and copied as it is."""
    shot, reads = make_shot(tmp_path, names=("density", "vel")), Reads(monkeypatch)
    if named:
        relations = "rel field:density = </World/smoke/density>\nrel field:vel = </World/smoke/vel>"
        files = sequence((1, 2, 3))
        body = density_prim(files) + density_prim(files, "vel", grid='token fieldName = "vel"')
        write_text(shot.stage, world(volume_prim(body, relations=relations)))
    run(shot, *settings)
    names = [f"cache/smoke.{number:04d}.vdb" for number in (1, 2, 3)]
    wanted = {(name, grid) for name in names for grid in ("density", "vel")}
    if not named:  # nothing goes on from the last frame, and nothing is copied
        wanted -= {(names[2], "vel")}
    assert set(reads.sources) == wanted
    assert set(reads.sources.values()) == {1}


def test_a_source_frame_leaves_the_disk_when_nothing_left_to_do_reads_it(
    tmp_path: Path, core: FakeCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("usdsmoke.vdb.store._FILE_BYTES", 1)  # a file for each grid
    monkeypatch.setattr("usdsmoke.vdb.store._folder", lambda: tmp_path)
    shot, counts = make_shot(tmp_path, n_frames=8), dict[tuple[str, int], int]()

    def count(state: RunProgress) -> None:
        counts[state.step, state.frame] = len(unnamed_files(tmp_path))

    run(shot, "windows.size=2", "windows.overlap=0", progress=count)
    # 1, 3, 6 and 8 are on the sheet
    assert [counts["write", frame] for frame in range(0, 8, 2)] == [8, 7, 6, 5]
    assert counts["picture", 0] == 4  # for the contact sheet
    assert not unnamed_files(tmp_path)


def test_velocity_is_read_only_where_a_frame_has_a_neighbour(
    tmp_path: Path, core: FakeCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    shot, reads = make_shot(tmp_path, names=("density", "vel")), Reads(monkeypatch)
    assert "velocity grids" in reasons(shot, "stage.frames=2")
    assert set(reads.sources) == {("cache/smoke.0002.vdb", "density")}
    reads.grids.clear()
    assert "windows.size" in reasons(shot, "windows.size=1")["velocity grids"]
    assert {grid for _, grid in reads.sources} == {"density"}
    assert "velocity grids" not in reasons(shot)
    read = {file_path for file_path, grid in reads.sources if grid == "vel"}
    assert read == {f"cache/smoke.{code:04d}.vdb" for code in (1, 2)}  # the third leads nowhere


def test_without_a_colour_step_no_colour_is_written(
    shot: Shot, core: FakeCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads = Reads(monkeypatch)
    assert "RGB emission" in reasons(shot, "optimize.steps=[shape]")
    assert set(reads.written) == {"density"}
    n_density = reads.written["density"]
    assert "RGB emission" not in reasons(shot)
    assert reads.written["emission"] >= 3 * n_density


def test_fields_that_are_not_asked_for_are_not_opened(
    tmp_path: Path, core: FakeCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file of the other field is damaged: opening it fails the run."""
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
    assert "fields heat, temperature of </World/smoke>" in reasons(shot)
    assert set(reads.sources) == {("cache/smoke.0001.vdb", "density")}


@pytest.mark.usefixtures("quick_grids")
def test_the_result_says_what_was_left_out(tmp_path: Path) -> None:
    """A slab in a large box, seen from one side, without a style: each is in the plan."""
    density = np.zeros((24, 8, 1), np.float32)
    density[:8] = density[-8:] = puff(8)[:, :, 4:5]
    write_sparse(tmp_path / "in/cache/smoke.0001.vdb", density)
    stage = write_text(tmp_path / "in/shot.usda", world(volume_prim(density_prim(sequence((1,))))))
    shot = Shot(tmp_path, stage, make_style(tmp_path / "style.png"), tmp_path / "out")
    one_view = ("views.azimuth=0", "views.elevation=0")
    said = reasons(shot, *QUICK, *one_view, "losses.style=0", "optimize.tolerance=0.01")
    for what, setting in (
        ("style loss and features", "losses.style"),
        ("iterations after convergence", "optimize.tolerance"),
        ("other views", "views.azimuth"),
    ):
        assert setting in said[what]
    for part in ("% of the bounding boxes of", "everything three-dimensional of"):
        assert [what for what in said if part in what], part


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

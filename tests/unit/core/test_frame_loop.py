"""Windows of frames as chains: what is carried, averaged, estimated and measured."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import frame_of, puff, random_style
from tests.fixtures.stylize_fixtures import by_voxel, quick_config, run_core, scene_of
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.sequence.coarse import coarse_frames, coarsen_field
from usdsmoke.core.sequence.controls import coarse_factor
from usdsmoke.core.sequence.frame_loop import run_frames
from usdsmoke.core.sequence.frame_state import make_context
from usdsmoke.core.sequence.start import Carried, start_colours, start_displacement
from usdsmoke.core.sequence.start_files import (
    load_carried,
    load_checkpoint,
    load_start,
    save_checkpoint,
    save_start,
)
from usdsmoke.core.sequence.steadiness import Steadiness
from usdsmoke.core.sequence.stylize import WindowStart, stylize_window
from usdsmoke.core.sequence.transit import Transit

BOX = (20, 16, 16)
STEP = 2  # voxels a frame


def drifting(number: int, velocity: bool = True) -> VolumeFrame:
    """A puff that moves along i, two voxels a frame, with the velocity that says so."""
    density = np.zeros(BOX, np.float32)
    density[STEP * number : STEP * number + 12, 2:14, 2:14] = puff(12)
    frame = frame_of(density, float(number))
    if not velocity:
        return frame
    speed = np.zeros((*BOX, 3), np.float32)
    speed[..., 0] = STEP * 24.0
    field = DenseField("vel", speed, (0, 0, 0), np.eye(4), (0.0, 0.0, 0.0))
    return replace(frame, velocity=field, velocity_to_stage=np.eye(4))


FRAMES = [drifting(number) for number in range(4)]


def errors_of(frames: list[VolumeFrame], **sections: dict) -> list[dict[str, float]]:
    reports = [frame.report for frame in run_core(frames, quick_config(**sections))]
    assert reports[0].temporal is None
    return [report.to_json()["temporal"] for report in reports[1:]]


STILL = {  # later frames take over what they start from, and write it as it is
    "shape": {"iterations": [2, 2], "warm_rate": 1e-9, "smoothing": 0.0},
    "colour": {"iterations": [2, 2], "warm_rate": 1e-9, "smoothing": 0.0, "occlusion": 0.0},
}


def test_smoke_that_only_drifts_has_no_temporal_error_when_nothing_is_optimised_any_more():
    """By whole voxels a frame, so that nothing is interpolated."""
    for errors in errors_of(FRAMES, **STILL):
        assert errors["colour"] < 1e-4 and errors["displacement"] < 1e-3


def test_a_higher_steadiness_keeps_displacements_nearer_to_the_frame_before():
    shape = {"iterations": [4, 12], "warm_rate": 1.0, "smoothing": 0.0}
    optimize = {"steps": ["shape"], "threads": 1, "tolerance": 0.0}

    def mean_error(steadiness: float) -> float:
        found = errors_of(
            FRAMES, shape=shape, optimize=optimize, windows={"steadiness": steadiness}
        )
        return float(np.mean([error["displacement"] for error in found]))

    assert mean_error(1e4) < 0.5 * mean_error(0.0)


def test_a_carried_velocity_is_no_longer_than_it_counts():
    lattice = Lattice(np.zeros(3), (6, 6, 6), np.eye(4))
    lengths = torch.linspace(0, 5, 216).view(6, 6, 6, 1)
    before = Displacement(lengths * torch.tensor([0.6, 0.0, 0.8]), lattice)
    still = Transit(frame_of(puff(6)), 1.0)
    near = torch.ones(lattice.shape, dtype=torch.bool)
    started = start_displacement(before, None, still, 2.0, lattice, near).norm(dim=-1)
    assert torch.allclose(started, lengths[..., 0].clamp(max=2.0), atol=1e-5)


def riding(number: int) -> VolumeFrame:
    """A puff that rests in a Volume that is moved and turned."""
    angle = 0.2 * number
    place = np.eye(4)
    place[:2, :2] = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    place[3, :3] = [0.3 * number, -5.5 * number, 2.0 * number]
    return replace(frame_of(puff(12), float(number)), density_to_stage=place)


def test_the_pattern_rides_on_a_volume_that_moves():
    shot = [riding(number) for number in range(3)]
    for errors in errors_of(shot, **STILL):
        assert errors["colour"] < 1e-4 and errors["displacement"] < 1e-3
    results = run_core(shot, quick_config(**STILL))
    first, *others = (by_voxel(frame.emission) for frame in results)
    for other in others:
        both = first.keys() & other.keys()
        apart = [np.abs(np.subtract(first[voxel], other[voxel])).max() for voxel in both]
        assert len(both) > 0.9 * len(first)
        assert np.max(apart) < 0.05 * np.max([np.max(value) for value in first.values()])


def test_the_pattern_rides_on_smoke_that_flows_in_a_volume_that_moves():
    """Two voxels a frame through a grid that is moved and turned meanwhile."""
    shot = []
    for number in range(3):
        place, flow = riding(number).density_to_stage, np.array([48.0, 0.0, 0.0])
        frame = frame_of(puff(12), float(number), flow, ijk_min=(2 * number, 0, 0))
        shot.append(replace(frame, density_to_stage=place, velocity_to_stage=place))
    for errors in errors_of(shot, **STILL):
        assert errors["colour"] < 1e-2 and errors["displacement"] < 1e-2
    first, *others = run_core(shot, quick_config(**STILL))
    start = by_voxel(first.emission)
    for number, other in enumerate(others, start=1):
        moved = {(i - 2 * number, j, k): v for (i, j, k), v in by_voxel(other.emission).items()}
        both = start.keys() & moved.keys()
        apart = [np.abs(np.subtract(start[voxel], moved[voxel])).max() for voxel in both]
        assert len(both) > 0.9 * len(start)
        assert np.max(apart) < 0.05 * np.max([np.max(value) for value in start.values()])


def test_the_pattern_stands_still_at_pattern_speed_zero_and_the_error_says_so():
    config = quick_config(**STILL, windows={"pattern_speed": 0.0})
    first, second = run_core(FRAMES[:2], config)[:2]
    emission = [by_voxel(frame.emission) for frame in (first, second)]
    both = emission[0].keys() & emission[1].keys()
    density = [by_voxel(frame.density) for frame in (first, second)]
    colours = [
        np.array([np.array(e[v]) / d[v][0] for v in sorted(both)])
        for e, d in zip(emission, density, strict=True)
    ]
    assert np.abs(colours[0] - colours[1]).max() < 0.02 * np.abs(colours[0]).max()


def test_a_chain_follows_the_smoke_more_closely_than_frames_alone():
    sections = {
        "colour": {"iterations": [6, 6]},
        "optimize": {"steps": ["colour"], "threads": 1, "tolerance": 0.0},
    }
    chained = np.mean([error["colour"] for error in errors_of(FRAMES, **sections)])
    config = quick_config(**sections)
    scene = scene_of(FRAMES, config, "Y")
    links = []
    for frame in FRAMES:
        job = make_context([random_style()], scene, config, None, 24.0, None, 1)
        links += list(run_frames([frame], job))
    measure = Steadiness()
    measure.compare(*links[0].paint, None)
    alone = [
        measure.compare(*link.paint, Transit(before.frame, 1 / 24))[1]
        for before, link in pairwise(links)
    ]
    assert chained < 0.5 * np.mean(alone)


def test_an_estimated_motion_takes_the_place_of_the_velocity():
    """The puff's way is found from its densities, and its colours go along."""
    frames = [drifting(number, velocity=False) for number in range(3)]
    with_estimate = errors_of(frames, **STILL, stage={"motion": "estimate"})
    truth = run_core(FRAMES[:3], quick_config(**STILL))
    found = run_core(frames, quick_config(**STILL, stage={"motion": "estimate"}))
    still = run_core(frames, quick_config(**STILL))

    def distance(results: list) -> float:
        wanted, other = (by_voxel(r[2].emission) for r in (truth, results))
        both = wanted.keys() & other.keys()
        return float(np.mean([np.abs(np.subtract(wanted[v], other[v])).mean() for v in both]))

    assert distance(found) < 0.5 * distance(still)
    assert all(error["colour"] < 0.1 for error in with_estimate)


def test_windows_that_share_a_coarse_step_start_alike():
    """The first frame of a window takes the coarse colours and leaves their octave out."""
    config = quick_config(windows={"shared_octaves": 1})
    assert coarse_factor(config) == 2
    scene = scene_of(FRAMES, config, "Y")
    starts = {s.time_code: s for s in coarse_frames(FRAMES, [random_style()], scene, config)}
    assert sorted(starts) == [0.0, 1.0, 2.0, 3.0]
    (frame,) = stylize_window(
        FRAMES[2:3], [random_style()], scene, config, start=WindowStart(lambda code: starts[code])
    )
    assert len(frame.report.colour.iterations) == 1
    assert len(frame.report.shape.iterations) == 1


def test_the_coarse_step_weighs_changes_in_the_pixels_of_the_shot():
    """It is a run on voxels twice as large, in which a change has half as many pixels."""
    steps = {"steps": ["shape"], "threads": 1, "tolerance": 0.0}
    config = quick_config(
        shape={"iterations": [4, 2], "warm_rate": 1.0}, optimize=steps,
        windows={"shared_octaves": 1, "steadiness": 0.25},
    )  # fmt: skip
    scene, style = scene_of(FRAMES, config, "Y"), random_style()
    starts = list(coarse_frames(FRAMES[:2], [style], scene, config))
    small = [replace(frame, density=coarsen_field(frame.density, 2)) for frame in FRAMES[:2]]
    coarse = replace(scene, pixel_size=2 * scene.pixel_size, image_size=round(scene.image_size / 2))

    def difference(steadiness: float) -> float:
        own = quick_config(
            shape={"iterations": [4], "warm_rate": 1.0}, optimize=steps,
            windows={"steadiness": steadiness},
        )  # fmt: skip
        job = make_context([style], coarse, own, None, 24.0, None, 2)
        *_, frame = run_frames(small, job)
        assert frame.unclamped is not None and starts[1].displacement is not None
        return float((frame.unclamped.values - starts[1].displacement.values).abs().max())

    assert difference(1.0) == 0 < difference(0.25)


def departure(steadiness: float, most_voxels: int = 0) -> float:
    """How far a window's first frame moves away from the coarse step, relative to that.

    Args:
        most_voxels: see ``Scene``; of large smoke, blocks of voxels move.
    """
    config = quick_config(
        shape={"iterations": [4, 12], "warm_rate": 1.0},
        optimize={"steps": ["shape"], "threads": 1, "tolerance": 0.0},
        windows={"shared_octaves": 1, "steadiness": steadiness},
    )
    scene, style = scene_of(FRAMES, config, "Y"), random_style()
    small = replace(scene, most_voxels=0)
    (start,) = coarse_frames(FRAMES[2:3], [style], small, config)
    shown = replace(scene, most_voxels=most_voxels)
    job = make_context([style], shown, config, None, 24.0, {2.0: start}.get, 1)
    (frame,) = run_frames(FRAMES[2:3], job)
    assert frame.unclamped is not None and start.displacement is not None
    lattice = frame.unclamped.lattice
    coarse = start.displacement.on(lattice)
    change = lattice.from_stage(frame.unclamped.values) - coarse
    return float(change.norm() / coarse.norm())


def test_a_windows_first_frame_stays_near_the_coarse_step():
    """Which the frames behind it are pulled to, and which the window before it started from."""
    assert departure(1e4) < 0.5 * departure(0.0)


def test_changes_of_blocks_count_in_the_pixels_of_the_shot():
    """Not in those of their own pictures, which are twice as large."""
    large = 10**6
    assert departure(0.0, large) > 0.9 * departure(0.0)
    assert departure(0.25, large) < 0.75 * departure(0.25)


def test_the_colours_of_a_windows_first_frame_stay_near_the_coarse_step():
    def departure(warm_rate: float) -> float:
        config = quick_config(
            colour={"iterations": [4, 12], "warm_rate": warm_rate},
            optimize={"steps": ["colour"], "threads": 1, "tolerance": 0.0},
            windows={"shared_octaves": 1},
        )
        scene, style = scene_of(FRAMES, config, "Y"), random_style()
        (start,) = coarse_frames(FRAMES[2:3], [style], scene, config)
        job = make_context([style], scene, config, None, 24.0, {2.0: start}.get, 1)
        (frame,) = run_frames(FRAMES[2:3], job)
        coarse = start_colours(None, start, None, frame.painted, 0)
        assert frame.colours is not None and coarse is not None
        return float((frame.colours - coarse).square().mean().sqrt())

    assert departure(0.1) < 0.8 * departure(1.0)


def test_a_start_comes_back_from_its_file_bit_for_bit(tmp_path):
    config = quick_config(windows={"shared_octaves": 1})
    scene = scene_of(FRAMES, config, "Y")
    (start,) = coarse_frames(FRAMES[:1], [random_style()], scene, config)
    save_start(start, tmp_path / "start.npz")
    read = load_start(tmp_path / "start.npz")
    assert (read.time_code, read.factor) == (start.time_code, start.factor)
    assert torch.equal(read.displacement.values, start.displacement.values)
    assert np.array_equal(read.displacement.lattice.low, start.displacement.lattice.low)
    for name in ("ijk", "density"):
        assert torch.equal(getattr(read.smoke, name), getattr(start.smoke, name))
    assert torch.equal(read.colours, start.colours)
    again = tmp_path / "again.npz"
    save_start(replace(read, carried=load_carried(tmp_path / "start.npz")), again)
    assert again.read_bytes() == (tmp_path / "start.npz").read_bytes()


EMPTY = frame_of(np.zeros(BOX, np.float32), 3.0)


@pytest.mark.parametrize("steps", [["shape", "colour"], ["shape"], ["colour"]])
@pytest.mark.parametrize("first", [0, 2])
def test_a_coarse_step_that_was_cut_goes_on_with_the_bits_of_one_that_was_not(
    tmp_path, steps, first
):
    config = quick_config(
        windows={"shared_octaves": 1}, optimize={"steps": steps}, shape={"smoothing": 0.5}
    )
    frames = [*FRAMES[:3], EMPTY, replace(drifting(3), time_code=4.0)]
    scene = scene_of(FRAMES, config, "Y")
    whole = list(coarse_frames(frames, [random_style()], scene, config))
    assert [start.carried is None for start in whole] == [False, False, False, True, False]
    save_start(whole[first], tmp_path / "cut.npz")
    known, seen = load_carried(tmp_path / "cut.npz"), []
    rest = coarse_frames(
        frames[first:], [random_style()], scene, config,
        lambda state: seen.append(state.time_code), known=known,
    )  # fmt: skip
    for number, (found, wanted) in enumerate(zip(rest, whole[first:], strict=True)):
        for start, name in ((found, "found"), (wanted, "wanted")):
            save_start(start, tmp_path / name)
        assert (tmp_path / "found").read_bytes() == (tmp_path / "wanted").read_bytes(), number
    assert whole[first].time_code not in seen and 4.0 in seen


@pytest.mark.parametrize(
    ("steps", "last"), [(["shape", "colour"], 1), (["shape"], 0), (["colour"], 0)]
)
def test_a_window_that_was_cut_goes_on_with_the_bits_of_one_that_was_not(tmp_path, steps, last):
    """Its fields and its temporal errors, over the frames before the cut too."""
    config = quick_config(optimize={"steps": steps})
    frames = [*FRAMES[:3], EMPTY, replace(drifting(3), time_code=4.0)]
    scene, style = scene_of(FRAMES, config, "Y"), [random_style()]
    whole = list(stylize_window(frames, style, scene, config))
    assert [frame.carried is None for frame in whole] == [False, False, False, True, False]
    save_checkpoint(whole[last].carried, "so far", tmp_path / "cut.npz")
    carried, text = load_checkpoint(tmp_path / "cut.npz")
    seen, start = set(), WindowStart(carried=carried)
    rest = stylize_window(
        frames[last:], style, scene, config, lambda state: seen.add(state.time_code), start=start
    )
    for found, wanted in zip(rest, whole[last + 1 :], strict=True):
        for field in ("density", "emission"):
            one, other = getattr(found, field), getattr(wanted, field)
            assert (one is None and other is None) or np.array_equal(one.values, other.values)
        assert found.report.temporal == wanted.report.temporal
    assert text == "so far" and frames[last].time_code not in seen and 4.0 in seen


def test_a_damaged_checkpoint_is_not_read(tmp_path):
    lattice = Lattice(np.zeros(3), (6, 6, 6), np.eye(4))
    file_path = tmp_path / "cut.npz"
    save_checkpoint(Carried(1.0, Displacement(torch.ones(6, 6, 6, 3), lattice)), "", file_path)
    whole = file_path.read_bytes()
    for damaged in (whole[:-9], whole[:999] + bytes([whole[999] ^ 1]) + whole[1000:], b""):
        file_path.write_bytes(damaged)
        with pytest.raises((OSError, ValueError, KeyError)):
            load_checkpoint(file_path)


def test_the_start_of_an_empty_frame_is_empty(tmp_path):
    config = quick_config(windows={"shared_octaves": 1})
    scene = scene_of(FRAMES, config, "Y")
    empty = frame_of(np.zeros(BOX, np.float32), 9.0)
    (start,) = coarse_frames([empty], [random_style()], scene, config)
    save_start(start, tmp_path / "start.npz")
    read = load_start(tmp_path / "start.npz")
    assert read.displacement is None and read.smoke is None and read.colours is None
    assert load_carried(tmp_path / "start.npz") is None


@pytest.mark.parametrize("shape", [(9, 8, 7), (8, 1, 5), (1, 1, 3)])
@pytest.mark.parametrize("low", [(0, 0, 0), (-3, 5, 2)])
def test_block_means_keep_the_mass(shape, low):
    values = np.random.default_rng(0).random(shape).astype(np.float32)
    fine = DenseField("density", values, low, np.diag([0.5, 0.25, 2.0, 1.0]))
    coarse = coarsen_field(fine, 4)
    masses = [
        field.values.sum(dtype=float) * abs(np.linalg.det(field.index_to_world[:3, :3]))
        for field in (fine, coarse)
    ]
    assert masses[1] == pytest.approx(masses[0], rel=1e-6)


def test_a_block_lies_in_the_middle_of_its_voxels_and_blocks_do_not_depend_on_the_crop():
    matrix = np.diag([0.5, 0.25, 2.0, 1.0])
    matrix[3, :3] = [1.0, -2.0, 3.0]
    values = np.random.default_rng(0).random((12, 8, 8)).astype(np.float32)
    coarse = coarsen_field(DenseField("density", values, (-4, 8, 0), matrix), 4)
    assert coarse.ijk_min == (-1, 2, 0)
    middle = np.array([-2.5, 9.5, 1.5]) @ matrix[:3, :3] + matrix[3, :3]
    first = np.array(coarse.ijk_min) @ coarse.index_to_world[:3, :3] + coarse.index_to_world[3, :3]
    assert first == pytest.approx(middle)
    cropped = coarsen_field(DenseField("density", values[4:], (0, 8, 0), matrix), 4)
    assert cropped.ijk_min == (0, 2, 0)
    assert np.array_equal(cropped.values, coarse.values[1:])


def test_no_octave_is_shared_that_a_step_has_not():
    assert coarse_factor(quick_config(windows={"shared_octaves": 0})) == 1
    assert coarse_factor(quick_config(windows={"shared_octaves": 5})) == 2  # of two octaves one
    single = quick_config(shape={"iterations": [3]}, windows={"shared_octaves": 2})
    assert coarse_factor(single) == 1

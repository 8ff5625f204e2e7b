"""Faults of the reference code that no other test would find here; see docs/stability.md.

The reference code is that of [Kim2019, Kim2020]; W1 to W22 number its faults.
"""

import json
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
import torch

from tests.fixtures.pipeline_fixtures import Shot, run
from tests.fixtures.smoke_fixtures import frame_of, puff, smoke_of
from tests.fixtures.stylize_fixtures import by_voxel, quick_config, run_core, scene_of
from usdsmoke.audit import provenance
from usdsmoke.base.errors import ConfigError
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.config.look_sections import ViewsConfig
from usdsmoke.config.resolve import resolve_config
from usdsmoke.core.sequence.stylize import StylizedFrame
from usdsmoke.core.views.cameras import View, orbit_view, sample_angles
from usdsmoke.core.views.project import column_map

DENSITY = puff(12)
SHAPE = {"optimize": {"steps": ["shape"], "threads": 1, "tolerance": 0.0}}
COLOUR = {"optimize": {"steps": ["colour"], "threads": 1, "tolerance": 0.0}}


def columns_of(density: np.ndarray, view: View) -> np.ndarray:
    smoke = smoke_of(density)
    image = column_map(smoke.positions, smoke.edges, view, torch.float64)
    return image.apply(smoke.density.double()[:, None])[..., 0].numpy()


def assert_same_bits(first: StylizedFrame, other: StylizedFrame) -> None:
    for name in ("density", "emission"):
        one, same = getattr(first, name), getattr(other, name)
        assert one.ijk_min == same.ijk_min
        assert np.array_equal(one.values, same.values)


@pytest.mark.parametrize("amount", [1.5, 7.0, 1e6])
def test_density_above_one_is_moved_no_farther(amount):
    """W2: a mask that is rounded up multiplies the unknown in every iteration."""
    config = quick_config(shape={"iterations": [0, 12], "learning_rate": 2e-3}, **SHAPE)
    plain, dense = (run_core([frame_of(DENSITY * np.float32(a))], config)[0] for a in (1.0, amount))
    moved = [result.report.transport.largest_displacement for result in (plain, dense)]
    cap = plain.report.transport.cap
    assert 0.1 * cap < moved[0] < 0.5 * cap  # it is not the cap that holds it back
    assert moved[1] == pytest.approx(moved[0], rel=1e-3)
    assert dense.report.shape.loss == pytest.approx(plain.report.shape.loss, rel=1e-4)


def test_an_empty_first_frame_changes_no_bit_of_the_frames_after_it():
    """W3: the maximum of an empty picture spoils what all frames are scaled by."""
    empty = frame_of(np.zeros((4, 4, 4)), 0.0)
    later = [frame_of(DENSITY, 1.0), frame_of(DENSITY, 2.0)]
    alone, (nothing, *after) = run_core(later), run_core([empty, *later])
    assert nothing.report.left_out == "empty frame"
    for first, other in zip(alone, after, strict=True):
        assert_same_bits(first, other)


@pytest.mark.parametrize("displacement", ["stream", "potential", "mixed"])
@pytest.mark.parametrize("rate", [1.0, 1e6, 1e30])
def test_no_learning_rate_moves_smoke_beyond_its_reach(rate, displacement):
    """W6: without a limit of the step smoke is sent many domain widths away."""
    shape = {"iterations": [4, 4], "learning_rate": rate, "displacement": displacement}
    result = run_core([frame_of(DENSITY)], quick_config(shape=shape, **SHAPE))[0]
    report, values = result.report, result.density.values
    assert report.transport.largest_displacement <= report.transport.cap * (1 + 1e-6)
    assert np.isfinite(values).all() and np.isfinite(report.shape.loss).all()
    assert values.sum() == pytest.approx(DENSITY.sum(), rel=1e-5)


@pytest.mark.parametrize("name", ["gamma", "gamma_shape"])
@pytest.mark.parametrize("gamma", [-0.1, -1e6, float("nan")])
def test_negative_extinction_is_refused(gamma, name):
    """W7: smoke that gives light to what is behind it."""
    with pytest.raises(ConfigError, match=rf"optics\.{name}"):
        resolve_config({"optics": {name: gamma}})


def test_negative_density_comes_back_as_it_was_where_nothing_is_moved():
    """W8: a clip in the middle changes the result though nothing was asked to change."""
    density = np.where(DENSITY > 0, DENSITY, np.float32(-0.2))
    painted = run_core([frame_of(density)], quick_config(**COLOUR))[0]
    assert np.array_equal(painted.density.values, density) and painted.emission.values.any()
    assert not painted.emission.values[density < 0].any()


def test_a_quarter_turn_of_a_box_that_is_no_cube_is_rigid():
    """W9: a turn in unit coordinates exchanges the long and the short side of the smoke."""
    density = np.random.default_rng(0).uniform(0.1, 1.0, (16, 32, 64))
    view = orbit_view(90.0, 0.0, "Y", np.array([7.5, 15.5, 31.5]), 32, 64, 1.0)
    wanted = density.astype(np.float32).sum(axis=0, dtype=float)[::-1, ::-1]
    assert columns_of(density, view) == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("elevation", [0.0, 45.0, 80.0])
def test_a_sheet_on_the_floor_keeps_its_mass_in_every_view(elevation):
    """W10: look-ups that are held at the border smear the sheet over all that is below it."""
    density = np.zeros((24, 24, 24))
    density[:, 0] = 1.0
    view = orbit_view(30.0, elevation, "Y", np.full(3, 11.5), 80, 80, 1.0)
    assert columns_of(density, view).sum() == pytest.approx(24 * 24, rel=1e-9)


def test_room_around_smoke_that_touches_its_walls_changes_nothing():
    """W10, W11: a border that is held, or a scale that counts empty voxels, would."""
    cut = DENSITY[5:]
    assert cut[0].any()
    padded = frame_of(np.pad(cut, ((12, 9), (10, 10), (9, 12))), ijk_min=(-12, -10, -9))
    config = quick_config(shape={"iterations": [4, 4], "learning_rate": 0.01})
    close, roomy = (run_core([frame], config)[0] for frame in (frame_of(cut), padded))
    assert roomy.report.shape.loss == pytest.approx(close.report.shape.loss, rel=1e-5)
    for name in ("largest_displacement", "mass_error"):
        wide, tight = (getattr(result.report.transport, name) for result in (roomy, close))
        assert wide == pytest.approx(tight, rel=1e-5)
    for name in ("density", "emission"):
        one, other = (by_voxel(getattr(result, name)) for result in (close, roomy))
        assert one.keys() == other.keys()
        assert all(other[voxel] == pytest.approx(one[voxel], rel=1e-5) for voxel in one)


@pytest.mark.parametrize("seed", range(10))
def test_eight_views_all_round_leave_no_third_of_the_circle_unseen(seed):
    """W13: points kept in the order in which they grew all stand on one side."""
    config = ViewsConfig(azimuth=180.0, elevation=0.0)
    angles = np.sort(np.mod(sample_angles(config, 8, seed)[:, 0], 360))
    assert max(b - a for a, b in pairwise([*angles, angles[0] + 360])) < 120


@pytest.mark.parametrize(("count", "pool"), [(3, 2), (7, 5), (40, 1)])
@pytest.mark.parametrize("sampling", ["fixed", "poisson"])
def test_any_number_of_views_an_iteration_from_any_pool(sampling, count, pool):
    """W14: more views than angles, counts that share no factor, a range of one angle."""
    views = {"count": count, "pool": pool, "sampling": sampling, "image_size": 16}
    for angles in ({}, {"azimuth": 0.0, "elevation": 0.0}):
        config = quick_config(
            views=views | angles, shape={"iterations": [1]}, colour={"iterations": [1]}
        )
        result = run_core([frame_of(puff(6))], config)[0]
        assert np.isfinite(result.emission.values).all() and result.emission.values.any()


@pytest.mark.parametrize("n_octaves", [1, 8, 20])
def test_any_number_of_octaves(n_octaves):
    """W15: the coarsest of these have one voxel, which nothing moves."""
    iterations = {"iterations": [1] * n_octaves}
    result = run_core([frame_of(puff(6))], quick_config(shape=iterations, colour=iterations))[0]
    for step in ("shape", "colour"):
        n_done = min(n_octaves, 3) if step == "shape" else n_octaves
        assert len(result.report.steps[step].loss) == n_done
        assert np.isfinite(result.report.steps[step].loss).all()
    assert result.density.values.sum() == pytest.approx(puff(6).sum(), rel=1e-5)


def frames_of(sizes: Sequence[tuple[int, int, int]]) -> list[VolumeFrame]:
    generator = np.random.default_rng(0)
    return [
        frame_of(generator.uniform(0.2, 1.0, size), 1.0 + n, np.array([6.0, 0.0, 0.0]))
        for n, size in enumerate(sizes)
    ]


def test_frames_of_different_size_are_stylized_in_one_window():
    """W15: smoke grows, and so does its box."""
    sizes = [(5, 6, 7), (8, 6, 3), (1, 1, 1), (4, 9, 1)]
    for frame, result in zip(frames_of(sizes), run_core(frames_of(sizes)), strict=True):
        source = frame.density.values.sum(dtype=float)
        assert result.density.values.sum(dtype=float) == pytest.approx(source, rel=1e-4)
        assert result.emission.values.any()


def test_a_frame_depends_on_no_frame_after_it_but_those_it_is_averaged_with():
    """W16, W17: masks blurred over time, and averages overwritten while they are taken.

    A frame is averaged with the next one, which is painted on density averaged with its next one.
    """
    frames = frames_of([(6, 6, 6), (6, 7, 6), (7, 6, 6), (6, 6, 7)])
    alone = {"shape": {"iterations": [2, 2], "smoothing": 0.0}}
    alone |= {"colour": {"iterations": [2, 2], "smoothing": 0.0}}
    for config, n_after in ((quick_config(**alone), 0), (quick_config(), 2)):
        scene = scene_of(frames, config, "Y")
        whole = run_core(frames, config, scene)
        for n in range(n_after + 1, len(frames)):
            cut = run_core(frames[:n], config, scene)
            for first, other in zip(cut[: n - n_after], whole[: n - n_after], strict=True):
                assert_same_bits(first, other)


@pytest.mark.usefixtures("quick_grids")
def test_the_record_gives_back_versions_settings_views_and_losses(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
):
    """W22: a result that cannot tell what it came from."""
    seen: list[np.ndarray] = []

    def noted(config: ViewsConfig, n: int, seed: int, n_aside: int = 0) -> np.ndarray:
        seen.append(sample_angles(config, n, seed, n_aside))
        return seen[-1]

    monkeypatch.setattr("usdsmoke.core.views.scene.sample_angles", noted)
    result = run(
        shot, "optimize.iterations=3", "optimize.seed=5", "views.image_size=16", "views.pool=2",
        "optimize.threads=1", "features.layers=[oriented1]",
        "optimize.error_budget=false",  # which looks from views of its own
    )  # fmt: skip
    (found,) = provenance(result.look_layer)
    assert found.record.packages.keys() >= {"torch", "numpy"}
    views = ViewsConfig(**found.record.settings["views"])
    known = [sample_angles(views, views.pool, found.record.seed + octave) for octave in range(3)]
    assert len(seen) >= 6  # two steps of three octaves
    assert all(any(np.array_equal(found, angles) for angles in known) for found in seen)
    record = json.loads((result.frames[0].parent / "run.json").read_text(encoding="utf-8"))
    for file_path, n_octaves in zip(result.frames, (3, 1, 1), strict=True):
        report = record["frames"][file_path.name]["report"]
        for step in ("shape", "colour"):
            n_done = len(report[step]["iterations"])
            assert len(report[step]["loss"]) == n_done
            # the coarsest octave is a row of voxels, in which a stream function moves nothing
            assert n_done == n_octaves or (step == "shape" and n_done == n_octaves - 1)
            assert np.isfinite(report[step]["loss"]).all()

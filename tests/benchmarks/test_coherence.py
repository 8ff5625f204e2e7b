"""The coherence benchmark: its measures against closed forms, and a small run of the command."""

from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks import coherence_study
from benchmarks.coherence_measures import border_ratio, painted_colours, temporal_errors
from benchmarks.coherence_runs import Outcome, Run, Shot, _joined, run_windows
from benchmarks.coherence_study import WINDOWS, Case, Kept, Study, keep_runs
from benchmarks.long_shot import fit_line, window_means
from tests.fixtures.smoke_fixtures import random_style
from tests.fixtures.stylize_fixtures import quick_config, scene_of
from tests.unit.core.test_fast_smoke import plume
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.smoke.active import activate
from usdsmoke.core.smoke.srgb import decode_srgb
from usdsmoke.planning.windows import Window
from usdsmoke.vdb.blend import tail_weights

GAMMA_W = 2.0


def make_outcome(
    time_code: float, colour: float, moved: float, density: float = 1.0, noise: int | None = None
) -> Outcome:
    """A cube of smoke of one grey that is displaced along i by one length; nothing flows.

    Noise is drawn anew for each seed, in both.
    """
    values = np.full((4, 4, 4), density, np.float32)
    smoke = DenseField("density", values, (0, 0, 0), np.eye(4))
    colours, displacement = torch.full((4, 4, 4, 3), colour), torch.zeros(4, 4, 4, 3)
    displacement[..., 0] = moved
    if noise is not None:
        drawn = torch.rand(2, 4, 4, 4, 3, generator=torch.Generator().manual_seed(noise))
        colours, displacement = drawn[0], drawn[1]
    light = (decode_srgb(colours) * GAMMA_W * density).numpy()
    emission = DenseField("emission", light, (0, 0, 0), np.eye(4), (0.0, 0.0, 0.0))
    frame = VolumeFrame(time_code, smoke, np.eye(4))
    still = activate(smoke, np.eye(4), torch.device("cpu"))
    lattice = Lattice(np.zeros(3), (4, 4, 4), np.eye(4))
    return Outcome(frame, still, Displacement(displacement, lattice), smoke, emission)


def test_what_stays_has_no_temporal_error_and_what_is_drawn_anew_has_one() -> None:
    seeds = [0, 0, 1, 2, 0]
    outcomes = [make_outcome(code, 0, 0, noise=seed) for code, seed in enumerate(seeds)]
    frames = [outcome.source for outcome in outcomes]
    for by_lag in temporal_errors(frames, Run(outcomes, 0), GAMMA_W).values():
        assert {lag: list(steps) for lag, steps in by_lag.items()} == {1: [1, 2, 3, 4], 4: [4]}
        assert by_lag[1][1] == 0 and by_lag[4][4] == 0
        np.testing.assert_allclose([by_lag[1][code] for code in (2, 3, 4)], 1, atol=0.35)


def test_colours_brighter_than_white_are_measured_as_they_are() -> None:
    _, colours = painted_colours(make_outcome(1, 1.4, 0), GAMMA_W)
    np.testing.assert_allclose(colours, 1.4, rtol=1e-5)


def test_frames_are_compared_over_those_that_a_run_has_left_out() -> None:
    outcomes = [make_outcome(code, 0, 0, noise=seed) for code, seed in enumerate([0, 0, 1, 2, 0])]
    frames = [outcome.source for outcome in outcomes]
    whole = temporal_errors(frames, Run(outcomes, 0), GAMMA_W)
    some = temporal_errors(frames, Run([outcomes[0], *outcomes[2:4], outcomes[4]], 0), GAMMA_W)
    for kind, by_lag in some.items():
        assert by_lag == {1: {c: whole[kind][1][c] for c in (3, 4)}, 4: whole[kind][4]}


def test_a_run_is_kept_and_used_again_with_the_same_settings_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(24, "strokes", 3, WINDOWS, (1, 2))
    asked: list[list[str]] = []

    def measure(case: Case, settings: list[str], study: Study, folder: Path) -> Kept:
        asked.append(settings)
        errors = {"colour": {1: {2: 0.25}}}
        distances, own = {"grey": {1: 2.0, 2: 3.0}}, {"colour": {2: 0.5}}
        kept = Kept(case, settings, distances, errors, 1.5, [2], [2], [(0.1, 0.2)], own)
        coherence_study._write(folder, kept, np.zeros((2, 4, 4, 3), np.uint8))
        return kept

    monkeypatch.setattr(coherence_study, "_measure", measure)
    study = Study((), (case,), 2)
    first, again = (keep_runs(study, tmp_path)[case] for _ in range(2))
    assert again.mean_distance("grey", [1, 2]) == first.mean_distance("grey", [1, 2]) == 2.5
    assert again.own == first.own
    assert again.mean_error("colour", 1) == 0.25 and np.isnan(again.mean_error("colour", 4))
    assert asked == [["optimize.seed=3"]]
    other = Study((), (case,), 2, ("views.pool=2",))
    assert keep_runs(other, tmp_path, 0) == {} and len(asked) == 1
    assert list(keep_runs(other, tmp_path, 1)) == [case] and len(asked) == 2


def test_borders_are_compared_with_all_other_steps() -> None:
    mean, most = border_ratio(np.array([1.0, 1.0, 2.0, 4.0, 1.0]), [2, 3])
    assert (mean, most) == (3.0, 4.0)
    with pytest.raises(ValueError, match="not all"):
        border_ratio(np.ones(2), [])


def test_a_line_over_frames_is_flat_only_within_its_noise() -> None:
    codes, noise = np.arange(1.0, 97.0, 4.0), np.tile([0.1, -0.1, -0.1, 0.1], 6)
    line = fit_line(codes, 2.0 + 0.5 * (codes - 1) / 92)
    np.testing.assert_allclose([line.mean, line.change], [2.25, 0.5], rtol=1e-12)
    assert line.error < 1e-12 and not line.is_flat
    assert fit_line(codes, 2.0 + noise).is_flat
    assert not fit_line(codes, 2.0 + noise + 0.5 * codes / 96).is_flat


def test_what_frames_of_a_window_share_counts_once() -> None:
    """Noise of windows, not of frames: half of all lines through it leave the band by frames."""
    codes, generator = np.arange(1.0, 97.0, 2.0), np.random.default_rng(0)
    outside = {"frames": 0, "windows": 0}
    for _ in range(200):
        values = np.repeat(generator.normal(size=12), 4)
        outside["frames"] += not fit_line(codes, values).is_flat
        outside["windows"] += not fit_line(*window_means(codes, values)).is_flat
    assert outside["windows"] < 25 < 50 < outside["frames"]
    means, of = window_means(codes, codes)
    assert of.tolist() == means.tolist() == [4.0 + 8 * number for number in range(12)]


def test_frames_of_an_overlap_are_blended_like_the_assemblys() -> None:
    first = [make_outcome(code, 0.2, 1.0) for code in (1, 2, 3, 4)]
    second = [make_outcome(code, 0.6, 2.0, density=2.0) for code in (3, 4, 5)]
    windows = [Window(0, (1, 2), (3, 4)), Window(1, (3, 4, 5), continues=True)]
    run = _joined(windows, [first, second])
    assert [item.source.time_code for item in run.outcomes] == [1, 2, 3, 4, 5]
    assert run.starts == (2,)
    assert run.touched == (1, 2, 3)  # from the frame before the overlap to the one behind it
    later = [1 - weight for weight in tail_weights(2)]
    moved = [float(item.displacement.values[0, 0, 0, 0]) for item in run.outcomes]
    np.testing.assert_allclose(moved, [1, 1, 1 + later[0], 1 + later[1], 2], rtol=1e-6)
    masses = [float(item.density.values.mean()) for item in run.outcomes]
    np.testing.assert_allclose(masses, [1, 1, 1 + later[0], 1 + later[1], 2], rtol=1e-6)
    np.testing.assert_allclose(run.differences, [(2 / 3, run.differences[0][1])] * 2, rtol=1e-6)


def test_nothing_of_the_smoke_before_a_jump_is_left_in_an_overlap() -> None:
    """Windows that meet at the jump: the coarse step and both versions start anew behind it."""
    steps = {"shape": {"iterations": [2, 3]}, "colour": {"iterations": [2, 3]}}
    config = quick_config(**steps, windows={"size": 2, "overlap": 2})
    shots = [
        [plume(seed, n) for n in (1, 2, 3)] + [plume(7, n) for n in (4, 5, 6)] for seed in (1, 4)
    ]
    scene = scene_of(shots[0], config)
    runs = [run_windows(Shot(frames, random_style(), config, scene)) for frames in shots]
    assert runs[0].starts == (2, 4)
    for number, (one, other) in enumerate(zip(*(run.outcomes for run in runs), strict=True)):
        for name in ("density", "emission"):
            values = [getattr(item, name).values for item in (one, other)]
            is_same = values[0].shape == values[1].shape and np.array_equal(*values)
            assert is_same == (number >= 3), (number, name)

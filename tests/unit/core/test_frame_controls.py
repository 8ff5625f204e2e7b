"""Strength, pattern speed, gamma and style weights that change from frame to frame."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import frame_of, puff, random_style
from tests.fixtures.stylize_fixtures import by_voxel, quick_config, run_core, scene_of
from usdsmoke.base.errors import ConfigError
from usdsmoke.base.volume import DenseField, FrameControls, VolumeFrame
from usdsmoke.core.sequence.coarse import coarse_frames
from usdsmoke.core.sequence.frame_loop import run_frames
from usdsmoke.core.sequence.frame_state import make_context
from usdsmoke.core.sequence.stylize import StylizedFrame
from usdsmoke.core.steps import targets as targets_module
from usdsmoke.core.steps.targets import StyleTargets, make_targets
from usdsmoke.core.views.scene import frame_scene

STYLES = [random_style(seed=0), 1 - random_style(20, 30, seed=1)]
STEPS = {name: {"steps": [name], "threads": 1, "tolerance": 0.0} for name in ("shape", "colour")}


def drifting(number: int) -> VolumeFrame:
    """A puff that moves by a voxel a frame along i."""
    density = np.zeros((18, 12, 12), np.float32)
    density[number : number + 10, 1:11, 1:11] = puff(10)
    return frame_of(density, float(number + 1), np.array([24.0, 0.0, 0.0]))


FRAMES = [drifting(number) for number in range(8)]


def controlled(frames: Sequence[VolumeFrame], **values: Sequence[Any]) -> list[VolumeFrame]:
    """The frames with one value of each control per frame."""
    return [
        replace(frame, controls=FrameControls(**{k: v[n] for k, v in values.items()}))
        for n, frame in enumerate(frames)
    ]


def assert_same(ours: Sequence[StylizedFrame], others: Sequence[StylizedFrame]) -> None:
    for one, other in zip(ours, others, strict=True):
        assert np.array_equal(one.density.values, other.density.values)
        assert (one.emission is None) == (other.emission is None)
        if one.emission is not None:
            assert np.array_equal(one.emission.values, other.emission.values)


def difference(field: DenseField, other: DenseField) -> float:
    """How far a field is from another one, as a share of that."""
    ours, theirs = by_voxel(field), by_voxel(other)
    nothing = (0.0,) * (1 if field.values.ndim == 3 else field.values.shape[3])
    changes = [
        np.abs(np.subtract(ours.get(voxel, nothing), theirs.get(voxel, nothing))).sum()
        for voxel in ours.keys() | theirs.keys()
    ]
    return float(sum(changes) / other.values.sum(dtype=float))


def way(result: StylizedFrame, source: VolumeFrame) -> float:
    """How far the density is from the source's, as a share of it."""
    return difference(result.density, source.density)


# strength


def test_a_fade_of_the_shape_shows_at_each_frame_what_its_strength_throughout_would_show():
    """The chain runs at full strength, so no frame knows of the strengths of the others."""
    config, fade = quick_config(optimize=STEPS["shape"]), [n / 7 for n in range(8)]
    faded = run_core(controlled(FRAMES, strength=fade), config)
    for number in (1, 4, 7):
        section = {**STEPS["shape"], "strength": fade[number]}
        alone = run_core(FRAMES, quick_config(optimize=section))
        assert_same([faded[number]], [alone[number]])


def test_a_fade_grows_from_the_source_frame_by_frame():
    faded = run_core(controlled(FRAMES, strength=[n / 7 for n in range(8)]))
    whole = run_core(FRAMES)
    assert np.array_equal(faded[0].density.values, FRAMES[0].density.values)
    assert faded[0].emission is not None and not faded[0].emission.values.any()
    ways = [way(result, source) for result, source in zip(faded, FRAMES, strict=True)]
    lights = [float(result.emission.values.sum(dtype=float)) for result in faded]
    assert all(later > earlier for earlier, later in pairwise(ways))
    assert all(later > earlier for earlier, later in pairwise(lights))
    assert ways[-1] == pytest.approx(way(whole[-1], FRAMES[-1]))
    assert ways[1] < 0.25 * ways[-1]
    # colours of the frames before were found on smoke that had moved less
    assert lights[-1] == pytest.approx(whole[-1].emission.values.sum(dtype=float), rel=0.05)


def test_emission_is_the_strengths_share_of_the_emission_at_full_strength():
    config, fade = quick_config(optimize=STEPS["colour"]), [n / 7 for n in range(8)]
    faded = run_core(controlled(FRAMES, strength=fade), config)
    whole = run_core(FRAMES, config)
    for share, ours, full in zip(fade, faded, whole, strict=True):
        np.testing.assert_allclose(ours.emission.values, share * full.emission.values, rtol=1e-5)


@pytest.mark.parametrize("steps", [["shape"], ["colour"], ["shape", "colour"]])
def test_a_frame_of_strength_0_among_others_is_the_source_and_does_not_break_the_chain(steps):
    config = quick_config(optimize={"steps": steps, "threads": 1, "tolerance": 0.0})
    frames = FRAMES[:4]
    dipped = run_core(controlled(frames, strength=[1.0, 1.0, 0.0, 1.0]), config)
    assert dipped[2].density.values is frames[2].density.values
    assert dipped[2].emission is None or not dipped[2].emission.values.any()
    assert not dipped[2].report.left_out
    whole = run_core(frames, config)
    if len(steps) == 1:
        assert_same([dipped[3]], [whole[3]])
    # with a chain that starts anew, 6% of the density and 37% of the emission differ
    assert difference(dipped[3].density, whole[3].density) < 0.02
    if whole[3].emission is not None:
        assert difference(dipped[3].emission, whole[3].emission) < 0.02


def test_frames_far_from_any_effect_are_left_out_and_what_follows_starts_anew():
    strengths = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]
    results = run_core(controlled(FRAMES, strength=strengths))
    reports = [result.report for result in results]
    left_out = [number for number, report in enumerate(reports) if report.left_out]
    assert left_out == [2, 3, 7]
    assert reports[2].left_out == "optimize.strength is 0"
    assert reports[0].shape.iterations == reports[4].shape.iterations == (2, 2)
    assert [len(reports[n].shape.iterations) for n in (1, 5, 6)] == [1, 1, 1]
    assert reports[4].temporal is None and reports[5].temporal is not None


# pattern speed


def test_a_pattern_speed_holds_from_its_frame_to_the_next_one():
    frames = controlled(FRAMES[:3], pattern_speed=[2.0, -0.5, 1.0])
    config = quick_config()
    job = make_context([STYLES[0]], scene_of(frames, config, "Y"), config, None, 24.0, None, 3)
    links = list(run_frames(frames, job))
    assert job.transit(links[0], links[1]).seconds == 2.0 / 24
    assert job.transit(links[1], links[2]).seconds == -0.5 / 24


def test_the_pattern_follows_the_smoke_or_stays_by_the_earlier_frames_speed():
    """With nothing optimised later, each frame's colours are the first one's, carried along."""
    still = {"iterations": [2, 2], "warm_rate": 1e-9, "smoothing": 0.0, "occlusion": 0.0}
    config = quick_config(colour=still, optimize=STEPS["colour"])
    frames = controlled(FRAMES[:3], pattern_speed=[0.0, 1.0, 0.0])
    colours = []
    for result, frame in zip(run_core(frames, config), frames, strict=True):
        smoke = frame.density.values > 0
        light = np.zeros((*smoke.shape, 3))
        light[smoke] = result.emission.values[smoke] / frame.density.values[smoke, None]
        colours.append((smoke, light))
    (smoke, first), (now, second), (_, third) = colours
    both = smoke & now
    np.testing.assert_allclose(second[both], first[both], atol=0.01 * first.max())
    np.testing.assert_allclose(third[1:], second[:-1], atol=0.01 * first.max())


# gamma


@pytest.mark.parametrize("gamma", [1e-6, 0.01, 0.3, 5.0])
def test_a_frames_scene_is_the_one_that_its_gamma_would_have_given_the_shot(gamma):
    config, wanted = quick_config(), quick_config(optics={"gamma": gamma})
    assert frame_scene(scene_of(FRAMES, config, "Y"), gamma) == scene_of(FRAMES, wanted, "Y")


def test_extinction_and_exposure_follow_gamma_as_the_closed_forms_say():
    scene = scene_of(FRAMES, quick_config(), "Y")
    assert scene.gamma_w * scene.thick == pytest.approx(30.0)  # optics.depth
    scenes = {gamma: frame_scene(scene, gamma) for gamma in np.geomspace(1e-4, 10, 60)}
    for gamma, own in scenes.items():
        assert own.gamma_w == gamma / scene.reference_voxel_size
        seen = 1 - np.exp(-own.gamma_w * scene.thick)
        assert own.exposure == pytest.approx(max(1.0, 0.7 / seen))
        assert replace(own, gamma_w=scene.gamma_w, exposure=scene.exposure) == scene
    exposures = [own.exposure for own in scenes.values()]
    assert all(0.8 < later / earlier <= 1 for earlier, later in pairwise(exposures))


def test_a_frame_emits_by_its_own_extinction_and_reports_it():
    """Equal smoke, equal colours: light is colour x gamma_w x density."""
    config = quick_config(
        optimize=STEPS["colour"],
        colour={"iterations": [2, 2], "warm_rate": 1e-9, "smoothing": 0.0, "occlusion": 0.0},
    )
    frames = [replace(FRAMES[0], time_code=float(n), velocity=None) for n in range(3)]
    gammas = [0.1, 0.2, None]
    scene = scene_of(frames, config, "Y")
    results = run_core(controlled(frames, gamma=gammas), config, scene)
    lights = [result.emission.values for result in results]
    extinctions = [0.1, 0.2, scene.gamma_w]
    assert [result.report.extinction for result in results] == extinctions
    for light, gamma_w in zip(lights, extinctions, strict=True):
        np.testing.assert_allclose(light / gamma_w, lights[0] / 0.1, rtol=1e-3, atol=1e-6)


# style weights


def targets_of(styles: Sequence[np.ndarray], weights: Sequence[float] = ()) -> StyleTargets:
    # styles set one level for areas by their shares, so that what areas lack is no sum over styles
    config = quick_config(style={"weights": list(weights)}, losses={"local_contrast": 0})
    scene = scene_of(FRAMES[:1], config, "Y")
    return make_targets(styles, scene, config, torch.device("cpu"))


@pytest.mark.parametrize(("weights", "number"), [([1.0, 0.0], 0), ([0.0, 2.0], 1)])
def test_the_ends_of_a_blend_have_the_targets_of_a_single_style(weights, number):
    both = targets_of(STYLES)
    assert both.brightness != targets_of(STYLES[number : number + 1]).brightness
    own = both.weighted(quick_config(style={"weights": weights}).style)
    alone = targets_of(STYLES[number : number + 1])
    assert own.brightness == alone.brightness
    assert torch.equal(own.background, alone.background)
    picture = torch.rand(16, 16, 3, generator=torch.Generator().manual_seed(1))
    for factor, grey in ((1, False), (2, False), (1, True)):
        guide = torch.ones(16, 16)
        assert torch.equal(
            own.at(factor, grey)(picture, guide), alone.at(factor, grey)(picture, guide)
        )


def test_between_the_ends_the_targets_are_mixed_by_the_shares():
    both = targets_of(STYLES)
    mixed = both.weighted(quick_config(style={"weights": [3, 1]}).style)
    picture, guide = torch.full((16, 16, 3), 0.3), torch.ones(16, 16)
    ends = [targets_of([style]).at(1)(picture, guide) for style in STYLES]
    torch.testing.assert_close(mixed.at(1)(picture, guide), 0.75 * ends[0] + 0.25 * ends[1])


def test_a_run_in_which_every_frame_asks_for_one_style_is_that_styles_run():
    frames = FRAMES[:3]
    asked = run_core(controlled(frames, style_weights=[(0.0, 1.0)] * 3), styles=STYLES)
    assert_same(asked, run_core(frames, styles=STYLES[1:]))


def test_a_style_is_measured_once_however_many_blends_it_is_in(monkeypatch):
    made = []

    class Counted(targets_module.StyleTarget):
        def __init__(self, *arguments: Any) -> None:
            made.append(arguments)
            super().__init__(*arguments)

    monkeypatch.setattr(targets_module, "StyleTarget", Counted)
    weights = [(1 - n / 7, n / 7) for n in range(8)]
    run_core(controlled(FRAMES, style_weights=weights), styles=STYLES)
    # 2 images at full size, and the first of them, which frame 1 alone sees, at half size as well;
    # in colour and in grey
    assert len(made) == 2 * (2 + 1)


def test_weights_that_do_not_fit_the_images_are_refused_with_the_time_code():
    frames = controlled(FRAMES[:2], style_weights=[(1.0, 0.0), (1.0,)])
    with pytest.raises(ConfigError, match=r"at timeCode 2: style.weights has 1 number for 2"):
        run_core(frames, styles=STYLES)


# all of them


EVERY = {
    "optics": {"gamma": 0.05},
    "windows": {"pattern_speed": 0.5},
    "style": {"weights": [3.0, 1.0]},
    "optimize": {"strength": 0.6, "threads": 1, "tolerance": 0.0},
}
AS_CONTROLS = {
    "strength": [0.6] * 3,
    "pattern_speed": [0.5] * 3,
    "gamma": [0.05] * 3,
    "style_weights": [(3.0, 1.0)] * 3,
}


def test_controls_that_are_the_same_at_every_frame_give_the_bits_of_the_setting():
    frames = FRAMES[:3]
    asked = run_core(controlled(frames, **AS_CONTROLS), styles=STYLES)
    assert_same(asked, run_core(frames, quick_config(**EVERY), styles=STYLES))


def test_the_coarse_step_sees_the_controls_too():
    config, frames = quick_config(), FRAMES[:3]
    deciding = quick_config(**EVERY)
    scene, other = (scene_of(frames, c, "Y") for c in (config, deciding))
    asked = list(coarse_frames(controlled(frames, **AS_CONTROLS), STYLES, scene, config))
    plain = list(coarse_frames(frames, STYLES, other, deciding))
    unasked = list(coarse_frames(frames, STYLES, scene, config))
    for ours, wanted, default in zip(asked, plain, unasked, strict=True):
        assert torch.equal(ours.colours, wanted.colours)
        assert torch.equal(ours.displacement.values, wanted.displacement.values)
        assert not torch.equal(ours.colours[: len(default.colours)], default.colours)
    faded = controlled(frames, strength=[0.0, 0.0, 1.0])
    starts = list(coarse_frames(faded, STYLES, scene, config))
    assert [start.colours is None for start in starts] == [True, False, False]

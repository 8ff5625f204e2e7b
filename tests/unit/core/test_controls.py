"""A frame's controls as settings: what they replace, what is refused, which frames are computed."""

import pytest

from tests.fixtures.stylize_fixtures import quick_config
from usdsmoke.base.errors import ConfigError
from usdsmoke.base.volume import FrameControls, FrameSource, VolumeSource
from usdsmoke.core.sequence.controls import check_controls, frame_config, in_effect, is_computed

CONFIG = quick_config(style={"weights": [3, 1]}, optics={"gamma": 0.5})


def test_a_frame_without_controls_has_the_settings_of_the_run():
    assert frame_config(CONFIG, FrameControls(), 1.0) is CONFIG


def test_controls_take_the_place_of_their_settings_and_of_no_others():
    controls = FrameControls(0.25, -2.0, 0.75, (1.0, 0.0))
    own = frame_config(CONFIG, controls, 1.0, n_styles=2)
    assert own.optimize == CONFIG.optimize.replace(strength=0.25)
    assert own.windows == CONFIG.windows.replace(pattern_speed=-2.0)
    assert own.optics == CONFIG.optics.replace(gamma=0.75)
    assert own.style == CONFIG.style.replace(weights=[1.0, 0.0])
    others = {"optimize", "windows", "optics", "style"}
    for section in type(CONFIG).model_fields:
        if section not in others:
            assert getattr(own, section) == getattr(CONFIG, section)


def test_what_is_not_said_stays_the_runs():
    own = frame_config(CONFIG, FrameControls(pattern_speed=0.0), 1.0, n_styles=2)
    assert own.windows.pattern_speed == 0.0
    assert own.optics == CONFIG.optics and own.style == CONFIG.style


@pytest.mark.parametrize(
    ("controls", "text"),
    [
        (FrameControls(strength=1.5), "optimize.strength is 1.5. Set it to a number from 0 to 1"),
        (FrameControls(strength=float("nan")), "optimize.strength is nan. Set it to a number"),
        (FrameControls(gamma=0.0), "optics.gamma is 0.0. Set it to null or a number above 0"),
        (
            FrameControls(pattern_speed=9.0),
            "windows.pattern_speed is 9.0. Set it to a number from -8 to 8",
        ),
        (FrameControls(style_weights=(1.0, -1.0)), "style.weights[1] is -1.0. Set it"),
        (FrameControls(style_weights=(1.0,)), "style.weights has 1 number for 2 style images"),
        (FrameControls(style_weights=(0.0, 0.0)), "all style.weights are 0"),
    ],
)
def test_controls_out_of_range_are_refused_with_volume_and_time_code(controls, text):
    frames = (FrameSource(1.0, {}), FrameSource(2.5, {}, controls))
    with pytest.raises(ConfigError) as refused:
        check_controls(VolumeSource("/World/smoke", frames, True), CONFIG, 2)
    assert str(refused.value).startswith("Volume </World/smoke>: at timeCode 2.5: ")
    assert text in str(refused.value)


def test_a_frame_takes_effect_by_its_own_strength_if_it_has_one():
    none = quick_config(optimize={"strength": 0.0})
    assert not in_effect(none, FrameControls())
    assert in_effect(none, FrameControls(strength=0.1))
    assert in_effect(CONFIG, FrameControls())
    assert not in_effect(CONFIG, FrameControls(strength=0.0))
    assert not in_effect(quick_config(losses={"style": 0.0}), FrameControls(strength=1.0))


@pytest.mark.parametrize(
    ("effect", "computed"),
    [("", ""), ("0", "0"), ("1", "1"), ("0001", "0011"), ("1000", "1100"), ("10001", "11011")],
)
def test_frames_beside_one_in_effect_are_computed_and_no_others(effect, computed):
    assert is_computed([mark == "1" for mark in effect]) == [mark == "1" for mark in computed]

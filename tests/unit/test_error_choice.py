"""Which settings a tolerance comes to, from a calibration that is given."""

import math
from typing import Any

import pytest

from usdsmoke.config import Config, config_to_dict, resolve_config
from usdsmoke.error_choice import SAFETY, Choice, choose_settings, user_values

PLANNED = {"shape": [60, 50, 0], "colour": [100]}
MEASURED: dict[str, Any] = {
    "image_sizes": [[20, 0.4], [40, 0.1], [80, 0.02], [160, 0.004]],
    "transport": {"linear": 0.02, "cubic": 0.001},
    "quadrature": 0.001,
    "half": 1e-4,
    "prune": [[1e-4, 0.001], [1e-3, 0.01], [1e-2, 0.1]],
    "steps": {
        "shape": {"octave": 60.0, "remaining": 0.5},
        "colour": {"octave": 100.0, "remaining": 0.1},
    },
    "view_deviation": 0.1,
}


def chosen(target: float, **set_by_user: Any) -> Choice:
    names = {name.replace("__", "."): value for name, value in set_by_user.items()}
    return choose_settings(MEASURED, target, PLANNED, names)


@pytest.mark.parametrize("target", [0.003, 0.02, 0.1, 0.5])
def test_every_chosen_error_is_below_its_part_or_the_best_there_is(target: float) -> None:
    found = chosen(target).settings
    size = found["views"]["image_size"]
    errors = dict(MEASURED["image_sizes"])
    assert SAFETY * errors[size] <= target / 2 or size == 160
    scheme = found["shape"]["interpolation"]
    assert SAFETY * MEASURED["transport"][scheme] <= target / 4 or scheme == "cubic"
    assert SAFETY * MEASURED["half"] <= target / 8 or not found["grids"]["half"]
    lost = {level: share for share, level in MEASURED["prune"]}.get(found["grids"]["prune"], 0.0)
    assert SAFETY * lost <= target / 8
    assert 0.1 / math.sqrt(found["views"]["pool"]) <= target or found["views"]["pool"] == 64


def test_a_looser_tolerance_never_takes_more_of_anything() -> None:
    tight, loose = (chosen(target).settings for target in (0.01, 0.3))
    for section, key in (("views", "image_size"), ("views", "pool")):
        assert loose[section][key] < tight[section][key]
    assert sum(loose["colour"]["iterations"]) < sum(tight["colour"]["iterations"])
    assert (loose["shape"]["interpolation"], tight["shape"]["interpolation"]) == ("linear", "cubic")
    assert loose["grids"]["half"] and not chosen(0.001).settings["grids"]["half"]
    assert loose["grids"]["prune"] > tight["grids"]["prune"]


def test_iterations_follow_an_exponential_tail_and_keep_their_proportions() -> None:
    found = chosen(0.2).settings
    assert found["colour"]["iterations"] == [100]  # a tenth is left after 100
    factor = math.log(10) / math.log(2)
    assert found["shape"]["iterations"] == [math.ceil(60 * factor), math.ceil(50 * factor), 0]


def test_what_the_user_has_set_stays_and_is_named() -> None:
    choice = chosen(0.3, views__image_size=512, grids__half=False)
    assert "image_size" not in choice.settings["views"] and "half" not in choice.settings["grids"]
    assert any(note.startswith("views.image_size=512 as set") for note in choice.notes)
    assert "pool" in choice.settings["views"]


def test_a_total_of_iterations_that_is_set_leaves_the_lists_alone() -> None:
    choice = chosen(0.3, optimize__iterations=30)
    assert "colour" not in choice.settings and "shape.iterations follow" in " ".join(choice.notes)


def test_a_pilot_whose_loss_did_not_fall_leaves_the_iterations_alone() -> None:
    flat = {**MEASURED, "steps": {"shape": {"octave": 60.0, "remaining": 1.0}}}
    choice = choose_settings(flat, 0.1, PLANNED, {})
    assert "iterations" not in choice.settings["shape"]
    assert "shape.iterations stay: the pilot's loss did not fall" in choice.notes


def test_errors_that_no_setting_brings_down_are_told() -> None:
    notes = chosen(1e-4).notes
    assert any("resolution" in note and "more than its part" in note for note in notes)
    assert any(note.startswith("quadrature") and "more than its part" in note for note in notes)


def test_nothing_is_chosen_where_nothing_is_done() -> None:
    assert choose_settings({}, 0.1, PLANNED, {}) == Choice({}, ())


def test_named_settings_and_those_that_are_no_defaults_are_the_user_s() -> None:
    given = config_to_dict(resolve_config({"views": {"pool": 5}, "grids": {"half": False}}))
    found = user_values(given, config_to_dict(Config()), {"grids.half"})
    assert found == {"views.pool": 5, "grids.half": False}


def test_choices_are_settings_that_exist() -> None:
    for target in (0.001, 0.05, 0.9):
        resolve_config({}, chosen(target).settings)

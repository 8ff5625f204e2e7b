"""Which settings a tolerance comes to, from a calibration that is given."""

import math
from typing import Any

import pytest

from usdsmoke.base.resolve import resolve_config
from usdsmoke.runs.budget.choice import (
    USUAL_HALF,
    Choice,
    choose_settings,
)
from usdsmoke.runs.budget.rows import PICTURE_SAFETY, SAFETY

PLANNED = {"shape": [60, 50, 0], "colour": [100]}
MEASURED: dict[str, Any] = {
    "image_sizes": [[20, 0.4], [40, 0.1], [80, 0.02], [160, 0.004]],
    "transport": {"linear": 0.02, "cubic": 0.001, "moved": 2.0},
    "quadrature": 0.001,
    "half": 1e-4,
    "prune": [[1e-4, 0.001], [1e-3, 0.01], [1e-2, 0.1]],
    "steps": {
        "shape": {"iterations": 32.0, "remaining": 0.5, "fallen": 0.4},
        "colour": {"iterations": 32.0, "remaining": 0.4, "fallen": 0.6},
    },
    "view_deviation": 0.1,
    "unseen_views": [4, 0.05],
}


def chosen(target: float, **set_by_user: Any) -> Choice:
    names = {name.replace("__", "."): value for name, value in set_by_user.items()}
    return choose_settings(MEASURED, target, PLANNED, names)


@pytest.mark.parametrize("target", [0.003, 0.02, 0.1, 0.5])
def test_every_chosen_error_is_below_its_part_or_the_best_there_is(target: float) -> None:
    found = chosen(target).settings
    size = found["views"]["image_size"]
    errors = dict(MEASURED["image_sizes"])
    assert PICTURE_SAFETY * errors[size] <= target / 2 or size == 160
    scheme = found["shape"]["interpolation"]
    assert SAFETY * MEASURED["transport"][scheme] <= target / 4 or scheme == "cubic"
    assert SAFETY * MEASURED["half"] <= target / 8 or not found["grids"]["half"]
    lost = {level: share for share, level in MEASURED["prune"]}.get(found["grids"]["prune"], 0.0)
    assert SAFETY * lost <= target / 8
    pool = found["views"]["pool"]
    assert max(0.1 / math.sqrt(pool), 4 * 0.05 / pool) <= target / SAFETY or pool == 64


def test_a_looser_tolerance_never_takes_more_of_anything() -> None:
    tight, loose = (chosen(target).settings for target in (0.01, 0.3))
    for section, key in (("views", "image_size"), ("views", "pool")):
        assert loose[section][key] < tight[section][key]
    assert sum(loose["colour"]["iterations"]) < sum(tight["colour"]["iterations"])
    assert (loose["shape"]["interpolation"], tight["shape"]["interpolation"]) == ("linear", "cubic")
    assert loose["grids"]["half"] and not chosen(0.001).settings["grids"]["half"]
    assert loose["grids"]["prune"] > tight["grids"]["prune"]


def remains(n: float, half: float, fallen: float = 0.4) -> float:
    """Of the final loss after n iterations, where 0.4 of the loss was gone after 32."""
    fall = fallen * (1 + half / 32)
    end = 1 + fallen - fall
    left = fall / (1 + n / half)
    return left / (end + left)


def test_iterations_follow_the_tail_and_keep_their_proportions() -> None:
    """Half of the fall was done after 32, and half after 15 is usual."""
    found = chosen(0.6).settings["shape"]["iterations"]
    assert found == [math.ceil(60 * found[1] / 50), found[1], 0] and found[1] < 50
    half = math.sqrt(32 * USUAL_HALF)
    assert remains(found[1], half) <= 0.6 / SAFETY < remains(found[1] - 1, half)


def test_coarse_octaves_get_no_more_than_planned() -> None:
    coarse, fine, none = chosen(0.1).settings["shape"]["iterations"]
    assert coarse == 60 and fine > 50 and none == 0
    half = math.sqrt(32 * USUAL_HALF)
    assert remains(fine, half) <= 0.1 / SAFETY < remains(fine - 1, half)


def test_a_tail_that_looks_finished_is_not_taken_at_its_word() -> None:
    steps = {"shape": {"iterations": 32.0, "remaining": 1e-3, "fallen": 0.4}}
    found = choose_settings({**MEASURED, "steps": steps}, 0.003, PLANNED, {})
    assert found.settings["shape"]["iterations"][1] > 32


def test_what_the_user_has_set_stays_and_is_named() -> None:
    choice = chosen(0.3, views__image_size=512, grids__half=False)
    assert "image_size" not in choice.settings["views"] and "half" not in choice.settings["grids"]
    assert any(note.startswith("views.image_size=512 as ") for note in choice.notes)
    assert "pool" in choice.settings["views"]


def test_a_total_of_iterations_that_is_set_leaves_the_lists_alone() -> None:
    choice = chosen(0.3, optimize__iterations=30)
    assert "colour" not in choice.settings and "shape.iterations follow" in " ".join(choice.notes)


@pytest.mark.parametrize(
    "found", [{"iterations": 32.0, "remaining": 0.95, "fallen": 0.5}, {"why": "it did not fall"}]
)
def test_a_pilot_whose_loss_did_not_fall_leaves_the_iterations_alone(found: Any) -> None:
    choice = choose_settings({**MEASURED, "steps": {"shape": found}}, 0.1, PLANNED, {})
    assert "iterations" not in choice.settings["shape"]
    (note,) = [note for note in choice.notes if note.startswith("shape.iterations")]
    assert "unchanged" in note


def test_a_pilot_that_did_not_move_its_smoke_is_told() -> None:
    still = {**MEASURED["transport"], "moved": 0.0}
    notes = choose_settings({**MEASURED, "transport": still}, 0.1, PLANNED, {}).notes
    (note,) = [note for note in notes if note.startswith("shape.interpolation")]
    assert "transport 0.001" in note and "half a voxel" in note


@pytest.mark.parametrize("target", [1e-9, 0.01, 0.3, 1.0])
@pytest.mark.parametrize("missing", ["", "shape", "colour", "image_sizes"])
def test_every_choice_has_its_sentence_and_every_other_setting_too(
    target: float, missing: str
) -> None:
    measured = dict(MEASURED)
    if missing == "image_sizes":
        measured["image_sizes"] = []
    elif missing:
        measured["steps"] = {k: v for k, v in MEASURED["steps"].items() if k != missing}
        measured["transport"] = None if missing == "shape" else MEASURED["transport"]
    notes = choose_settings(measured, target, PLANNED, {}).notes
    for name in (
        "views.image_size", "quadrature", "shape.interpolation", "grids.half", "grids.prune",
        "shape.iterations", "colour.iterations", "views.pool",
    ):  # fmt: skip
        assert sum(name in note for note in notes) == 1, (name, notes)


def test_errors_that_no_setting_brings_down_are_told() -> None:
    notes = chosen(1e-4).notes
    (note,) = [note for note in notes if note.startswith("views.image_size=160: cannot be kept: ")]
    assert "resolution" in note and "0.004" in note and "5e-05" in note
    for what in ("quadrature", "transport", "shape step's loss", "view sampling", "unseen views"):
        assert any("cannot be kept: " in note and what in note for note in notes), what


def test_nothing_is_chosen_where_nothing_is_done() -> None:
    choice = choose_settings({}, 0.1, PLANNED, {})
    assert not choice.settings and "nothing to stylize" in choice.notes[0]


def test_choices_are_settings_that_exist() -> None:
    for target in (0.001, 0.05, 0.9):
        resolve_config({}, chosen(target).settings)

"""The views of an octave, most of a step's memory, are held while it is optimised and no longer."""

import weakref
from typing import Any

import pytest

from tests.smoke_fixtures import frame_of, puff
from tests.stylize_fixtures import quick_config, run_core
from usdsmoke.core.steps import optimize, shape


@pytest.mark.parametrize("iterations", [[2, 2, 2], [2, 2, 0]])
def test_the_shape_step_holds_the_views_of_one_octave(
    monkeypatch: pytest.MonkeyPatch, iterations: list[int]
) -> None:
    made: list[weakref.ref[Any]] = []
    alive: list[tuple[str, int]] = []

    class Watched(shape._Octave):
        def __init__(self, *arguments: Any) -> None:
            note("begins")
            super().__init__(*arguments)
            made.append(weakref.ref(self))
            made.append(weakref.ref(self.pyramid))

    def note(what: str) -> None:
        alive.append((what, sum(octave() is not None for octave in made)))

    def unclamped(*arguments: Any, made: Any = shape.unclamped_displacement) -> Any:
        note("ends")
        return made(*arguments)

    monkeypatch.setattr(shape, "_Octave", Watched)
    monkeypatch.setattr(shape, "unclamped_displacement", unclamped)
    config = quick_config(shape={"iterations": iterations}, optimize={"steps": ["shape"]})
    run_core([frame_of(puff(12))], config)
    n_octaves = sum(n > 0 for n in iterations)
    assert len(made) == 2 * n_octaves  # octaves, and what is optimised in them
    assert alive == [("begins", 0)] * n_octaves + [("ends", 0)]


def test_what_is_left_in_pieces_is_given_back_before_an_octave_is_optimised(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[int] = []
    monkeypatch.setattr(optimize, "give_back_memory", lambda: calls.append(1))
    run_core([frame_of(puff(12))])
    assert len(calls) == 4  # two octaves of two steps

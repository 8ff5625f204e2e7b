"""Iterations of the colour step's last octave that are one step."""

import math

import pytest

from tests.fixtures.smoke_fixtures import puff, smoke_of
from tests.unit.core.test_colour import config_of, problem_of
from usdsmoke.core.steps import colour, joined
from usdsmoke.core.steps.colour import run_colour_step
from usdsmoke.core.steps.joined import FEWEST, joined_iterations
from usdsmoke.core.steps.loss_tail import remaining_decrease


@pytest.mark.parametrize(
    ("n_drawn", "n_pool", "apart", "n_joined"),
    [(1, 16, False, 2), (1, 16, True, 1), (2, 16, False, 1), (9, 36, False, 1), (1, 1, False, 1)],
)
def test_two_views_are_one_step_unless_there_are_as_many_already(n_drawn, n_pool, apart, n_joined):
    assert joined_iterations(FEWEST, n_drawn, n_pool, apart) == n_joined


def test_few_iterations_are_steps_of_their_own():
    assert joined_iterations(FEWEST - 1, 1, 16, False) == 1


def test_the_last_octave_alone_has_half_of_the_steps_at_twice_the_rate(monkeypatch):
    seen, told = [], []
    whole = colour.optimize_colours

    def spy(pool, colours, loss, background, descent, *rest):
        seen.append((pool.n_drawn, descent.n_iterations, descent.rate))
        return whole(pool, colours, loss, background, descent, *rest)

    monkeypatch.setattr(colour, "optimize_colours", spy)
    monkeypatch.setattr(joined, "FEWEST", 5)
    config = config_of(colour={"learning_rate": 0.1})
    problem = problem_of(smoke_of(puff(12)), config)
    _, ends = run_colour_step(
        problem, [4, 5], watch=lambda octave, state: told.append((octave, state.iteration))
    )
    assert seen == [(1, 4, 0.1), (2, 3, pytest.approx(0.2))]
    assert [end.n_joined for end in ends] == [1, 2]
    assert [end.iteration + 1 for end in ends] == [4, 5]  # what the settings ask for
    assert told == [(0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 3), (1, 4)]


def test_what_is_left_is_told_from_as_few_joined_iterations_as_from_single_ones():
    losses, rates = [1 + 1 / (1 + n) for n in range(16)], [0.1] * 16
    assert math.isnan(remaining_decrease(losses, rates, 0.4))
    assert 0 < remaining_decrease(losses, rates, 0.4, n_joined=2) < 0.1

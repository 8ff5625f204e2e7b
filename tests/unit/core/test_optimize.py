"""The optimiser on problems with known answers, and on those that go wrong."""

import math
from collections.abc import Callable
from functools import partial
from itertools import count
from typing import Any

import pytest
import torch
from torch import Tensor

from usdsmoke.base.errors import NonFiniteError
from usdsmoke.core.steps.optimize import Adam, Descent, Minimum, minimize, minimize_and_mend
from usdsmoke.core.views.cameras import draw_views

GOAL = torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64)
SCALES = torch.tensor([1.0, 30.0, 0.1], dtype=torch.float64)


def start() -> Tensor:
    return torch.zeros(3, dtype=torch.float64, requires_grad=True)


def bowl(x: Tensor) -> Tensor:
    return (SCALES * (x - GOAL) ** 2).sum()


def run(
    x: Tensor, n: int, rate: float = 0.1, tolerance: float = 0.0, **options: Any
) -> list[Minimum]:
    return list(minimize(lambda _: bowl(x), [x], Descent(rate, n, tolerance), **options))


def test_a_quadratic_bowl_is_solved_to_round_off():
    """Runs one after the other with falling rates; the moments stay with the problem."""
    x, adam = start(), Adam()
    for rate in (0.1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8):
        ends = run(x, 400, rate, adam=adam)
    assert (x - GOAL).abs().max().item() < 1e-8
    assert ends[-1].loss < 1e-15 and ends[-1].rollbacks == 0


def test_ups_and_downs_of_round_off_at_the_bottom_are_no_divergence():
    x = GOAL.clone().requires_grad_()
    with torch.no_grad():
        x += 1e-3
    end = run(x, 300, 1e-4)[-1]
    assert end.reason == "iterations" and end.rollbacks == 0


def test_adam_steps_as_published():
    """The first two steps of [Kingma2015, algorithm 1] for gradients 2 and -1, by hand."""
    p, adam = torch.zeros(1, dtype=torch.float64), Adam(betas=(0.9, 0.99), epsilon=0.0)
    adam.step([p], [torch.tensor([2.0], dtype=torch.float64)], 0.1)
    assert p.item() == pytest.approx(-0.1)
    adam.step([p], [torch.tensor([-1.0], dtype=torch.float64)], 0.1)
    first = (0.9 * 0.2 - 0.1) / (1 - 0.81)
    second = (0.99 * 0.04 + 0.01) / (1 - 0.99**2)
    assert p.item() == pytest.approx(-0.1 - 0.1 * first / math.sqrt(second))


def test_every_iteration_is_reported_and_the_last_one_says_why_it_ended():
    ends = run(start(), 25)
    assert [end.iteration for end in ends] == list(range(25))
    assert [end.reason for end in ends] == [""] * 24 + ["iterations"]
    assert ends[0].loss == pytest.approx(bowl(torch.zeros(3).double()).item())
    rates = [end.rate for end in ends]
    assert rates[0] == rates[12] == 0.1 and rates[-1] < 0.02 and rates == sorted(rates)[::-1]


def test_no_iterations_change_and_yield_nothing():
    x = start()
    assert run(x, 0) == [] and not x.any()


def test_it_stops_when_converged_and_not_while_the_loss_falls():
    x = start()
    ends = run(x, 4000, tolerance=1e-3)
    assert ends[-1].reason == "converged" and ends[-1].iteration < 3000
    assert bowl(x).item() < 1e-3
    assert run(start(), 4, tolerance=0.5)[-1].reason == "iterations"


def shaken(x: Tensor, iteration: int) -> Tensor:
    """The bowl's edges, so that steps of one size hover above its bottom."""
    return 1.0 + (SCALES * (x - GOAL).abs()).sum()


def test_a_plateau_at_the_full_rate_is_not_the_end_but_starts_the_annealing():
    """Steps of full size keep the loss up, and falling ones let it down."""
    x, adam = start(), Adam(betas=(0.9, 0.99))
    ends = list(minimize(partial(shaken, x), [x], Descent(0.1, 2000, 1e-3), adam=adam))
    rates = torch.tensor([end.rate for end in ends])
    n_full = int((rates == rates[0]).sum())
    assert ends[-1].reason == "converged" and n_full < 1000
    assert rates[-1] == pytest.approx(0.01) and (rates.diff() <= 1e-9).all()
    falling = int((rates > 0.0101).sum()) - n_full
    assert falling == pytest.approx(n_full, abs=2)  # as long as the rate was full
    assert len(rates) > 2 * n_full + 10  # and not the end either, as the loss has just fallen
    plateau = sum(end.loss for end in ends[n_full - 50 : n_full]) / 50
    assert ends[-1].loss - 1 < 0.3 * (plateau - 1)


@pytest.mark.parametrize("size", [0.05, 0.5])
def test_views_that_differ_neither_hide_a_fall_nor_feign_an_end(size):
    """Sixteen views in an order of their own in each passage, as a pool draws them."""
    generator = torch.Generator().manual_seed(0)
    views = 1 + size * torch.randn(16, generator=generator, dtype=torch.float64)

    def run_views(loss: Callable[[Tensor], Tensor]) -> Minimum:
        x = start()

        def objective(iteration: int) -> Tensor:
            return loss(x) + views[draw_views(iteration, 1, 16, 0)[0]]

        return list(minimize(objective, [x], Descent(0.01, 640, 1e-3, passage=16)))[-1]

    falling = run_views(lambda x: 0.5 * (GOAL[0] * 10 - x[0]).abs())
    assert falling.iteration == 639 and falling.reason == "iterations"
    assert run_views(lambda x: 0 * x.sum()).reason == "converged"


def test_tolerance_zero_never_stops_early_even_when_the_loss_rises():
    x = start()
    ends = list(minimize(lambda t: bowl(x) + 0.001 * t, [x], Descent(1e-9, 60)))
    assert ends[-1].iteration == 59 and ends[-1].reason == "iterations"


def test_a_learning_rate_a_hundred_times_too_large_is_found_reduced_and_reported():
    def steep(x: Tensor) -> Tensor:
        return (1e3 * (x - GOAL) ** 4).sum() + bowl(x)

    x = start()
    end = list(minimize(lambda _: steep(x), [x], Descent(100.0, 200)))[-1]
    assert end.rollbacks >= 3 and end.rate < 100 / 2**3
    assert torch.isfinite(x).all()
    assert steep(x).item() <= steep(torch.zeros(3).double()).item()


def test_views_whose_losses_differ_a_thousandfold_are_no_divergence():
    """Whatever the step: such a loss was there before it, and no smaller step mends that."""
    x = start()
    end = list(minimize(lambda t: bowl(x) * (1e3 if t % 7 == 6 else 1.0), [x], Descent(0.05, 400)))[
        -1
    ]
    assert end.rollbacks == 0 and end.rate > 0.05 / 10 and bowl(x).item() < 1e-3


def test_a_step_that_goes_wrong_is_seen_among_views_that_differ_too():
    x = start()

    def objective(iteration: int) -> Tensor:
        return bowl(x) * (1e3 if iteration % 7 == 6 else 1.0) + (x.abs() > 3).sum() * 1e6

    end = list(minimize(objective, [x], Descent(20.0, 200)))[-1]
    assert end.rollbacks >= 3 and bool((x.abs() < 3).all())


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_loss_that_is_not_finite_is_rolled_back(bad):
    x, seen = start(), []

    def objective(iteration: int) -> Tensor:
        seen.append(x.detach().clone())
        return bowl(x) + (bad if iteration == 10 else 0.0)

    ends = list(minimize(objective, [x], Descent(0.1, 40)))
    assert ends[-1].rollbacks == 1 and [end.iteration for end in ends].count(10) == 0
    assert torch.equal(seen[11], seen[8])  # the last state that had been remembered
    assert bowl(x).item() < bowl(torch.zeros(3).double()).item()


def test_a_gradient_that_is_not_finite_is_rolled_back():
    x = start()

    def objective(iteration: int) -> Tensor:
        trap = torch.sqrt((x * 0).sum()) if iteration == 5 else 0.0  # slope: 0 x infinity
        return bowl(x) + trap

    end = list(minimize(objective, [x], Descent(0.1, 40)))[-1]
    assert end.rollbacks == 1 and torch.isfinite(x).all()


def test_the_moments_are_rolled_back_in_the_state_that_was_carried_in():
    x, adam = start(), Adam()
    list(
        minimize(lambda t: bowl(x) + (math.nan if t == 3 else 0.0), [x], Descent(0.1, 4), adam=adam)
    )
    assert adam.n_steps == 0  # back before the first step, where all was remembered
    list(minimize(lambda _: bowl(x), [x], Descent(0.1, 5), adam=adam))
    assert adam.n_steps == 5


def test_a_hopeless_objective_is_a_named_error_that_counts_the_halvings():
    x = start()
    with pytest.raises(NonFiniteError, match=r"12 times.* 0\.1\b"):
        list(minimize(lambda t: bowl(x) * (math.nan if t else 1.0), [x], Descent(0.1, 100)))


@pytest.mark.parametrize("n", [1, 5])
def test_few_iterations_without_a_single_finite_loss_are_not_passed_over_in_silence(n):
    x = start()
    with pytest.raises(NonFiniteError, match=f"all {n} iterations"):
        list(minimize(lambda _: bowl(x) * math.nan, [x], Descent(0.1, n)))


def test_the_last_step_is_looked_at_when_there_were_rollbacks_before():
    """Iterations 1 and 3 fail; the step of iteration 4, the last, would fail in a sixth."""
    x = start()
    rate = 1e4

    def cliff(_: int) -> Tensor:
        return bowl(x) + (1e9 * (x.abs().max() > 500)).double()

    end = list(minimize(cliff, [x], Descent(rate, 5)))[-1]
    assert end.rollbacks == 2 and end.restored
    assert not x.any()
    assert end.smoothed == pytest.approx(bowl(torch.zeros(3).double()).item())


def test_the_best_remembered_state_comes_back_when_the_end_is_clearly_worse():
    """What holds the parameters pulls them away near the end."""
    x, steps = start(), count()

    def pull() -> None:
        if next(steps) >= 60:
            x.mul_(0.9)

    end = list(minimize(lambda _: bowl(x) + 1, [x], Descent(0.1, 64), pull))[-1]
    assert end.restored
    assert bowl(x).item() < 0.2
    assert not run(start(), 64)[-1].restored


@pytest.mark.parametrize("n", [4, 64])
def test_an_easy_first_view_is_no_better_state(n: int):
    """Its loss is the least of all, whatever is done."""
    x = start()
    end = list(minimize(lambda t: bowl(x) + 1000 * (t > 0), [x], Descent(0.1, n)))[-1]
    assert end.smoothed > 2 * bowl(start()).item()  # the losses alone would tell to go back
    assert not end.restored
    assert bowl(x).item() < 0.9 * bowl(start()).item()


def test_an_objective_without_the_parameters_leaves_them_alone():
    x = start()
    end = list(minimize(lambda _: torch.tensor(0.0), [x], Descent(0.1, 3)))[-1]
    assert end.loss == 0 and not x.any()


def test_a_zero_gradient_at_the_start_moves_nothing_and_is_no_error():
    """A flat place that is no minimum: Adam divides 0 by the root of 0 plus its epsilon."""
    x = start()
    end = list(minimize(lambda _: (1 - x**2).sum(), [x], Descent(0.1, 20)))[-1]
    assert end.loss == 3 and end.rollbacks == 0 and not x.any()


def test_a_zero_loss_that_rises_later_is_no_divergence():
    x = start()
    ends = list(minimize(lambda t: bowl(x) * (t > 2), [x], Descent(0.1, 30)))
    assert len(ends) == 30 and ends[-1].rollbacks == 0
    assert ends[-1].loss < ends[3].loss


def test_the_projection_follows_each_step():
    x = start()

    def into_range() -> None:
        x.clamp_(0, 1)

    run(x, 200, project=into_range)
    assert x.tolist() == pytest.approx([1.0, 0.0, 0.5], abs=0.05)


def quartic_path(unit: float, dtype: torch.dtype) -> Tensor:
    """Parameters after some steps on an objective in another unit."""
    x = torch.tensor([2.0, -1.0, 0.3], dtype=dtype, requires_grad=True)
    list(minimize(lambda t: unit * ((x - GOAL.to(x)) ** 4).sum(), [x], Descent(0.05, 40)))
    return x.detach()


@pytest.mark.parametrize("unit", [1e-20, 1e20])
def test_the_path_does_not_depend_on_the_loss_s_unit(unit):
    """Also in float32, where squared gradients of such losses under- or overflow."""
    single = torch.float32
    assert torch.allclose(quartic_path(unit, single), quartic_path(1.0, single), atol=1e-6)
    assert not torch.allclose(quartic_path(unit, single)[0], torch.tensor(2.0), atol=0.1)


def test_a_zero_gradient_first_sets_no_unit_and_counts_as_no_step():
    p, q = torch.zeros(2), torch.zeros(2)
    late, plain = Adam(), Adam()
    late.step([p], [torch.zeros(2)], 0.1)
    assert late.n_steps == 0 and late.unit == 0 and not p.any()
    for gradient in ([1e-12, -3e-12], [2e-12, 1e-12]):
        late.step([p], [torch.tensor(gradient)], 0.1)
        plain.step([q], [torch.tensor(gradient)], 0.1)
    assert torch.equal(p, q) and p[0] == pytest.approx(-0.1 - 0.1, abs=0.05)


def test_the_unit_counts_every_entry_of_every_tensor():
    adam = Adam()
    tensors = [torch.zeros(3), torch.zeros(1)]
    adam.step(tensors, [torch.tensor([3e25, 0.0, 0.0]), torch.tensor([4e25])], 0.1)
    assert adam.unit == pytest.approx(math.sqrt((9 + 16) / 4) * 1e25)
    assert torch.isfinite(torch.cat(tensors)).all()


def test_a_change_before_the_last_iterations_is_mended_and_its_losses_are_left_out():
    x = torch.tensor([2.0, 0.0], requires_grad=True)
    seen: list[int] = []

    def bowl(iteration: int) -> torch.Tensor:
        seen.append(iteration)
        return (x - 1).square().sum()

    def change(n_after: int) -> None:
        assert n_after == 14
        x.add_(0.3)

    states = list(minimize_and_mend(bowl, [x], Descent(0.1, 200), change))
    assert [state.iteration for state in states] == list(range(200))
    assert len(states[-1].losses) == len(states[-1].rates) == 186  # 7 % come after the change
    changed = float((0.3 * torch.ones(2)).square().sum())
    assert states[186].loss == pytest.approx(changed, rel=0.1)
    assert states[-1].loss < 0.2 * changed
    assert sorted(set(seen))[:200] == list(range(200))
    # without iterations to mend, the change is the last
    few = torch.zeros(2, requires_grad=True)
    (*_, end) = minimize_and_mend(
        lambda n: few.square().sum(),
        [few],
        Descent(0.1, 5),
        lambda n_after: few.fill_(7.0 + n_after),
    )
    assert end.iteration == 4 and few.tolist() == [7.0, 7.0]
    assert list(minimize_and_mend(bowl, [x], Descent(0.1, 0), change)) == []

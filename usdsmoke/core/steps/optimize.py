"""Adam that keeps the best state: it rolls back, anneals its rate and stops when converged.

It minimises any objective and knows nothing of smoke, so it can be tested on a quadratic bowl.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import torch
from torch import Tensor

from usdsmoke.base.errors import NonFiniteError
from usdsmoke.base.machine import give_back_memory
from usdsmoke.core.smoke.memory import SHARED_ROWS, chunks, run_on, share_rows

BLOW_UP = 10.0  # a loss this many times the best recent one is a step gone wrong
NOISE = 1e-6  # share of the first loss below which its ups and downs are round-off
MOST_ROLLBACKS = 12
CHUNK_ELEMENTS = 2**16  # numbers that Adam moves at once
REMEMBER_EVERY = 8  # iterations between two states to roll back to
ANNEALED = 0.1  # share of the rate at the end
SHORTEST_SPAN = 10  # iterations over which a plateau shows
MENDING, MENDING_RATE = (
    0.07,
    0.3,
)  # share of the iterations after a change, and their share of the rate
WORSE = 1.05  # a last state this much above the best one, by the same views, is replaced by it
LOOKS = 8  # iterations whose losses tell, at most


@dataclass
class Adam:
    """Adam's moments for a list of tensors. [Kingma2015, algorithm 1]

    Deviations: the momentum is 0.7, not 0.9. Each iteration sees other views, and a longer memory
    follows views that are gone (decision 058). Gradients are measured in units of the first ones'
    root mean square. So the path does not depend on the loss's unit, nothing under- or overflows,
    and epsilon keeps what hardly shows in any picture from being moved by round-off.
    """

    betas: tuple[float, float] = (0.7, 0.99)
    epsilon: float = 1e-5
    n_steps: int = 0
    first: list[Tensor] = field(default_factory=list)
    second: list[Tensor] = field(default_factory=list)
    unit: float = 0.0  # 0: the next gradients set it

    def step(self, parameters: list[Tensor], gradients: list[Tensor], rate: float) -> None:
        """Moves the parameters in place by one step of size ``rate``."""
        if not self.first:
            self.first = [torch.zeros_like(p) for p in parameters]
            self.second = [torch.zeros_like(p) for p in parameters]
        self.unit = self.unit or _root_mean_square(gradients)
        if self.unit == 0:
            return
        self.n_steps += 1
        b1, b2 = self.betas
        unbias = math.sqrt(1 - b2**self.n_steps) / (1 - b1**self.n_steps)
        for p, g, m, v in zip(parameters, gradients, self.first, self.second, strict=True):
            flat = [p.view(-1), g.reshape(-1), m.view(-1), v.view(-1)]

            def move(part: slice, flat: list[Tensor] = flat) -> None:
                values, slopes, first, second = (tensor[part] for tensor in flat)
                slopes = slopes / self.unit
                first.mul_(b1).add_(slopes, alpha=1 - b1)
                second.mul_(b2).addcmul_(slopes, slopes, value=1 - b2)
                scale = second.sqrt().add_(self.epsilon)
                values.addcdiv_(first, scale, value=-rate * unbias)

            share_rows(move, len(flat[0]), CHUNK_ELEMENTS, flat[0].device)

    def copy(self) -> "Adam":
        """The same state in tensors of its own."""
        copied = replace(self)
        copied.restore(self)
        return copied

    def restore(self, kept: "Adam") -> None:
        """Takes over the moments of another state."""
        self.n_steps, self.unit = kept.n_steps, kept.unit
        self.first = [t.clone() for t in kept.first]
        self.second = [t.clone() for t in kept.second]


def _root_mean_square(tensors: list[Tensor]) -> float:
    """Over all entries; squares neither under- nor overflow."""
    most = max((float(t.abs().max()) for t in tensors if t.numel()), default=0.0)
    if most == 0:
        return 0.0
    squares = sum(float((t / most).square().sum()) for t in tensors)
    return most * math.sqrt(squares / sum(t.numel() for t in tensors))


@dataclass(frozen=True)
class Descent:
    """How an objective is minimised; see ``minimize``."""

    rate: float
    n_iterations: int
    tolerance: float = 0.0
    epsilon: float = Adam.epsilon
    passage: int = 1  # iterations whose losses together are free of noise


@dataclass(frozen=True)
class Minimum:
    """The state of an optimisation, yielded after every good iteration; the last is the result."""

    iteration: int
    loss: float
    smoothed: float  # running mean of the loss over about ten iterations
    rollbacks: int  # so far
    rate: float  # of the step just taken
    reason: str  # "" while running, then "iterations" or "converged"
    restored: bool = False  # the result is an earlier state, because the last one was worse
    losses: tuple[float, ...] = ()  # of every good iteration; the last item alone has these two
    rates: tuple[float, ...] = ()


def minimize(
    objective: Callable[[int], Tensor],
    parameters: list[Tensor],
    descent: Descent,
    project: Callable[[], None] | None = None,
    adam: Adam | None = None,
) -> Iterator[Minimum]:
    """Minimises ``objective`` over ``parameters`` in place; one item per good iteration.

    The rate is full for the first half of the iterations and then falls linearly to a tenth. A
    plateau in the first half starts the fall at once, which then takes as many iterations as there
    were. Only after it the run can end early, as converged, which is checked until the iterations
    are used up. A plateau, or convergence, is a loss that falls by less than ``tolerance``
    (relative) over a quarter of the iterations; means over whole passages are compared.

    A loss or gradient that is not finite, or a loss ten times the recent best, rolls the parameters
    and moments back to the last good state and halves the rate; but not where that state has such a
    loss in this iteration too: views differ, the more so the nearer a loss is to 0. At the end the
    best remembered state is restored if the last one is clearly worse in the same iterations.

    Args:
        objective: iteration -> scalar loss; its random draws depend on that number.
        parameters: leaf tensors that require gradients; changed in place.
        descent: at most so many iterations, 0 yields nothing; a tolerance of 0 never stops early.
        project: called after each step, e.g. to clip colours to their range.
        adam: its settings and moments; changed in place. None starts a new one with the descent's
            epsilon.

    Raises:
        NonFiniteError: still not finite after many halvings, or in every iteration there was.
    """
    give_back_memory()  # what making the objective has left in pieces
    n_iterations = descent.n_iterations
    state = _State(parameters, adam or Adam(epsilon=descent.epsilon), descent.rate)
    schedule = _Schedule(descent)
    losses: list[float] = []
    rates: list[float] = []
    latest = None
    for iteration in range(n_iterations):
        value, gradients = _evaluate(objective, iteration, parameters)
        if not state.accept(iteration, value, gradients, partial(_loss, objective, iteration)):
            continue
        now = state.rate * schedule.share(iteration)
        with torch.no_grad():
            state.adam.step(parameters, gradients, now)
            if project is not None:
                project()
        losses.append(value)
        rates.append(now)
        latest = Minimum(iteration, value, state.smoothed, state.rollbacks, now, "")
        if schedule.ends(iteration, losses):
            latest = replace(latest, reason="converged")
            break
        if iteration < n_iterations - 1:
            yield latest
    if n_iterations > 0:
        end = state.settle(latest, partial(_loss, objective), n_iterations)
        yield replace(end, losses=tuple(losses), rates=tuple(rates))


def minimize_and_mend(
    objective: Callable[[int], Tensor],
    parameters: list[Tensor],
    descent: Descent,
    change: Callable[[int], None],
    project: Callable[[], None] | None = None,
) -> Iterator[Minimum]:
    """``minimize`` with a change of the parameters before the last iterations, ``MENDING`` of them.

    These mend what the objective loses by the change. A run with hardly any iterations ends with
    the change. The last item has the losses and rates before the change: what a longer run would
    gain shows in them.

    Args:
        objective, parameters, descent, project: as of ``minimize``.
        change: is called once, without gradients, with the number of iterations that follow it, and
            changes the parameters in place.
    """
    adam, rest = Adam(epsilon=descent.epsilon), int(MENDING * descent.n_iterations)
    first = replace(descent, n_iterations=descent.n_iterations - rest)
    states = minimize(objective, parameters, first, project, adam)
    latest = next(states, None)
    if latest is None:
        return
    for state in states:
        yield latest
        latest = state
    with torch.no_grad():
        change(rest)
    before, last = latest, Descent(MENDING_RATE * descent.rate, rest)
    done = before.iteration + 1
    for state in minimize(lambda n: objective(done + n), parameters, last, project, adam):
        yield latest
        latest = replace(
            before,
            iteration=done + state.iteration,
            loss=state.loss,
            smoothed=state.smoothed,
            rollbacks=before.rollbacks + state.rollbacks,
        )
    yield latest


class _Schedule:
    """The rate's share in each iteration, and when to stop; see ``minimize``."""

    def __init__(self, descent: Descent) -> None:
        self._tolerance, self._passage = descent.tolerance, max(descent.passage, 1)
        self._annealed_at = descent.n_iterations  # the iteration in which the rate has fallen
        span = max(descent.n_iterations // 4, SHORTEST_SPAN)
        self._span = -(-span // self._passage) * self._passage

    def share(self, iteration: int) -> float:
        """Of the full rate, in [0.1, 1]."""
        fraction = min(iteration / self._annealed_at, 1.0)
        return 1.0 if fraction < 0.5 else 1.0 - (1.0 - ANNEALED) * (fraction - 0.5) / 0.5

    def ends(self, iteration: int, losses: Sequence[float]) -> bool:
        """Whether the last iteration was enough; notes a plateau at the full rate."""
        done, falls = iteration + 1, 2 * iteration >= self._annealed_at
        if (falls and done < self._annealed_at) or not self._is_flat(losses):
            return False
        if not falls:
            self._annealed_at = 2 * done
            return False
        return True

    def _is_flat(self, losses: Sequence[float]) -> bool:
        """Whether the last whole passage lies hardly below the one a span before it."""
        passage, span = self._passage, self._span
        if self._tolerance <= 0 or len(losses) % passage or len(losses) < passage + span:
            return False
        last = math.fsum(losses[-passage:])
        before = math.fsum(losses[-passage - span : -span])
        return before - last < self._tolerance * max(abs(last), NOISE * passage * abs(losses[0]))


def _evaluate(
    objective: Callable[[int], Tensor], iteration: int, parameters: list[Tensor]
) -> tuple[float, list[Tensor]]:
    """The loss and its gradients; NaN and none where something on the way was not finite."""
    try:
        loss = objective(iteration)
    except NonFiniteError:  # parameters that overflow
        return math.nan, []
    if not loss.requires_grad:  # nothing in it depends on the parameters
        return float(loss), [torch.zeros_like(p) for p in parameters]
    gradients = torch.autograd.grad(loss, parameters, materialize_grads=True)
    return float(loss.detach()), list(gradients)


def _is_finite(values: Tensor) -> bool:
    """Whether no value is NaN or infinite; in one pass that makes no other tensor."""
    flat = values.reshape(-1)
    parts = chunks(len(flat), SHARED_ROWS, flat.device)
    ends = run_on(flat.device, [flat[part].aminmax for part in parts])
    return all(math.isfinite(end) for pair in ends for end in pair)


def _loss(objective: Callable[[int], Tensor], iteration: int) -> float:
    """The loss alone; NaN where something on the way was not finite."""
    try:
        with torch.no_grad():
            return float(objective(iteration))
    except NonFiniteError:
        return math.nan


class _State:
    """The present state of an optimisation, and the states to return to."""

    def __init__(self, parameters: list[Tensor], adam: Adam, rate: float) -> None:
        self.parameters, self.adam, self.rate = parameters, adam, rate
        self.smoothed = math.nan
        self.rollbacks = 0
        self._first_rate, self._first_loss = rate, math.nan
        self._best = math.inf  # smoothed loss
        self._good = self._copy()  # what is rolled back to
        self._kept, self._kept_loss = self._good[0], math.inf  # the best of the remembered states

    def _copy(self) -> tuple[list[Tensor], Adam]:
        return [p.detach().clone() for p in self.parameters], self.adam.copy()

    def accept(
        self,
        iteration: int,
        value: float,
        gradients: list[Tensor],
        loss_again: Callable[[], float],
    ) -> bool:
        """True when the step may be taken; else everything is rolled back and the rate halved.

        Args:
            loss_again: the loss of the same iteration with the parameters as they are then.
        """
        finite = math.isfinite(value) and all(_is_finite(g) for g in gradients)
        if finite and (self._is_sound(value) or self._was_so_before(value, loss_again)):
            begins = math.isnan(self._first_loss)
            if begins:
                self._first_loss = self.smoothed = value
            self.smoothed = 0.9 * self.smoothed + 0.1 * value
            self._best = min(self._best, self.smoothed)
            if begins or iteration % REMEMBER_EVERY == 0:
                self._good = self._copy()
                if self.smoothed < self._kept_loss:
                    self._kept, self._kept_loss = self._good[0], self.smoothed
            return True
        self.rollbacks += 1
        self.rate /= 2
        if self.rollbacks > MOST_ROLLBACKS:
            raise NonFiniteError(
                f"the optimisation diverged at iteration {iteration} (loss {value:.3g}, best "
                f"{self._best:.3g}), although the learning rate was halved {MOST_ROLLBACKS} times. "
                f"Lower it from {self._first_rate:g}, or check for extreme values in the smoke "
                "and in the settings of losses and optics."
            )
        self._put(self._good[0])
        self.adam.restore(self._good[1])
        return False

    def _was_so_before(self, value: float, loss_again: Callable[[], float]) -> bool:
        """Whether the state to roll back to has about this loss too; no step is to blame then."""
        here = [p.detach().clone() for p in self.parameters]
        self._put(self._good[0])
        before = loss_again()
        if not value <= BLOW_UP * before:  # NaN too
            return False
        self._put(here)
        self._best = max(self._best, before)
        return True

    def settle(self, latest: Minimum | None, loss: Callable[[int], float], n: int) -> Minimum:
        """The end: the last state, or the best remembered one where that is clearly better.

        After a rollback the last step is not trusted before its loss has been looked at.

        Args:
            loss: of an iteration, with the parameters as they are then.
            n: number of iterations.
        """
        if latest is None:
            raise NonFiniteError(
                f"the loss or its gradient was NaN or infinite in all {self.rollbacks} iterations. "
                "Check for extreme values in the smoke and in the settings of losses, optics and "
                "learning rates."
            )
        worse = self.rollbacks > 0 and not self._is_sound(loss(n))
        restored = worse or self._is_worse(loss, latest.iteration + 1)
        if restored:
            self._put(self._kept)
        return replace(
            latest,
            smoothed=self._kept_loss if restored else self.smoothed,
            rollbacks=self.rollbacks,
            reason=latest.reason or "iterations",
            restored=restored,
        )

    def _is_worse(self, loss: Callable[[int], float], n: int) -> bool:
        """Whether the last state is clearly worse than the best one, not only its iterations."""
        if self.smoothed <= WORSE * self._kept_loss:
            return False
        shown, here = range(max(n - LOOKS, 0), n), [p.detach().clone() for p in self.parameters]
        last = math.fsum(map(loss, shown))
        self._put(self._kept)
        best = math.fsum(map(loss, shown))
        self._put(here)
        return not last <= WORSE * best  # NaN too

    def _is_sound(self, value: float) -> bool:
        if not math.isfinite(value):
            return False
        limit = BLOW_UP * max(self._best, NOISE * self._first_loss)
        return not value > limit or limit == 0  # before the first loss there is no limit (NaN)

    def _put(self, kept: list[Tensor]) -> None:
        with torch.no_grad():
            for p, values in zip(self.parameters, kept, strict=True):
                p.copy_(values)

"""Adam that does not lose what it has: it rolls back, slows down and stops when converged.

It minimises any objective and knows nothing of smoke, so it can be tested on a quadratic bowl.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import torch
from torch import Tensor

from usdsmoke.errors import NonFiniteError

__all__ = ["Adam", "Minimum", "minimize"]

BLOW_UP = 10.0  # a loss this many times the best recent one counts as a step gone wrong
MOST_ROLLBACKS = 12
REMEMBER_EVERY = 8  # iterations between two states to roll back to


@dataclass
class Adam:
    """Adam's moments for a list of tensors. [Kingma2015, algorithm 1]"""

    betas: tuple[float, float] = (0.9, 0.99)
    epsilon: float = 1e-8
    n_steps: int = 0
    first: list[Tensor] = field(default_factory=list)
    second: list[Tensor] = field(default_factory=list)

    def step(self, parameters: list[Tensor], gradients: list[Tensor], rate: float) -> None:
        """Moves the parameters in place by one step of size ``rate``."""
        if not self.first:
            self.first = [torch.zeros_like(p) for p in parameters]
            self.second = [torch.zeros_like(p) for p in parameters]
        self.n_steps += 1
        b1, b2 = self.betas
        unbias = math.sqrt(1 - b2**self.n_steps) / (1 - b1**self.n_steps)
        for p, g, m, v in zip(parameters, gradients, self.first, self.second, strict=True):
            m.mul_(b1).add_(g, alpha=1 - b1)
            v.mul_(b2).addcmul_(g, g, value=1 - b2)
            p.addcdiv_(m, v.sqrt().add_(self.epsilon), value=-rate * unbias)

    def copy(self) -> "Adam":
        """The same state in tensors of its own."""
        return Adam(
            self.betas,
            self.epsilon,
            self.n_steps,
            [t.clone() for t in self.first],
            [t.clone() for t in self.second],
        )


@dataclass(frozen=True)
class Minimum:
    """Where an optimisation ended; yielded after every iteration, the last one is the result."""

    iteration: int
    loss: float
    smoothed: float
    rollbacks: int
    rate: float
    reason: str  # "" while running, then "iterations" or "converged"


def _schedule(fraction: float) -> float:
    """Share of the rate: full for the first half, then linearly down to a tenth."""
    return 1.0 if fraction < 0.5 else 1.0 - 0.9 * (fraction - 0.5) / 0.5


def minimize(
    objective: Callable[[int], Tensor],
    parameters: list[Tensor],
    rate: float,
    n_iterations: int,
    project: Callable[[], None] | None = None,
    tolerance: float = 0.0,
    adam: Adam | None = None,
) -> Iterator[Minimum]:
    """Minimises ``objective`` over ``parameters`` in place, one iteration per item.

    A loss or gradient that is not finite, or a loss ten times the recent best, rolls the parameters
    and moments back to the last good state and halves the rate. The run ends early when the
    smoothed loss has fallen by less than ``tolerance`` (relative) over a quarter of the iterations.

    Args:
        objective: iteration -> scalar loss; draws whatever it draws by that number.
        parameters: leaf tensors that require gradients; changed in place.
        rate: Adam's step.
        n_iterations: at most this many; 0 yields nothing.
        project: called after each step, e.g. to clip colours to their range.
        tolerance: 0 never stops early.
        adam: moments carried over from an earlier run.

    Raises:
        NonFiniteError: still not finite after many halvings.
    """
    state = _State(parameters, adam or Adam(), rate)
    history: list[float] = []
    span = max(n_iterations // 4, 10)
    for iteration in range(n_iterations):
        loss = objective(iteration)
        gradients = list(torch.autograd.grad(loss, parameters))
        value = float(loss.detach())
        if not state.accept(iteration, value, gradients):
            continue
        smoothed = value if not history else 0.9 * history[-1] + 0.1 * value
        history.append(smoothed)
        state.best = min(state.best, smoothed)
        now = state.rate * _schedule(iteration / n_iterations)
        with torch.no_grad():
            state.adam.step(parameters, gradients, now)
            if project is not None:
                project()
        stalled = len(history) > span and history[-1 - span] - smoothed < tolerance * abs(smoothed)
        ended = "converged" if stalled else "iterations" if iteration == n_iterations - 1 else ""
        yield Minimum(iteration, value, smoothed, state.rollbacks, now, ended)
        if stalled:
            return


class _State:
    """Where an optimisation stands, and where it stood when all was well."""

    def __init__(self, parameters: list[Tensor], adam: Adam, rate: float) -> None:
        self.parameters, self.adam, self.rate = parameters, adam, rate
        self.first_rate = rate
        self.best = math.inf
        self.rollbacks = 0
        self._remember()

    def _remember(self) -> None:
        self._good = ([p.detach().clone() for p in self.parameters], self.adam.copy())

    def accept(self, iteration: int, value: float, gradients: list[Tensor]) -> bool:
        """True when the step may be taken; else everything is rolled back and the rate halved."""
        sound = math.isfinite(value) and all(bool(torch.isfinite(g).all()) for g in gradients)
        if sound and value <= BLOW_UP * self.best:
            if iteration % REMEMBER_EVERY == 0:
                self._remember()
            return True
        self.rollbacks += 1
        self.rate /= 2
        if self.rollbacks > MOST_ROLLBACKS:
            raise NonFiniteError(
                f"the optimisation diverges at iteration {iteration}: loss {value:.3g}, best "
                f"{self.best:.3g}, after {MOST_ROLLBACKS} halvings of the learning rate from "
                f"{self.first_rate:g}; "
                "lower the learning rate and look for extreme values in the inputs"
            )
        with torch.no_grad():
            for p, kept in zip(self.parameters, self._good[0], strict=True):
                p.copy_(kept)
        self.adam = self._good[1].copy()
        return False

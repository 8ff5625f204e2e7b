"""Adam that does not lose what it has: rolls back, slows down, stops when converged, keeps the best.

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
            self.betas, self.epsilon, self.n_steps, [t.clone() for t in self.first], [t.clone() for t in self.second]
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

    A loss or gradient that is not finite, or a loss ten times the recent best, rolls the parameters and moments back
    to the last good state and halves the rate. The run ends early when the smoothed loss has fallen by less than
    ``tolerance`` (relative) over a quarter of the iterations.

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
    adam = adam or Adam()
    good = ([p.detach().clone() for p in parameters], adam.copy())
    smoothed = best = math.inf
    rollbacks, slow = 0, 1.0
    history: list[float] = []
    span = max(n_iterations // 4, 10)
    for iteration in range(n_iterations):
        loss = objective(iteration)
        gradients = list(torch.autograd.grad(loss, parameters))
        value = float(loss.detach())
        sound = math.isfinite(value) and all(bool(torch.isfinite(g).all()) for g in gradients)
        if not sound or value > BLOW_UP * best:
            rollbacks, slow = rollbacks + 1, slow / 2
            if rollbacks > MOST_ROLLBACKS:
                raise NonFiniteError(
                    f"the optimisation diverges at iteration {iteration}: loss {value:.3g}, best {best:.3g}, "
                    f"after {MOST_ROLLBACKS} reductions of the learning rate from {rate:g}; "
                    "lower the learning rate and look for extreme values in the inputs"
                )
            with torch.no_grad():
                for p, kept in zip(parameters, good[0], strict=True):
                    p.copy_(kept)
            adam = good[1].copy()
            continue
        if iteration % 8 == 0:
            good = ([p.detach().clone() for p in parameters], adam.copy())
        smoothed = value if math.isinf(smoothed) else 0.9 * smoothed + 0.1 * value
        best = min(best, smoothed)
        history.append(smoothed)
        now = rate * slow * _schedule(iteration / n_iterations)
        with torch.no_grad():
            adam.step(parameters, gradients, now)
            if project is not None:
                project()
        stalled = len(history) > span and history[-1 - span] - smoothed < tolerance * abs(smoothed)
        ended = "converged" if stalled else "iterations" if iteration == n_iterations - 1 else ""
        yield Minimum(iteration, value, smoothed, rollbacks, now, ended)
        if stalled:
            return
